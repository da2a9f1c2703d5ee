"""Past its breaking points the camera goes to the right limit or refuses in one sentence; no NaN,
no wrapped code.
"""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from labdata import Array, BadInput, Camera, Conditions, Target, load_camera
from simulate import LabBench
from simulate.camera import (
    CameraModel,
    Slot,
    StageImage,
    camera_from_description,
    mcp_input_from_photoelectrons,
    mcp_input_from_radiance,
)
from simulate.radiance import RadianceCube

ROWS, COLUMNS = 24, 32
FRAMES = 12
NM = np.arange(400.0, 1000.0, 20.0)
NAMES = ["pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512"]


def codes_of(
    camera: Any,
    picture_pe: float | Array,
    conditions: Conditions,
    seed: int,
    frames: int = FRAMES,
):
    """Frames of a picture in photoelectrons, none of them outside the digitiser's range."""
    picture = np.broadcast_to(np.asarray(picture_pe, float), camera.shape)
    light = mcp_input_from_photoelectrons(camera, picture, conditions)
    return checked(
        np.stack(list(islice(camera.frames(light, conditions, seed=seed), frames))), camera
    )


def checked(codes: Array, camera: Any) -> Array:
    """The codes, which are whole numbers of the digitiser."""
    assert codes.dtype in (np.uint8, np.uint16)
    assert codes.max() <= 2**camera.description.video.bit_depth - 1
    return codes.astype(float)


def sentence(refusal: BaseException) -> str:
    """The refusal's words, if they are one clear sentence that gives the value."""
    words = str(refusal)
    assert "\n" not in words and 20 < len(words) < 400
    assert "got" in words or "but" in words
    return words


def refused(make: Callable[[], object]) -> None:
    """Assert that what cannot be made is refused in one sentence."""
    with pytest.raises(BadInput) as refusal:
        make()
    sentence(refusal.value)


def small_camera(description: Camera, rows: int = ROWS, columns: int = COLUMNS) -> CameraModel:
    return camera_from_description(
        replace(description, ccd=replace(description.ccd, rows=rows, columns=columns))
    )


def with_error(codes: Array) -> tuple[float, float]:
    """Mean and its standard error from the scatter of frames, widened for what fields share through
    the glow.
    """
    per_frame = codes.mean(axis=(1, 2))
    return float(per_frame.mean()), 2.0 * float(per_frame.std(ddof=1)) / np.sqrt(len(per_frame))


# Gain.


@pytest.mark.parametrize("bit_depth", [8, 16])
def test_gain_from_one_to_a_million_is_proportional_until_full_scale(bit_depth, plain, seed):
    """Mean above black is gain times photoelectrons times DN per electron, or full scale; it never
    falls again.
    """
    sensor = plain(
        ROWS,
        COLUMNS,
        photocathode__ebi_lm_per_cm2=0.0,
        video__black_level_dn=12.0,
        ccd__full_well_e=1e12,
    )
    sensor = replace(sensor, video=replace(sensor.video, bit_depth=bit_depth))
    top = 2**bit_depth - 1
    means = []
    for gain in 10.0 ** np.arange(0.0, 6.1):
        camera = CameraModel(sensor.with_values({"tube.luminous_gain": gain}))
        codes = codes_of(camera, 2.0, Conditions(), seed)
        mean, error = with_error(codes)
        photons = gain / 15000.0 * 10229.0
        expected = 12.0 + 2.0 * photons * 0.225 * 0.32 * float(
            sensor.video.conversion_gain_dn_per_e
        )
        # Clipping bends the mean once the brightest pixels reach the top.
        if codes.max() < top and codes.min() > 0:
            assert abs(mean - expected) < 4.5 * error + 2e-3 * (expected - 12.0)
        assert mean <= top
        means.append(mean)
    assert all(later > earlier - 0.5 for earlier, later in pairwise(means))
    assert means[-1] > 0.85 * top if bit_depth == 8 else means[-1] > means[0]


@pytest.mark.parametrize("change", [{"mcp_v": 0.0}, {"mcp_v": 1.0}, {"gain_control": 0.0}])
def test_a_tube_without_gain_shows_darks(change, plain, seed):
    camera = CameraModel(plain(ROWS, COLUMNS, microchannel_plate__gain_control_reference=5000.0))
    lit = codes_of(camera, 50.0, Conditions(**change), seed)
    dark = codes_of(camera, 0.0, Conditions(**change), seed)
    assert abs(lit.mean() - dark.mean()) < 0.02


@pytest.mark.parametrize(
    "change", [{"mcp_v": 1e6}, {"gain_control": 2000.0}, {"gain_control": 1e5}]
)
def test_gain_beyond_sense_fills_the_scale_or_is_refused(change, plain, seed):
    camera = CameraModel(plain(ROWS, COLUMNS, microchannel_plate__strip_current_ua_per_cm2=0.6))
    try:
        codes = codes_of(camera, 50.0, Conditions(**change), seed)
    except BadInput as refusal:
        sentence(refusal)
    else:
        assert np.isfinite(codes).all()


# Light.


@pytest.fixture(scope="module")
def bench(sheet) -> LabBench:
    return LabBench(replace(sheet, ccd=replace(sheet.ccd, rows=ROWS, columns=COLUMNS)))


def test_light_from_a_nanolux_to_ten_thousand_lux_goes_from_dark_to_full_scale(bench, seed):
    """The mean never falls with light; a nanolux is darkness, and the strip current limits what
    bright light gives.
    """
    top = 2**bench.camera.description.video.bit_depth - 1
    means, errors = [], []
    for lux in 10.0 ** np.arange(-9.0, 4.1):
        stack = bench.expose(
            "flat", Target(), Conditions(illuminance_lux=lux), frames=FRAMES, seed=seed
        ).data
        codes = checked(stack, bench.camera)
        mean, error = with_error(codes)
        means.append(mean)
        errors.append(error)
        noiseless = bench.mean("flat", Target(), Conditions(illuminance_lux=lux))
        assert np.isfinite(noiseless).all()
    dark = checked(
        bench.expose("dark", Target(), Conditions(), frames=FRAMES, seed=seed).data, bench.camera
    )
    assert abs(means[0] - dark.mean()) < 4.5 * errors[0] + 0.01
    for n in range(1, len(means)):
        assert means[n] > means[n - 1] - 4.5 * np.hypot(errors[n], errors[n - 1]) - 0.02
    # Full scale of 8 bits lies below what the plate can give.
    assert means[-1] > 0.98 * top
    assert means[4] < 0.5 * top


def test_a_plate_at_its_strip_current_gives_that_and_no_more(plain, seed):
    """Output tends to the saturation current: G n / (1 + G n / s) goes to s, whatever the light."""
    sensor = plain(
        ROWS,
        COLUMNS,
        microchannel_plate__strip_current_ua_per_cm2=1e-3,
        photocathode__ebi_lm_per_cm2=0.0,
        ccd__full_well_e=1e12,
        video__conversion_gain_dn_per_e=1.0,
    )
    camera = CameraModel(sensor)
    plate = camera.stage(Slot.MCP, Conditions())
    area = 2.0 * camera.cells.cell_area_cm2 * camera.cells.per_column * camera.cells.per_row
    limit_e = plate.saturation_e_per_s_cm2 * camera.field_s * area * 205.0 * 0.225 * 0.32
    levels = []
    for photoelectrons in (1e2, 1e4, 1e6, 1e8):
        light = mcp_input_from_photoelectrons(
            camera, np.full(camera.shape, photoelectrons), Conditions()
        )
        levels.append(float(camera.mean_frame(light, Conditions()).mean(dtype=float)) - 400.0)
    assert levels[-1] == pytest.approx(limit_e, rel=1e-3)
    assert np.all(np.diff(levels) > 0.0) or levels[-1] == pytest.approx(levels[-2], rel=1e-4)


def test_zero_light_gives_the_very_darks(bench, seed):
    dark = bench.expose("dark", Target(), Conditions(), frames=3, seed=seed).data
    unlit = bench.expose(
        "flat", Target(), Conditions(illuminance_lux=0.0), frames=3, seed=seed
    ).data
    assert dark.tobytes() == unlit.tobytes()


def test_zero_light_and_no_dark_emission_leave_black_and_read_noise(plain, seed):
    camera = CameraModel(plain(ROWS, COLUMNS, photocathode__ebi_lm_per_cm2=0.0))
    codes = codes_of(camera, 0.0, Conditions(), seed)
    mean, error = with_error(codes)
    assert abs(mean - 400.0) < 4.5 * error
    ccd = camera.description.ccd
    dark_e = float(ccd.dark_current_e_per_s) * 2.0 / 59.94
    white = float(
        np.sum(CameraModel(camera.description).stage(Slot.VIDEO).low_pass.impulse_response() ** 2)
    )
    expected = (float(ccd.read_noise_e) ** 2 + dark_e) * 0.2**2 * white + 1.0 / 12.0
    assert codes[:, :, 8:].var() == pytest.approx(expected, rel=4.5 * np.sqrt(4.0 / codes.size))


# Size.


@pytest.mark.parametrize(
    ("shape", "interlaced"),
    [
        ((1, 1), True),
        ((1, 1), False),
        ((1, 40), True),
        ((40, 1), True),
        ((40, 1), False),
        ((3, 2), True),
    ],
)
def test_frames_of_one_pixel_one_row_or_one_column_have_the_mean_of_any_other(
    shape, interlaced, plain, seed
):
    sensor = plain(*shape, photocathode__ebi_lm_per_cm2=0.0)
    camera = CameraModel(replace(sensor, video=replace(sensor.video, interlaced=interlaced)))
    light = mcp_input_from_photoelectrons(camera, np.full(shape, 20.0), Conditions())
    expected = 400.0 + 20.0 * 10229.0 * 0.225 * 0.32 * 0.2
    assert camera.mean_frame(light, Conditions()) == pytest.approx(expected, rel=2e-3)
    codes = codes_of(camera, 20.0, Conditions(), seed, frames=60)
    assert codes.shape == (60, *shape)
    mean, error = with_error(codes)
    assert abs(mean - expected) < 4.5 * error + 2e-3 * expected


@pytest.mark.parametrize("name", NAMES)
def test_every_shipped_camera_of_one_pixel_sees(name, seed):
    camera = small_camera(load_camera(name), 1, 1)
    dark, lit = (codes_of(camera, level, Conditions(), seed, frames=4) for level in (0.0, 1e5))
    assert lit.mean() > dark.mean()


def test_the_smallest_frames_are_made_in_memory_of_their_own():
    # Compiled loops read and write what lies beside an array without a word, unless every index is
    # checked. Loops with checks are kept where `make test-all` keeps them.
    kept = Path(__file__).resolve().parents[2] / "build" / "bounds"
    watched = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(kept)}
    tests = ["-q", "-n", "0", "-p", "no:cacheprovider", "-k", "one_pixel_one_row", __file__]
    made = subprocess.run(
        [sys.executable, "-m", "pytest", *tests], env=watched, capture_output=True, text=True
    )
    assert made.returncode == 0, made.stdout


@pytest.mark.parametrize("shape", [(0, 5), (5, 0), (-3, 4)])
def test_frames_without_pixels_are_refused(shape, plain):
    refused(lambda: plain(*shape))


# Radiance and pictures.


def _cube(value: float) -> RadianceCube:
    radiance = np.full((len(NM), 6, 8), 1e-9)
    radiance[3, 2, 5] = value
    return RadianceCube(wavelength_nm=NM, radiance=radiance)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1e-9])
def test_radiance_that_is_none_is_refused(name, value):
    camera = small_camera(load_camera(name))
    refused(lambda: mcp_input_from_radiance(camera, _cube(value), Conditions()))


@pytest.mark.parametrize(
    "wavelength", [[500.0, math.nan], [600.0, 500.0], [500.0, 500.0], [-5.0, 500.0], [0.0, 500.0]]
)
def test_wavelengths_that_are_none_are_refused(wavelength, sheet):
    def make() -> None:
        cube = RadianceCube(wavelength_nm=np.array(wavelength), radiance=np.ones((2, 4, 4)))
        mcp_input_from_radiance(small_camera(sheet), cube, Conditions())

    refused(make)


@pytest.mark.parametrize("level", [0.0, 1e-12, 1.0, 1e12])
def test_radiance_of_any_size_gives_codes(level, sheet, seed):
    camera = small_camera(sheet)
    cube = RadianceCube(wavelength_nm=NM, radiance=np.full((len(NM), 4, 4), level))
    light = mcp_input_from_radiance(camera, cube, Conditions())
    assert np.isfinite(light.values).all() and (level == 0.0 or light.values.mean() > 0.0)
    codes = checked(
        np.stack(list(islice(camera.frames(light, Conditions(), seed=seed), 3))), camera
    )
    dark = codes_of(camera, 0.0, Conditions(), seed, frames=3)
    if level < 1e-11:
        assert codes.tobytes() == dark.tobytes() or abs(codes.mean() - dark.mean()) < 0.5
    else:
        assert codes.mean() > dark.mean()


@pytest.mark.parametrize("photoelectrons", [1e-12, 1e3, 1e6, 1e15])
def test_one_pixel_of_any_brightness_neither_wraps_nor_darkens_the_picture(
    photoelectrons, sheet, seed
):
    camera = small_camera(sheet)
    picture = np.zeros(camera.shape)
    picture[12, 16] = photoelectrons
    codes = codes_of(camera, picture, Conditions(), seed, frames=4)
    dark = codes_of(camera, 0.0, Conditions(), seed, frames=4)
    assert codes[:, 12, 16].mean() >= dark[:, 12, 16].mean() - 1.0
    if photoelectrons >= 1e6:
        assert codes[:, 12, 15:18].max() == 255.0


# Time.


@pytest.mark.parametrize("gate_ns", [1e-3, 1e3, 1e6, 1e7])
def test_gates_shorter_than_the_decay_keep_the_light_in_proportion(gate_ns, plain):
    """What lingers comes in later fields: a steady scene shows all its light, however short the
    gate.
    """
    camera = CameraModel(
        plain(ROWS, COLUMNS, photocathode__ebi_lm_per_cm2=0.0, ccd__full_well_e=1e12)
    )
    conditions = Conditions(gate_ns=gate_ns)
    cathode = camera.stage(Slot.PHOTOCATHODE, conditions)
    share = gate_ns * 1e-9
    per_s = 20.0 / share
    light = camera.mcp_input(
        StageImage(
            values=np.full(camera.scene_cells.shape, per_s, np.float32), grid=camera.scene_cells
        ),
        conditions,
    )
    closed = (camera.field_s - share) / float(camera.description.photocathode.gate_on_off_ratio)
    expected = per_s * cathode.quantum_efficiency * (share + closed) * 4.0
    assert light.values.mean(dtype=float) == pytest.approx(expected, rel=1e-3)
    assert camera.stage(Slot.DECAY, conditions).weights.sum() == pytest.approx(1.0, abs=1e-9)
    mean = camera.mean_frame(light, conditions) - 400.0
    flat = 8.0 * light.values.mean(dtype=float) * 10229.0 * 0.225 * 0.32 * 0.2
    assert mean.mean(dtype=float) == pytest.approx(flat, rel=2e-3, abs=1e-3)


@pytest.mark.parametrize("gate_ns", [0.0, -5.0, math.nan, math.inf, 1e9])
def test_gates_that_are_none_are_refused(gate_ns, plain):
    refused(lambda: CameraModel(plain(ROWS, COLUMNS)).chain(Conditions(gate_ns=gate_ns)))


@pytest.mark.parametrize(
    "name", ["illuminance_lux", "mcp_v", "gate_ns", "temperature_c", "gain_control"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_conditions_that_are_none_are_refused(name, value, bench, seed):
    def make() -> None:
        asked = Conditions(**{"illuminance_lux": 1e-4} | {name: value})
        bench.expose("flat", Target(), asked, frames=1, seed=seed)

    refused(make)


@pytest.mark.parametrize("temperature_c", [-273.0, 80.0, 300.0, 2000.0])
def test_temperatures_from_absolute_zero_to_glowing_give_codes(temperature_c, bench, seed):
    try:
        conditions = Conditions(temperature_c=temperature_c)
        codes = checked(
            bench.expose("dark", Target(), conditions, frames=3, seed=seed).data, bench.camera
        )
    except BadInput as refusal:
        sentence(refusal)
    else:
        cold = checked(
            bench.expose(
                "dark", Target(), Conditions(temperature_c=-60.0), frames=3, seed=seed
            ).data,
            bench.camera,
        )
        assert codes.mean() >= cold.mean() - 0.5


# Descriptions.


def _of_few_pixels(name: str):
    description = load_camera(name)
    return replace(description, ccd=replace(description.ccd, rows=6, columns=8))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_description_with_a_number_that_is_none_is_refused(name, value):
    description, accepted = _of_few_pixels(name), []
    for path in sorted(description.parameters()):
        try:
            camera_from_description(description.with_values({path: value})).chain(Conditions())
        except BadInput as refusal:
            sentence(refusal)
        else:
            accepted.append(path)
    assert not accepted


# Both cameras with a tube have the same stages but for the analog video: that numbers may be too
# small is tried on one.
@pytest.mark.parametrize(
    ("name", "factor"),
    [
        *((name, factor) for name in (NAMES[0], NAMES[2]) for factor in (-1.0, 0.0, 100.0)),
        (NAMES[1], 0.1),
    ],
)
def test_any_number_of_a_description_may_be_absurd_and_is_refused_or_gives_codes(
    name, factor, seed
):
    """With the sign turned, at zero, and far from the shipped value either way: no number of either
    kind of camera.
    """
    description, broken = _of_few_pixels(name), []
    for path, parameter in sorted(description.parameters().items()):
        try:
            camera = camera_from_description(
                description.with_values({path: factor * float(parameter)})
            )
            light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 5.0), Conditions())
            assert np.isfinite(camera.mean_frame(light, Conditions())).all()
            next(iter(camera.frames(light, Conditions(), seed=seed)))
        except BadInput as refusal:
            sentence(refusal)
        except Exception as error:
            broken.append(f"{path} x {factor:g}: {type(error).__name__}: {str(error)[:90]}")
    assert not broken, "\n".join(broken)


@pytest.mark.parametrize(
    "changes",
    [
        {"video": {"bit_depth": 0}},
        {"video": {"bit_depth": 17}},
        {"video": {"bandwidth_mhz": None}},
        {"video": {"pixel_clock_mhz": None}},
        {"video": {"filter_order": None}},
        {"video": {"filter_order": 0}},
        {"microchannel_plate": {"stages": 0}},
        {"photocathode": {"wavelength_nm": (500.0, 400.0)}},
        {"photocathode": {"relative_quantum_efficiency": (0.1, 0.2)}},
    ],
    ids=str,
)
def test_descriptions_that_contradict_themselves_are_refused(changes, sheet):
    ((stage, fields),) = changes.items()
    refused(
        lambda: CameraModel(
            replace(sheet, **{stage: replace(getattr(sheet, stage), **fields)})
        ).chain(Conditions())
    )
