"""What a renderer is told of a camera's noise is the noise of its frames."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata import Conditions, load_sensor
from simulate import render_sensor_of
from simulate.camera import CameraModel, mcp_input_from_photoelectrons


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd"])
def test_blur_evens_the_noise_of_an_intensified_camera_as_its_eye_says(seed, name):
    described = load_sensor(name)
    camera = CameraModel(replace(described, ccd=replace(described.ccd, rows=32, columns=48)))
    conditions = Conditions(
        gate_ns=1e6, mcp_v=float(described.microchannel_plate.reference_v) - 100.0
    )
    eye, signal = render_sensor_of(camera, conditions), 8.0
    dark, light = (
        mcp_input_from_photoelectrons(camera, np.full(camera.shape, level, np.float32), conditions)
        for level in (0.0, signal)
    )
    dn_per_pe = (
        float(np.mean(camera.mean_frame(light, conditions) - camera.mean_frame(dark, conditions)))
        / signal
    )
    frames = np.stack(list(islice(camera.frames(light, conditions, seed=seed), 60))).astype(float)
    noise_pe = np.sqrt(np.mean(frames.var(axis=0, ddof=1))) / dn_per_pe
    assert eye.noise_averaging_factor < 0.6
    assert noise_pe == pytest.approx(float(eye.noise_floor(signal, smooth=True)), rel=0.1)
