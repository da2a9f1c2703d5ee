"""Grey pixels out of the kernel's formats: against bytes put down by hand."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from drivers.cameras.aravis.capture import PACKINGS
from drivers.cameras.v4l2 import structures
from drivers.cameras.v4l2.pixels import LAYOUTS, BufferImage
from drivers.cameras.v4l2.structures import code_of, four_letters
from labdata import BadInput

HEADER = Path("/usr/include/linux/videodev2.h")
# sizeof and the ioctl's number, as the header of Linux 6.1 gives them on x86-64.
KERNEL = {
    "QUERYCAP": (104, 0x80685600),
    "ENUM_FMT": (64, 0xC0405602),
    "G_FMT": (208, 0xC0D05604),
    "S_FMT": (208, 0xC0D05605),
    "REQBUFS": (20, 0xC0145608),
    "QUERYBUF": (88, 0xC0585609),
    "QBUF": (88, 0xC058560F),
    "DQBUF": (88, 0xC0585611),
    "STREAMON": (4, 0x40045612),
    "STREAMOFF": (4, 0x40045613),
    "G_PARM": (204, 0xC0CC5615),
    "S_PARM": (204, 0xC0CC5616),
    "G_STD": (8, 0x80085617),
    "S_STD": (8, 0x40085618),
    "ENUMINPUT": (80, 0xC050561A),
    "G_CTRL": (8, 0xC008561B),
    "S_CTRL": (8, 0xC008561C),
    "QUERYCTRL": (68, 0xC0445624),
    "G_INPUT": (4, 0x80045626),
    "S_INPUT": (4, 0xC0045627),
    "ENUM_FRAMESIZES": (44, 0xC02C564A),
}
ASKED = {one.name: one for one in vars(structures).values() if isinstance(one, structures.Request)}


def picture(letters: str, rows: int, columns: int, row_bytes: int, **more) -> BufferImage:
    return BufferImage(
        rows=rows, columns=columns, row_bytes=row_bytes, layout=LAYOUTS[code_of(letters)], **more
    )


def grey(letters: str, rows: int, columns: int, row_bytes: int, data: list[int]) -> list[list[int]]:
    return picture(letters, rows, columns, row_bytes).grey(np.array(data, np.uint8)).tolist()


def test_every_request_has_the_number_and_size_of_the_kernels():
    assert {name: (ctypes.sizeof(one.structure), one.code) for name, one in ASKED.items()} == KERNEL


PLACES = {
    "v4l2_buffer": (
        structures.Buffer,
        {
            "flags": "flags",
            "timestamp": "timestamp",
            "sequence": "sequence",
            "m": "offset",
            "length": "length",
        },
    ),
    "v4l2_pix_format": (
        structures.PixelFormat,
        {"field": "field", "bytesperline": "bytesperline", "quantization": "quantization"},
    ),
    "v4l2_queryctrl": (
        structures.ControlQuery,
        {"name": "name", "minimum": "minimum", "flags": "flags"},
    ),
    "v4l2_input": (structures.Input, {"std": "std", "status": "status"}),
}


@pytest.mark.skipif(
    not (HEADER.exists() and shutil.which("gcc")), reason="the kernel's header or gcc is not here"
)
def test_fields_lie_where_the_header_of_this_machine_puts_them(tmp_path):
    lines = [
        f'printf("%zu\\n", offsetof(struct {name}, {theirs}));'
        for name, (_, pairs) in PLACES.items()
        for theirs in pairs
    ]
    source = tmp_path / "places.c"
    source.write_text(
        "#include <stdio.h>\n#include <stddef.h>\n#include <linux/videodev2.h>\nint main() {"
        + "".join(lines)
        + "}"
    )
    subprocess.run(["gcc", "-o", tmp_path / "places", source], check=True, timeout=60)
    told = subprocess.run(
        [tmp_path / "places"], capture_output=True, text=True, check=True, timeout=10
    ).stdout.split()
    ours = [
        getattr(kind, name).offset for kind, pairs in PLACES.values() for name in pairs.values()
    ]
    assert list(map(int, told)) == ours


def test_grey_of_8_bits_leaves_out_what_pads_a_row():
    assert grey("GREY", 2, 3, 4, [1, 2, 3, 99, 4, 5, 6, 99]) == [[1, 2, 3], [4, 5, 6]]


def test_the_last_row_need_not_be_padded():
    assert grey("GREY", 2, 3, 4, [1, 2, 3, 99, 4, 5, 6]) == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("letters", "value"), [("Y10 ", 0x03FF), ("Y12 ", 0x0FFF), ("Y14 ", 0x3FFF), ("Y16 ", 0xFFFE)]
)
def test_deeper_grey_comes_little_end_first(letters, value):
    assert grey(letters, 1, 2, 4, [value & 0xFF, value >> 8, 1, 0]) == [[value, 1]]


def test_grey_of_16_bits_with_the_big_end_first():
    code = code_of("Y16 ") | structures.BIG_ENDIAN
    assert four_letters(code) == "Y16-BE"
    one = BufferImage(rows=1, columns=2, row_bytes=4, layout=LAYOUTS[code])
    assert one.grey(np.array([0x12, 0x34, 0, 1], np.uint8)).tolist() == [[0x1234, 1]]


@pytest.mark.parametrize(
    ("letters", "data"),
    [
        ("YUYV", [10, 200, 20, 201, 30, 202, 40, 203]),
        ("YVYU", [10, 200, 20, 201, 30, 202, 40, 203]),
        ("UYVY", [200, 10, 201, 20, 202, 30, 203, 40]),
        ("VYUY", [200, 10, 201, 20, 202, 30, 203, 40]),
    ],
)
def test_luma_of_paired_video_leaves_the_colour_out(letters, data):
    assert grey(letters, 1, 4, 8, data) == [[10, 20, 30, 40]]


@pytest.mark.parametrize("letters", ["NV12", "NV21", "YU12", "YV12", "NV16", "422P"])
def test_luma_of_planar_video_is_its_first_plane(letters):
    one = picture(letters, 2, 2, 2)
    assert one.size_bytes == (8 if letters in ("NV16", "422P") else 6)
    assert one.grey(
        np.array([1, 2, 3, 4, 99, 99, 99, 99][: one.size_bytes], np.uint8)
    ).tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("rows", "columns", "row_bytes"),
    [(0, 4, 4), (4, 0, 4), (4, 4, 3), (1 << 20, 4, 4), (4, 4, 4_000_000_000)],
)
def test_a_picture_that_cannot_be_is_refused(rows, columns, row_bytes):
    with pytest.raises(BadInput):
        picture("GREY", rows, columns, row_bytes)


# Pixels and the bytes that they make, worked out by hand from the bits of the standards.
BY_HAND = [
    ("Mono10p", [0x3FF, 0x000, 0x3FF, 0x000], [0xFF, 0x03, 0xF0, 0x3F, 0x00]),
    ("Mono10p", [0x001, 0x002, 0x004, 0x008], [0x01, 0x08, 0x40, 0x00, 0x02]),
    ("Mono12p", [0xABC, 0x123], [0xBC, 0x3A, 0x12]),
    ("Mono12p", [0xFFF, 0x000], [0xFF, 0x0F, 0x00]),
    ("Mono12Packed", [0xABC, 0x123], [0xAB, 0x3C, 0x12]),
    ("Mono10Packed", [0x3FD, 0x006], [0xFF, 0x21, 0x01]),
]


@pytest.mark.parametrize(("name", "pixels", "data"), BY_HAND)
def test_packed_pixels_are_those_put_down_by_hand(name, pixels, data):
    assert PACKINGS[name].unpack(np.array(data, np.uint8), len(pixels)).tolist() == pixels


@pytest.mark.parametrize(("name", "pixels", "data"), BY_HAND)
def test_a_group_cut_short_still_gives_the_pixels_it_holds(name, pixels, data):
    fewer = len(pixels) - 1
    size = PACKINGS[name].size_bytes(fewer)
    assert PACKINGS[name].unpack(np.array(data[:size], np.uint8), fewer).tolist() == pixels[:fewer]


@pytest.mark.parametrize(("name", "bits"), [("Mono10p", 10), ("Mono12p", 12)])
def test_pixels_without_gaps_come_back_from_any_bits(name, bits, seed):
    pixels = np.random.default_rng(seed).integers(0, 1 << bits, 1001)
    stream = (pixels[:, None] >> np.arange(bits) & 1).astype(np.uint8).reshape(-1)
    data = np.packbits(stream, bitorder="little")
    assert np.array_equal(PACKINGS[name].unpack(data, len(pixels)), pixels)
