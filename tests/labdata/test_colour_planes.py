"""Planes of a mosaic: every second row and column of the file, from the site of its colour."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from labdata import (
    BadInput,
    Conditions,
    SessionFile,
    SessionWriter,
    from_toml,
    import_frames,
    open_lazy_stack,
    open_session,
    read_array,
    read_frames,
    to_toml,
    write_atomically,
)

SITES = {"r": (0, 0), "g1": (0, 1), "g2": (1, 0), "b": (1, 1)}


def dark(shape: tuple[int, ...] = (5, 24, 36)) -> np.ndarray:
    """Return frames without a checkerboard, as those of a dark."""
    return np.random.default_rng(3).integers(50, 70, shape, dtype=np.uint16)


@pytest.mark.parametrize(("plane", "site"), SITES.items())
def test_a_mosaic_that_does_not_show_is_stated_with_the_plane(
    tmp_path: Path, plane: str, site: tuple[int, int]
) -> None:
    data = dark()
    cv2.imwrite(str(tmp_path / "dark.png"), data[0])
    with pytest.raises(BadInput, match=f"got plane '{plane}' of dark.png; .* `plane` rggb:{plane}"):
        read_frames(tmp_path / "dark.png", plane)
    for stack in (
        read_frames(tmp_path / "dark.png", f"rggb:{plane}"),
        read_array(data[:1], f"rggb:{plane}"),
    ):
        assert np.array_equal(stack.data[0], data[0, site[0] :: 2, site[1] :: 2])
        assert (stack.plane, stack.sample_pitch_px) == (plane, 2)
        assert any("two pixels of the camera apart" in note for note in stack.notes)


@pytest.mark.parametrize("stated", ["rgb:g1", "RGGB:g1", "rg1b:g1"])
def test_a_mosaic_of_other_than_four_colours_is_refused(stated: str) -> None:
    with pytest.raises(BadInput, match=f"of its first 2x2 pixels, as rggb, got '{stated[:-3]}'"):
        read_array(dark(), stated)


def test_a_plane_of_a_picture_of_three_colours_is_as_fine_as_the_picture() -> None:
    stack = read_array(np.stack([dark((24, 36))] * 3, axis=-1), "r")
    assert (stack.shape, stack.plane, stack.sample_pitch_px) == ((1, 24, 36), "r", 1)


def write_fits(path: Path, data: np.ndarray, **cards: object) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    unit = fits.PrimaryHDU(data)
    unit.header.update(CTYPE3="TIME", **cards)
    unit.writeto(path)


@pytest.mark.parametrize(
    ("across", "down", "red"), [(0, 0, (0, 0)), (1, 0, (0, 1)), (0, 1, (1, 0)), (1, 1, (1, 1))]
)
def test_offsets_of_a_fits_header_move_the_mosaic(
    tmp_path: Path, across: int, down: int, red: tuple[int, int]
) -> None:
    data = dark()
    write_fits(tmp_path / "a.fits", data, BAYERPAT="RGGB", XBAYROFF=across, YBAYROFF=down)
    assert np.array_equal(
        read_frames(tmp_path / "a.fits", "r").data, data[:, red[0] :: 2, red[1] :: 2]
    )


def test_a_plane_stated_against_the_file_is_refused(tmp_path: Path) -> None:
    write_fits(tmp_path / "a.fits", dark(), BAYERPAT="GRBG")
    assert np.array_equal(read_frames(tmp_path / "a.fits", "grbg:r").data, dark()[:, 0::2, 1::2])
    with pytest.raises(
        BadInput, match=r"mosaic of a\.fits is grbg by the file itself, got the plane rggb:r"
    ):
        read_frames(tmp_path / "a.fits", "rggb:r")


def test_a_border_cut_off_leaves_the_colours_in_their_places(tmp_path: Path) -> None:
    data = dark().astype(np.float32)
    data[:, 0], data[:, :, :3] = np.nan, np.nan
    write_fits(tmp_path / "a.fits", data, BAYERPAT="RGGB")
    for plane, (row, col) in SITES.items():
        found = read_frames(tmp_path / "a.fits", plane).data
        inside = data[:, 2 - row if row == 0 else 1 :: 2, 4 - col if col == 0 else 3 :: 2]
        assert np.array_equal(found, inside)


def recorded(folder: Path, data: np.ndarray, plane: str) -> None:
    """Write a session of the store as an acquisition does, and state the plane of its stack."""
    with SessionWriter.create(folder, name="s") as writer:
        stack = writer.begin_stack("dark", "dark", data.shape[1:], data.dtype, Conditions())
        for number, frame in enumerate(data):
            stack.append(frame, number / 30, number)
        stack.finish()
    form = from_toml(folder / "session.toml", SessionFile)
    form = replace(form, stack=tuple(replace(one, plane=plane) for one in form.stack))
    write_atomically(folder / "session.toml", to_toml(form).encode())


def test_a_recorded_mosaic_gives_the_same_plane_read_at_once_and_on_demand(tmp_path: Path) -> None:
    data = dark()
    recorded(tmp_path / "s", data, "bggr:r")
    (entry,) = open_session(tmp_path / "s").stacks
    red = data[:, 1::2, 1::2]
    assert np.array_equal(entry.read().data, red)
    lazy = open_lazy_stack(entry)
    assert lazy.shape == red.shape
    assert np.array_equal(lazy.frames(0, 5), red)
    assert np.array_equal(entry.read().frame_number, np.arange(5))


def test_a_session_knows_the_plane_of_its_files_and_how_far_its_samples_lie_apart(
    tmp_path: Path,
) -> None:
    np.save(tmp_path / "a.npy", dark())
    np.save(tmp_path / "b.npy", dark())
    session = import_frames([tmp_path / "a.npy"], tmp_path / "s", kind="dark", plane="rggb:g2")
    assert session.sampling == ("g2", 2)
    session = import_frames(
        [tmp_path / "b.npy"], tmp_path / "s", kind="flat", plane="rggb:b", add=True
    )
    with pytest.raises(
        BadInput, match="one colour plane, got g2 in 'a' and b in 'b' of session 's'"
    ):
        _ = session.sampling
    grey = import_frames([tmp_path / "a.npy"], tmp_path / "t", kind="dark")
    assert grey.sampling == ("mono", 1)
