"""Scenes that change: steady ones are as any steady run, lag fades as the screen does, channels and gains recover."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata.conditions import Conditions
from labdata.errors import BadInput
from simulate.iiccd import tube_photometry
from simulate.iiccd.automatic_controls import SET_LEVEL
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.reference_sampler import (
    ChainState,
    initial_state,
    next_frame,
    sequence,
    steady_frames,
    steady_state,
)
from simulate.iiccd.scene_to_photoelectrons import mcp_input_from_photoelectrons

NONE = Conditions()


@pytest.fixture
def camera(plain) -> IntensifiedCamera:
    return IntensifiedCamera(plain(30, 44, photocathode__ebi_lm_per_cm2=0.0))


def _scene(camera: IntensifiedCamera, level: float):
    image = np.full(camera.shape, level)
    image[:, : camera.shape[1] // 2] *= 0.5
    return mcp_input_from_photoelectrons(camera, image, NONE)


@pytest.mark.parametrize("local", [False, True])
def test_a_steady_sequence_is_the_steady_run(plain, local):
    """The same draws; sums in another order may round a few pixels to the next code."""
    camera = IntensifiedCamera(plain(30, 44, microchannel_plate__strip_current_ua_per_cm2=0.6), local_depletion=local)
    scene = _scene(camera, 20.0)
    steady = islice(steady_frames(camera, scene, NONE, seed=7), 4)
    start = steady_state(camera, scene, NONE, seed=7)
    changing = sequence(camera, [scene] * 8, NONE, seed=7, state=start)
    for one, other in zip(steady, changing, strict=True):
        different = one.astype(int) - other
        assert np.abs(different).max() <= 1
        assert np.mean(different != 0) < 0.05


def test_a_frame_is_drawn_again_alone_from_the_memory_before_it(camera):
    scenes = [_scene(camera, level) for level in (5.0, 50.0, 0.0, 20.0, 3.0, 3.0)]
    run = list(sequence(camera, scenes, NONE, seed=7))
    state = initial_state(camera, NONE)
    for n in range(2):
        _, state = next_frame(camera, scenes[2 * n : 2 * n + 2], NONE, state, seed=7)
    alone, after = next_frame(camera, scenes[4:], NONE, state, seed=7)
    assert alone.tobytes() == run[2].tobytes()
    assert after.frame == 3


def test_light_switched_off_leaves_the_screens_residuals(camera, seed):
    """Truth 19 in frames: the field residuals 0.48, 0.28, 0.17, 0.11, ... are the shares of later fields."""
    light, dark = _scene(camera, 400.0), _scene(camera, 0.0)
    start = steady_state(camera, light, NONE, seed=seed)
    frames = np.stack(list(sequence(camera, [dark] * 8, NONE, seed=seed, state=start))).astype(float) - 400.0
    full = camera.mean_frame(light, NONE).mean() - 400.0
    residual = np.concatenate([[1.0], camera.afterglow(NONE).residuals(9)])
    for n, frame in enumerate(frames):
        for parity in (0, 1):
            # Steady light before: what a field shows n fields after the end is the residual of all before it.
            expected = residual[2 * n + parity + 1]
            assert frame[parity::2].mean() / full == pytest.approx(expected, abs=0.01)


def test_interlaced_fields_see_their_own_moment(plain):
    camera = IntensifiedCamera(
        plain(30, 44, phosphor__fast_decay_ms=1e-9, phosphor__slow_decay_ms=1e-9, photocathode__ebi_lm_per_cm2=0.0)
    )
    (frame,) = sequence(camera, [_scene(camera, 100.0), _scene(camera, 0.0)], NONE, seed=1)
    assert frame[0::2].mean() > 1000.0
    assert frame[1::2].mean() == pytest.approx(400.0, abs=15.0)


def test_channels_recover_after_a_flash(plain, seed):
    """Behind a bright exposure the plate has less gain, and gets it back with the channels' time constant."""
    sensor = plain(
        30,
        44,
        phosphor__fast_decay_ms=1e-9,
        phosphor__slow_decay_ms=1e-9,
        microchannel_plate__strip_current_ua_per_cm2=0.6,
        microchannel_plate__channel_recovery_ms=50.0,
    )
    camera = IntensifiedCamera(replace(sensor, video=replace(sensor.video, interlaced=False)), local_depletion=True)
    flash, probe = (mcp_input_from_photoelectrons(camera, np.full(camera.shape, level), NONE) for level in (3e4, 20.0))
    plate = camera.mcp(NONE)
    load = plate.depletion.load(plate.gain * flash.in_whole_rows().values, flash.in_whole_rows().grid)
    state = replace(initial_state(camera, NONE), depletion=load)
    frames = np.stack(list(sequence(camera, [probe] * 8, NONE, seed=seed, state=state))).astype(float) - 400.0
    found = frames.mean(axis=(1, 2))
    undiminished = camera.mean_frame(probe, NONE).mean() - 400.0
    state = float(load.mean())
    assert state > 0.3
    fade = camera.field_s / 0.05
    for n, signal in enumerate(found):
        within = state * np.exp(-n * fade) * -np.expm1(-fade) / fade
        assert signal / undiminished == pytest.approx(1.0 / (1.0 + within), abs=0.03)


def test_a_lamp_that_enters_the_picture_pumps_the_tubes_brightness(plain, seed):
    sensor = plain(30, 44, photocathode__ebi_lm_per_cm2=0.0)
    camera, on = IntensifiedCamera(sensor), Conditions(brightness_control=True)
    per_lux = tube_photometry.photoelectrons_per_lumen_s(sensor) * 1e-4 * camera.field_s
    per_lux *= 2.0 * camera.cells.pitch_x_mm * camera.cells.pitch_y_mm * 1e-2
    threshold = float(sensor.tube.brightness_control_lux) * per_lux
    state = initial_state(camera, on)
    bright = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 10.0 * threshold), on)
    for _ in range(40):
        _, state = next_frame(camera, [bright, bright], on, state, seed=seed)
    assert state.automatic.brightness == pytest.approx(0.1, rel=0.03)
    dim = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 0.1 * threshold), on)
    for _ in range(40):
        _, state = next_frame(camera, [dim, dim], on, state, seed=seed)
    assert state.automatic.brightness == 1.0


def test_automatic_gain_follows_the_frames_it_has_seen(plain, seed):
    camera, on = IntensifiedCamera(plain(30, 44)), Conditions(automatic_gain=True)
    set_dn = SET_LEVEL * (2**16 - 1 - 400.0)
    per_pe = (camera.mean_frame(_scene(camera, 10.0), NONE).mean() - 400.0) / 10.0
    scene = _scene(camera, 0.5 * set_dn / per_pe)
    frames = list(sequence(camera, [scene] * 160, on, seed=seed))
    assert frames[0].mean() - 400.0 < 0.52 * set_dn
    assert frames[-1].mean() - 400.0 == pytest.approx(set_dn, rel=0.02)


def test_a_frame_of_the_wrong_number_of_exposures_is_refused(camera):
    with pytest.raises(BadInput, match="2 exposures, got 1"):
        next_frame(camera, [_scene(camera, 1.0)], NONE, initial_state(camera, NONE), seed=1)


def test_memory_of_a_rested_camera_is_dark(camera):
    state = initial_state(camera, NONE)
    assert isinstance(state, ChainState)
    assert state.glow.shape == (camera.afterglow(NONE).n_lag_fields, 2, *camera.shape)
    assert not state.glow.any()
