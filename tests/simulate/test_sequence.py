"""Scenes that move: the screen glows on, channels and gains recover, controls follow."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata import BadInput, Conditions, load_phosphor, load_sensor
from simulate.camera import (
    AutomaticControls,
    AutomaticGain,
    AutomaticState,
    BrightnessControl,
    CameraModel,
    PhosphorDecay,
    Slot,
    StageImage,
    automatic_controls,
    decay_components,
    grid,
    mcp_input_from_photoelectrons,
    tube_photometry,
)

# The screen of any phosphor: residuals by field, gates shorter than a decay, and steady scenes
# left alone.


# The screen's decay: residuals of P20 by field, shares of pulses at random times, and steady
# scenes left alone.


FIELD_S = 0.01668


def _p20(gate_s: float = FIELD_S) -> PhosphorDecay:
    return PhosphorDecay(
        components=((0.95, 1.45e-3), (0.05, 35e-3)), gate_s=gate_s, field_s=FIELD_S
    )


def test_early_and_late_halves_have_the_mean_products_of_random_pulses():
    glow = _p20()
    exact = glow.pulse_shares.T @ glow.pulse_shares / len(glow.pulse_shares)
    halves = glow.halves.T @ glow.halves / 2.0
    for lag in (0, 1, 2):
        assert np.trace(halves, lag) == pytest.approx(np.trace(exact, lag), rel=0.01)
    assert glow.halves.min() >= 0.0


def test_pulses_at_random_times_have_those_shares(seed):
    """Against decays of single pulses at random times, not the even ones of the stage."""
    glow = _p20()
    arrival = np.random.default_rng(seed).uniform(0.0, FIELD_S, 40_000)
    tau, share = np.array([1.45e-3, 35e-3]), np.array([0.95 * 1.45, 0.05 * 35.0])
    left = np.exp(-(FIELD_S - arrival)[:, None] / tau) @ (share / share.sum())
    squares = (1.0 - left) ** 2
    expected = np.mean(glow.pulse_shares[:, 0] ** 2)
    assert abs(squares.mean() - expected) < 4.5 * squares.std() / np.sqrt(len(squares))


def test_steady_scene_stays_and_a_flash_decays():
    glow = _p20()
    steady = StageImage(values=np.full((6, 3, 4), 7.0, np.float32))
    assert np.allclose(glow.mean(steady).values, 7.0, rtol=1e-5)
    flash = np.zeros((30, 2, 2), np.float32)
    flash[1] = 1.0
    seen = glow.mean(StageImage(values=flash)).values[:, 0, 0]
    assert seen[0] == 0.0
    assert seen[1 : 1 + glow.n_lag_fields + 1] == pytest.approx(glow.weights, rel=1e-4)
    assert seen.sum() == pytest.approx(1.0, rel=1e-5)


def test_screen_without_decay_keeps_nothing():
    glow = PhosphorDecay(components=((1.0, 0.0),), gate_s=FIELD_S, field_s=FIELD_S)
    assert glow.n_lag_fields <= 1
    assert glow.weights[0] == pytest.approx(1.0, abs=1e-6)


# Screens other than P20, and gates shorter than a decay: shares of later fields and what they do
# to the noise.


def _glow(name: str, field_s: float, gate_s: float | None = None) -> PhosphorDecay:
    components = decay_components(load_phosphor(name))
    return PhosphorDecay(components=components, gate_s=gate_s or field_s, field_s=field_s)


@pytest.mark.parametrize("name", ["P20", "P43", "P46", "P47"])
@pytest.mark.parametrize("field_s", [1 / 25, 1 / 60, 1e-3])
def test_every_screen_gives_all_its_light_at_any_rate(name, field_s):
    glow = _glow(name, field_s)
    assert glow.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert glow.weights.min() >= 0.0
    # What is remembered reaches as far as the slow component does.
    exact = _late(glow, glow.n_lag_fields + 1)
    assert exact < grid.ACCURACY.max_lag_fraction


def _late(glow: PhosphorDecay, fields: int) -> float:
    """Share of light later than so many fields, of pulses spread over the gate, by the closed
    integral.
    """
    weight, tau = np.array(glow.components).T
    share = weight * tau
    left = (
        np.exp(-(fields * glow.field_s - glow.gate_s) / tau)
        * -np.expm1(-glow.gate_s / tau)
        * tau
        / glow.gate_s
    )
    return float(left @ (share / share.sum()))


@pytest.mark.parametrize("name", ["P20", "P43", "P46", "P47"])
@pytest.mark.parametrize("gate_s", [1e-9, 1e-6, 1e-4, 1e-2])
def test_gates_shorter_than_a_decay_leave_what_the_closed_integral_says(name, gate_s):
    glow = _glow(name, 0.01668, gate_s)
    for fields in range(1, min(glow.n_lag_fields, 5) + 1):
        assert glow.residuals(5)[fields - 1] == pytest.approx(
            _late(glow, fields), abs=1e-4 + grid.ACCURACY.max_lag_fraction
        )


# Scenes that move, and automatic controls that follow them.


# Scenes that move: steady ones are as any steady run, lag fades as the screen does, channels and
# gains recover.


NONE = Conditions()
LEVELS = {"dense": 20.0, "sparse": 0.2}


@pytest.fixture
def camera(plain) -> CameraModel:
    return CameraModel(plain(30, 44, photocathode__ebi_lm_per_cm2=0.0))


def _scene(camera: CameraModel, level: float):
    image = np.full(camera.shape, level)
    image[:, : camera.shape[1] // 2] *= 0.5
    return mcp_input_from_photoelectrons(camera, image, NONE)


@pytest.mark.parametrize("light", LEVELS)
@pytest.mark.parametrize("local", [False, True])
def test_a_steady_sequence_is_the_steady_run(plain, light, local):
    """The same draws, as scenes are drawn one by one; sums in another order may round a few pixels
    otherwise.
    """
    camera = CameraModel(
        plain(30, 44, microchannel_plate__strip_current_ua_per_cm2=0.6), local_depletion=local
    )
    scene = _scene(camera, LEVELS[light])
    for count in (1, 2):
        # Two scenes that are equal, not the same, are prepared and drawn each by itself.
        scenes = [scene.with_values(scene.values.copy()) if n % count else scene for n in range(8)]
        steady = islice(camera.frames(scene, NONE, seed=7), 4)
        for one, other in zip(
            steady, camera.moving_frames(scenes, NONE, seed=7, settled=True), strict=True
        ):
            different = one.astype(int) - other
            assert np.abs(different).max() <= 1
            assert np.mean(different != 0) < 0.05


@pytest.mark.parametrize("light", LEVELS)
def test_light_switched_off_leaves_the_screens_residuals(plain, light, seed):
    """Truth 19 in frames: the field residuals 0.48, 0.28, 0.17, 0.11, ... are the shares of later
    fields.
    """
    camera = CameraModel(plain(120, 160, photocathode__ebi_lm_per_cm2=0.0))
    scenes = [_scene(camera, 20.0 * LEVELS[light])] * 2 + [_scene(camera, 0.0)] * 8
    if light == "sparse":
        # So few pulses that they are drawn one by one: the light of a dim field among dark ones.
        scenes = [_scene(camera, 0.7)] * 2 + scenes[2:]
    run = camera.moving_frames(scenes, NONE, seed=seed, settled=True)
    frames = np.stack(list(run)).astype(float)[1:, :, 16:] - 400.0
    full = camera.mean_frame(scenes[0], NONE)[:, 16:].mean() - 400.0
    residual = np.concatenate([[1.0], camera.stage(Slot.DECAY).residuals(9)])
    for n, frame in enumerate(frames):
        for parity in (0, 1):
            # Steady light before: what a field shows n fields after the end is the residual of all
            # before it.
            expected = residual[2 * n + parity + 1]
            assert frame[parity::2].mean() / full == pytest.approx(
                expected, abs=0.01 if light == "dense" else 0.04
            )


def test_interlaced_fields_see_their_own_moment_and_a_rested_camera_is_dark(plain):
    camera = CameraModel(
        plain(
            30,
            44,
            phosphor__fast_decay_ms=1e-9,
            phosphor__slow_decay_ms=1e-9,
            photocathode__ebi_lm_per_cm2=0.0,
        )
    )
    (frame,) = camera.moving_frames([_scene(camera, 100.0), _scene(camera, 0.0)], NONE, seed=1)
    assert frame[0::2].mean() > 1000.0
    assert frame[1::2].mean() == pytest.approx(400.0, abs=15.0)


def test_channels_recover_after_a_flash(plain, seed):
    """Behind a bright exposure the plate has less gain, and gets it back with the channels' time
    constant.
    """
    sensor = plain(
        30,
        44,
        phosphor__fast_decay_ms=1e-9,
        phosphor__slow_decay_ms=1e-9,
        microchannel_plate__strip_current_ua_per_cm2=0.6,
        microchannel_plate__channel_recovery_ms=50.0,
    )
    camera = CameraModel(
        replace(sensor, video=replace(sensor.video, interlaced=False)), local_depletion=True
    )
    flash, probe = (
        mcp_input_from_photoelectrons(camera, np.full(camera.shape, level), NONE)
        for level in (3e4, 20.0)
    )
    state = float(camera.stage(Slot.MCP).load(flash.values, flash.grid).mean())
    assert state > 0.3
    run = camera.moving_frames([flash, *[probe] * 8], NONE, seed=seed, settled=True)
    found = np.stack(list(run)).astype(float)[1:].mean(axis=(1, 2)) - 400.0
    undiminished = camera.mean_frame(probe, NONE).mean() - 400.0
    fade = camera.field_s / 0.05
    for n, signal in enumerate(found):
        within = state * np.exp(-n * fade) * -np.expm1(-fade) / fade
        assert signal / undiminished == pytest.approx(1.0 / (1.0 + within), abs=0.03)


def test_a_lamp_that_enters_the_picture_pumps_the_tubes_brightness(plain, seed):
    changes = {
        "photocathode__ebi_lm_per_cm2": 0.0,
        "video__conversion_gain_dn_per_e": 1e-4,
        "ccd__full_well_e": 1e12,
    }
    sensor = plain(30, 44, **changes)
    camera, on = CameraModel(sensor), Conditions(brightness_control=True)
    per_lux = (
        tube_photometry.photoelectrons_per_lumen_s(sensor)
        * 1e-4
        * camera.field_s
        * camera.field_pixel_area_cm2
    )
    threshold = float(sensor.tube.brightness_control_lux) * per_lux
    bright, dim = (
        mcp_input_from_photoelectrons(camera, np.full(camera.shape, factor * threshold), on)
        for factor in (10.0, 0.1)
    )
    run = camera.moving_frames([*[bright] * 80, *[dim] * 80], on, seed=seed, settled=True)
    frames = np.stack(list(run)).astype(float).mean(axis=(1, 2)) - 400.0
    assert frames[39] / frames[0] == pytest.approx(0.1, rel=0.05)
    assert frames[-1] / (camera.mean_frame(dim, NONE).mean() - 400.0) == pytest.approx(
        1.0, rel=0.05
    )


def test_automatic_gain_follows_the_frames_it_has_seen(plain, seed):
    camera, on = CameraModel(plain(30, 44)), Conditions(automatic_gain=True)
    set_dn = automatic_controls.SET_LEVEL * (2**16 - 1 - 400.0)
    per_pe = (camera.mean_frame(_scene(camera, 10.0), NONE).mean() - 400.0) / 10.0
    scene = _scene(camera, 0.5 * set_dn / per_pe)
    frames = list(camera.moving_frames([scene] * 160, on, seed=seed))
    assert frames[3].mean() - 400.0 < 0.7 * set_dn
    assert frames[-1].mean() - 400.0 == pytest.approx(set_dn, rel=0.02)


# Automatic controls settle to their set level in their time and range, and bend the noise law at
# their own places.


GAIN = AutomaticGain(set_level_dn=100.0, range_db=16.0, time_constant_s=0.5, step_s=1 / 30)
CONTROL = BrightnessControl(limit_e_per_s_cm2=1e8, attack_s=0.2, step_s=1 / 30)


def _settled(law, level_at_one: float, steps: int, state: float = 1.0) -> list[float]:
    states = [state]
    for _ in range(steps):
        states.append(law.next(states[-1], states[-1] * level_at_one))
    return states


@pytest.mark.parametrize("level", [30.0, 60.0, 99.0])
def test_automatic_gain_settles_on_its_set_level_within_its_range(level):
    assert _settled(GAIN, level, 400)[-1] * level == pytest.approx(100.0, rel=1e-4)


@pytest.mark.parametrize(
    ("level", "gain"), [(1.0, 10 ** (16 / 20)), (0.0, 10 ** (16 / 20)), (500.0, 1.0)]
)
def test_beyond_its_range_automatic_gain_stays_at_its_end(level, gain):
    assert _settled(GAIN, level, 400)[-1] == pytest.approx(gain, rel=1e-6)


def test_a_small_error_falls_to_one_part_in_e_in_the_time_constant():
    states = _settled(GAIN, 50.0, 15, state=2.02)
    error = [state / 2.0 - 1.0 for state in states]
    assert error[15] / error[0] == pytest.approx(np.exp(-1.0), rel=0.02)


@pytest.mark.parametrize("overload", [2.0, 1e3, 1e6])
def test_brightness_control_holds_the_screen_current_from_any_overload(overload):
    states = _settled(CONTROL, overload * 1e8, 400)
    assert states[-1] * overload == pytest.approx(1.0, rel=1e-6)
    error = np.log(np.array(states) * overload)
    assert error[6] / error[0] == pytest.approx(np.exp(-1.0), rel=1e-6)


def test_below_its_limit_brightness_control_gives_all_gain_back():
    assert _settled(CONTROL, 0.5e8, 100, state=0.01)[-1] == 1.0
    assert CONTROL.next(0.2, 0.0) == 1.0


def _lit(camera: CameraModel, lux: float):
    per_pixel = 2.0 * camera.cells.pitch_x_mm * camera.cells.pitch_y_mm * 1e-2
    level = (
        lux
        * 1e-4
        * tube_photometry.photoelectrons_per_lumen_s(camera.description)
        * per_pixel
        * camera.field_s
    )
    return mcp_input_from_photoelectrons(camera, np.full(camera.shape, level), Conditions())


def test_with_brightness_control_the_charge_stays_constant_above_the_threshold(camera):
    on = Conditions(brightness_control=True)
    threshold = float(camera.description.tube.brightness_control_lux)
    levels = []
    for times in (0.1, 0.5, 2.0, 8.0, 32.0):
        light = _lit(camera, times * threshold)
        state = camera.automatic_state_of(light, on)(199)
        assert state.brightness == pytest.approx(min(1.0, 1.0 / times), rel=2e-3)
        levels.append(float(camera.mean_frame(light, on, state).mean(dtype=float)) - 400.0)
    assert levels[1] / levels[0] == pytest.approx(5.0, rel=1e-3)
    assert levels[3:] == pytest.approx([levels[2]] * 2, rel=2e-3)
    assert levels[2] / levels[1] == pytest.approx(2.0, rel=2e-3)


def _noise_over_signal(
    camera: CameraModel, conditions: Conditions, light, seed: int
) -> tuple[float, float]:
    """Settled mean above black, and temporal variance over mean."""
    stream = camera.frames(light, conditions, seed=seed)
    settled = np.stack(list(islice(stream, 32))[16:]).astype(float)
    signal = float(settled.mean()) - float(camera.description.video.black_level_dn)
    return signal, float(settled.var(axis=0, ddof=1).mean()) / signal


def test_the_two_controls_bend_the_noise_law_at_their_own_places(plain, seed):
    """At one level of video: brightness control leaves the photoelectrons' noise, automatic gain
    multiplies it.
    """
    camera = CameraModel(
        plain(40, 56, tube__brightness_control_s=0.05, video__automatic_gain_s=0.05)
    )
    threshold = float(camera.description.tube.brightness_control_lux)
    steady = _noise_over_signal(camera, Conditions(), _lit(camera, threshold), seed)
    lowered = _noise_over_signal(
        camera, Conditions(brightness_control=True), _lit(camera, 8.0 * threshold), seed
    )
    assert lowered[0] == pytest.approx(steady[0], rel=0.02)
    # The same video of eight times the photoelectrons: an eighth of the noise power.
    assert lowered[1] / steady[1] == pytest.approx(1.0 / 8.0, rel=0.15)
    set_dn = automatic_controls.SET_LEVEL * (2**16 - 1 - 400.0)
    dim = _lit(camera, threshold * set_dn / steady[0] / 4.0)
    raised = _noise_over_signal(camera, Conditions(automatic_gain=True), dim, seed)
    alone = _noise_over_signal(camera, Conditions(), dim, seed)
    assert raised[0] == pytest.approx(set_dn, rel=0.02)
    assert raised[1] / alone[1] == pytest.approx(raised[0] / alone[0], rel=0.02)


def test_controls_that_are_off_or_unknown_change_no_byte(camera):
    light = _lit(camera, 1e-4)
    for conditions in (Conditions(automatic_gain=False, brightness_control=False), Conditions()):
        frame = next(camera.frames(light, conditions, seed=4, first_frame=2))
        assert (
            frame.tobytes()
            == next(camera.frames(light, Conditions(), seed=4, first_frame=2)).tobytes()
        )
    assert camera.automatic_state_of(light, Conditions())(3) == AutomaticState()


def test_a_frame_of_a_controlled_run_follows_from_its_number(camera):
    on = Conditions(brightness_control=True, automatic_gain=True)
    light = _lit(camera, 0.02)
    run = list(islice(camera.frames(light, on, seed=4), 6))
    alone = next(camera.frames(light, on, seed=4, first_frame=5))
    assert run[5].tobytes() == alone.tobytes()


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda _: _p20(2 * FIELD_S), "at most one field"),
        (
            lambda camera: next(camera.moving_frames([_scene(camera, 1.0)], NONE, seed=1)),
            "2 exposures, got 1",
        ),
        (lambda _: replace(GAIN, set_level_dn=0.0), "set_level_dn"),
        (lambda _: replace(GAIN, time_constant_s=0.0), "time_constant_s"),
        (lambda _: replace(GAIN, range_db=-1.0), "range_db"),
        (
            lambda _: AutomaticControls.of(
                CameraModel(load_sensor("gen3-digital-iccd")), Conditions(automatic_gain=True)
            ),
            "has none",
        ),
    ],
)
def test_impossible_sequences_and_controls_are_refused(camera, make, rule):
    with pytest.raises(BadInput, match=rule):
        make(camera)
