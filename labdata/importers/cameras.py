"""Files of camera software: Princeton Instruments SPE, Andor SIF, SER of astronomical and machine cameras."""

import struct
import warnings
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, COLOUR, FRAME, ROW
from labdata.importers.recorded import Recorded

SER_MAGIC = b"LUCAM-RECORDER"
SER_HEADER_BYTES = 178
SER_MOSAICS = {8: "rggb", 9: "grbg", 10: "gbrg", 11: "bggr"}
SER_COLOURS = {0: 1, 100: 3, 101: 3}
"""Samples of a pixel by ColorID: grey, RGB, BGR (SER format description version 3, Grischa Hahn)."""


def read(path: Path) -> Recorded:
    """Read a file of camera software; see `labdata.importers.read_frames`."""
    reader = {".spe": _spe, ".sif": _sif, ".ser": _ser}[path.suffix.lower()]
    try:
        with warnings.catch_warnings(action="ignore"):
            return reader(path)
    except (BadInput, MemoryError):
        raise
    except Exception:
        kind = path.suffix[1:].upper()
        raise BadInput(f"a {kind} file must be whole and readable, got something else in {path}") from None


def _spe(path: Path) -> Recorded:
    """SPE 2.x (WinView, WinSpec) and 3.0 (LightField) by imageio's plugin."""
    from imageio.v3 import imopen

    with imopen(path, "r", plugin="SPE") as file:
        frames, *picture = file.properties(index=...).shape
        stated = frames * int(np.prod(picture)) * file.properties(index=...).dtype.itemsize
        if stated > path.stat().st_size:
            raise BadInput(f"an SPE file must be whole, got {path} of fewer bytes than the {stated} of its frames")
        return Recorded(data=np.asarray(file.read(index=...)), names=(FRAME, ROW, COL))


def _sif(path: Path) -> Recorded:
    try:
        import sif_parser
    except ImportError:
        raise BadInput(f"Andor SIF files need sif_parser, got {path.name}: pip install 'charact[sif]'") from None
    with path.open("rb") as file:
        data, _ = sif_parser.np_open(file)
    return Recorded(data=data, names=(FRAME, ROW, COL))


def _ser(path: Path) -> Recorded:
    """SER version 3: a header of 178 bytes, then the frames."""
    with path.open("rb") as file:
        header = file.read(SER_HEADER_BYTES)
    if not header.startswith(SER_MAGIC):
        raise BadInput(f"a .ser file must be a SER recording, got something else in {path}")
    colour, little, columns, rows, bits, frames = struct.unpack_from("<6I", header, 18)
    samples = 1 if colour in SER_MOSAICS else SER_COLOURS.get(colour)
    if samples is None or not 1 <= bits <= 16:
        raise BadInput(
            f"a SER file must be grey, a Bayer mosaic or RGB of up to 16 bits, got ColorID {colour} in {path}"
        )
    # Most writers set the flag of the byte order the wrong way round: 0 is little-endian (Siril, FireCapture, PIPP).
    kind = np.dtype("u1" if bits <= 8 else ">u2" if little else "<u2")
    shape = (frames, rows, columns, samples)
    if SER_HEADER_BYTES + int(np.prod(shape, dtype=object)) * kind.itemsize > path.stat().st_size:
        raise BadInput(f"a SER file must be whole, got {path} of fewer bytes than its {frames} frames")
    data = np.memmap(path, kind, "r", SER_HEADER_BYTES, shape)
    data = data[..., ::-1] if colour == 101 else data
    names = (FRAME, ROW, COL, COLOUR)
    full_scale_dn = float(2**bits - 1) if data.max(initial=0) <= 2**bits - 1 else None
    return Recorded(data=data, names=names, pattern=SER_MOSAICS.get(colour), full_scale_dn=full_scale_dn)
