"""Parts and sequences of a simulation from the command line."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from labdata import BadInput, load_camera, load_sensor, open_session
from simulate import centre_on_frame, conditions_of, read_cube, read_image, voltage_limit_warnings
from tests.charact.cli.runner import LAWN, done_well, small_camera, small_imager

# Before and after the physics of `charact simulate`: pictures become light, options conditions,
# stages files.


@pytest.fixture(scope="module")
def tube():
    return load_sensor("pulnix-ag5745ef3")


@pytest.fixture(scope="module")
def emccd():
    return load_camera("emccd-512")


def saved(folder, picture, name="picture.npy"):
    np.save(folder / name, picture)
    return folder / name


def test_every_dn_above_black_is_so_many_photoelectrons(tmp_path):
    picture = np.array([[10.0, 12.0], [20.0, 10.0]])
    image, notes = read_image(
        saved(tmp_path, picture), photoelectrons_per_dn=0.5, black_dn=10.0, shape=(2, 2)
    )
    assert_allclose(image, [[0.0, 1.0], [5.0, 0.0]])
    assert image.dtype == np.float32
    assert "0.5 photoelectrons per DN above 10 DN" in notes[0]


def test_the_first_frame_of_several_is_taken_and_said_so(tmp_path):
    stack = np.stack([np.full((2, 2), 7), np.full((2, 2), 9)]).astype(np.uint16)
    image, notes = read_image(
        saved(tmp_path, stack), photoelectrons_per_dn=1.0, black_dn=0.0, shape=(2, 2)
    )
    assert_array_equal(image, 7.0)
    assert any("first of 2 frames" in note for note in notes)


@pytest.mark.parametrize(("rows", "cols"), [(3, 3), (4, 7), (5, 10), (8, 6), (9, 10)])
def test_a_picture_stands_in_the_middle_of_the_frame_to_half_a_pixel(rows, cols):
    picture = np.arange(1.0, rows * cols + 1).reshape(rows, cols)
    frame, notes = centre_on_frame(picture, (5, 7))
    row, col = np.mgrid[:5, :7]
    lit = frame > 0
    # Where neither side was cropped unevenly, the lit rectangle's centre is the frame's.
    assert abs(row[lit].mean() - 2.0) <= 0.5
    assert abs(col[lit].mean() - 3.0) <= 0.5
    assert set(frame[lit]) <= set(picture.ravel())
    assert lit.sum() == min(rows, 5) * min(cols, 7)
    inner = np.diff(frame[lit].reshape(min(rows, 5), min(cols, 7)), axis=1)
    assert_array_equal(inner, 1.0)
    assert ("cropped" in " ".join(notes)) == (rows > 5 or cols > 7)
    assert ("darkness" in " ".join(notes)) == (rows < 5 or cols < 7)


@pytest.mark.parametrize(
    ("picture", "options", "sentence"),
    [
        (
            np.ones((2, 2)),
            {"photoelectrons_per_dn": None},
            "an image needs photoelectrons_per_dn",
        ),
        (
            np.ones((2, 2)),
            {"photoelectrons_per_dn": 0.0},
            "photoelectrons_per_dn must be positive, got 0",
        ),
        (np.ones((2, 2)), {"photoelectrons_per_dn": float("nan")}, "must be positive, got nan"),
        (np.ones((2, 2)), {"black_dn": float("nan")}, "black_dn must be a number, got nan"),
        (-np.ones((2, 2)), {}, "an image must have no negative pixel, got -1 in picture.npy"),
        (np.array([[np.nan, 1.0]]), {}, "every pixel must be finite"),
    ],
)
def test_what_is_no_light_is_refused(tmp_path, picture, options, sentence):
    keys = {"photoelectrons_per_dn": 1.0, "black_dn": 0.0, "shape": (2, 2), **options}
    with pytest.raises(BadInput) as error:
        read_image(saved(tmp_path, picture), **keys)
    assert sentence in str(error.value)


def test_a_cube_is_read_as_it_was_written(tmp_path):
    radiance = np.random.default_rng(0).random((3, 4, 5))
    np.savez(tmp_path / "c.npz", wavelength_nm=np.array([500.0, 600.0, 700.0]), radiance=radiance)
    cube = read_cube(tmp_path / "c.npz")
    assert_array_equal(cube.radiance, radiance)
    assert_array_equal(cube.wavelength_nm, [500.0, 600.0, 700.0])


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        (
            {"radiance": np.ones((1, 2, 2))},
            "must contain wavelength_nm and radiance, got no wavelength_nm",
        ),
        (
            {"wavelength_nm": np.ones(1), "radiance": -np.ones((1, 2, 2))},
            "must be finite and not negative",
        ),
        (
            {"wavelength_nm": np.ones(1), "radiance": np.full((1, 2, 2), np.nan)},
            "must be finite and not negative",
        ),
        (
            {"wavelength_nm": np.array([2.0, 1.0]), "radiance": np.ones((2, 2, 2))},
            "wavelengths must ascend",
        ),
        (
            {"wavelength_nm": np.ones(2), "radiance": np.ones((1, 2, 2))},
            "axes (band, row, col) with 2 bands",
        ),
        ({"wavelength_nm": np.array(["a"]), "radiance": np.ones((1, 2, 2))}, "must be numbers"),
    ],
)
def test_what_is_no_radiance_is_refused(tmp_path, arrays, sentence):
    np.savez(tmp_path / "c.npz", **arrays)
    with pytest.raises(BadInput) as error:
        read_cube(tmp_path / "c.npz")
    assert sentence in str(error.value)


def test_a_file_that_is_no_cube_is_refused(tmp_path):
    for name, content in (
        ("text.npz", b"radiance"),
        ("empty.npz", b""),
        ("cut.npz", b"PK\x03\x04 and no more"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(
            BadInput, match=r"must be a complete \.npz file, got " + name.replace(".", r"\.")
        ):
            read_cube(tmp_path / name)
    whole = tmp_path / "whole.npz"
    np.savez_compressed(
        whole, wavelength_nm=np.arange(2.0), radiance=np.random.default_rng(0).random((2, 40, 40))
    )
    spoilt = bytearray(whole.read_bytes())
    spoilt[len(spoilt) // 2 : len(spoilt) // 2 + 400] = bytes(400)
    whole.write_bytes(spoilt)
    np.save(tmp_path / "array", np.ones(3))
    for name in ("whole.npz", "array.npy"):
        with pytest.raises(BadInput, match=r"must be a complete \.npz file"):
            read_cube(tmp_path / name)
    with pytest.raises(BadInput, match="must exist to be read"):
        read_cube(tmp_path / "none.npz")


def test_a_luminous_gain_is_the_voltage_that_gives_it(tube):
    """G = G0 (V/V0)^m with G0 = 15,000, V0 = 800 V and m = 10: half the gain is 746.4 V."""
    assert conditions_of(tube, gain=15000.0).mcp_v == pytest.approx(800.0)
    assert conditions_of(tube, gain=7500.0).mcp_v == pytest.approx(800.0 * 0.5**0.1)
    assert conditions_of(tube).mcp_v == 800.0


@pytest.mark.parametrize(("mcp_v", "warned"), [(5000.0, True), (900.0, False)])
def test_more_voltage_than_the_description_allows_is_told(tube, mcp_v, warned):
    told = voltage_limit_warnings(tube, conditions_of(tube, mcp_v=mcp_v))
    assert [("exceeds the limit 900 of" in sentence) for sentence in told] == [True] * warned


def test_what_is_left_open_is_nominal_and_recorded(tube, emccd):
    asked = conditions_of(tube, temperature_c=10.0, automatic_gain=None)
    assert asked.gate_ns == pytest.approx(1e9 / 59.94)
    assert asked.exposure_s == pytest.approx(1.0 / 59.94)
    assert (asked.temperature_c, asked.automatic_gain, asked.em_gain) == (10.0, None, None)
    plain = conditions_of(emccd)
    assert (plain.em_gain, plain.mcp_v, plain.gate_ns) == (1000.0, None, None)
    assert conditions_of(emccd, gain=300.0).em_gain == 300.0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"gain": 0.0}, "gain must be positive, got 0"),
        ({"gain": 100.0, "mcp_v": 700.0}, "the gain must be set once, got mcp_v and gain"),
        (
            {"gain_control": 10.0, "mcp_v": 700.0},
            "the gain must be set once, got mcp_v and gain_control",
        ),
        ({"gate_ns": -1.0}, "gate_ns must not be negative, got -1"),
        ({"gain": 2000.0}, "gain of 'EMCCD 512' must lie between 1 and 1000, got 2000"),
        ({"mcp_v": 800.0}, "mcp_v needs a camera with a tube, got 'EMCCD 512'"),
        ({"gate_ns": 100.0}, "gate_ns needs a camera with a tube, got 'EMCCD 512'"),
        (
            {"brightness_control": True},
            "brightness_control needs a camera with a tube, got 'EMCCD 512'",
        ),
        ({"automatic_gain": True}, "automatic_gain needs a camera that has it, got 'EMCCD 512'"),
    ],
)
def test_settings_that_no_tube_takes_or_of_a_tube_where_there_is_none_are_refused(
    tube, emccd, options, sentence
):
    with pytest.raises(BadInput) as error:
        conditions_of(emccd if "EMCCD" in sentence else tube, **options)
    assert str(error.value) == sentence


# `charact simulate` of a moving scene: a camera of visible light and a thermal imager in step.


# The front of the box is 10 m before the cameras. ACROSS is its velocity (east), m/s.
SCENE = (
    LAWN.replace("CAMERA", "position_m = [0, -10, 1], look_at_m = [0, 0, 1]")
    + """
size_m = [0.15, 0.15, 1.2]
position_m = [0, 0.075, 0]
temperature_c = 60
KEYFRAMES
[[lamp]]
label = "lamp"
kind = "incandescent"
lumens = 3e2
position_m = [0, -8, 4]
"""
)
FRAMES = 2


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A bolometer array and a camera of visible light of few pixels."""
    folder = tmp_path_factory.mktemp("sequence")
    small_imager(folder, "vox-lwir-640", "bolometer", rows=24, columns=64)
    small_camera(folder, 24, 64).rename(folder / "visible.toml")
    return folder


def simulated(files, out, keyframes, *options):
    scene = files / f"{out.name}.toml"
    scene.write_text(SCENE.replace("KEYFRAMES", keyframes))
    done_well(
        "simulate",
        scene,
        out,
        "--sensor",
        files / "visible.toml",
        "--sensor",
        files / "thermal.toml",
        "--frames",
        FRAMES,
        "--gain",
        3e4,
        *options,
    )
    return open_session(out)


def truth_of(out, name, number=0):
    with np.load(
        out / "truth" / (f"{name}-{number:04d}.npz" if number else f"{name}.npz")
    ) as truth:
        return {key: truth[key] for key in truth.files}


def front_of_box(truth):
    """Columns of the front of the box, which faces the cameras, in one of its rows."""
    front = (truth["object"] == list(truth["objects"]).index("box")) & (
        truth["normal"][..., 1] < -0.5
    )
    row = np.flatnonzero(front.any(axis=1))[3]
    return np.flatnonzero(front[row])


def test_an_object_is_found_where_its_keyframes_bring_it_in_both_bands(files, tmp_path):
    """5 px of the thermal imager a frame: truth within half a pixel, frames within a tenth of the
    way.
    """
    thermal = load_camera(files / "thermal.toml")
    pitch = 1e-3 * thermal.pitch_mrad[1]
    shift_px = 5.0
    velocity = shift_px * pitch * 10.0 * thermal.frame_rate_hz
    keyframes = f"[[object.keyframe]]\ntime_s = 1\nposition_m = [{velocity}, 0.075, 0]"
    session = simulated(files, tmp_path / "moving", keyframes)
    for name in ("visible", "thermal"):
        first, last = (truth_of(tmp_path / "moving", name, number) for number in (0, FRAMES - 1))
        stack = session.stack(name).read()
        assert (
            len(stack) == FRAMES and first["time_s"] == 0.0 and last["time_s"] == stack.time_s[-1]
        )
        moved_px = velocity * last["time_s"] / 10.0 * first["focal_px"][0]
        found_px = front_of_box(last).mean() - front_of_box(first).mean()
        assert moved_px > 2.0 and abs(found_px - moved_px) <= 0.5
        assert "views, each with its truth" in " ".join(session.stack(name).notes)
    frames = session.stack("thermal").read().data.astype(float)
    rows = np.flatnonzero((truth_of(tmp_path / "moving", "thermal")["object"] == 1).any(axis=1))[
        2:-2
    ]
    hot = frames[:, rows].mean(axis=1)
    hot = np.maximum(hot - 0.5 * (hot.min() + hot.max()), 0.0)
    place = hot @ np.arange(hot.shape[1]) / hot.sum(axis=1)
    # Of a bolometer's frame the part exp(-T / tau) is that of the frame before.
    lag = float(np.exp(-1e3 / thermal.frame_rate_hz / float(thermal.bolometer.time_constant_ms)))
    assert place[1] - place[0] == pytest.approx((1.0 - lag) * shift_px, abs=0.2)


def test_a_still_scene_is_that_without_keyframes_bit_for_bit(files, tmp_path):
    still = simulated(files, tmp_path / "still", "")
    standing = simulated(
        files,
        tmp_path / "standing",
        "[[object.keyframe]]\ntime_s = 0.01\nposition_m = [0, 0.075, 0]\nheading_deg = 0",
    )
    for name in ("visible", "thermal"):
        np.testing.assert_array_equal(
            standing.stack(name).read().data, still.stack(name).read().data
        )
        np.testing.assert_array_equal(
            standing.stack(name).read().time_s, still.stack(name).read().time_s
        )
        for key, values in truth_of(tmp_path / "still", name).items():
            np.testing.assert_array_equal(truth_of(tmp_path / "standing", name)[key], values)
    assert sorted(path.name for path in (tmp_path / "standing" / "truth").iterdir()) == [
        "thermal.npz",
        "visible.npz",
    ]
