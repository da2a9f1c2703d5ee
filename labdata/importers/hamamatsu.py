"""Reader of Hamamatsu .img files (ITEX), as HiPic and HPD-TA write them.

A header of 64 bytes, little-endian: "IM", length of the comment, columns, rows, two offsets, type
of the pixels, number of further images. The comment follows, in sections `[Name],key=value,...`
(HPD-TA User Manual, appendix "ITEX file format"), then the pixels.
"""

import re
import struct
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.file_io import require_picture
from labdata.importers.axes import COL, FRAME, ROW, Recorded
from labdata.importers.headers import TIMES_S, Stated, stated
from labdata.importers.parts import whole_frames

HEADER_BYTES = 64
TYPES = {0: "u1", 2: "<u2", 3: "<u4"}
PHOTON_COUNTING, ANALOG_INTEGRATION = "3", "4"  # Modes whose image is a sum of exposures
SECTION = re.compile(r"\[([^\[\]]+)\],?([^\[]*)")
ENTRY = re.compile(r'([^,="\r\n]+)=("[^"]*"|[^,\r\n]*)')
# Corrections of the software, which change noise and level
CORRECTIONS = {
    "BacksubCorr": "a background was subtracted",
    "ShadingCorr": "shading was corrected",
    "CurveCorr": "curvature was corrected",
    "DefectCorrection": "defects were replaced",
}


def read(path: Path) -> Recorded:
    """Read the image; see `labdata.importers.read_frames`."""
    start, rows, cols, kind, comment = _header(path)
    pixels = np.dtype(kind).itemsize * rows * cols
    whole_frames(
        path.name,
        frames=1,
        start=start,
        stride=pixels,
        frame_bytes=pixels,
        size=path.stat().st_size,
        partial=False,
    )
    data = np.memmap(path, kind, "r", start, (1, rows, cols))
    acquisition = comment.get("Acquisition", {})
    changes = [text for key, text in CORRECTIONS.items() if acquisition.get(key) == "-1"]
    notes = (
        [f"the camera's software changed the pixels: {' and '.join(changes)}"] if changes else []
    )
    if acquisition.get("AcqMode") == PHOTON_COUNTING:
        notes.append("the pixels are counts of photons, not grey values of a camera")
    return Recorded(data=data, names=(FRAME, ROW, COL), notes=tuple(notes))


def _header(path: Path) -> tuple[int, int, int, str, dict[str, dict[str, str]]]:
    """Return the position of the pixels, rows, columns, their type, and the comment."""
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
        if len(header) < HEADER_BYTES or header[:2] != b"IM":
            raise BadInput(f"a .img file must begin as one of HiPic or HPD-TA, got {path}")
        length, cols, rows, _, _, kind, images = struct.unpack_from("<HHHHHHI", header, 2)
        text = file.read(length).decode("utf-8", "replace")
    if kind not in TYPES or images > 1:
        raise BadInput(
            f"a .img file must hold one image of 8, 16 or 32 bits, got type {kind} and {images} "
            f"images in {path}"
        )
    require_picture(rows, cols, path.name)
    comment = {
        name: {key.strip(): value.strip('" ') for key, value in ENTRY.findall(entries)}
        for name, entries in SECTION.findall(text)
    }
    return HEADER_BYTES + length, rows, cols, TYPES[kind], comment


def conditions(path: Path, extension: str | None = None) -> Stated:
    """Return exposure, gain of the microchannel plate and gate, summed exposures counted."""
    *_, comment = _header(path)
    acquisition, streak = comment.get("Acquisition", {}), comment.get("Streak camera", {})
    gate_s = _time_s(streak.get("Gate Time", ""))
    summed = acquisition.get("AcqMode") in (PHOTON_COUNTING, ANALOG_INTEGRATION)
    exposures = acquisition.get("NrExposure", "")
    return stated(
        int(exposures) if summed and exposures.isdecimal() else 1,
        exposure_s=_time_s(acquisition.get("ExposureTime", "")),
        gain_control=_number(streak.get("MCP Gain", "")),
        gate_ns=None if gate_s is None else 1e9 * gate_s,
    )


def _time_s(text: str) -> float | None:
    """Return a time with its unit, s; None without one."""
    number, _, unit = text.partition(" ")
    value, factor = _number(number), TIMES_S.get(unit.strip())
    return None if value is None or factor is None else value * factor


def _number(text: str) -> float | None:
    return float(text) if re.fullmatch(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?", text) else None
