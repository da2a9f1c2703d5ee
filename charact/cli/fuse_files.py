"""Files of the verb `fuse`: pictures, maps and settings of a fused picture or sequence."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.cli.outputs import require_free
from charact.fusion.fused import MARKS, Fused
from labdata.errors import BadInput
from labdata.file_io import write_atomically

Region = tuple[int, int, int, int]
SETTINGS, PAGE = "fused.json", "index.html"


def require_free_output(out: Path, *, force: bool) -> None:
    """Require a new output; --force replaces a picture, or a folder that holds fused pictures."""
    if out.suffix.lower() in (".png", ".tif", ".tiff"):
        require_free(out, force=force, kept=lambda: None if out.is_file() else "a folder")
    elif out.suffix:
        raise BadInput(f"OUT must be a folder, .png or .tif, got {out.name!r}")
    else:
        taken = out.exists() and (not out.is_dir() or any(out.iterdir()))
        ours = (out / SETTINGS).is_file() or (out / PAGE).is_file()
        require_free(
            out,
            force=force,
            taken=taken,
            kept=lambda: None if ours else f"something without a {SETTINGS}",
        )


def picture_of(out: Path, method: str | None = None) -> Path:
    """Return the path of a fused picture of 8 bits; `method`: of several."""
    if out.suffix:
        return out
    return (out if method is None else out / method) / "fused.png"


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
    found: dict[str, Fused],
    shown: Sequence[NDArray[np.uint8]],
    out: Path,
    given: Sequence[str],
    region: Region | None,
) -> None:
    """Write bands as codes of 8 bits and fused pictures to a folder, or one picture to a .png or
    .tif.

    Of several methods each has a folder in it.
    """
    first = next(iter(found.values()))
    if out.suffix:
        write_atomically(
            out, _png(first.codes) if out.suffix.lower() == ".png" else _tiff(first.picture)
        )
        return
    out.mkdir(parents=True, exist_ok=True)
    for name, band in zip(first.names, shown, strict=True):
        write_atomically(out / f"{name}.png", _png(band))
    for name, one in found.items():
        folder = out if len(found) == 1 else out / name
        folder.mkdir(exist_ok=True)
        _write_maps(one, folder)
        write_atomically(folder / SETTINGS, _settings(one, name, given, region))
        for file, picture in (("fused.tif", one.picture), ("sd.tif", one.sd)):
            write_atomically(folder / file, _tiff(picture))


def write_sequence(
    frames: Sequence[Fused],
    out: Path,
    given: Sequence[str],
    region: Region | None,
    time_s: list[float] | None,
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


def _write_maps(found: Fused, folder: Path) -> None:
    contents = {
        "fused.png": _png(found.codes),
        "share.tif": _tiff(found.share),
        "mask.png": _png(found.marks),
    }
    for name, content in contents.items():
        write_atomically(folder / name, content)


def _settings(
    found: Fused, method: str, given: Sequence[str], region: Region | None, **more: Any
) -> bytes:
    document = {
        "method": method,
        "bands": dict(zip(found.names, given, strict=True)),
        "spans": found.spans,
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
