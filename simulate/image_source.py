"""Input of a simulation from files: images in DN, and cubes of spectral radiance."""

import math
import zipfile
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.file_io import require_regular, require_room

if TYPE_CHECKING:
    from simulate.radiance.cube import RadianceCube


def read_image(
    source: Path | NDArray[Any],
    *,
    photoelectrons_per_dn: float | None,
    black_dn: float,
    shape: tuple[int, int],
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Return the first frame of a file or array as mean photoelectrons on a frame of a camera, with
    notes.

    The image is centred on rows and columns `shape`, cropped or padded with darkness; the scale is
    as in `SimulationRequest`. Raises BadInput if the file cannot be read, a pixel is negative or
    not finite, or the scale is missing or not positive.
    """
    from labdata.importers import read_array, read_frames

    scale = photoelectrons_per_dn
    if scale is None:
        raise BadInput(
            "an image needs photoelectrons_per_dn, mean photoelectrons per pixel and exposure "
            "for each DN, got none"
        )
    if not (math.isfinite(scale) and scale > 0.0):
        raise BadInput(f"photoelectrons_per_dn must be positive, got {scale:g}")
    if not math.isfinite(black_dn):
        raise BadInput(f"black_dn must be a number, got {black_dn:g}")
    stack = read_frames(source) if isinstance(source, Path) else read_array(source)
    name = name_of(source)
    image = stack.data[0].astype(np.float64)
    if image.min() < 0.0:
        raise BadInput(f"an image must have no negative pixel, got {image.min():g} in {name}")
    signal_dn = image - black_dn
    dark_pixels = int(np.count_nonzero(signal_dn < 0.0))
    frame_image, how = centre_on_frame(np.maximum(signal_dn, 0.0) * scale, shape)
    notes = [
        f"{name}: {scale:g} photoelectrons per DN above {black_dn:g} DN, per pixel and exposure",
        *how,
    ]
    notes += [f"first of {len(stack)} frames of {name}"] if len(stack) > 1 else []
    notes += [f"{dark_pixels} pixels below {black_dn:g} DN count as dark"] if dark_pixels else []
    return frame_image.astype(np.float32), (*notes, *stack.notes)


def name_of(source: Path | NDArray[Any]) -> str:
    """Return the name of a source in messages."""
    return source.name if isinstance(source, Path) else "the array"


def centre_on_frame(
    image: NDArray[np.floating], shape: tuple[int, int]
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return an image centred on a frame, cropped or padded with zeros, and a note if its shape
    differs.
    """
    frame = np.zeros(shape)
    frame_slices, image_slices = [], []
    for size, room in zip(image.shape, shape, strict=True):
        shift, length = (room - size) // 2, min(size, room)
        frame_slices.append(slice(max(shift, 0), max(shift, 0) + length))
        image_slices.append(slice(max(-shift, 0), max(-shift, 0) + length))
    frame[tuple(frame_slices)] = image[tuple(image_slices)]
    sizes = list(zip(image.shape, shape, strict=True))
    actions = ["cropped"] * any(size > room for size, room in sizes)
    actions += ["padded with darkness"] * any(size < room for size, room in sizes)
    (rows, cols), (height, width) = image.shape, shape
    note = (
        f"the image of {rows} x {cols} pixels is centred on the frame of {height} x {width}, "
        f"{' and '.join(actions)}"
    )
    return frame, (note,) if actions else ()


def read_cube(path: Path) -> "RadianceCube":
    """Read a radiance cube, an .npz of `wavelength_nm` (band,) and `radiance` (band, row, col), W
    m-2 sr-1 nm-1.
    """
    from simulate.radiance.cube import RadianceCube

    require_regular(path, "a radiance cube")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            unpacked_bytes = sum(member.file_size for member in archive.zip.infolist())
            require_room(path, pixels=unpacked_bytes // 8, pixel_bytes=8)
            missing = sorted({"wavelength_nm", "radiance"} - set(archive.files))
            arrays = (
                {} if missing else {name: archive[name] for name in ("wavelength_nm", "radiance")}
            )
    except BadInput:
        raise
    except (
        ValueError,
        TypeError,
        AttributeError,
        EOFError,
        MemoryError,
        zlib.error,
        zipfile.BadZipFile,
    ):
        raise BadInput(f"a radiance cube must be a complete .npz file, got {path.name}") from None
    if missing:
        raise BadInput(
            "a radiance cube must contain wavelength_nm and radiance, got no "
            f"{' and no '.join(missing)}"
        )
    if any(array.dtype.kind not in "uif" for array in arrays.values()):
        raise BadInput(
            "wavelength_nm and radiance must be numbers, got "
            f"{[str(a.dtype) for a in arrays.values()]}"
        )
    if (
        not all(np.isfinite(array).all() for array in arrays.values())
        or arrays["radiance"].min(initial=0.0) < 0.0
    ):
        raise BadInput(
            f"radiance must be finite and not negative, got another value in {path.name}"
        )
    return RadianceCube(**arrays)
