"""Automatic controls settle to their set level in their time and range, and bend the noise law at
their own places.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata import BadInput, Conditions, load_sensor
from simulate.camera import (
    AutomaticControls,
    AutomaticGain,
    AutomaticState,
    BrightnessControl,
    CameraModel,
    automatic_controls,
    mcp_input_from_photoelectrons,
    tube_photometry,
)

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


@pytest.mark.parametrize(
    "change", [{"set_level_dn": 0.0}, {"time_constant_s": 0.0}, {"range_db": -1.0}]
)
def test_impossible_automatic_gain_is_refused(change):
    with pytest.raises(BadInput):
        replace(GAIN, **change)


@pytest.fixture
def camera(plain) -> CameraModel:
    return CameraModel(plain(40, 56, photocathode__ebi_lm_per_cm2=0.0))


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


def test_a_camera_without_automatic_gain_refuses_that_it_was_on():
    camera = CameraModel(load_sensor("gen3-digital-iccd"))
    with pytest.raises(BadInput, match="has none"):
        AutomaticControls.of(camera, Conditions(automatic_gain=True))
