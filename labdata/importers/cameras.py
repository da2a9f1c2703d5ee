"""Readers of camera software files: Princeton Instruments SPE, Andor SIF, SER."""

import io
import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, COLOUR, FRAME, ROW, Recorded, optional_module

SPE_HEADER_BYTES = 4100
# Header fields: byte offset and format (Princeton Instruments, SPE 3.0 File Format Specification,
# appendix A)
SPE_FIELDS = {
    "cols": (42, "<H"),
    "type": (108, "<h"),
    "rows": (656, "<H"),
    "footer": (678, "<Q"),
    "frames": (1446, "<i"),
    "version": (1992, "<f"),
}
SPE_TYPES = {0: "<f4", 1: "<i4", 2: "<i2", 3: "<u2", 5: "<f8", 6: "u1", 8: "<u4"}

SER_MAGIC = b"LUCAM-RECORDER"
SER_HEADER_BYTES = 178
SER_MOSAICS = {8: "rggb", 9: "grbg", 10: "gbrg", 11: "bggr"}
# Samples per pixel by ColorID: grey, RGB, BGR (SER format description version 3, Grischa Hahn)
SER_COLOURS = {0: 1, 100: 3, 101: 3}


def read(path: Path) -> Recorded:
    """Read a file of camera software; see `labdata.importers.read_frames`."""
    return {".spe": _spe, ".sif": _sif, ".ser": _ser}[path.suffix.lower()](path)


def _spe(path: Path) -> Recorded:
    """SPE 2.x (WinView, WinSpec) by its header, 3.0 (LightField) by the XML at its end."""
    content = np.memmap(path, np.uint8, "r")
    header = content[:SPE_HEADER_BYTES].tobytes()
    field = {
        name: struct.unpack_from(form, header, at)[0] for name, (at, form) in SPE_FIELDS.items()
    }
    kind = np.dtype(SPE_TYPES[field["type"]])
    frames, rows, cols = field["frames"], field["rows"], field["cols"]
    stride = rows * cols * kind.itemsize
    if field["version"] >= 3.0:
        blocks = [
            block.attrib
            for block in ElementTree.fromstring(content[field["footer"] :].tobytes()).iter()
            if block.tag.endswith("}DataBlock")
        ]
        frame, regions = blocks[0], blocks[1:]
        if len(regions) != 1:
            raise BadInput(
                f"an SPE file must hold one region a frame, got {len(regions)} in {path}"
            )
        # Recorded time stamps lie between the frames.
        frames, stride = int(frame["count"]), int(frame["stride"])
        rows, cols = int(regions[0]["height"]), int(regions[0]["width"])
    if SPE_HEADER_BYTES + (frames - 1) * stride + rows * cols * kind.itemsize > content.size:
        raise BadInput(
            f"an SPE file must be whole, got {path} of fewer bytes than its {frames} frames"
        )
    strides = (stride, cols * kind.itemsize, kind.itemsize)
    data = np.ndarray((frames, rows, cols), kind, content, SPE_HEADER_BYTES, strides)
    return Recorded(data=data, names=(FRAME, ROW, COL))


def _sif(path: Path) -> Recorded:
    sif_parser = optional_module("sif_parser", "sif", path)
    with _EndingFile(io.FileIO(path)) as file:
        data = np.asarray(sif_parser.np_open(file)[0])
    return Recorded(data=data, names=(FRAME, ROW, COL))


class _EndingFile(io.BufferedReader):
    """A file whose end is an error, since the library looks there for a next word for ever."""

    def read(self, size: int | None = -1) -> bytes:
        if not (data := super().read(size)) and size:
            raise EOFError("it is cut off")
        return data


def _ser(path: Path) -> Recorded:
    """SER version 3: a header of 178 bytes, then the frames."""
    with path.open("rb") as file:
        header = file.read(SER_HEADER_BYTES)
    if not header.startswith(SER_MAGIC):
        raise BadInput(f"a .ser file must be a SER recording, got something else in {path}")
    colour, is_little_endian, columns, rows, bits, frames = struct.unpack_from("<6I", header, 18)
    samples = 1 if colour in SER_MOSAICS else SER_COLOURS.get(colour)
    if samples is None or not 1 <= bits <= 16:
        raise BadInput(
            f"a SER file must be grey, a Bayer mosaic or RGB of up to 16 bits, got ColorID "
            f"{colour} in {path}"
        )
    # Most writers invert the byte-order flag: 0 is little-endian (Siril, FireCapture, PIPP).
    kind = np.dtype("u1" if bits <= 8 else ">u2" if is_little_endian else "<u2")
    shape = (frames, rows, columns, samples)
    if SER_HEADER_BYTES + int(np.prod(shape, dtype=object)) * kind.itemsize > path.stat().st_size:
        raise BadInput(
            f"a SER file must be whole, got {path} of fewer bytes than its {frames} frames"
        )
    data = np.memmap(path, kind, "r", SER_HEADER_BYTES, shape)
    data = data[..., ::-1] if colour == 101 else data
    names = (FRAME, ROW, COL, COLOUR)
    full_scale_dn = float(2**bits - 1) if data.max(initial=0) <= 2**bits - 1 else None
    return Recorded(
        data=data, names=names, pattern=SER_MOSAICS.get(colour), full_scale_dn=full_scale_dn
    )
