"""Series taken elsewhere become sessions that point at the images where they lie."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from labdata import BadInput, Conditions, import_emva1288, import_frames, open_session

DESCRIPTOR = """# a comment
v 3.0
n 12 7 5
b 40000.0 120.0
i images\\b0.png
i images\\b1.png
d 40000.0
i images/d0.png
i images/d1.png
i images/d2.png
"""


def series(folder: Path, descriptor: str = DESCRIPTOR, size: tuple[int, int] = (5, 7)) -> Path:
    (folder / "images").mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(["b0", "b1", "d0", "d1", "d2"]):
        cv2.imwrite(str(folder / "images" / f"{name}.png"), np.full(size, 100 + number, np.uint16))
    (folder / "EMVA1288_Data.txt").write_text(descriptor)
    return folder / "EMVA1288_Data.txt"


def test_a_descriptor_becomes_a_session_of_pairs_and_spatial_series(tmp_path):
    session = import_emva1288(series(tmp_path / "series"), tmp_path / "S")
    assert session == open_session(tmp_path / "S")
    bright, dark = session.stacks
    assert (bright.kind, dark.kind) == ("flat", "dark")
    assert bright.conditions == Conditions(exposure_s=4e-5, photons_per_px=120.0)
    assert dark.conditions == Conditions(exposure_s=4e-5)
    assert bright.read().data[:, 0, 0].tolist() == [100, 101]
    assert dark.read().data[:, 0, 0].tolist() == [102, 103, 104]
    assert "spatial" in dark.label
    assert bright.read().full_scale_dn == 4095
    assert not session.is_interlaced


def test_the_images_stay_where_they_are(tmp_path):
    import_emva1288(series(tmp_path / "series"), tmp_path / "S")
    assert [path.name for path in (tmp_path / "S").iterdir()] == ["session.toml"]
    assert "../series/images/b0.png" in (tmp_path / "S" / "session.toml").read_text()


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (("n 12 7 5\n", ""), "must hold a line n and at least one of b or d"),
        (
            ("b 40000.0 120.0", "b forty 120.0"),
            r"got 'b forty 120\.0' in line 4 of EMVA1288_Data\.txt",
        ),
        (("b 40000.0 120.0", "b 40000.0"), r"got 'b 40000\.0' in line 4"),
        (("v 3.0", "q 3.0"), r"must be v, n, b, d or i with its values, got 'q 3\.0' in line 2"),
        (
            ("n 12 7 5", "n 12 8 5"),
            r"images must be the 8x5 px of EMVA1288_Data\.txt, got 7x5 px in images/b0\.png",
        ),
        (("images\\b0.png", "images/none.png"), r"must exist to be read, got .*none\.png"),
        (("i images\\b1.png\n", ""), "must have two images or more, got 1 at 40000 ns"),
        (("b 40000.0 120.0", "b -40000.0 120.0"), "exposure_s must not be negative"),
        (
            ("d2.png", "none.png"),
            r"the frames of stack 'dark-001-spatial' must exist to be read, got .*none\.png",
        ),
    ],
)
def test_a_descriptor_that_breaks_its_format_is_refused(tmp_path, change, rule):
    file = series(tmp_path / "series", DESCRIPTOR.replace(*change))
    with pytest.raises(BadInput, match=rule) as error:
        import_emva1288(file, tmp_path / "S")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "S" / "session.toml").exists()


def test_a_descriptor_must_be_there_and_be_text(tmp_path):
    with pytest.raises(BadInput, match="must exist to be read"):
        import_emva1288(tmp_path / "none.txt", tmp_path / "S")
    (tmp_path / "a.txt").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(BadInput, match="must be a text file"):
        import_emva1288(tmp_path / "a.txt", tmp_path / "S")


def test_an_import_does_not_write_over_a_session(tmp_path):
    file = series(tmp_path / "series")
    import_emva1288(file, tmp_path / "S")
    with pytest.raises(BadInput, match="needs a folder without one"):
        import_emva1288(file, tmp_path / "S")


def test_the_real_series_is_imported_whole(shared_data, tmp_path):
    session = import_emva1288(
        shared_data / "emva001_basler_ccd12" / "EMVA1288_Data.txt", tmp_path / "S"
    )
    bright, dark = session.of_kind("flat"), session.of_kind("dark")
    assert len(bright) == len(dark) == 26
    assert sorted(len(stack.paths) for stack in bright) == [2] * 25 + [16]
    assert session.bit_depth == 12
    assert bright[0].read().shape == (2, 480, 640)
    assert bright[24].conditions.photons_per_px == 41235.0
    assert bright[24].conditions.exposure_s == pytest.approx(13.72e-3)


def frames(folder: Path, *names: str) -> list[Path]:
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        np.save(folder / name, np.full((1, 3, 4), number, np.uint8))
    return [folder / name for name in names]


def test_loose_files_become_a_stack_each(tmp_path):
    session = import_frames(frames(tmp_path / "in", "b.npy", "a.npy"), tmp_path / "S", kind="edge")
    assert [stack.label for stack in session.stacks] == ["a", "b"]
    assert {stack.kind for stack in session.stacks} == {"edge"}
    assert session.stack("b").read().data.max() == 0


def test_conditions_are_read_from_names_and_gather_frames(tmp_path):
    names = ("700V_5e6ns_1.npy", "700V_5e6ns_2.npy", "1050.5V_5e6ns_1.npy")
    session = import_frames(
        frames(tmp_path / "in", *names),
        tmp_path / "S",
        kind="flat",
        name_pattern="{mcp_v}V_{gate_ns}ns_*",
    )
    low, high = session.stacks
    assert low.conditions == Conditions(mcp_v=700.0, gate_ns=5e6)
    assert high.conditions == Conditions(mcp_v=1050.5, gate_ns=5e6)
    assert low.read().data[:, 0, 0].tolist() == [0, 1]


@pytest.mark.parametrize(
    ("pattern", "rule"),
    [
        ("{mcp_volt}V_*", "must be one of exposure_s, mcp_v, .*, got 'mcp_volt'"),
        ("flat_*", r"must name one condition or more, each once, in braces, got 'flat_\*'"),
        ("{mcp_v}V_{mcp_v}V", "each once"),
        (
            "{mcp_v}kV_*",
            r"every file name must match the pattern '\{mcp_v\}kV_\*', got '700V_1\.npy'",
        ),
    ],
)
def test_a_pattern_that_does_not_fit_is_refused(tmp_path, pattern, rule):
    with pytest.raises(BadInput, match=rule):
        import_frames(frames(tmp_path / "in", "700V_1.npy"), tmp_path / "S", name_pattern=pattern)


def fits_frame(path: Path, level: float, **cards: object) -> Path:
    """Write a frame of one level with header cards, `_` for `-` in their names."""
    fits = pytest.importorskip("astropy.io.fits", reason="FITS files need astropy")
    header = fits.Header([(name.replace("_", "-"), value) for name, value in cards.items()])
    fits.PrimaryHDU(np.full((3, 4), level, np.uint16), header).writeto(path)
    return path


def test_fits_frames_are_gathered_by_what_their_headers_state(tmp_path):
    flat = {"IMAGETYP": "Flat Field", "EXPTIME": 0.5, "CCD_TEMP": -10.0}
    files = [
        fits_frame(tmp_path / "b1.fit", 100, IMAGETYP="Bias Frame", EXPTIME=0.0, CCD_TEMP=-10.1),
        fits_frame(tmp_path / "b2.fit", 100, IMAGETYP="Bias Frame", EXPTIME=0.0, CCD_TEMP=-9.9),
        fits_frame(tmp_path / "warm.fit", 100, IMAGETYP="Bias Frame", EXPTIME=0.0, CCD_TEMP=20.0),
        # The same lamp within its drift, and a brighter one.
        fits_frame(tmp_path / "f1.fit", 1000, **flat),
        fits_frame(tmp_path / "f2.fit", 1010, **flat),
        fits_frame(tmp_path / "f3.fit", 3000, **flat),
        fits_frame(tmp_path / "other colour.fit", 1000, **flat, FILTER="R"),
        # A temperature in kelvins says nothing here, and a file without kind and exposure is a
        # stack of its own.
        fits_frame(
            tmp_path / "kelvin.fit", 50, IMAGETYP="Light Frame", EXPTIME=2.0, CCD_TEMP=168.0
        ),
        fits_frame(tmp_path / "silent.fit", 50),
    ]
    session = import_frames(files, tmp_path / "S")
    found = {tuple(path.stem for path in stack.paths): stack for stack in session.stacks}
    assert set(found) == {
        ("silent",),
        ("b1", "b2"),
        ("warm",),
        ("f1", "f2"),
        ("f3",),
        ("other colour",),
        ("kelvin",),
    }
    assert found["b1", "b2"].kind == "dark"
    assert found["b1", "b2"].conditions == Conditions(exposure_s=0.0, temperature_c=-10.0)
    assert found["f1", "f2"].kind == "flat"
    assert found["f1", "f2"].read().data[:, 0, 0].tolist() == [1000, 1010]
    assert found["kelvin",].conditions == Conditions(exposure_s=2.0)
    assert (found["kelvin",].kind, found["silent",].kind) == ("scene", "scene")
    told = import_frames(files[:2], tmp_path / "T", kind="flat")
    assert [stack.kind for stack in told.stacks] == ["flat"]
    # A gain that changes from dark to flat is in no condition: noise would compare them in silence.
    other = fits_frame(tmp_path / "gain.fit", 1000, **flat, GAIN=2)
    with pytest.raises(
        BadInput, match=r"must have one GAIN, got 'none' in f1\.fit and '2' in gain\.fit"
    ):
        import_frames([files[3], other], tmp_path / "U")
    with pytest.raises(BadInput, match="must have one GAIN"):
        import_frames([other], tmp_path / "T", label="other", add=True)


def test_files_of_one_stack_are_named_and_added_to_a_session(tmp_path):
    import_frames(
        frames(tmp_path / "in", "b.npy", "a.npy"), tmp_path / "S", kind="dark", label="dark"
    )
    session = import_frames(
        frames(tmp_path / "lit", "c.npy"), tmp_path / "S", kind="flat", label="flat", add=True
    )
    assert [(stack.label, stack.kind, len(stack.read().data)) for stack in session.stacks] == [
        ("dark", "dark", 2),
        ("flat", "flat", 1),
    ]
    before = (tmp_path / "S" / "session.toml").read_bytes()
    for keys, rule in (
        ({"label": "flat", "add": True}, "every stack's label must be its own, got 'flat' twice"),
        ({"label": "flat"}, "a new session needs a folder without one"),
        ({"label": "x", "name_pattern": "{mcp_v}*", "add": True}, "give one of them"),
    ):
        with pytest.raises(BadInput, match=rule):
            import_frames([tmp_path / "lit" / "c.npy"], tmp_path / "S", kind="flat", **keys)
    with pytest.raises(BadInput, match="`add` needs the folder of a session"):
        import_frames([tmp_path / "lit" / "c.npy"], tmp_path / "none", add=True)
    assert (tmp_path / "S" / "session.toml").read_bytes() == before


def test_loose_files_that_are_missing_or_of_no_known_kind_are_refused(tmp_path):
    (tmp_path / "a.xyz").write_bytes(b"x")
    for files, rule in (
        ([], "at least one file"),
        ([tmp_path / "none.tif"], "must exist"),
        ([tmp_path / "a.xyz"], r"or a Zarr array, got 'a\.xyz'"),
    ):
        with pytest.raises(BadInput, match=rule):
            import_frames(files, tmp_path / "S")
    with pytest.raises(BadInput, match="kind must be one of 'dark', 'flat'"):
        import_frames(frames(tmp_path / "in", "a.npy"), tmp_path / "S", kind="flap")  # type: ignore[arg-type]
    assert not (tmp_path / "S" / "session.toml").exists()


def test_files_without_frames_and_stacks_of_several_sizes_are_not_imported(tmp_path):
    (tmp_path / "empty.tif").write_bytes(b"")
    with pytest.raises(BadInput, match=r"must be whole and readable, got .*empty\.tif"):
        import_frames([tmp_path / "empty.tif"], tmp_path / "S")
    files = frames(tmp_path / "in", "700V_1.npy", "700V_2.npy")
    np.save(files[1], np.zeros((1, 3, 5), np.uint8))
    with pytest.raises(
        BadInput, match=r"one picture size, got 3 x 4 in 700V_1\.npy and 3 x 5 in 700V_2\.npy"
    ):
        import_frames(files, tmp_path / "S", name_pattern="{mcp_v}V_*")
    assert not (tmp_path / "S" / "session.toml").exists()
    session = import_frames(files, tmp_path / "S")
    assert session.notes == (
        "pictures of several sizes, rows x columns: 3 x 4 (700V_1), 3 x 5 (700V_2)",
    )
