"""Every stage meets the same demands: draws average to its mean, follow the seed, keep the shape; misfits refused."""

import zlib

import numpy as np
import pytest

from labdata.conditions import Conditions
from labdata.errors import BadInput
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.ccd import Ccd
from simulate.iiccd.chain import Chain, Stage
from simulate.iiccd.light import Light

DRAWS = 60
NAMES = (
    "optics",
    "photocathode",
    "gap",
    "microchannel plate",
    "phosphor",
    "taper",
    "pixels",
    "afterglow",
    "scan",
    "ccd",
    "video",
)


def _light_for(camera: IntensifiedCamera, name: str) -> Light:
    """An uneven image of the kind that reaches a stage, far from any limit."""
    rng = np.random.default_rng(5)
    if name in ("optics", "photocathode", "gap"):
        shape, grid, level = camera.scene_cells.shape, camera.scene_cells, 50.0
    elif name in ("microchannel plate", "phosphor", "taper", "pixels"):
        shape, grid, level = camera.cells.shape, camera.cells, 3.0
    elif name in ("afterglow", "scan"):
        shape, grid, level = (4, *camera.shape), None, 2000.0
    else:
        shape, grid, level = (2, *camera.shape), None, 2000.0
    return Light(values=(level * (0.5 + rng.random(shape))).astype(np.float32), grid=grid)


@pytest.fixture(scope="module")
def camera(plain) -> IntensifiedCamera:
    return IntensifiedCamera(plain(24, 40, microchannel_plate__ion_event_rate_per_s_cm2=1e6))


@pytest.fixture(params=NAMES)
def stage(request, camera) -> Stage:
    (found,) = (s for s in camera.chain(Conditions()).stages if s.name == request.param)
    return found


def test_draws_average_to_the_stated_mean(stage, camera, seed):
    light = _light_for(camera, stage.name)
    rng = np.random.default_rng([seed, zlib.crc32(stage.name.encode())])
    draws = np.stack([stage.draw(light, rng).values for _ in range(DRAWS)]).astype(float)
    mean = stage.mean(light).values.astype(float)
    # A stage without noise may differ by rounding alone; one that rounds to whole numbers by part of its step.
    floor = 2e-5 * np.abs(mean).max() + (0.02 if stage.emits == "DN" else 0.0)
    for axes in (-1, -2, (-2, -1)):
        profiles = (draws - mean).mean(axis=axes)
        error = profiles.std(axis=0, ddof=1) / np.sqrt(DRAWS)
        # Six by Student's law of so few draws are as rare as five by the normal law.
        assert np.all(np.abs(profiles.mean(axis=0)) < 6.0 * error + floor * (25.0 if stage.emits == "DN" else 1.0))


def test_same_seed_gives_same_bytes_and_another_seed_others(stage, camera):
    light = _light_for(camera, stage.name)
    first, again, other = (stage.draw(light, np.random.default_rng(n)).values for n in (3, 3, 4))
    assert first.tobytes() == again.tobytes()
    if stage.name in ("microchannel plate", "ccd"):
        assert first.tobytes() != other.tobytes()


def test_shape_is_that_of_the_mean_and_the_light_given_is_untouched(stage, camera):
    light = _light_for(camera, stage.name)
    before = light.values.copy()
    drawn = stage.draw(light, np.random.default_rng(1))
    assert drawn.values.shape == stage.mean(light).values.shape
    assert np.array_equal(light.values, before)
    if stage.name not in ("gap", "pixels", "scan"):
        assert drawn.values.shape == light.values.shape


def test_a_chain_refuses_neighbours_that_do_not_fit(camera):
    stages = camera.chain(Conditions()).stages
    with pytest.raises(
        BadInput, match="microchannel plate takes photoelectrons at the plate, but optics emits photons"
    ):
        Chain((stages[0], stages[3]))
    with pytest.raises(BadInput, match="phosphor"):
        camera.chain(Conditions()).without("microchannel plate")
    with pytest.raises(BadInput, match="names of their own"):
        Chain((stages[4], stages[5], stages[5]))


def test_changing_one_stage_leaves_the_noise_of_the_others(camera):
    chain = camera.chain(Conditions()).part("microchannel plate", "taper")
    light = _light_for(camera, "microchannel plate")
    whole = chain.draw(light, np.random.default_rng(9)).values
    without = chain.without("taper").draw(light, np.random.default_rng(9)).values
    assert np.allclose(whole, without * chain.stages[-1].transmission, rtol=1e-6)
    gap, plate = camera.chain(Conditions()).part("gap", "microchannel plate").stages
    light = _light_for(camera, "gap")
    behind_gap = Chain((gap, plate)).draw(light, np.random.default_rng(9)).values
    alone = Chain((plate,)).draw(gap.mean(light), np.random.default_rng(9)).values
    assert behind_gap.tobytes() == alone.tobytes()


def test_parts_of_an_exposure_add_up_to_the_whole(camera):
    """Ions and the load of the plate included."""
    plate = camera.chain(Conditions()).stages[3]
    light = _light_for(camera, "microchannel plate")
    half = plate.under_load(light, parts=2).mean(light.with_values(light.values / 2)).values
    assert np.allclose(2.0 * half, plate.mean(light).values, rtol=1e-5)


@pytest.mark.parametrize("change", [{"mcp_v": -1.0}, {"gate_ns": 0.0}, {"gate_ns": 3e7}])
def test_conditions_out_of_bounds_are_refused(camera, change):
    with pytest.raises(BadInput):
        camera.chain(Conditions(**change))


def test_parameters_out_of_bounds_are_refused():
    with pytest.raises(BadInput, match="full_well_e must be positive, got 0"):
        Ccd(quantum_efficiency=0.3, full_well_e=0.0)
