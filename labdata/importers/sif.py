"""Reader of Andor SIF files, of all versions of Andor Solis.

The header is text of lines whose number grew with the versions. What does not change is the
description of the pixels: the line `version left top right bottom frames areas pixels
pixels-of-a-frame`, followed by one line `version left top right bottom row-bin column-bin offset`
for each area. It is found by its form and by its numbers, which must agree, so that no version
needs to be known. Time stamps of the frames follow, one a line, then 32-bit reals
(M. Leutenegger, sifread.m, 2006).
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, FRAME, ROW, Recorded
from labdata.importers.headers import NOTHING, Stated, number_of, stated
from labdata.importers.parts import Part, choose, whole_frames

MOST_HEADER_BYTES = 2**26  # Texts of a section hold a line of calibration for each frame
MAGIC = b"Andor Technology Multi-Channel File"
LAYOUT = re.compile(
    rb"6\d{4} \d{1,9} \d{1,9} \d{1,9} \d{1,9} (\d{1,9}) (\d{1,4}) (\d{1,18}) (\d{1,12}) *\r?\n"
    rb"((?:6\d{4}(?: \d{1,9}){6,7} *\r?\n)+)"
)
# First version whose header states whether the gain is that of the register
WITH_REAL_GAIN = 65553
ACCUMULATE, KINETICS = 2, 3  # Acquisition modes whose frames may be sums
INTENSIFIED = b"DH"  # First letters of the heads with an intensifier, iStar
# First line of a section: version, temperature, five bytes with blanks, the fields from the twelfth
# on; and the line of the camera's head
FIRST = re.compile(rb"(6\d{4}) \d+ \d+ \d+ \d+ (-?[\d.]+) (.{10})([^\n]*)\n([^\n]*)", re.DOTALL)
# Line of the intensifier in versions from 65566 on: the eighth field is the gate's width, ps
INTENSIFIER = re.compile(rb"\n65539 \d+ \d+ \d+ \S+ \S+ \S+ (\d+) ")


@dataclass(frozen=True)
class _Section:
    """Frames of one kind of a file: signal, then reference and background."""

    header: bytes
    shape: tuple[int, int, int]
    start: int  # of the pixels


def read(path: Path, extension: str | None = None, *, partial: bool = False) -> Recorded:
    """Read the frames of a section; see `labdata.importers.read_frames`."""
    section, notes, size = _section(path, extension)
    frames, rows, cols = section.shape
    frames, missing = whole_frames(
        path.name,
        frames=frames,
        start=section.start,
        stride=4 * rows * cols,
        frame_bytes=4 * rows * cols,
        size=size,
        partial=partial,
    )
    data = np.memmap(path, "<f4", "r", section.start, (frames, rows, cols))
    return Recorded(data=data, names=(FRAME, ROW, COL), notes=(*notes, *missing))


def _section(path: Path, extension: str | None) -> tuple[_Section, tuple[str, ...], int]:
    """Return the chosen section of a file, a note where there are several, and the file's bytes."""
    content = np.memmap(path, np.uint8, "r")
    if content[: len(MAGIC)].tobytes() != MAGIC:
        raise BadInput(f"a .sif file must be a file of Andor Solis, got something else in {path}")
    sections: list[_Section] = []
    end = len(MAGIC)
    # A regular expression reads any buffer.
    text: Any = content
    while (match := LAYOUT.search(text, end, end + MOST_HEADER_BYTES)) is not None:
        section = _section_of(match, content[end : match.start()].tobytes(), text)
        end = match.end()
        if section is not None:
            sections.append(section)
            end = section.start + 4 * math.prod(section.shape)
    if not sections:
        raise BadInput(f"a SIF file must describe its frames, got no such line in {path}")
    parts = [Part(number, "", section.shape) for number, section in enumerate(sections)]
    at, notes = choose(parts, extension, 0, "the first")
    return sections[at], notes, content.size


def _section_of(match: re.Match, header: bytes, content: Any) -> _Section | None:
    """Return the section of a description; None if its numbers contradict each other."""
    frames, areas, pixels, frame_pixels = (int(text) for text in match.groups()[:4])
    lines = match[5].splitlines(keepends=True)[:areas]
    if len(lines) != areas or not areas or not frames or frames * frame_pixels != pixels:
        return None
    boxes = np.array([line.split()[1:7] for line in lines], int)
    left, top, right, bottom, row_bin, col_bin = boxes.T
    heights = (1 + abs(top - bottom)) // np.maximum(1, row_bin)
    widths = (1 + abs(right - left)) // np.maximum(1, col_bin)
    rows, cols = int(heights.sum()), int(widths[0])
    if (widths != cols).any() or rows * cols != frame_pixels:
        return None
    start = match.start(5) + sum(len(line) for line in lines)
    # Time stamps; newer versions end them with a line 0, or 1 and one more line for each frame.
    for lines_before in (rb"(?: *\d+\r?\n){%d}" % frames, rb"0\n|1\n(?: *\d+\n){%d}" % frames):
        before = re.compile(lines_before).match(content, start)
        start = start if before is None else before.end()
    return _Section(header, (frames, rows, cols), start)


def conditions(path: Path, extension: str | None = None) -> Stated:
    """Return exposure, temperature, gain and gate of a section, summed exposures counted.

    Notes
    -----
    Fields of the first line of a section, by position: 5 temperature, 9 acquisition mode, 12
    exposure (s), 15 accumulations, 21 gain, 23 gate width (ps), 42 output amplifier, 47
    temperature before it was stable, 50 whether the gain is that of the register. Fields 6 to 10
    are single bytes, of which any may be a blank or an end of line.
    """
    section, *_ = _section(path, extension)
    first = FIRST.search(section.header)
    if first is None:
        return NOTHING
    # Older versions have fewer fields; what is no number is unknown.
    fields = dict(enumerate(map(number_of, first[4].split(b" ")[:60]), 11))
    temperature_c, gain, gate_ps = number_of(first[2]), fields.get(21), fields.get(23)
    is_intensified = first[5].startswith(INTENSIFIED)
    if is_intensified and (newer := INTENSIFIER.search(section.header)):
        gate_ps = float(newer[1])
    is_real = int(first[1]) >= WITH_REAL_GAIN and fields.get(50) == 1 and fields.get(42) == 0
    is_sum = first[3][6] in (ACCUMULATE, KINETICS)
    return stated(
        fields.get(15) or 1.0 if is_sum else 1.0,
        exposure_s=fields.get(12),
        temperature_c=fields.get(47) if temperature_c == -999 else temperature_c,
        gain_control=gain if is_intensified else None,
        gate_ns=1e-3 * gate_ps if is_intensified and gate_ps is not None else None,
        em_gain=gain if is_real and not is_intensified else None,
    )
