"""What is wrong with a series is said: no wrong number goes out without a flag."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import noise
from labdata import BadInput, Conditions, FrameStack
from tests.truth.counted_pulses import (
    METHODS,
    QUICK,
    Pulses,
    errors,
    flat_series,
    gaussian,
    session_of,
)

LEVELS = (5.0, 15.0, 30.0)
SMALL = (96, 128)


def flags_of(result) -> set[str]:
    return {flag for m in result.measurements for flag in m.flags}


def gain_of(result):
    return next(m for m in result.measurements if m.quantity in ("covariance_gain", "system_gain"))


@pytest.mark.parametrize("method", METHODS)
def test_frames_of_pure_noise_are_never_ok(seed, method):
    rng = np.random.default_rng(seed)
    stacks = [
        (
            f"flat-{i}",
            "flat",
            FrameStack(data=rng.integers(0, 256, (6, 96, 128), np.uint8)),
            Conditions(),
        )
        for i in range(3)
    ]
    dark = [
        (
            "dark",
            "dark",
            FrameStack(data=rng.integers(0, 256, (6, 96, 128), np.uint8)),
            Conditions(),
        )
    ]
    for session in (session_of(dark + stacks), session_of(stacks)):
        gain = gain_of(noise.measure(session, method=method, context=QUICK))
        assert gain.status != "ok", gain


@pytest.mark.parametrize("method", METHODS)
def test_frames_that_never_change_are_refused(method):
    stacks = [
        ("dark", "dark", FrameStack(data=np.full((4, 96, 128), 10, np.uint8)), Conditions()),
        ("flat", "flat", FrameStack(data=np.full((4, 96, 128), 90, np.uint8)), Conditions()),
    ]
    gain = gain_of(noise.measure(session_of(stacks), method=method, context=QUICK))
    assert gain.status == "refused" and "noisier" in gain.reason


def test_a_session_without_flats_or_darks_is_bad_input(seed):
    stacks = [("edge", "edge", FrameStack(data=np.zeros((2, 8, 8), np.uint8)), Conditions())]
    with pytest.raises(BadInput, match="dark or flat"):
        noise.measure(session_of(stacks), context=QUICK)


def blurred_faint_pulses(pulses):
    """Pulses of 3 DN behind a blur of .7 px over electronics far finer than a step."""
    return pulses(shape=(128, 160), gain_dn=3.0, read_noise_dn=0.2, transfer=gaussian(0.7))


def test_pulses_whose_faint_parts_the_steps_cut_off_are_flagged_until_the_light_lifts_them(seed):
    rng = np.random.default_rng(seed)
    dim, bright = (
        gain_of(
            noise.measure(
                flat_series(blurred_faint_pulses(Pulses), rng, levels, frames=8), context=QUICK
            )
        )
        for levels in ((0.1, 0.2, 0.4), (4.0, 8.0, 16.0))
    )
    assert "quantised" in dim.flags
    assert "quantised" not in bright.flags


def test_light_within_the_steps_of_the_digitiser_ends_in_verdicts_and_not_in_a_traceback(seed):
    rng, camera = np.random.default_rng(seed), blurred_faint_pulses(Pulses)
    stacks = [
        (
            f"{kind}-{level}",
            kind,
            camera.frames(rng, level, 8),
            Conditions(illuminance_lux=1e-5 * level),
        )
        for kind, level in (("dark", 0.0), ("flat", 0.03), ("flat", 0.05), ("flat", 0.08))
    ]
    result = noise.measure(session_of(stacks), context=QUICK)
    assert gain_of(result).status != "ok"
    assert all(m.status != "ok" for m in result.find("minimum_illumination"))


def test_drift_and_flicker_are_told_apart(seed):
    drifting = Pulses(shape=SMALL, light_of_frame=lambda n: 1.0 + 0.01 * n)
    flickering = Pulses(shape=SMALL, light_of_frame=lambda n: 1.0 + 0.04 * (-1) ** n)
    steady = Pulses(shape=SMALL)
    seen = [
        flags_of(
            noise.measure(
                flat_series(c, np.random.default_rng(seed), LEVELS),
                method="variance",
                context=QUICK,
            )
        )
        & {"drift", "flicker"}
        for c in (drifting, flickering, steady)
    ]
    assert seen == [{"drift"}, {"flicker"}, set()]


def test_a_mean_that_stays_while_the_light_changes_betrays_automatic_gain(seed):
    rng = np.random.default_rng(seed)
    stacks = [
        ("dark", "dark", Pulses(shape=SMALL).frames(rng, 0.0, 8), Conditions(illuminance_lux=0.0))
    ]
    for index, level in enumerate((4.0, 12.0, 36.0)):
        held = Pulses(shape=SMALL, gain_dn=20.0 * 20.0 / level * (1 + 0.01 * index))
        stacks.append(
            (f"flat-{index}", "flat", held.frames(rng, level, 8), Conditions(illuminance_lux=level))
        )
    for method in METHODS:
        assert (
            "agc" in gain_of(noise.measure(session_of(stacks), method=method, context=QUICK)).flags
        )


@pytest.mark.parametrize("control", ["automatic_gain", "brightness_control"])
def test_an_automatic_gain_that_the_session_states_is_flagged_though_no_flat_betrays_it(
    seed, control
):
    """A gain that all levels share alike is no other than the camera's own."""
    session = flat_series(Pulses(shape=SMALL), np.random.default_rng(seed), LEVELS, frames=4)
    told = tuple(
        replace(s, conditions=replace(s.conditions, **{control: True})) for s in session.stacks
    )
    for method in METHODS:
        assert (
            "agc"
            in gain_of(
                noise.measure(replace(session, stacks=told), method=method, context=QUICK)
            ).flags
        )


def test_levels_beyond_the_variance_peak_are_left_out(seed):
    camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5, full_scale_dn=4095.0)
    levels = (400.0, 1200.0, 2500.0, 4000.0, 5500.0, 7000.0, 8400.0)
    session = flat_series(camera, np.random.default_rng(seed), levels, frames=4)
    result = noise.measure(session, method="variance", context=QUICK)
    (saturation,), (gain,) = result.find("saturation"), result.find("system_gain")
    assert saturation.value == pytest.approx(100 + 0.5 * 7000, rel=0.02)
    assert gain.status == "ok"
    assert abs(errors(gain, 0.5)) < 4.5
    assert not result.evidence["photon-transfer"]["fitted"][-1]


@pytest.mark.parametrize("levels", [(600.0,), (600.0, 1200.0)])
def test_what_few_levels_leave_open_of_the_response_is_in_the_interval(seed, levels):
    """One or two levels cannot tell a response that bends by 2 % from a straight one of another
    gain.

    The variance over signal of the brightest is 6 % low by arithmetic: (1 - 2 x 0.02)^2 / (1 -
    0.02).
    """
    for bend in (0.0, 0.02):
        camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5, bend_per_dn=bend / (0.5 * levels[-1]))
        session = flat_series(camera, np.random.default_rng(seed), levels)
        for method in METHODS:
            found = noise.measure(session, method=method, context=QUICK).find("system_gain")[0]
            assert "nonlinear" in found.flags or found.interval95[0] < 0.5 < found.interval95[1], (
                method
            )
            assert bend or (found.status == "ok" and found.value == pytest.approx(0.5, rel=0.02))


@pytest.mark.parametrize("bend", [0.0, 0.02])
def test_gain_is_the_slope_and_curvature_stands_beside_it(seed, bend):
    """Of y = s (1 - b s / top) shot noise has the variance K s (1 - 2 b s / top)^2."""
    electrons = np.linspace(0.2, 1.0, 5) * 4000.0
    camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5, bend_per_dn=bend / (0.5 * electrons[-1]))
    session = flat_series(camera, np.random.default_rng(seed), tuple(electrons), frames=8)
    result = noise.measure(session, method="variance", context=QUICK)
    x = bend * electrons / electrons[-1]
    signal, variance = electrons * 0.5 * (1.0 - x), electrons * 0.25 * (1.0 - 2.0 * x) ** 2
    (gain,), (curvature,) = result.find("system_gain"), result.find("gain_curvature")
    assert abs(errors(gain, float(signal @ variance / (signal @ signal)))) < 4.5
    low, high = gain.interval95
    assert high - low < 0.03 * gain.value
    line = np.polynomial.Polynomial.fit(signal / signal[-1], variance / signal, 1).convert().coef
    expected = 100.0 * line[1] / float(np.mean(variance / signal))
    assert abs(errors(curvature, expected)) < 4.5


def test_saturation_that_no_flat_reaches_is_refused(seed):
    result = noise.measure(
        flat_series(Pulses(shape=SMALL), np.random.default_rng(seed), LEVELS, frames=4),
        context=QUICK,
    )
    (saturation,) = result.find("saturation")
    assert saturation.status == "refused" and "still rises" in saturation.reason


def test_missing_darks_are_flagged_and_the_slope_still_found(seed):
    camera = Pulses()
    session = flat_series(
        camera, np.random.default_rng(seed), (3.0, 10.0, 20.0, 30.0), dark_frames=0
    )
    gain = gain_of(noise.measure(session, context=QUICK))
    assert gain.status == "suspect" and "no-darks" in gain.flags
    assert abs(errors(gain, camera.covariance_gain_dn)) < 4.5


def named_and_held(measurement, flag, truth):
    """Whether a bounded effect is named and the interval holds the truth."""
    low, high = measurement.interval95
    return any(note.startswith(f"{flag}: ") for note in measurement.notes) and low <= truth <= high


def test_the_bound_of_noise_finer_than_the_digitiser_is_in_the_interval(seed):
    camera = Pulses(read_noise_dn=0.2, shape=SMALL)
    session = flat_series(camera, np.random.default_rng(seed), LEVELS, frames=4)
    result = noise.measure(session, method="variance", context=QUICK)
    read = next(m for m in result.find("read_noise") if m.unit == "DN")
    assert read.status == "ok" and named_and_held(read, "quantised", np.hypot(0.2, 12**-0.5))


def test_the_bound_of_a_dark_clipped_at_zero_is_in_the_interval(seed):
    camera = Pulses(black_dn=1.0, shape=SMALL)
    session = flat_series(camera, np.random.default_rng(seed), LEVELS, frames=4)
    result = noise.measure(session, method="variance", context=QUICK)
    assert named_and_held(gain_of(result), "clipped", camera.covariance_gain_dn)
    read, level = (result.find(name, unit="DN")[0] for name in ("read_noise", "dark_signal"))
    assert named_and_held(read, "clipped", camera.read_noise_dn)
    assert named_and_held(level, "clipped", 1.0)


def test_dead_pixels_of_a_dark_are_no_noise_cut_off(seed):
    """Dead pixels inside rows, not lost ones: noise far above 0 DN explains no value there."""
    session = flat_series(Pulses(shape=SMALL), np.random.default_rng(seed), LEVELS, frames=4)
    (dark,) = session.of_kind("dark")
    data = dark.read().data.copy()
    data[:, :9, 1:-1] = 0
    stacks = [
        (s.label, s.kind, FrameStack(data=data) if s is dark else s.read(), s.conditions)
        for s in session.stacks
    ]
    result = noise.measure(session_of(stacks), method="variance", context=QUICK)
    assert "clipped" in gain_of(result).flags
    assert all("clipped" in m.flags for m in result.find("read_noise", unit="DN"))


def test_drift_and_flicker_of_flats_are_bounded_for_the_slope_and_no_matter_of_the_dark(seed):
    for camera in (
        Pulses(shape=SMALL, light_of_frame=lambda n: 1.0 + 0.01 * n),
        Pulses(shape=SMALL, light_of_frame=lambda n: 1.0 + 0.04 * (-1) ** n),
    ):
        session = flat_series(camera, np.random.default_rng(seed), LEVELS)
        result = noise.measure(session, method="variance", context=QUICK)
        gain, (read,) = gain_of(result), result.find("read_noise", unit="DN")
        assert gain.status == "ok" and any(": at most " in note for note in gain.notes)
        assert abs(errors(gain, camera.covariance_gain_dn)) < 4.5
        assert read.status == "ok" and result.find("prnu")[0].status != "ok"


def test_darks_alone_give_read_noise_and_blur_factor(seed):
    rng = np.random.default_rng(seed)
    white = rng.normal(0.0, 9.0, (12, 128, 160))
    # The mean of two neighbours: half the variance, the same covariance sum.
    smooth = 0.5 * (white + np.roll(white, 1, axis=2))
    for noisy, blur in ((white, 1.0), (smooth, 0.5)):
        stack = FrameStack(data=np.rint(100 + noisy).astype(np.uint16))
        result = noise.measure(session_of([("dark", "dark", stack, Conditions())]), context=QUICK)
        (read,), (factor,) = result.find("read_noise"), result.find("blur_factor")
        assert read.value == pytest.approx(9.0 * np.sqrt(blur), rel=0.02)
        assert abs(errors(factor, blur)) < 4.5
        assert result.find("covariance_gain")[0].status == "refused"


def test_images_too_small_for_a_covariance_are_refused_one_and_still_have_a_variance(seed):
    """Nine pixels: the mean of the frame takes a ninth of the noise along, which is put back."""
    rng = np.random.default_rng(seed)
    gain = 0.5
    stacks = [
        (
            "dark" if not level else f"flat-{level}",
            "flat" if level else "dark",
            FrameStack(
                data=(100 + gain * rng.poisson(400 + level, (1500, 3, 3))).astype(np.float32)
            ),
            Conditions(),
        )
        for level in (0, 3000, 6000, 9000)
    ]
    session = session_of(stacks)
    assert (
        gain_of(noise.measure(session, method="covariance-sum", context=QUICK)).status == "refused"
    )
    found = gain_of(noise.measure(session, method="variance", context=QUICK))
    assert found.status == "ok"
    assert abs(errors(found, gain)) < 4.5


def test_stacks_that_take_no_part_are_named(seed):
    rng = np.random.default_rng(seed)
    session = flat_series(Pulses(shape=SMALL), rng, LEVELS, frames=4)
    stacks = [
        (s.label, s.kind, s.read(), replace(s.conditions, mcp_v=800.0)) for s in session.stacks
    ]
    other = (
        "other-gain",
        "flat",
        Pulses(gain_dn=40.0, shape=SMALL).frames(rng, 9.0, 4),
        Conditions(mcp_v=850.0),
    )
    lone = ("lone", "flat", Pulses(shape=SMALL).frames(rng, 9.0, 1), Conditions(mcp_v=800.0))
    gain = gain_of(noise.measure(session_of([*stacks, other, lone]), context=QUICK))
    assert any("different gain): other-gain" in note for note in gain.notes)
    assert any("excluded (single frame, no noise): lone" in note for note in gain.notes)


@pytest.mark.parametrize(("bend_per_dn", "seen"), [(-1.3e-5, True), (0.0, False), (1.3e-5, False)])
def test_covariance_that_rises_with_the_signal_is_no_tiring_plate(seed, bend_per_dn, seen):
    """A response that steepens by 2 % makes covariance over signal rise by 6 %, one that tires
    makes it fall.
    """
    camera = Pulses(gain_dn=20.0, transfer=gaussian(0.7), bend_per_dn=bend_per_dn)
    session = flat_series(camera, np.random.default_rng(seed), (8.0, 20.0, 40.0, 80.0), frames=8)
    gain = gain_of(noise.measure(session, method="covariance-sum", context=QUICK))
    assert ("nonlinear" in gain.flags) is seen
