"""Reader of Andor SIF files, of all versions of Andor Solis.

The header is text of lines whose number grew with the versions. What does not change is the
description of the pixels: the line `version left top right bottom frames areas pixels
pixels-of-a-frame`, followed by one line `version left top right bottom row-bin column-bin offset`
for each area. It is found by its form and by its numbers, which must agree, so that no version
needs to be known. Time stamps of the frames follow, one a line, then 32-bit reals
(M. Leutenegger, sifread.m, 2006).
"""

import mmap
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labdata.errors import BadInput
from labdata.importers.axes import COL, FRAME, ROW, Recorded
from labdata.importers.headers import Stated, stated
from labdata.importers.parts import Part, choose, whole_frames

MAGIC = b"Andor Technology Multi-Channel File"
LAYOUT = re.compile(
    rb"6\d{4} \d{1,9} \d{1,9} \d{1,9} \d{1,9} (\d{1,9}) (\d{1,4}) (\d{1,18}) (\d{1,12}) *\r?\n"
    rb"((?:6\d{4}(?: \d{1,9}){6,7} *\r?\n)+)"
)
# First version whose header states the gate's step and whether the gain is that of the register
WITH_GATE_STEP, WITH_REAL_GAIN = 65542, 65553
ACCUMULATE, KINETICS = 2, 3  # Acquisition modes whose frames may be sums
INTENSIFIED = "DH"  # First letters of the heads with an intensifier, iStar
# Line of the intensifier in versions from 65566 on: gain, and width of the gate, ps
INTENSIFIER = re.compile(rb"\n65539 \d+ \d+ (\d+) \S+ \S+ \S+ (\d+) ")


@dataclass(frozen=True)
class _Section:
    """Frames of one kind of a file: signal, then reference and background."""

    header: bytes
    frames: int
    rows: int
    cols: int
    start: int  # of the pixels


def read(path: Path, extension: str | None = None, *, partial: bool = False) -> Recorded:
    """Read the frames of a section; see `labdata.importers.read_frames`."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        section, notes = _section(content, path, extension)
        size = len(content)
    frame_bytes = 4 * section.rows * section.cols
    frames, missing = whole_frames(
        path.name,
        frames=section.frames,
        start=section.start,
        stride=frame_bytes,
        frame_bytes=frame_bytes,
        size=size,
        partial=partial,
    )
    shape = (frames, section.rows, section.cols)
    data = np.memmap(path, "<f4", "r", section.start, shape)
    return Recorded(data=data, names=(FRAME, ROW, COL), notes=(*notes, *missing))


def _section(content: mmap.mmap, path: Path, extension: str | None) -> tuple[_Section, tuple]:
    """Return the chosen section of a file, and a note where there are several."""
    if content[: len(MAGIC)] != MAGIC:
        raise BadInput(f"a .sif file must be a file of Andor Solis, got something else in {path}")
    sections: list[_Section] = []
    end = len(MAGIC)
    while (match := LAYOUT.search(content, end)) is not None:
        section = _section_of(match, content[end : match.start()], content)
        end = match.end()
        if section is not None:
            sections.append(section)
            end = section.start + 4 * section.frames * section.rows * section.cols
    if not sections:
        raise BadInput(f"a SIF file must describe its frames, got no such line in {path}")
    parts = [
        Part(number, "", (section.frames, section.rows, section.cols))
        for number, section in enumerate(sections)
    ]
    at, notes = choose(parts, extension, 0, "the first")
    return sections[at], notes


def _section_of(match: re.Match, header: bytes, content: mmap.mmap) -> _Section | None:
    """Return the section of a description; None if its numbers contradict each other."""
    frames, areas, pixels, frame_pixels = (int(text) for text in match.groups()[:4])
    lines = [[int(text) for text in line.split()] for line in match[5].splitlines()][:areas]
    if len(lines) < areas or not frames or frames * frame_pixels != pixels:
        return None
    heights, widths = [], set()
    for _, left, top, right, bottom, row_bin, col_bin, *_ in lines:
        heights.append((1 + abs(top - bottom)) // max(1, row_bin))
        widths.add((1 + abs(right - left)) // max(1, col_bin))
    if len(widths) != 1 or sum(heights) * max(widths) != frame_pixels:
        return None
    at = match.start(5) + sum(len(line) for line in match[5].splitlines(keepends=True)[:areas])
    stamps = re.compile(rb"(?: *\d+\r?\n){%d}" % frames).match(content, at)
    at = at if stamps is None else stamps.end()
    # Newer versions end the stamps with a line 0, or with 1 and one more line for each frame.
    more = re.compile(rb"0\n|1\n(?: *\d+\n){%d}" % frames).match(content, at)
    return _Section(header, frames, sum(heights), max(widths), at if more is None else more.end())


def conditions(path: Path, extension: str | None = None) -> Stated:
    """Return exposure, temperature, gain and gate of a section, summed exposures counted.

    Notes
    -----
    Fields of the first line of a section, by position: 5 temperature, 9 acquisition mode, 12
    exposure (s), 15 accumulations, 21 gain, 23 gate width (ps), 42 output amplifier, 47
    temperature before it was stable, 50 whether the gain is that of the register. Fields 6 to 10
    are single bytes.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        section, _ = _section(content, path, extension)
    first = re.search(rb"6\d{4} \d+ \d+ \d+ \d+ -?[\d.]+ ", section.header)
    if first is None:
        return stated()
    # The bytes of the mode may be blanks and ends of lines.
    mode = section.header[first.end() + 6]
    rest = section.header[first.end() + 10 :]
    line, *further = rest.split(b"\n")
    words = first[0].split() + [b""] * 5 + line.split(b" ")
    version, temperature_c = int(words[0]), float(words[5])
    numbers = [float(word) if re.fullmatch(rb"[-+.\deE]+", word) else 0.0 for word in words]
    numbers += [0.0] * (60 - len(numbers))
    if version < WITH_GATE_STEP:  # the fields behind the gate stand one place earlier
        numbers.insert(24, 0.0)
    temperature_c = temperature_c if temperature_c != -999 else numbers[47]
    head = further[0].decode("latin-1") if further else ""
    found: dict[str, float | None] = {}
    if head.startswith(INTENSIFIED):
        newer = INTENSIFIER.search(section.header)
        gate_ps = float(newer[2]) if newer else numbers[23]
        found = {"gain_control": numbers[21], "gate_ns": 1e-3 * gate_ps}
    elif version >= WITH_REAL_GAIN and numbers[50] == 1 and numbers[42] == 0:
        found = {"em_gain": numbers[21]}
    summed = int(numbers[15]) if mode in (ACCUMULATE, KINETICS) else 1
    return stated(summed, exposure_s=numbers[12], temperature_c=temperature_c, **found)
