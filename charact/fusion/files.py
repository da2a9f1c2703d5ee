"""Files of a fusion: pictures, maps and settings of a fused picture or sequence."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.fusion.fused import MARKS, Fused
from labdata import BadInput, read_frames, write_atomically

Region = tuple[int, int, int, int]
SETTINGS, PAGE = "fused.json", "index.html"


def require_place(out: Path, *, is_folder: bool, name: str = "out") -> None:
    """Raise BadInput unless a path is one of a folder, or of a picture where that is enough."""
    if out.suffix and is_folder:
        raise BadInput(
            f"{name} must be a folder for several methods or a sequence, got {out.name!r}"
        )
    if out.suffix.lower() not in ("", ".png", ".tif", ".tiff"):
        raise BadInput(f"{name} must be a folder, .png or .tif, got {out.name!r}")


def read_codes(picture: str | Path | NDArray) -> NDArray[np.uint8]:
    """Return the 8-bit codes of a picture, (row, col) or (row, col, 3); other values in a file are
    BadInput.
    """
    if not isinstance(picture, str | Path):
        return np.asarray(picture)
    try:
        planes = [read_frames(picture, plane).data[0] for plane in ("r", "g", "b")]
    except BadInput:
        planes = [read_frames(picture).data[0]]
    codes = planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)
    if codes.dtype != np.uint8:
        raise BadInput(
            f"scores are of pictures of 8 bits, got {codes.dtype} in {picture}: score fused.png, "
            "not fused.tif"
        )
    return codes


def region_of(picture: Path) -> Region | None:
    """Return the region of the visible frame that a fused picture shows, by the settings in its
    folder.
    """
    settings = picture.parent / SETTINGS
    try:
        region = json.loads(settings.read_text())["region"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return None if region is None else (region[0], region[1], region[2], region[3])


def write(
    pictures: Mapping[str, Fused],
    shown: Sequence[NDArray[np.uint8]],
    out: Path,
    given: Sequence[str],
    region: Region | None,
) -> None:
    """Write bands as codes of 8 bits and fused pictures to a folder, or one picture to a .png or
    .tif.

    Of several methods each has a folder in it.
    """
    first = next(iter(pictures.values()))
    if out.suffix:
        write_atomically(
            out, _png(first.codes) if out.suffix.lower() == ".png" else _tiff(first.picture)
        )
        return
    out.mkdir(parents=True, exist_ok=True)
    for name, band in zip(first.names, shown, strict=True):
        write_atomically(out / f"{name}.png", _png(band))
    for name, fused in pictures.items():
        folder = out if len(pictures) == 1 else out / name
        folder.mkdir(exist_ok=True)
        _write_maps(fused, folder)
        write_atomically(folder / SETTINGS, _settings(fused, name, given, region))
        for file, picture in (("fused.tif", fused.picture), ("sd.tif", fused.sd)):
            write_atomically(folder / file, _tiff(picture))


def write_sequence(
    frames: Sequence[Fused],
    out: Path,
    given: Sequence[str],
    region: Region | None,
    time_s: Sequence[float] | None,
) -> None:
    """Write a sequence: fused.tif and sd.tif with all frames, and the maps of the first one."""
    first = frames[0]
    out.mkdir(parents=True, exist_ok=True)
    _write_maps(first, out)
    more: dict[str, Any] = {"frames": len(frames), "time_s": time_s}
    write_atomically(
        out / SETTINGS, _settings(first, first.measurements[0].method, given, region, **more)
    )
    for file, pictures in (
        ("fused.tif", [f.picture for f in frames]),
        ("sd.tif", [f.sd for f in frames]),
    ):
        write_atomically(out / file, _tiff(np.stack(pictures)))


def _write_maps(fused: Fused, folder: Path) -> None:
    contents = {
        "fused.png": _png(fused.codes),
        "share.tif": _tiff(fused.share),
        "mask.png": _png(fused.marks),
    }
    for name, content in contents.items():
        write_atomically(folder / name, content)


def _settings(
    fused: Fused, method: str, given: Sequence[str], region: Region | None, **more: Any
) -> bytes:
    document = {
        "method": method,
        "bands": dict(zip(fused.names, given, strict=True)),
        "spans": fused.spans,
        "region": region,
        "marks": MARKS,
        **more,
    }
    return json.dumps(document, indent=1).encode()


def _png(picture: NDArray) -> bytes:
    import io

    from PIL import Image

    content = io.BytesIO()
    Image.fromarray(picture).save(content, format="png")
    return content.getvalue()


def _tiff(values: NDArray) -> bytes:
    import io

    import tifffile

    content = io.BytesIO()
    colour = values.ndim > 2 and values.shape[-1] == 3
    tifffile.imwrite(
        content,
        np.ascontiguousarray(values, np.float32),
        photometric="rgb" if colour else "minisblack",
        metadata=None,
    )
    return content.getvalue()
