"""Chips of several parts: cases of other tools' users, and siblings drawn here in plain NumPy."""

import re

import numpy as np
import pytest
from scipy.special import erf
from typer.testing import CliRunner

import charact
from charact.cli.application import app
from charact.estimators import noise
from charact.frames.layout import lost_rows
from charact.reporting.report_images import representative
from charact.session_measurement import method_context
from labdata import BadInput, open_session

LEVELS = (300.0, 1000.0, 2500.0, 5000.0)


def measured(folder, **settings):
    session = open_session(folder)
    return noise.measure(session, context=method_context(session, quick=True, seed=0, **settings))


def drawn(
    folder,
    *,
    seed=1,
    gain=0.4,
    offset=100.0,
    light=1.0,
    size=(128, 160),
    frames=2,
    full_e=1e9,
    levels=4,
    **wrong,
):
    """A session of a plain camera: K (DN/e-), offset (DN) and light may be of shape `size`.

    `wrong`: by label of a stack, with "_" for "-", a function that changes its frames in place.
    """
    rng = np.random.default_rng(seed)
    lines = ['name = "sibling"']
    stacks = {"dark-0": 0.0} | {f"flat-{i}": level for i, level in enumerate(LEVELS[-levels:])}
    response = 1.0 + 0.005 * rng.standard_normal(size)
    folder.mkdir()
    for label, level in stacks.items():
        mean_e = np.broadcast_to(level * light * response, (frames, *size))
        electrons = np.minimum(rng.poisson(mean_e), full_e)
        electrons = electrons + rng.normal(0.0, 5.0, mean_e.shape)
        data = np.rint(np.clip(gain * electrons + offset, 0, 65535)).astype(np.uint16)
        wrong.get(label.replace("-", "_"), lambda frames: None)(data)
        np.save(folder / f"{label}.npy", data)
        lines += [
            "[[stack]]",
            f'label = "{label}"',
            f'kind = "{label[:-2]}"',
            f'frames = "{label}.npy"',
        ]
    (folder / "session.toml").write_text("\n".join(lines))
    return folder


def ramp(size, axis, low, high):
    """Values that rise linearly along an axis."""
    shape = [1, 1]
    shape[axis] = size[axis]
    return np.broadcast_to(np.linspace(low, high, size[axis]).reshape(shape), size)


def one(result, quantity, unit=None, **where):
    """The only measurement of a quantity, of the chip without an amplifier."""
    (measurement,) = (m for m in result.find(quantity, **where) if unit in (None, m.unit))
    return measurement


def parts_of(result):
    """Numbers of the amplifiers that carry a gain."""
    gains = (m for m in result.measurements if m.quantity == "system_gain")
    return sorted(m.amplifier for m in gains if m.amplifier)


def said(result):
    return " ".join(note for m in result.measurements for note in m.notes)


def holds(measurement, truth, within):
    """Whether a number is ok, near the truth, and its interval holds it."""
    low, high = measurement.interval95
    assert measurement.status == "ok", measurement.flags
    assert low <= truth <= high
    assert measurement.value == pytest.approx(truth, rel=within)


def is_whole(result):
    """Whether nothing was left out and one amplifier was found."""
    assert not parts_of(result)
    assert "left out" not in said(result) and "amplifier" not in said(result)


def test_two_amplifiers_have_a_gain_each_and_the_chips_holds_both(case):
    result = case("s1-two-amplifiers")
    for number, truth in ((1, 0.40), (2, 0.44)):
        holds(one(result, "system_gain", amplifier=number), truth, 0.02)
        read_dn = np.hypot(5.0 * truth, 12.0**-0.5)
        holds(one(result, "read_noise", "DN", amplifier=number), read_dn, 0.01)
    low, high = one(result, "system_gain").interval95
    assert low <= 0.40 and high >= 0.44
    assert "between columns 63 and 64" in said(result)
    # No pattern is in these frames but the step.
    assert {one(result, name).status for name in ("dsnu", "prnu")} == {"refused"}


def test_overscan_columns_are_left_out(case):
    result = case("t1-overscan-columns")
    assert "columns 128 to 143 are an unexposed strip" in said(result)
    assert one(result, "prnu").status == "refused"
    holds(one(result, "system_gain"), 0.40, 0.01)
    for label, truth in (("flat-00", 15.02), ("flat-04", 77.3)):
        (snr,) = result.find("snr", stack=label)
        holds(snr, truth, 0.01)


def test_a_frame_with_lost_rows_is_left_out(case):
    result = case("dd1-black-bar-in-a-dark")
    assert "rows 40 to 57 of frame 3 of dark-00 are 0 DN" in said(result)
    holds(one(result, "system_gain"), 0.40, 0.01)
    holds(one(result, "read_noise", "e-"), 5.0, 0.02)


def test_four_amplifiers(tmp_path):
    size = (144, 192)
    right, lower = np.arange(size[1]) >= 96, (np.arange(size[0]) >= 72)[:, None]
    number = 2 * lower + right
    gains, offsets = np.array([0.40, 0.43, 0.37, 0.41]), np.array([100.0, 109.0, 104.0, 95.0])
    chip = {"gain": gains[number], "offset": offsets[number], "size": size, "frames": 4}
    result = measured(drawn(tmp_path / "s", **chip))
    assert parts_of(result) == [1, 2, 3, 4]
    for index, truth in enumerate(gains):
        low, high = one(result, "system_gain", amplifier=index + 1).interval95
        assert low <= truth <= high
        holds(one(result, "dark_signal", amplifier=index + 1), offsets[index], 0.001)
    # Response of the pixels, without the steps of 16 %.
    holds(one(result, "prnu"), 0.5, 0.15)


def test_steps_between_amplifiers_are_no_image_lag(tmp_path):
    """They are a pattern whose variance has a part linear in the signal, as lag of two frames."""
    right = np.arange(160) >= 80
    gains = np.array([0.40, 0.46])
    chip = {"gain": gains[right * 1], "offset": np.array([100.0, 106.0])[right * 1]}
    result = measured(drawn(tmp_path / "s", **chip))
    gain = one(result, "system_gain")
    holds(gain, gains.mean(), 0.02)
    of_amplifiers = [one(result, "system_gain", amplifier=number).value for number in (1, 2)]
    assert gain.value == pytest.approx(np.mean(of_amplifiers), rel=1e-9)
    holds(one(result, "read_noise", "e-"), 5.0, 0.02)


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_gains_that_differ_by_three_percent_are_seen_in_even_and_tilted_light(tmp_path, slope):
    size = (128, 160)
    gain = np.where(np.arange(160) < 80, 0.400, 0.412)
    light = ramp(size, 1, 1.0 - slope, 1.0 + slope)
    result = measured(drawn(tmp_path / "s", gain=gain, light=light))
    assert parts_of(result) == [1, 2]
    assert "between columns 79 and 80" in said(result)
    low, high = one(result, "system_gain").interval95
    assert low <= 0.406 <= high


def test_one_amplifier_of_several_is_measured_alone(tmp_path):
    gain = np.where(np.arange(128) < 64, 0.3, 0.4)[:, None]
    folder = drawn(tmp_path / "s", gain=gain)
    result = measured(folder, amplifier=2)
    assert {m.amplifier for m in result.measurements} == {2}
    holds(one(result, "system_gain", amplifier=2), 0.4, 0.02)
    with pytest.raises(BadInput, match="1 to 2, got 3"):
        measured(folder, amplifier=3)


def test_prescan_rows_on_top_are_left_out(tmp_path):
    light = (np.arange(128) >= 10)[:, None] * np.ones(160)
    result = measured(drawn(tmp_path / "s", light=light))
    assert "rows 0 to 9 are an unexposed strip" in said(result)
    holds(one(result, "prnu"), 0.5, 0.15)


def test_strips_on_two_sides_under_uneven_light_are_left_out(tmp_path):
    size = (150, 200)
    light = ramp(size, 0, 0.6, 1.3).copy()
    light[:, :6] = light[:, 180:] = light[140:] = 0.0
    result = measured(drawn(tmp_path / "s", light=light, size=size))
    for strip in ("columns 0 to 5", "columns 180 to 199", "rows 140 to 149"):
        assert f"{strip} are an unexposed strip" in said(result)
    holds(one(result, "system_gain"), 0.40, 0.02)
    assert not parts_of(result)


@pytest.mark.parametrize("frames", [2, 4])
def test_rows_of_a_flat_that_were_lost_cost_its_frame_or_these_rows(tmp_path, frames):
    def lose(data):
        data[1, 90:97] = 0
        data[1, 97, :40] = 0

    result = measured(drawn(tmp_path / "s", flat_2=lose, frames=frames))
    assert "rows 90 to 97 of frame 1 of flat-2 are 0 DN" in said(result)
    holds(one(result, "system_gain"), 0.40, 0.02)
    holds(one(result, "prnu"), 0.5, 0.2)


def test_an_uneven_flat_that_is_full_in_the_middle_gives_the_gain_of_the_others(case):
    result = case("w1-uneven-flat-saturated")
    holds(one(result, "system_gain"), 11.2, 0.03)
    assert re.search("are full at about 34[01]. DN", said(result))
    # 3400 DN above a black of 256 DN, of 11.2 DN/e-.
    low, high = one(result, "saturation_capacity").interval95
    assert low <= (3400.0 - 256.0) / 11.2 <= high
    assert not result.find("snr") and not result.find("prnu")


def scene(size):
    """Light of a room: a ramp, a lamp and dark shapes, 40 to 1."""
    light = ramp(size, 0, 0.2, 1.0).copy()
    row, col = np.mgrid[: size[0], : size[1]]
    light += 1.5 * np.exp(-((row - 40.0) ** 2 + (col - 90.0) ** 2) / 500.0)
    light[60:100, 20:70] *= 0.3
    return light


@pytest.mark.parametrize(("full_e", "gain"), [(1e9, 0.4), (6000.0, 0.4), (6000.0, 7.5)])
def test_frames_of_one_scene_have_a_gain_whatever_part_is_full(tmp_path, full_e, gain):
    folder = drawn(
        tmp_path / "s", light=scene((160, 200)), size=(160, 200), gain=gain, full_e=full_e, levels=1
    )
    result = measured(folder)
    assert one(result, "system_gain").method == "uneven-scene"
    holds(one(result, "system_gain"), gain, 0.05)
    holds(one(result, "read_noise", "e-"), 5.0, 0.08)
    if full_e < 1e9:
        low, high = one(result, "saturation_capacity").interval95
        assert low <= full_e <= high


def test_full_pixels_of_the_brightest_of_uneven_flats_take_no_part(tmp_path):
    light = scene((160, 200))
    result = measured(drawn(tmp_path / "s", light=light, size=(160, 200), full_e=5000.0))
    holds(one(result, "system_gain"), 0.4, 0.02)
    low, high = one(result, "saturation_capacity").interval95
    assert low <= 5000.0 <= high


@pytest.mark.parametrize("method", ["variance", "covariance-sum"])
def test_a_named_method_says_that_pixels_are_full(tmp_path, method):
    folder = drawn(
        tmp_path / "s", light=scene((160, 200)), size=(160, 200), full_e=4000.0, levels=1
    )
    session = open_session(folder)
    context = method_context(session, quick=True, seed=0)
    result = noise.measure(session, method=method, context=context)
    assert "saturated" in one(result, "system_gain").flags
    assert one(result, "read_noise", "DN").status == "ok"


def test_an_even_flat_is_no_scene(tmp_path):
    session = open_session(drawn(tmp_path / "s", levels=1))
    context = method_context(session, quick=True, seed=0)
    gain = one(noise.measure(session, method="uneven-scene", context=context), "system_gain")
    assert gain.status == "refused" and "span a factor of 1.5" in gain.reason
    assert one(noise.measure(session, context=context), "system_gain").method != "uneven-scene"


def test_view_outlines_the_parts_and_the_report_shows_them(tmp_path):
    light = np.ones((128, 160))
    light[:, 150:] = 0.0
    gain = np.where(np.arange(128) < 64, 0.3, 0.4)[:, None]
    folder = drawn(tmp_path / "s", light=light, gain=gain)
    picture = tmp_path / "parts.png"
    arguments = ["view", f"{folder}#flat-3", "--layout", "--out", str(picture)]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "columns 150 to 159 are an unexposed strip" in done.output
    assert "between rows 63 and 64 another amplifier begins" in done.output
    assert picture.read_bytes()[:4] == b"\x89PNG"
    result = measured(folder)
    images = representative(open_session(folder), (), result.evidence["layout"])
    regions = {box.region: box.status for image in images for box in image.boxes}
    assert regions == {
        (0, 150, 128, 10): "refused",
        (0, 0, 64, 150): "ok",
        (64, 0, 64, 150): "ok",
    }


@pytest.mark.parametrize("lost", [np.s_[2, 40:52, 80:], np.s_[2, 40:52, :30]], ids=str)
def test_rows_lost_in_part_cost_their_frame(tmp_path, lost):
    def lose(frames):
        frames[lost] = 0

    result = measured(drawn(tmp_path / "s", frames=4, flat_2=lose))
    width = 160 - 80 if lost[2].start else 30
    assert f"rows 40 to 51 of frame 2 of flat-2 are 0 DN in {width} columns" in said(result)
    holds(one(result, "system_gain"), 0.40, 0.01)


def test_columns_of_one_value_in_every_frame_are_no_lost_rows():
    frames = np.random.default_rng(5).poisson(500.0, (4, 64, 160))
    frames[:, :, 130:] = 100
    assert not lost_rows(frames)
    frames[1, 30, 140] = 101
    assert not lost_rows(frames)


def test_rows_that_one_frame_of_an_edge_lost_are_named():
    row, col = np.mgrid[:100, :120]
    edge = 1000.0 + 400.0 * erf((col - 60.0 + 0.1 * (row - 50.0)) / 1.5)
    frames = np.random.default_rng(1).poisson(np.broadcast_to(edge, (4, 100, 120)))
    frames = frames.astype(np.uint16)
    region = (0, 0, 100, 120)
    assert charact.mtf(frames, roi=region, method="edge-slanted").mtf50.status == "ok"
    frames[2, 30:38] = 0
    (lost,) = charact.mtf(frames, roi=region, method="edge-slanted").find("mtf50")
    assert "defects" in lost.flags
    assert any("rows 30 to 37 of frame 2 are 0 DN" in note for note in lost.notes)


def vignetted(size):
    """Light of a lens that falls to nothing in the corners."""
    row, col = np.mgrid[: size[0], : size[1]]
    radius = np.hypot(row - 0.5 * size[0], col - 0.5 * size[1]) / (0.62 * size[1])
    return np.clip(1.0 - radius**2, 0.0, None) ** 2


def disc(size):
    """Light of a tube, whose screen ends inside the frame on a sharp rim."""
    row, col = np.mgrid[: size[0], : size[1]]
    return 1.0 * (np.hypot(row - 0.5 * size[0], col - 0.5 * size[1]) < 0.47 * size[1])


def stripes(size):
    """Gains of columns that differ at random, some far."""
    rng = np.random.default_rng(4)
    return np.broadcast_to(1.0 + 0.02 * rng.standard_t(2.0, size[1]), size).clip(0.5, 1.5)


@pytest.mark.parametrize("light", [vignetted, disc, stripes, lambda size: ramp(size, 1, 0.3, 1.7)])
def test_light_that_is_uneven_is_one_whole_chip(tmp_path, light):
    is_whole(measured(drawn(tmp_path / "s", light=light((128, 160)))))


def test_bad_columns_and_rows_of_two_fields_are_one_whole_chip(tmp_path):
    offset = np.full((128, 160), 100.0)
    offset[1::2] += 3.0
    offset[:, [30, 31, 100]] += 40.0
    gain = np.full((128, 160), 0.4)
    gain[1::2] *= 1.02
    is_whole(measured(drawn(tmp_path / "s", gain=gain, offset=offset)))
