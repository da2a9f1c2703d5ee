"""Scenes that move: steady ones are as any steady run, lag fades as the screen does, channels and
gains recover.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata import BadInput, Conditions
from simulate.camera import (
    CameraModel,
    Slot,
    automatic_controls,
    mcp_input_from_photoelectrons,
    tube_photometry,
)

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


def test_a_frame_of_the_wrong_number_of_exposures_is_refused(camera):
    with pytest.raises(BadInput, match="2 exposures, got 1"):
        next(camera.moving_frames([_scene(camera, 1.0)], NONE, seed=1))
