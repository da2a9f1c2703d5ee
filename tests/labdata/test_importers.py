"""Frames made elsewhere come in unchanged, or are refused in one sentence."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from labdata import BadInput, import_frames, read_frames
from tests.labdata import dng

TYPES = ["u1", "u2", "u4", "i2", "i4", "f4", "f8"]


def pixels(kind: str, shape: tuple[int, ...] = (4, 5, 7)) -> np.ndarray:
    values = np.random.default_rng(1).integers(0, 200, shape)
    return (values / (3.0 if np.dtype(kind).kind == "f" else 1)).astype(kind)


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("order", ["<", ">"])
def test_tiff_pages_are_frames_in_either_byte_order(tmp_path, kind, order):
    data = pixels(kind)
    tifffile.imwrite(tmp_path / "a.tif", data, byteorder=order, photometric="minisblack")
    read = read_frames(tmp_path / "a.tif").data
    assert np.array_equal(read, data)
    assert read.dtype == np.dtype(kind).newbyteorder("=")
    assert not read.flags.writeable


@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_what_opencv_writes_by_default_is_read(tmp_path, kind):
    """It packs by LZW: one page, several, and colours, blue first in its hands."""
    frames = pixels(kind, (3, 40, 48))
    assert cv2.imwrite(str(tmp_path / "one.tif"), frames[0])
    assert cv2.imwritemulti(str(tmp_path / "many.tif"), list(frames))
    assert cv2.imwrite(str(tmp_path / "colour.tif"), np.moveaxis(frames, 0, -1))
    with tifffile.TiffFile(tmp_path / "one.tif") as file:
        assert file.pages[0].compression.name == ("NONE" if kind == "f4" else "LZW")
    assert np.array_equal(read_frames(tmp_path / "one.tif").data, frames[:1])
    assert np.array_equal(read_frames(tmp_path / "many.tif").data, frames)
    for plane, samples in zip("rgb", frames[::-1], strict=True):
        assert np.array_equal(read_frames(tmp_path / "colour.tif", plane=plane).data[0], samples)


def test_a_packed_file_cut_anywhere_is_refused_or_whole(tmp_path):
    data = pixels("u2", (40, 48))
    assert cv2.imwrite(str(tmp_path / "a.tif"), data)
    content, refused = (tmp_path / "a.tif").read_bytes(), 0
    sizes = [*range(8, len(content), 97), *range(len(content) - 12, len(content))]
    for size in sizes:
        (tmp_path / "b.tif").write_bytes(content[:size])
        try:
            assert np.array_equal(read_frames(tmp_path / "b.tif").data[0], data), size
        except BadInput as error:
            assert "a TIFF file must" in str(error) or "a .tif file must" in str(error)
            refused += 1
    assert refused > 0.9 * (len(sizes) - 12)


@pytest.mark.parametrize(
    "options", [{}, {"rowsperstrip": 4}, {"tile": (16, 16)}, {"compression": "deflate"}]
)
def test_no_way_of_laying_out_a_tiff_hides_that_its_end_is_missing(tmp_path, options):
    data = pixels("u2", (2, 40, 48))
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for frame in data:
            file.write(frame, contiguous=False, metadata=None, **options)
        last = file._fh.tell()
    content = (tmp_path / "a.tif").read_bytes()
    assert np.array_equal(read_frames(tmp_path / "a.tif").data, data)
    (tmp_path / "a.tif").write_bytes(content[: last - 20])
    with pytest.raises(BadInput, match="must be whole"):
        read_frames(tmp_path / "a.tif")


@pytest.mark.parametrize("to", [0, 2])
def test_a_last_page_that_leads_back_to_an_earlier_one_is_refused(tmp_path, to):
    path, data = tmp_path / "a.tif", pixels("u2", (3, 16, 16))
    tifffile.imwrite(path, data, photometric="minisblack", metadata=None)
    with tifffile.TiffFile(path) as file:
        pages = [page.aspage().offset for page in file.pages]
    content = bytearray(path.read_bytes())
    # The offset of the next page follows the number of entries and the entries, 12 bytes each.
    entries = int.from_bytes(content[pages[-1] : pages[-1] + 2], "little")
    end = pages[-1] + 2 + 12 * entries
    content[end : end + 4] = pages[to].to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(BadInput, match="must end"):
        read_frames(path)


def two_pages(path: Path) -> None:
    for shape in ((5, 7), (4, 7)):
        tifffile.imwrite(path, np.zeros(shape, np.uint8), metadata=None, append=True)


ARRAYS = [np.zeros(5), np.zeros((2, 3, 4, 5)), np.array([["a", "b"]]), np.zeros((2, 2), complex)]


@pytest.mark.parametrize(
    ("name", "write", "rule"),
    [
        ("a.tif", two_pages, "must have one shape"),
        (
            "a.tif",
            lambda path: tifffile.imwrite(path, pixels("u1"), photometric="miniswhite"),
            "must rise with light, got the type MINISWHITE",
        ),
        (
            "a.npy",
            lambda path: np.save(path, np.array([[{}]], dtype=object), allow_pickle=True),
            "must hold one whole array of numbers",
        ),
        *(("a.npy", lambda path, data=data: np.save(path, data), "must ") for data in ARRAYS),
        (
            "a.tif",
            lambda path: tifffile.imwrite(path, pixels("u1"), photometric="minisblack"),
            "of a colour picture or a mosaic, got plane 'r' of a",
        ),
    ],
)
def test_what_is_no_stack_of_grey_pictures_is_refused(tmp_path, name, write, rule):
    """Pickled objects are never loaded."""
    write(tmp_path / name)
    with pytest.raises(BadInput, match=rule):
        read_frames(tmp_path / name, plane="r" if "plane" in rule else None)


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_colour_planes_are_kept_apart_and_the_luminance_is_said(tmp_path, planar):
    data = pixels("u1", (5, 7, 3))
    stored = data if planar == "contig" else np.moveaxis(data, -1, 0)
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", planarconfig=planar)
    for index, name in enumerate("rgb"):
        plane = read_frames(tmp_path / "a.tif", plane=name)
        assert np.array_equal(plane.data[0], data[..., index])
        assert plane.plane == name
    luminance = read_frames(tmp_path / "a.tif")
    assert luminance.data[0] == pytest.approx(data @ np.array([0.2125, 0.7154, 0.0721]))
    assert "0.2125 R + 0.7154 G + 0.0721 B" in luminance.notes[-1]
    assert ("if they are frames: `axis` 0" in luminance.notes[0]) == (planar == "separate")
    assert luminance.full_scale_dn == 255
    assert luminance.plane == "luminance"
    assert np.array_equal(read_frames(tmp_path / "a.tif", plane="luminance").data, luminance.data)
    with pytest.raises(BadInput, match="must be r, g, b or luminance, got 'g1' for a"):
        read_frames(tmp_path / "a.tif", plane="g1")


def test_the_colours_of_a_png_are_in_their_places(tmp_path):
    data = pixels("u1", (5, 7, 3))
    cv2.imwrite(str(tmp_path / "a.png"), data[..., ::-1])
    for index, name in enumerate("rgb"):
        assert np.array_equal(read_frames(tmp_path / "a.png", plane=name).data[0], data[..., index])


def test_a_zarr_array_of_anyone_is_read(tmp_path):
    import zarr

    data = pixels("f4")
    zarr.save_array(str(tmp_path / "a.zarr"), data)
    assert np.array_equal(read_frames(tmp_path / "a.zarr").data, data)


@pytest.mark.parametrize(
    ("plane", "row", "col", "black"),
    [("r", 0, 0, 64), ("g1", 0, 1, 65), ("g2", 1, 0, 66), ("b", 1, 1, 67)],
)
def test_a_mosaic_is_taken_apart_and_never_interpolated(tmp_path, plane, row, col, black):
    data = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60)
    dng.write(tmp_path / "a.dng", data)
    stack = read_frames(tmp_path / "a.dng", plane=plane)
    active = data[dng.TOP : dng.BOTTOM, dng.LEFT : dng.RIGHT]
    assert np.array_equal(stack.data[0], active[row::2, col::2])
    assert stack.plane == plane
    assert stack.black_level_dn == black
    assert stack.full_scale_dn == dng.WHITE


def test_a_mosaic_must_be_told_which_plane(tmp_path):
    dng.write(tmp_path / "a.dng", np.ones((40, 60), np.uint16))
    for plane in (None, "g"):
        with pytest.raises(BadInput, match=f"must be one of b, g1, g2, r, got {plane} for a.dng"):
            read_frames(tmp_path / "a.dng", plane=plane)


def written(tmp_path: Path, name: str) -> Path:
    """Write a good file of a kind and return its path."""
    path = tmp_path / name
    data = pixels("u2", (3, 50, 70))
    if path.suffix == ".tif":
        tifffile.imwrite(path, data, photometric="minisblack")
    elif path.suffix == ".npy":
        np.save(path, data)
    elif path.suffix == ".png":
        cv2.imwrite(str(path), data[0])
    elif path.suffix == ".dng":
        dng.write(path, np.ones((40, 60), np.uint16))
    else:
        pytest.importorskip("astropy.io.fits").PrimaryHDU(data).writeto(path)
    return path


KINDS = ["a.tif", "a.npy", "a.png", "a.fits", "a.dng"]


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_truncated_file_is_refused_in_one_sentence(tmp_path, name, share):
    path = written(tmp_path, name)
    content = path.read_bytes()
    path.write_bytes(content[: int(share * (len(content) - 1))])
    with pytest.raises(BadInput) as error:
        read_frames(path, plane="r" if name == "a.dng" else None)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_picture_that_is_not_finite_is_refused_with_its_name(tmp_path, bad):
    data = pixels("f4")
    data[1, 2, 3] = bad
    tifffile.imwrite(tmp_path / "a.tif", data, photometric="minisblack")
    with pytest.raises(
        BadInput,
        match=r"every pixel must be finite, .*, got 1 that are NaN or infinite of 140, in .*a\.tif",
    ):
        read_frames(tmp_path / "a.tif")


@pytest.mark.parametrize("shape", [(0, 10), (10, 0), (0, 0), (0, 4, 5), (3, 0, 5)])
def test_an_array_without_pixels_is_refused_by_its_shape(tmp_path, shape):
    import zarr

    fits = pytest.importorskip("astropy.io.fits")
    data = np.zeros(shape, np.uint8)
    np.save(tmp_path / "a.npy", data)
    zarr.create_array(
        tmp_path / "a.zarr", shape=shape, dtype="u1", chunks=tuple(max(1, side) for side in shape)
    )
    fits.PrimaryHDU(data).writeto(tmp_path / "a.fits")
    for name in ("a.npy", "a.zarr", "a.fits"):
        with pytest.raises(
            BadInput, match=rf"must hold pixels, got the shape {re.escape(str(shape))}.*{name}"
        ):
            read_frames(tmp_path / name)


@pytest.mark.parametrize(("bits", "kind"), [(10, "u2"), (12, "u2"), (14, "i4"), (16, "u2")])
def test_the_full_scale_shows_where_pixels_pile_up(tmp_path, bits, kind):
    top = 2**bits - 1
    data = pixels(kind, (4, 20, 20))
    data[0, 0, :5] = top
    np.save(tmp_path / "a.npy", data)
    stack = read_frames(tmp_path / "a.npy")
    assert stack.full_scale_dn == top
    assert stack.notes == (
        (
            f"full scale found from the data: 5 pixels hold the highest code, {top} DN, which is "
            f"that of {bits} bits"
        ),
    )


@pytest.mark.parametrize("top", [4094, 3000])
def test_a_full_scale_that_does_not_show_is_unknown(tmp_path, top):
    data = pixels("u2", (4, 20, 20))
    data[0, 0, :5] = top
    np.save(tmp_path / "a.npy", data)
    np.save(tmp_path / "b.npy", np.where(np.arange(9).reshape(1, 3, 3) == 4, 4095, 7).astype("u2"))
    np.save(tmp_path / "c.npy", pixels("f4"))
    for name in ("a.npy", "b.npy", "c.npy"):
        assert read_frames(tmp_path / name).full_scale_dn is None


def test_a_session_of_raw_files_keeps_their_plane(tmp_path):
    data = np.arange(40 * 60, dtype=np.uint16).reshape(40, 60)
    dng.write(tmp_path / "a.dng", data)
    with pytest.raises(BadInput, match=r"must be one of b, g1, g2, r, got None for a\.dng"):
        import_frames([tmp_path / "a.dng"], tmp_path / "S")
    session = import_frames([tmp_path / "a.dng"], tmp_path / "S", plane="g1", kind="flat")
    assert np.array_equal(
        session.stack("a").read().data, read_frames(tmp_path / "a.dng", "g1").data
    )
