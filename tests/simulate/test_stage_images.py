"""Images after each stage show the light on its way: every stage once, in order, with its levels
and its noise.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import Conditions, load_camera
from simulate import stage_images
from simulate.camera import (
    CameraModel,
    camera_from_description,
    mcp_input_from_photoelectrons,
    mcp_input_from_radiance,
    true_quantities,
)
from simulate.radiance import RadianceCube, planck

NM = np.arange(400.0, 1000.0, 50.0)
CUBE = RadianceCube(
    wavelength_nm=NM, radiance=np.tile(1e-11 * planck(NM, 2856.0)[:, None, None], (1, 30, 44))
)


def _small(name: str):
    description = load_camera(name)
    return camera_from_description(
        replace(description, ccd=replace(description.ccd, rows=30, columns=44))
    )


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512"])
def test_every_stage_of_the_chain_is_shown_once_in_its_order(name):
    camera, conditions = _small(name), Conditions(temperature_c=-20.0)
    images = list(stage_images(camera, CUBE, conditions, seed=1))
    assert [stage for stage, _, _ in images] == [
        stage.name for stage in camera.chain(conditions).stages
    ]
    assert all(
        image.dtype == np.float32 and image.ndim == 2 and quantity for _, quantity, image in images
    )
    assert images[-1][2].shape == camera.shape
    assert images[-1][1] == "DN"


def test_light_at_the_plate_is_that_of_the_exposure():
    camera = _small("pulnix-ag5745ef3")
    shown = {stage: image for stage, _, image in stage_images(camera, CUBE, Conditions(), seed=1)}
    at_mcp = mcp_input_from_radiance(camera, CUBE, Conditions())
    grid = at_mcp.grid
    assert grid is not None
    top, left = grid.margin_rows * 2, grid.margin_columns * 2
    whole = at_mcp.values[top : top + 2 * grid.rows, left : left + 2 * grid.columns]
    assert shown["taper distortion and fibre shear"] == pytest.approx(whole, rel=1e-4)


def test_levels_grow_by_the_gains_of_the_stages(plain):
    sensor = plain(60, 88, phosphor__fast_decay_ms=1e-9, phosphor__slow_decay_ms=1e-9)
    camera = CameraModel(sensor)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 200.0), Conditions())
    shown = {
        stage: image.mean(dtype=float)
        for stage, _, image in stage_images(camera, light, Conditions(), seed=1)
    }
    chain = {stage.name: stage for stage in camera.chain(Conditions()).stages}
    assert shown["phosphor"] / shown["microchannel plate"] == pytest.approx(
        chain["phosphor"].photons_per_electron, rel=1e-2
    )
    assert shown["taper"] / shown["phosphor"] == pytest.approx(
        chain["taper"].transmission, rel=1e-2
    )
    assert shown["pixels"] / shown["taper"] == pytest.approx(8.0, rel=2e-2)
    assert shown["ccd"] / shown["scan"] == pytest.approx(
        float(sensor.ccd.quantum_efficiency), rel=1e-2
    )
    k = true_quantities.true_quantities(sensor)["photoelectron_gain"]
    assert shown["video"] - 400.0 == pytest.approx(200.0 * k, rel=2e-2)


def test_pixels_of_a_camera_without_a_tube_hold_the_photoelectrons_of_the_picture():
    camera, conditions = _small("emccd-512"), Conditions(temperature_c=-20.0)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 7.0), conditions)
    found = {
        stage: (what, image)
        for stage, what, image in stage_images(camera, light, conditions, seed=1)
    }
    what, image = found["pixels"]
    assert what == "photoelectrons per exposure and pixel, expected"
    assert image == pytest.approx(np.full(camera.shape, 7.0), rel=1e-5)


def test_same_seed_shows_the_same_frame_and_another_another():
    camera = _small("pulnix-ag5745ef3")
    first, again, other = (
        list(stage_images(camera, CUBE, Conditions(), seed=n))[-1][2] for n in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
