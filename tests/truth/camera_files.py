"""Writers of camera files, from the descriptions of their formats: Andor SIF, Hamamatsu .img,
Princeton Instruments SPE.
"""

import struct
from pathlib import Path

import numpy as np


def write_sif(
    path: Path,
    data: np.ndarray,
    *,
    version: int = 65559,
    background: np.ndarray | None = None,
    head: str = "DU897_BV",
    mode: int = 3,
    exposure_s: float = 0.02,
    accumulations: int = 1,
    temperature_c: float = -70.0,
    gain: int = 0,
    gate_ps: float = 0.0,
    real_gain: bool = False,
) -> Path:
    """Write frames (frame, row, col) as a version of Andor Solis does.

    Fields appear with the version that introduced them, after the structures TInstaImage,
    TCalibImage and TImage of Andor (as printed by read_sif.c of the Python package andor-sif).
    """
    minor = version - 65536
    sections = [data] if background is None else [data, background]
    out = b"Andor Technology Multi-Channel File\n65538 1\n"
    for at, frames in enumerate(sections):
        count, rows, cols = frames.shape
        words = [version, 0, 0, 1, 1254330082, f"{temperature_c:g}"]
        # Five bytes: head, store type, data type, mode, trigger; a byte may be the end of a line
        line = " ".join(map(str, words)).encode() + bytes(
            [32, 0, 32, 0, 32, 10, 32, mode, 32, 0, 32]
        )
        words = [0, f"{exposure_s:g}", 0.03, 0.03, accumulations]
        line += " ".join(map(str, words)).encode() + b" \0 "
        words = [0.03, 1e-7, 0, 1, gain, 0, f"{gate_ps:g}"] + [0] * (minor >= 6) + [0, count]
        line += " ".join(map(str, words)).encode() + b" \1 \0 "
        words = [0] * (3 * (minor >= 7) + 8 * (minor >= 8)) + [0, 5e-7] * (minor >= 9)
        words += [0, 1.0] * (minor >= 10) + [3425] * (minor >= 11) + [1] * (minor >= 13)
        words += [1] * (minor >= 14) + [-999, 0] * (minor >= 15) + [0] * (minor >= 16)
        words += [int(real_gain)] * (minor >= 17) + [0] * (minor >= 18) + [-1] * (minor >= 19)
        words += [0] * (minor >= 20) + [4, 12, 30003, 0] * (minor >= 21) + [0, 0] * (minor >= 23)
        line += " ".join(map(str, words)).encode() + b" %d\n" % len(head)
        text = f"{head}\n{cols} {rows}\n9\nseries.sif\n65538 4\nnote65538 "
        line += text.encode() + b"\1 \1 \0 \0 0 0\n"
        if minor >= 12:
            text = "65536 0 0 0 0 0 0 650NM\n0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 "
            line += text.encode() + b"\n" * (minor < 22)
        if minor >= 22:
            line += b"65536 0 0 0\n0 spectrograph\n"
        line += b"65539 \1 \0 \1 \0 \1 \0\n0 1 0 0\n0 1 0 0\n0 1 0 0\n0\n13\n13\n"
        line += b"12\nPixel number6\nCounts12\nPixel number"
        line += f"65538 1 {rows} {cols} 1 {count} 1 {frames.size} {rows * cols}\n".encode()
        line += f"65538 1 {rows} {cols} 1 1 1 0\n".encode() + b"         0\n" * count
        last = at == len(sections) - 1
        out += line + frames.astype("<f4").tobytes() + (b"0\n" if last else b"1\n")
    path.write_bytes(out + b"0\n0\n0\n" * (background is None))
    return path


def write_img(path: Path, image: np.ndarray, comment: str) -> Path:
    """Write an image (row, col) of 8, 16 or 32 bits as HPD-TA does (HPD-TA User Manual)."""
    rows, cols = image.shape
    text = comment.encode()
    kind = {1: 0, 2: 2, 4: 3}[image.dtype.itemsize]
    header = struct.pack("<2s6HI", b"IM", len(text), cols, rows, 0, 0, kind, 0)
    path.write_bytes(
        header.ljust(64, b"\0") + text + image.astype(image.dtype.newbyteorder("<")).tobytes()
    )
    return path


def write_spe(path: Path, data: np.ndarray, xml: str | None = None, **fields: float) -> Path:
    """Write frames (frame, row, col) of 16 bits as WinView does, or with the settings `xml` as
    LightField does (Princeton Instruments, SPE 3.0 File Format Specification).
    """
    frames, rows, cols = data.shape
    places = {
        "avgexp": (2, "<h"),
        "exp_sec": (10, "<f"),
        "DetTemperature": (36, "<f"),
        "PulserType": (94, "<h"),
        "PulseRepWidth": (118, "<f"),
        "PImaxUsed": (144, "<h"),
        "PImaxGain": (148, "<h"),
        "lavgexp": (668, "<I"),
    }
    header = bytearray(4100)
    stated = [(*places[name], value) for name, value in fields.items()]
    stated += [(42, "<H", cols), (656, "<H", rows), (108, "<h", 3), (1446, "<i", frames)]
    stated += [(1992, "<f", 2.5 if xml is None else 3.0), (678, "<Q", 4100 + 2 * data.size)]
    for offset, form, value in stated:
        struct.pack_into(form, header, offset, value)
    footer = ""
    if xml is not None:
        size = 2 * rows * cols
        footer = (
            '<SpeFormat version="3.0" xmlns="http://www.princetoninstruments.com/spe/2009">'
            f'<DataFormat><DataBlock type="Frame" count="{frames}" size="{size}" stride="{size}">'
            f'<DataBlock type="Region" width="{cols}" height="{rows}" size="{size}"/></DataBlock>'
            f"</DataFormat><DataHistories>{xml}</DataHistories></SpeFormat>"
        )
    path.write_bytes(bytes(header) + data.astype("<u2").tobytes() + footer.encode())
    return path
