"""`charact simulate` end to end: a picture, a cube and a bench scene become sessions that say how
they came about, and what was left out.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from typer.testing import Result

from labdata import load_camera, load_phosphor, open_session, save_sensor
from tests.charact.cli.runner import assert_one_sentence, charact, done_well, small_camera

ROWS, COLS = 48, 64
CAMERAS = ("pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512")


@pytest.fixture(scope="module")
def cameras(tmp_path_factory) -> dict[str, Path]:
    """Every shipped camera with a small chip, as a file."""
    folder = tmp_path_factory.mktemp("cameras")
    return {name: small_camera(folder, ROWS, COLS, name) for name in CAMERAS}


@pytest.fixture
def picture(tmp_path) -> Path:
    """Half of it dark at 20 DN, half lit at 120 DN."""
    image = np.full((ROWS, COLS), 20, np.uint16)
    image[:, COLS // 2 :] = 120
    tifffile.imwrite(tmp_path / "half.tif", image)
    return tmp_path / "half.tif"


PLAIN = {
    "photocathode.halo_fraction": 0.0,
    "microchannel_plate.strip_current_ua_per_cm2": 1e9,
    "microchannel_plate.ion_event_rate_per_s_cm2": 0.0,
    "microchannel_plate.pattern_contrast": 0.0,
    "phosphor.gain_nonuniformity": 0.0,
    "taper.pattern_contrast": 0.0,
    "taper.distortion_fraction": 0.0,
    "ccd.prnu": 0.0,
    "ccd.dsnu_e": 0.0,
    "ccd.full_well_e": 1e6,
    "ccd.smear_fraction": 0.0,
    "register.clock_induced_e": 0.0,
}
SCALE = ("--photoelectrons-per-dn", 0.1, "--black-dn", 20)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_picture_comes_out_as_bright_as_its_photoelectrons_make_it(
    tmp_path, cameras, picture, name
):
    """10 photoelectrons per pixel as read, without halo, saturation and patterns: within 4 standard
    errors.

    The mean over a patch away from the edge, above a dark one; 1 % is left for what the tube blurs
    across.
    """
    plain = load_camera(cameras[name])
    plain = plain.with_values(
        {path: value for path, value in PLAIN.items() if path in plain.parameters()}
    )
    save_sensor(plain, tmp_path / "plain.toml")
    gain = (
        ("--gain", 100, "--temperature-c", -70) if name == "emccd-512" else ("--temperature-c", 25)
    )
    sensor = ("--sensor", tmp_path / "plain.toml")
    done_well("simulate", picture, tmp_path / "out", *sensor, *SCALE, "--frames", 24, *gain)
    frames = open_session(tmp_path / "out").stack("scene").read().data.astype(float)
    assert frames.shape == (24, ROWS, COLS)
    inner = slice(8, -8)
    lit = frames[:, inner, COLS - 20 : COLS - 8] - frames[:, inner, 8:20]
    known = plain.parameters()
    per_e = float(known["video.conversion_gain_dn_per_e"])
    if name == "emccd-512":
        per_pe, excess = 100.0 * per_e, 2.0
    else:
        lumens = float(known["phosphor.luminous_efficacy_lm_per_w"]) * float(
            known["phosphor.photon_energy_ev"]
        )
        sensitivity = float(known["photocathode.luminous_sensitivity_ua_per_lm"]) * 1e-6
        photons = float(known["tube.luminous_gain"]) / lumens / sensitivity
        per_pe = (
            photons
            * float(known["taper.transmission"])
            * float(known["ccd.quantum_efficiency"])
            * per_e
        )
        excess = 2.0 / float(known["microchannel_plate.detection_probability"])
    # Counts in the patch and all frames; rows of an interlaced frame share half of theirs, and the
    # patch is 12 wide.
    electrons = 10.0 * 24 * (ROWS - 16) * 12 * (0.5 if name == "pulnix-ag5745ef3" else 1.0)
    error = 10.0 * per_pe * np.sqrt(excess / electrons)
    assert lit.mean() == pytest.approx(10.0 * per_pe, abs=4.0 * error + 0.01 * 10.0 * per_pe)


def test_the_session_records_camera_settings_and_how_the_light_came_about(
    tmp_path, cameras, picture
):
    options = (
        "--gain",
        7500,
        "--gate-ns",
        5e6,
        "--temperature-c",
        10,
        "--seed",
        3,
        "--phosphor",
        "P43",
        "--frames",
        2,
    )
    done_well(
        "simulate",
        picture,
        tmp_path / "out",
        "--sensor",
        cameras["pulnix-ag5745ef3"],
        *SCALE,
        *options,
    )
    session = open_session(tmp_path / "out")
    assert session.camera.phosphor == load_phosphor("p43")
    (stack,) = session.stacks
    assert (stack.kind, stack.finished, session.is_interlaced, stack.bit_depth) == (
        "scene",
        True,
        True,
        8,
    )
    asked = stack.conditions
    gain = float(session.camera.tube.luminous_gain) * (asked.mcp_v / 800.0) ** 10.0
    assert gain == pytest.approx(7500.0, rel=1e-9)
    assert (asked.gate_ns, asked.temperature_c) == (5e6, 10.0)
    said = " | ".join(stack.notes)
    for words in (
        "seed 3",
        "half.tif",
        "0.1 photoelectrons per DN above 20 DN",
        "PULNiX",
        "gain 7500",
    ):
        assert words in said
    frames = stack.read()
    assert list(frames.frame_number) == [0, 1]
    assert frames.time_s[1] == pytest.approx(2.0 / 59.94)


def test_the_same_seed_gives_the_same_frames_and_more_frames_begin_with_them(
    tmp_path, cameras, picture
):
    for name, options in {"a": (3, 5), "b": (2, 5), "c": (2, 6)}.items():
        frames, seed = options
        done_well(
            *(
                "simulate",
                picture,
                tmp_path / name,
                "--sensor",
                cameras["gen3-digital-iccd"],
                *SCALE,
            ),
            *("--frames", frames, "--seed", seed),
        )
    a, b, c = (open_session(tmp_path / name).stack("scene").read().data for name in "abc")
    assert np.array_equal(a[:2], b)
    assert not np.array_equal(b, c)


@pytest.mark.parametrize(
    ("file", "options", "words"),
    [
        ("half.tif", (), ("an image needs ",)),
        (
            "half.tif",
            (*SCALE, "--illuminance-lux", 1),
            (" is only for bench scenes",),
        ),
        (
            "half.tif",
            (*SCALE, "--frequency", 0.1),
            ("is only for", "bars of a bench scene"),
        ),
        ("airfield", ("--illuminance-lux", 1e-4), (" is only for bench scenes",)),
        ("bench", ("--preview",), ("preview needs an outdoor scene",)),
        (
            "nowhere",
            (),
            ("must be a .toml file or one of airfield, bench, bench-lit, hangar, road",),
        ),
        (
            "half.tif",
            (*SCALE, "--phosphor", "P11"),
            ("a phosphor must be one of p20, p43, p46, p47",),
        ),
        ("half.tif", (*SCALE, "--kind", "house"), ("--kind must be one of dark, flat",)),
        ("half.tif", (*SCALE, "--gate-ns", 1e9), ("--gate-ns", "at most one exposure")),
        ("letter.tif", SCALE, ("letter.tif",)),
        ("picture.xyz", SCALE, (".xyz", ".tif")),
        ("cube.npz", (), ("must be a complete .npz file",)),
        ("cube.npz", SCALE, (" is only for an image",)),
        ("bench", SCALE, (" is only for an image",)),
        ("missing.toml", (), ("must exist",)),
        (
            "half.tif",
            (*SCALE, "--pinhole-px", 1),
            ("is only for", "point of a bench scene"),
        ),
        (
            "half.tif",
            (*SCALE, "--kind", "dark"),
            ("a dark must have no light, got it on 50 % of half.tif",),
        ),
        (
            "airfield",
            ("--kind", "dark"),
            ("a dark must have no light, got the scene 'half-moon airfield'",),
        ),
        (
            "airfield",
            ("--preview", "--stage-images", "s"),
            ("--preview has no stages, got --stage-images",),
        ),
        ("bench", ("--kind", "point"), ("kind point of a bench scene needs",)),
        ("bench", ("--kind", "bars"), ("kind bars of a bench scene needs",)),
        (
            "bench",
            ("--frequency", 0.1),
            ("bars of a bench scene, got it with", "kind edge"),
        ),
        (
            "bench",
            ("--kind", "point", "--pinhole-px", "inf"),
            ("--pinhole-px must be a finite number, got inf",),
        ),
        (
            "bench",
            ("--kind", "dark", "--illuminance-lux", 1),
            ("a dark must have no light, got",),
        ),
    ],
)
def test_what_cannot_be_simulated_is_one_sentence_and_leaves_no_session(
    tmp_path, cameras, picture, file, options, words
):
    (tmp_path / "letter.tif").write_text("Dear lab")
    (tmp_path / "picture.xyz").write_text("Dear lab")
    (tmp_path / "cube.npz").write_text("Dear lab")
    source = file if "." not in file else tmp_path / file
    done = charact(
        "simulate", source, tmp_path / "out", "--sensor", cameras["pulnix-ag5745ef3"], *options
    )
    assert_one_sentence(done, *words)
    assert not (tmp_path / "out").exists()


STAGES = {
    "pulnix-ag5745ef3": (
        "photoelectrons-at-the-plate",
        "microchannel-plate",
        "phosphor",
        "taper",
        "ccd",
        "video",
    ),
    "gen3-digital-iccd": (
        "photoelectrons-at-the-plate",
        "microchannel-plate",
        "phosphor",
        "taper",
        "ccd",
        "video",
    ),
    "emccd-512": ("photoelectrons-in-the-chip", "ccd", "register", "video"),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_the_image_after_each_stage_is_a_file_of_its_quantity(tmp_path, cameras, picture, name):
    folder = tmp_path / "stages"
    done_well(
        *("simulate", picture, tmp_path / "out", "--sensor", cameras[name], *SCALE, "--frames", 1),
        *("--stage-images", folder),
    )
    files = sorted(path.name for path in folder.glob("*.tif"))
    assert files[0] == "01-picture.tif"
    assert [file[:2] for file in files] == [f"{number:02d}" for number in range(1, len(files) + 1)]
    places = [
        next(i for i, file in enumerate(files) if file[3:-4] == stage) for stage in STAGES[name]
    ]
    assert places == sorted(places)
    seen = tifffile.imread(folder / files[0])
    assert seen.shape == (ROWS, COLS)
    assert (seen.min(), seen.max()) == (0.0, pytest.approx(10.0))
    # As many photoelectrons arrive as were in the picture: what the halo and the blur carry over
    # its borders, few.
    arrived = tifffile.imread(folder / files[places[0]]).astype(float).sum()
    rows_summed = 2 if name == "pulnix-ag5745ef3" else 1
    assert arrived == pytest.approx(seen.astype(float).sum() / rows_summed, rel=0.12)
    last = tifffile.imread(folder / files[-1])
    assert last.shape == (ROWS, COLS)
    assert np.array_equal(last, np.rint(last))
    assert (folder / "stages.png").stat().st_size > 10_000


def test_a_cube_is_seen_from_the_lens_on(tmp_path, cameras):
    cube = {"wavelength_nm": np.array([500.0, 900.0]), "radiance": np.full((2, ROWS, COLS), 1e-8)}
    np.savez(tmp_path / "c.npz", **cube)
    sensor = ("--sensor", cameras["gen3-digital-iccd"])
    done_well(
        *(
            "simulate",
            tmp_path / "c.npz",
            tmp_path / "out",
            *sensor,
            "--frames",
            1,
            "--stage-images",
            tmp_path / "s",
        )
    )
    assert sorted(path.name for path in (tmp_path / "s").glob("0[12]*")) == [
        "01-optics.tif",
        "02-photocathode.tif",
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A small camera, and an evenly dim picture of it in DN."""
    folder = tmp_path_factory.mktemp("economy")
    small_camera(folder, ROWS, COLS)
    np.save(folder / "dim.npy", np.full((ROWS, COLS), 1, np.uint16))
    return folder


def _simulated(folder: Path, out: str, *more: object, camera: str = "pulnix-ag5745ef3") -> Result:
    return done_well(
        "simulate",
        folder / "dim.npy",
        folder / out,
        "--sensor",
        folder / f"{camera}.toml",
        "--photoelectrons-per-dn",
        1,
        "--frames",
        2,
        *more,
    )


def _left_out(session: Path) -> set[str]:
    plan = json.loads((session / "economy.json").read_text())
    return {effect["name"] for effect in plan["effects"] if not effect["kept"]}


def test_a_dim_scene_goes_without_halo_overflow_and_smear_and_the_session_says_so(folder):
    done = _simulated(folder, "dim", "--explain")
    assert {"halo", "column blooming", "smear"} <= _left_out(folder / "dim")
    rows = {line[:26].strip(): line for line in done.stdout.splitlines()}
    assert "left out" in rows["halo"]
    assert "kept" in rows["pulse-height distribution"]
    notes = " ".join(open_session(folder / "dim").stacks[0].notes)
    assert "halo" in notes
    assert "% of the temporal noise, of 10 % allowed" in notes


def test_within_nothing_only_what_has_no_influence_is_left_out(folder):
    _simulated(folder, "within", "--error-budget", 0)
    plan = json.loads((folder / "within" / "economy.json").read_text())
    assert all(effect["kept"] == (effect["influence"] > 0.0) for effect in plan["effects"])


def test_exact_keeps_everything(folder):
    done = _simulated(folder, "exact", "--exact", "--explain")
    assert not _left_out(folder / "exact")
    assert "left out  " not in done.stdout
    assert "nothing left out" in " ".join(open_session(folder / "exact").stacks[0].notes)


def test_a_camera_without_a_tube_keeps_every_stage_and_says_so(folder):
    small_camera(folder, ROWS, COLS, "emccd-512")
    done = _simulated(folder, "emccd", "--explain", camera="emccd-512")
    assert "all effects are retained" in done.stdout
