"""Every stage of every kind of camera: draws average to its mean, follow the seed; its images show
the light on its way.
"""

import zlib
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from labdata import BadInput, Conditions, load_camera
from simulate import stage_images
from simulate.camera import (
    CameraModel,
    Ccd,
    Chain,
    Slot,
    Stage,
    StageImage,
    camera_from_description,
    mcp_input_from_photoelectrons,
    mcp_input_from_radiance,
    true_quantities,
)
from simulate.radiance import RadianceCube, planck

# Every stage of every kind of camera: draws average to its mean, follow the seed, keep the shape;
# misfits refused.


DRAWS = 60
# Every stage there is: of a tube with video, of a tube with a digital back end, and of silicon
# alone.
TUBE = (
    "optics",
    "photocathode",
    "gap",
    "taper distortion and fibre shear",
    "microchannel plate",
    "phosphor",
    "taper",
    "pixels",
    "phosphor decay",
    "scan",
    "ccd",
    "video",
)
SILICON = ("optics", "silicon", "pixels", "ccd", "register", "video")
STAGES = (
    *(("tube", name) for name in TUBE),
    ("depleted tube", "microchannel plate"),
    ("digital tube", "video"),
    *(("silicon", name) for name in SILICON),
    ("radiometric", "optics"),
)
NOISY = ("microchannel plate", "ccd", "register")


def _light_for(camera: CameraModel, stage: Stage) -> StageImage | RadianceCube:
    """An uneven image of the kind that reaches a stage, far from any limit."""
    rng = np.random.default_rng(5)
    if stage.takes == "radiance":
        return RadianceCube(
            wavelength_nm=np.array([500.0, 700.0, 900.0]), radiance=1e-9 * rng.random((3, 24, 40))
        )
    if stage.name in ("optics", "photocathode", "gap", "silicon"):
        shape, grid, level = camera.scene_cells.shape, camera.scene_cells, 50.0
    elif stage.name in (
        "taper distortion and fibre shear",
        "microchannel plate",
        "phosphor",
        "taper",
        "pixels",
    ):
        shape, grid, level = camera.cells.shape, camera.cells, 3.0
    elif stage.name in ("phosphor decay", "scan"):
        shape, grid, level = (4, *camera.shape), None, 2000.0
    else:
        shape, grid, level = (2, *camera.shape), None, 2000.0
    values = level * (0.5 + rng.random(shape))
    # Wells and registers hold whole electrons.
    values = np.rint(values) if stage.takes == "charge in the wells" else values
    return StageImage(values=values.astype(np.float32), grid=grid)


@pytest.fixture(scope="module")
def camera(plain) -> CameraModel:
    return CameraModel(plain(24, 40, microchannel_plate__ion_event_rate_per_s_cm2=1e6))


@pytest.fixture(scope="module")
def cameras(plain, camera) -> dict[str, CameraModel]:
    """Small cameras of every kind, with the fixed patterns and line noises that the plain one
    lacks.
    """
    patterned = plain(
        24,
        40,
        microchannel_plate__pattern_contrast=0.05,
        ccd__dsnu_e=5.0,
        ccd__prnu=0.02,
        video__sync_jitter_ns=4.0,
        video__line_noise_dn=0.3,
        video__aperture_correction_db=4.0,
    )
    digital, emccd = (
        replace(found, ccd=replace(found.ccd, rows=24, columns=40))
        for found in (load_camera("gen3-digital-iccd"), load_camera("emccd-512"))
    )
    return {
        "tube": CameraModel(patterned, geometry=True),
        "depleted tube": CameraModel(
            plain(24, 40, microchannel_plate__strip_current_ua_per_cm2=0.6), local_depletion=True
        ),
        "digital tube": CameraModel(digital),
        "silicon": camera_from_description(
            emccd.with_values({"register.em_gain": 20.0, "video.conversion_gain_dn_per_e": 0.5})
        ),
        "radiometric": camera,
    }


@pytest.fixture(params=STAGES, ids=[f"{kind}: {name}" for kind, name in STAGES])
def found(request, cameras) -> tuple[Stage, StageImage | RadianceCube]:
    """A stage and light for it."""
    kind, name = request.param
    owner = cameras[kind]
    if kind == "radiometric":
        return owner.lens(), _light_for(owner, owner.lens())
    (stage,) = (s for s in owner.chain(Conditions()).stages if s.name == name)
    return stage, _light_for(owner, stage)


def test_draws_average_to_the_stated_mean(found, seed):
    stage, light = found
    rng = np.random.default_rng([seed, zlib.crc32(stage.name.encode())])
    draws = np.stack([stage.draw(light, rng).values for _ in range(DRAWS)]).astype(float)
    mean = stage.mean(light).values.astype(float)
    # A stage without noise may differ by rounding alone; one that rounds to whole numbers by part
    # of its step.
    floor = 2e-5 * np.abs(mean).max() + (0.02 if stage.emits == "DN" else 0.0)
    for axes in (-1, -2, (-2, -1)):
        profiles = (draws - mean).mean(axis=axes)
        error = profiles.std(axis=0, ddof=1) / np.sqrt(DRAWS)
        # Six by Student's law of so few draws are as rare as five by the normal law.
        assert np.all(
            np.abs(profiles.mean(axis=0))
            < 6.0 * error + floor * (25.0 if stage.emits == "DN" else 1.0)
        )


def test_same_seed_gives_same_bytes_and_another_seed_others(found):
    stage, light = found
    first, again, other = (stage.draw(light, np.random.default_rng(n)).values for n in (3, 3, 4))
    assert first.tobytes() == again.tobytes()
    if stage.name in NOISY:
        assert first.tobytes() != other.tobytes()


def test_shape_is_that_of_the_mean_and_the_light_given_is_untouched(found):
    stage, light = found
    before = _values(light).copy()
    drawn = stage.draw(light, np.random.default_rng(1))
    assert drawn.values.shape == stage.mean(light).values.shape
    assert np.array_equal(_values(light), before)
    if stage.name not in ("gap", "pixels", "scan", "silicon") and stage.takes != "radiance":
        assert drawn.values.shape == _values(light).shape


def test_stages_are_values_that_name_what_they_take_and_emit(found):
    stage, _ = found
    assert stage.takes and stage.emits and stage.name
    assert replace(stage) == stage
    with pytest.raises(FrozenInstanceError):
        stage.name = "another"


def test_chains_of_every_kind_of_camera_are_the_stages_in_order(cameras):
    assert tuple(s.name for s in cameras["tube"].chain(Conditions()).stages) == TUBE
    assert tuple(s.name for s in cameras["silicon"].chain(Conditions()).stages) == SILICON


def _values(light: StageImage | RadianceCube) -> np.ndarray:
    return light.radiance if isinstance(light, RadianceCube) else light.values


def test_a_chain_refuses_neighbours_that_do_not_fit(camera):
    stages = camera.chain(Conditions()).stages
    with pytest.raises(
        BadInput,
        match="microchannel plate takes photoelectrons at the plate, but optics emits photons",
    ):
        Chain((stages[0], stages[3]))
    with pytest.raises(BadInput, match="phosphor"):
        camera.chain(Conditions()).without(Slot.MCP)
    with pytest.raises(BadInput, match="names of their own"):
        Chain((stages[4], stages[5], stages[5]))


def test_changing_one_stage_leaves_the_noise_of_the_others(camera):
    chain = camera.chain(Conditions()).between(Slot.MCP, Slot.TAPER)
    light = _light_for(camera, camera.stage(Slot.MCP, Conditions()))
    whole = chain.draw(light, np.random.default_rng(9)).values
    without = chain.without(Slot.TAPER).draw(light, np.random.default_rng(9)).values
    assert np.allclose(whole, without * chain.stages[-1].transmission, rtol=1e-6)
    gap, plate = camera.chain(Conditions()).between(Slot.GAP, Slot.MCP).stages
    light = _light_for(camera, gap)
    behind_gap = Chain((gap, plate)).draw(light, np.random.default_rng(9)).values
    alone = Chain((plate,)).draw(gap.mean(light), np.random.default_rng(9)).values
    assert behind_gap.tobytes() == alone.tobytes()


def test_parts_of_an_exposure_add_up_to_the_whole(camera):
    """Ions and the load of the plate included."""
    plate = camera.chain(Conditions()).stages[3]
    light = _light_for(camera, camera.stage(Slot.MCP, Conditions()))
    half = plate.under_load(light, parts=2).mean(light.with_values(light.values / 2)).values
    assert np.allclose(2.0 * half, plate.mean(light).values, rtol=1e-5)


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda camera: camera.chain(Conditions(mcp_v=-1.0)), "mcp_v"),
        (lambda camera: camera.chain(Conditions(gate_ns=0.0)), "gate"),
        (lambda camera: camera.chain(Conditions(gate_ns=3e7)), "gate"),
        (
            lambda _: Ccd(quantum_efficiency=0.3, full_well_e=0.0),
            "full_well_e must be positive, got 0",
        ),
    ],
)
def test_conditions_and_parameters_out_of_bounds_are_refused(camera, make, rule):
    with pytest.raises(BadInput, match=rule):
        make(camera)


# Images after each stage show the light on its way: every stage once, in order, with its levels
# and its noise.


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
