"""SiTF, NETD and 3-D noise in kelvin of drawn cameras, and what makes them suspect or refused."""

from dataclasses import replace

import numpy as np
import pytest

import charact
from charact.estimators import noise
from charact.session_measurement import measure_noise, method_context
from labdata import BadInput, load_camera
from tests.truth.infrared import NOISE_K, Camera, blackbody_session

LEVELS = (17.0, 20.0, 22.0, 25.0, 28.0)
SMALL = (16, 48, 48)
# Numbers of the sheet, not of what was measured: 12 bits of white noise alone.
WHITE = {name: 0.1 * (name == "tvh") for name in NOISE_K}


def measured(session, seed=1):
    return measure_noise(session, context=method_context(session, quick=True, seed=seed))


def one(result, quantity, **where):
    (found,) = result.find(quantity, **where)
    return found


def of(camera, rng, levels=LEVELS, **more):
    return measured(blackbody_session(camera, rng, levels, **more))


def mapped(camera, rng, function):
    """Return a change of the frames by a function of them and of the number of the level."""
    return lambda number, level, pattern: camera.stack(
        np.rint(function(camera.frames(rng, level, pattern).data.astype(float), number)).astype(
            np.uint16
        )
    )


@pytest.fixture
def rng(seed):
    return np.random.default_rng([seed, 47])


def test_the_camera_drawn_is_the_camera_measured(rng):
    """SiTF and NETD within 1 %, all seven components within five standard errors, in K at each
    black body.
    """
    camera = Camera(shape=(16, 48, 64))
    session = blackbody_session(camera, rng, LEVELS)
    result = measured(session)
    sitf, netd = one(result, "sitf"), one(result, "netd")
    assert (sitf.status, sitf.unit, netd.status, netd.unit) == ("ok", "DN/K", "ok", "mK")
    assert sitf.value == pytest.approx(camera.sitf_dn_per_k, rel=0.01)
    random = np.hypot(100.0, 1e3 * np.sqrt(1.0 / 12.0) / camera.sitf_dn_per_k)
    assert netd.value == pytest.approx(random, rel=0.01)
    assert any("22.0 °C (295.1 K)" in note for note in netd.notes)
    assert any("E1543" in note for note in netd.notes)
    for name, truth in NOISE_K.items():
        part = one(result, f"noise_{name}", unit="K", stack="bb-2")
        low, high = part.interval68
        assert abs(part.value - truth) < 5.0 * max(0.5 * (high - low), 0.01 * truth), name
        in_dn = one(result, f"noise_{name}", unit="DN", stack="bb-2")
        assert part.value * sitf.value == pytest.approx(in_dn.value, rel=0.01)
    assert len(result.find("noise_tvh", unit="K")) == len(LEVELS)


def test_flats_of_a_black_body_are_not_taken_for_flats_of_light(rng):
    """By the session's analysis they are measured in kelvin, and the noise against light refuses
    them.
    """
    session = blackbody_session(Camera(shape=SMALL), rng, LEVELS)
    assert not measured(session).find("system_gain")
    with pytest.raises(
        BadInput, match=r"needs flats of light, got bb-0, .* of a black body \(blackbody_c\)"
    ):
        noise.measure(session, context=method_context(session, quick=True, seed=1))


def test_noise_in_kelvin_is_that_at_its_own_black_body(rng):
    """Equal noise in DN is less in K where 3-5 um have more radiance per kelvin: 37 % from 17 to 28
    C.
    """
    result = of(Camera(band_um=(3.0, 5.0), shape=SMALL), rng)
    cold, hot = (one(result, "noise_tvh", unit="K", stack=f"bb-{i}").value for i in (0, 4))
    assert cold / hot == pytest.approx(1.42, abs=0.04)


def test_arrays_without_a_session_are_measured_too(rng):
    camera, levels = Camera(shape=SMALL, noise_k=WHITE), [20.0, 22.0, 25.0]
    flats = [np.array(camera.frames(rng, camera.mean_dn(level), 0.0).data) for level in levels]
    result = charact.noise(flats=flats, blackbody_c=levels, background_c=22.0, quick=True)
    assert result.sitf.value == pytest.approx(20.0, rel=0.02)
    assert result.netd.value == pytest.approx(np.hypot(100.0, 14.4), rel=0.02)


def test_a_picture_stored_in_coarse_steps_and_white_cold(rng):
    """Values in steps of 16 DN, falling with temperature: the same SiTF and NETD."""
    camera = Camera(shape=SMALL, noise_k=WHITE, bits=16)
    result = of(camera, rng, change=mapped(camera, rng, lambda frames, _: 16 * (4000 - frames)))
    assert one(result, "sitf").value == pytest.approx(320.0, rel=0.01)
    assert one(result, "netd").value == pytest.approx(np.hypot(100.0, 14.4), rel=0.02)
    assert any("White is cold" in note for note in one(result, "sitf").notes)


@pytest.mark.parametrize("levels", [(), (22.0,), (22.0, 22.0)])
def test_one_temperature_names_what_is_missing(rng, levels):
    camera = Camera(shape=SMALL)
    # 1000 C is clipped.
    result = of(camera, rng, levels or (22.0, 1000.0))
    for quantity in ("sitf", "netd"):
        refused = one(result, quantity)
        assert refused.status == "refused"
        assert "two or more black-body levels" in refused.reason
        assert "at 22.0 °C" in refused.reason
        assert "add 8 or more frames at 27 °C" in refused.reason
    assert result.find("noise_tvh", unit="DN")
    assert not result.find("noise_tvh", unit="K")


def test_few_frames_give_sitf_but_no_netd(rng):
    for frames in (2, 4, 7):
        result = of(Camera(shape=(frames, *SMALL[1:])), rng)
        assert one(result, "sitf").value == pytest.approx(20.0, rel=0.02)
        assert "at least 8 frames" in one(result, "netd").reason
    assert "two or more" in one(of(Camera(shape=(1, *SMALL[1:])), rng), "sitf").reason


def test_levels_at_full_scale_are_left_out_and_named(rng):
    camera = Camera(shape=SMALL, bits=11)
    found = one(of(camera, rng, (17.0, 20.0, 22.0, 23.0, 30.0)), "sitf")
    assert found.value == pytest.approx(20.0, rel=0.02)
    assert any("bb-4" in note and "full scale" in note for note in found.notes)


def test_a_well_that_fills_below_full_scale_is_seen(rng):
    """The signal stops at 2100 of 16383 DN, where its noise stops too."""
    camera = Camera(shape=SMALL)
    change = mapped(camera, rng, lambda frames, _: np.minimum(frames, 2100))
    found = one(of(camera, rng, (17.0, 20.0, 22.0, 25.0, 32.0), change=change), "sitf")
    assert found.status == "suspect"
    assert "saturated" in found.flags
    assert found.value == pytest.approx(20.0, rel=0.02)


@pytest.mark.parametrize(("sitf", "told"), [(40.0, False), (10.0, False), (4.0, True), (1.0, True)])
def test_noise_below_the_digitiser_is_never_a_silent_netd(rng, sitf, told):
    """8 bits and 0.1 K of noise: 4 to 0.1 steps. What is ok is right, the rest is told."""
    camera = Camera(sitf_dn_per_k=sitf, bits=8, offset_dn=100.3, shape=SMALL, noise_k=WHITE)
    found = one(of(camera, rng, (20.0, 21.0, 22.0, 23.0, 24.0)), "netd")
    assert any(note.startswith("quantised: ") for note in found.notes) == told
    truth_mk, (low, high) = np.hypot(100.0, 1e3 / np.sqrt(12.0) / sitf), found.interval95
    assert low < truth_mk < high or not told
    assert told or found.value == pytest.approx(truth_mk, rel=0.03)


def with_gain(camera, rng, gains, steps=(0,) * 5):
    return mapped(camera, rng, lambda f, n: 2000.0 + gains[n] * (f - 2000.0) + steps[n])


def test_a_gain_that_follows_the_scene_is_refused_or_flagged(rng):
    camera = Camera(shape=SMALL, noise_k=WHITE)
    level_kept = with_gain(camera, rng, (1,) * 5, 2000.0 - camera.mean_dn(LEVELS))
    assert "automatic" in one(of(camera, rng, change=level_kept), "sitf").reason
    turned = with_gain(camera, rng, (1, 1, 1, 1, 0.9), (0, 0, 0, 0, -60))
    assert "turns back" in one(of(camera, rng, change=turned), "sitf").reason
    slow = with_gain(camera, rng, (1.5, 1.2, 1.1, 0.9, 0.8))
    assert "agc" in one(of(camera, rng, change=slow), "sitf").flags
    two = blackbody_session(camera, rng, LEVELS[1:4:2], change=with_gain(camera, rng, (1.3, 0.8)))
    assert "agc" in one(measured(two), "netd").flags
    session = blackbody_session(camera, rng, LEVELS)
    told = [
        replace(s, conditions=replace(s.conditions, automatic_gain=True)) for s in session.stacks
    ]
    assert one(measured(replace(session, stacks=tuple(told))), "sitf").flags == ("agc",)


def test_an_offset_that_changes_between_levels_is_drift(rng):
    camera = Camera(shape=SMALL, noise_k=WHITE)
    found = one(of(camera, rng, change=with_gain(camera, rng, (1,) * 5, (0, 0, 30, 30, 0))), "sitf")
    assert found.flags == ("drift",)
    assert found.interval95[0] < 20.0 < found.interval95[1]

    # 10 DN a level, in the order of the levels, is 3.6 DN/K more and seen by nothing but a level
    # that comes again.
    risen = [10 * number for number in range(6)]
    rising = one(of(camera, rng, change=with_gain(camera, rng, (1,) * 5, risen)), "sitf")
    assert any("taken again show it" in note for note in rising.notes)
    again = one(
        of(camera, rng, (*LEVELS, 17.0), change=with_gain(camera, rng, (1,) * 6, risen)), "sitf"
    )
    assert again.flags == ("drift",)
    assert not any("taken again show it" in note for note in again.notes)
    within = np.linspace(0, 12, SMALL[0])[:, None, None]
    warming = mapped(camera, rng, lambda frames, number: frames + within + 15 * number)
    assert "drift" in one(of(camera, rng, change=warming), "sitf").flags


def test_a_bent_response_is_nonlinear(rng):
    camera = Camera(shape=SMALL, noise_k=WHITE, band_um=None)

    def change(number, level, pattern):
        return camera.frames(rng, level - 2e-3 * (level - 2000.0) ** 2, pattern)

    assert one(of(camera, rng, change=change), "sitf").flags == ("nonlinear",)


def test_a_black_body_that_does_not_fill_the_frame_is_a_gradient(rng):
    camera = Camera(shape=SMALL, noise_k=WHITE)
    fills = np.linspace(1.0, 0.6, SMALL[2])

    def change(number, level, pattern):
        return camera.frames(rng, 2000.0 + (level - 2000.0) * fills, pattern)

    assert "gradient" in one(of(camera, rng, change=change), "sitf").flags


@pytest.mark.parametrize("band", [(3.0, 5.0), (8.0, 14.0), None])
@pytest.mark.parametrize("span", [2.0, 60.0])
@pytest.mark.parametrize("count", [2, 6])
def test_no_span_of_levels_fails_silently(rng, band, span, count):
    """Wherever the band is unknown and the levels lie, what is ok holds the truth within twice its
    interval.
    """
    camera = Camera(band_um=band, shape=(8, 32, 32), noise_k=WHITE, offset_dn=4000.0)
    found = one(of(camera, rng, 22.0 + np.linspace(-0.3, 0.7, count) * span), "sitf")
    if found.status == "ok":
        low, high = found.interval95
        assert 2.0 * low - found.value < 20.0 < 2.0 * high - found.value


def test_backgrounds_that_differ_or_lie_far_away_are_told(rng):
    camera = Camera(shape=SMALL, noise_k=WHITE)
    far = one(of(camera, rng, (40.0, 42.0, 44.0)), "sitf")
    assert "extrapolated" in far.flags
    unstated = one(of(camera, rng, (20.0, 22.0, 25.0), background_c=None), "sitf")
    assert unstated.status == "ok"
    assert any("background_c in session.toml narrows it" in note for note in unstated.notes)
    session = blackbody_session(camera, rng, LEVELS)
    stacks = list(session.stacks)
    stacks[0] = replace(stacks[0], conditions=replace(stacks[0].conditions, background_c=25.0))
    mixed = one(measured(replace(session, stacks=tuple(stacks))), "sitf")
    (note,) = [note for note in mixed.notes if note.startswith("unlike-conditions: ")]
    # 3 K of the steepest band: dL/dT grows by 3.2 % a kelvin, of which a half lies on either side.
    bound = float(note.split("at most ")[1].split(" DN/K")[0])
    assert bound == pytest.approx(1.5 * 0.032 * mixed.value, rel=0.03)
    assert mixed.interval95[0] <= mixed.value - 0.9 * bound
    assert mixed.interval95[1] >= mixed.value + 0.9 * bound


def test_lines_of_both_scan_directions_are_no_fixed_row_noise(rng):
    """A two-way scanner whose return lines lie 3 DN higher: apart they have no row noise, together
    1.5 DN.
    """
    camera = Camera(shape=(16, 96, 64), noise_k=WHITE)
    row = np.arange(96)[:, None]

    def change(number, level, pattern):
        return camera.frames(rng, level + 3.0 * (row % 4 >= 2), pattern)

    session = blackbody_session(
        camera, rng, LEVELS[1:4], change=change, imager=load_camera("scanning-lwir")
    )
    apart = one(measured(session), "noise_v", unit="K", stack="bb-1")
    together = one(measured(replace(session, camera=None)), "noise_v", unit="K", stack="bb-1")
    assert apart.value < 0.02
    assert together.value == pytest.approx(1.5 / 20.0, rel=0.2)
    netd = one(measured(session), "netd")
    assert netd.value == pytest.approx(np.hypot(100.0, 14.4), rel=0.02)
    assert any("as by ASTM E1543" in note for note in netd.notes)
