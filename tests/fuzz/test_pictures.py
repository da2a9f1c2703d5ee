"""Mangled files of frames give one sentence or frames: never another exception, never memory that
they do not need.
"""

import random
import struct
import zlib

import numpy as np
import pytest
import tifffile

from labdata import BadInput, read_frames
from labdata.store import journal
from simulate.radiance.outdoor import build_surfaces
from tests.fuzz import pictures
from tests.fuzz.bounds import in_time


@pytest.mark.parametrize("name", pictures.FILES)
def test_the_files_are_sound_before_they_are_mangled(name, tmp_path):
    assert pictures.read(name, random.Random(1), tmp_path, wrong=False)


@pytest.mark.parametrize("name", pictures.FILES)
def test_a_mangled_file_is_refused_in_a_sentence_or_read(name, tmp_path):
    with in_time():
        read = [pictures.read(name, random.Random(seed), tmp_path) for seed in range(15)]
    assert not all(read), "some of what is wrong shows"


def _png(header: bytes, *, data: bytes = b"") -> bytes:
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(data)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )


def test_a_small_png_that_states_a_gigabyte_is_refused_before_it_takes_one(tmp_path):
    (tmp_path / "a.png").write_bytes(_png(struct.pack(">IIBBBBB", 16_000, 16_000, 16, 0, 0, 0, 0)))
    with pytest.raises(
        BadInput, match=r"must fit into its file, got 512000000 bytes of pixels stated by a\.png"
    ):
        read_frames(tmp_path / "a.png")


def test_a_png_with_one_wrong_bit_is_no_picture(tmp_path):
    sound = pictures.sound("png").read_bytes()
    for at in range(33, len(sound), 7):
        (tmp_path / "a.png").write_bytes(sound[:at] + bytes([sound[at] ^ 4]) + sound[at + 1 :])
        with pytest.raises(BadInput, match="must"):
            read_frames(tmp_path / "a.png")


def test_a_small_tiff_of_one_huge_tile_is_refused_before_it_takes_the_memory(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((16, 16), np.uint16), tile=(16, 16), metadata=None)
    with tifffile.TiffFile(path, mode="r+b") as file:
        for tag in ("TileWidth", "TileLength"):
            file.pages[0].tags[tag].overwrite(32_000)
    with pytest.raises(BadInput, match="must fit into its file"):
        read_frames(path)


def test_a_tiff_without_rows_is_refused(tmp_path):
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.zeros((16, 16), np.uint16), metadata=None)
    with tifffile.TiffFile(path, mode="r+b") as file:
        file.pages[0].tags["ImageLength"].overwrite(0)
    with pytest.raises(BadInput):
        read_frames(path)


def test_a_frame_of_the_store_that_was_cut_or_grew_is_refused(tmp_path):
    pictures.read("store", random.Random(1), tmp_path, wrong=False)
    file = journal.chunk(tmp_path / "a.zarr", 1)
    for content in (file.read_bytes()[:-9], file.read_bytes() + b"more"):
        file.write_bytes(content)
        with pytest.raises(
            BadInput, match=r"must be as it describes them|must be what was acknowledged"
        ):
            read_frames(tmp_path / "a.zarr")


@pytest.mark.parametrize(
    ("mesh", "rule"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "must be among its 3 vertices|must be a whole"),
        ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "must have three coordinates|must be a whole"),
    ],
)
def test_a_mesh_that_refers_to_nothing_or_lies_nowhere_is_refused(tmp_path, mesh, rule):
    (tmp_path / "a.obj").write_text(mesh)
    with pytest.raises(BadInput, match=rule):
        build_surfaces(pictures.scene_of(tmp_path / "a.obj"))
