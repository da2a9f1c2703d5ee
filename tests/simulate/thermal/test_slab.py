"""Black bodies, convection and slabs against tables and closed forms; what pictures say of
themselves.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erfc

from labdata import from_mapping
from simulate.radiance import (
    STEFAN_BOLTZMANN,
    band_photon_radiance,
    band_radiance,
    band_radiance_slope,
)
from simulate.radiance.geometry import Viewpoint
from simulate.radiance.outdoor import OutdoorScene
from simulate.thermal import (
    Columns,
    Exchange,
    infrared_radiance,
    infrared_rendering,
    kernels,
    march,
    notes_beyond_laws,
    periodic_start,
    temperatures_of,
    thresholds,
    vapour_pressure_pa,
)
from tests.simulate.thermal.slabs import (
    ASPHALT,
    CONCRETE,
    DAY,
    DRY_SOIL,
    HOUR,
    STEEL,
    forcing_of,
    reference_day,
    slab_of,
)
from tests.simulate.thermal.test_air import humid_air
from tests.simulate.thermal.test_infrared_rendering import NIGHT, box, ground

# Black bodies, convection and slabs against tables and closed forms.


# Band radiances of a black body against a table of six digits, and the laws that tie them
# together.


# Temperature, band, radiance, derivative, photon radiance: by quadrature and by series, CODATA
# 2018.
TABLE = (
    (273.15, (3.0, 5.0), 0.644266, 0.0278635, 1.45943e19),
    (273.15, (8.0, 12.0), 23.8219, 0.465701, 1.20516e21),
    (273.15, (8.0, 14.0), 35.1520, 0.637354, 1.94537e21),
    (300.0, (3.0, 5.0), 1.86596, 0.0676983, 4.18311e19),
    (300.0, (3.4, 4.1), 0.331898, 0.0138860, 6.40040e18),
    (300.0, (7.5, 13.5), 55.4916, 0.882489, 2.91534e21),
    (300.0, (8.0, 12.0), 38.5004, 0.629704, 1.93596e21),
    (300.0, (8.0, 14.0), 54.9335, 0.837821, 3.00884e21),
    (310.0, (3.0, 5.0), 2.65284, 0.0905267, 5.92467e19),
    (310.0, (8.0, 12.0), 45.1149, 0.693357, 2.26403e21),
    (310.0, (8.0, 14.0), 63.6944, 0.914474, 3.47678e21),
)


@pytest.mark.parametrize(("kelvin", "band", "radiance", "slope", "photons"), TABLE)
def test_band_radiances_have_the_digits_of_the_table(kelvin, band, radiance, slope, photons):
    for found, exact in (
        (band_radiance(*band, kelvin), radiance),
        (band_radiance_slope(*band, kelvin), slope),
        (band_photon_radiance(*band, kelvin), photons),
    ):
        # Half a unit of the sixth digit, and for numbers whose last digit is a zero no more.
        assert float(found) == pytest.approx(exact, rel=5.1e-6 / float(f"{exact:.9e}"[:8]))


def test_all_bands_together_are_the_law_of_stefan_and_boltzmann():
    edges = np.geomspace(2.0, 90.0, 40)
    total = band_radiance(edges[:-1], edges[1:], 300.0).sum()
    assert total == pytest.approx(band_radiance(2.0, 90.0, 300.0), rel=1e-12)
    # Textbook tables of the fraction below 27,000 um K.
    assert total == pytest.approx(0.9937 * STEFAN_BOLTZMANN * 300.0**4 / np.pi, rel=2e-4)


def test_the_slope_is_that_of_the_radiance():
    kelvin = np.array([180.0, 250.0, 300.0, 600.0, 1500.0])
    step = 1e-3
    difference = (
        band_radiance(8.0, 12.0, kelvin + step) - band_radiance(8.0, 12.0, kelvin - step)
    ) / (2.0 * step)
    assert band_radiance_slope(8.0, 12.0, kelvin) == pytest.approx(difference, rel=1e-7)


# Laws of convection against their tables, and plates on which dew forms.


AIR, DIFFERENCE = np.array([285.0]), np.array([2.0, 5.0, 10.0])


def coefficient(law, *, upward=1.0, excess=DIFFERENCE, wind=0.0, constant=0.0):
    exchange = Exchange(
        law=law,
        constant_w_m2_k=constant,
        wind_coefficient=np.full(3, 5.0),
        upward=np.full(3, float(upward)),
        condensation=False,
    )
    dry = np.zeros(1), np.full(1, 1013.0)
    flux, slope = exchange.loss(AIR + excess, AIR, np.array([float(wind)]), *dry)
    step = 1e-5
    further, _ = exchange.loss(AIR + excess + step, AIR, np.array([float(wind)]), *dry)
    assert slope == pytest.approx((further - flux) / step, rel=1e-4)
    return flux / excess


@pytest.mark.parametrize(
    ("upward", "sign", "h"),
    [
        (1.0, -1.0, (0.96, 1.30, 1.64)),
        (1.0, 1.0, (1.92, 2.60, 3.27)),
        (-1.0, -1.0, (1.92, 2.60, 3.27)),
        (-1.0, 1.0, (0.96, 1.30, 1.64)),
        (0.0, 1.0, (1.65, 2.24, 2.82)),
    ],
)
def test_natural_convection_is_weak_where_air_is_stable(upward, sign, h):
    assert coefficient("buoyant", upward=upward, excess=sign * DIFFERENCE) == pytest.approx(
        h, rel=0.01
    )


def test_wind_adds_by_each_law():
    assert coefficient("mcadams", wind=2.0) == pytest.approx(13.3)
    assert coefficient("watmuff", wind=2.0) == pytest.approx(8.8)
    assert coefficient("constant", wind=2.0, constant=4.0) == pytest.approx(4.0)
    assert coefficient("buoyant", wind=2.0) - coefficient("buoyant") == pytest.approx(10.0)


# Air at 12.2 C, dew point 10 C, sky of emissivity .774: temperatures dry and with condensation.
@pytest.mark.parametrize(("h", "dry", "wet"), [(13.3, 7.9, 8.9), (6.0, 5.0, 7.0), (3.0, 2.0, 4.4)])
def test_dew_warms_an_insulated_plate(h, dry, wet):
    flux = np.full((288, 1), 0.9 * 0.7743 * STEFAN_BOLTZMANN * 285.35**4)
    for vapour, celsius in ((0.0, dry), (float(vapour_pressure_pa(283.15)), wet)):
        forcing = forcing_of(flux, 285.35, emissivity=0.9, h=h, vapour_pa=vapour)
        face, _ = periodic_start(Columns.of([slab_of(STEEL)]), forcing)
        assert face[-1, 0] - 273.15 == pytest.approx(celsius, abs=0.1)


# Slabs against exact solutions of conduction, and their periodic start and kernels against long
# runs.


LAYERS = (CONCRETE, ASPHALT, DRY_SOIL)
GROUND = Columns.of([slab_of(layer) for layer in LAYERS])
STEPS = 288
TIME = (np.arange(STEPS) + 1) * 300.0


def harmonic(series):
    """Return amplitude and lag in hours of the columns of a day against a sine."""
    first = np.exp(-2j * np.pi * TIME / DAY) @ series * 2.0 / STEPS
    return np.abs(first), (-np.angle(first * 1j) / (2.0 * np.pi) * 24.0) % 24.0


def centres(mm: float = 600.0):
    """Depths of the centres of cells, m."""
    size = thresholds.LIMITS.ratio ** np.arange(thresholds.LIMITS.cells)
    size *= 1e-3 * mm / size.sum()
    return np.cumsum(size) - 0.5 * size


@pytest.mark.parametrize(
    ("h", "amplitude", "lag"),
    [
        (1e-6, (6.9662, 9.6956, 18.9235), (3.0, 3.0, 3.0)),
        (13.3, (3.9134, 4.5774, 5.7334), (1.5604, 1.3001, 0.8247)),
    ],
)
def test_a_sine_of_flux_moves_the_face_as_the_half_space(h, amplitude, lag):
    flux = 100.0 * np.sin(2.0 * np.pi * TIME / DAY)[:, None] * np.ones(3)
    forcing = forcing_of(flux, 290.0, h=h)
    _, start = periodic_start(GROUND, forcing)
    found, late = harmonic(march(GROUND, forcing, start)[0])
    assert found == pytest.approx(amplitude, rel=2e-3)
    assert late == pytest.approx(lag, abs=0.03)


@pytest.mark.parametrize("hours", [1.0, 6.0])
def test_a_step_of_the_face_sinks_in_as_erfc(hours):
    steps = round(hours * 60.0)
    concrete = Columns.of([slab_of(CONCRETE)])
    _, cells = march(
        concrete,
        forcing_of(np.zeros((steps, 1)), 1.0, h=1e7),
        np.zeros((thresholds.LIMITS.cells, 1)),
        60.0,
    )
    exact = erfc(centres() / (2.0 * np.sqrt(1.4 / (2300.0 * 880.0) * hours * HOUR)))
    assert cells[:, 0] == pytest.approx(exact, abs=5e-3)


def test_a_step_of_flux_or_of_air_warms_the_face_as_the_half_space():
    concrete, steps = Columns.of([slab_of(CONCRETE)]), 360
    flux, _ = march(
        concrete,
        forcing_of(np.full((steps, 1), 100.0), 0.0),
        np.zeros((thresholds.LIMITS.cells, 1)),
        60.0,
    )
    assert flux[[59, 359], 0] == pytest.approx([4.02195, 9.85173], rel=5e-3)
    air, _ = march(
        concrete,
        forcing_of(np.zeros((steps, 1)), 1.0, h=13.3),
        np.zeros((thresholds.LIMITS.cells, 1)),
        60.0,
    )
    assert air[[9, 59, 359], 0] == pytest.approx([0.185750, 0.370765, 0.612756], abs=5e-3)


def test_a_layered_slab_conducts_as_its_resistances_in_series():
    layers = ((*CONCRETE[:3], 100.0), (0.04, 30.0, 1400.0, 80.0), (0.5, 1200.0, 1000.0, 12.0))
    slab = slab_of(*layers, back_w_m2_k=8.0, back_c=20.0)
    forcing = forcing_of(np.full((STEPS, 1), 50.0), 273.15, h=10.0)
    face, cells = periodic_start(Columns.of([slab]), forcing)
    resistance = 0.1 / 1.4 + 0.08 / 0.04 + 0.012 / 0.5 + 1.0 / 8.0
    exact = 273.15 + (50.0 + 20.0 / resistance) / (10.0 + 1.0 / resistance)
    assert face[-1, 0] == pytest.approx(exact, abs=1e-3)
    assert np.argmax(np.abs(np.diff(cells[:, 0]))) >= thresholds.LIMITS.cells - 1


@pytest.mark.parametrize(
    ("sky", "emissivity", "h", "depression"),
    [
        (0.70, 0.9, 3.0, 13.455),
        (0.75, 0.9, 0.0, 19.649),
        (0.75, 0.9, 3.0, 11.131),
        (0.75, 0.9, 10.0, 5.657),
        (0.75, 0.1, 6.0, 1.399),
        (0.85, 0.9, 15.0, 2.514),
    ],
)
def test_an_insulated_plate_cools_to_its_balance(sky, emissivity, h, depression):
    flux = np.full((STEPS, 1), emissivity * sky * STEFAN_BOLTZMANN * 283.15**4)
    face, _ = periodic_start(
        Columns.of([slab_of(STEEL)]), forcing_of(flux, 283.15, emissivity=emissivity, h=h)
    )
    assert 283.15 - face[-1, 0] == pytest.approx(depression, abs=2e-3)


@pytest.mark.parametrize(
    ("layer", "emissivity", "h", "tau_s"),
    [
        ((150.0, 2700.0, 900.0, 1.0), 0.9, 5.0, 252.4),
        ((45.0, 7850.0, 470.0, 5.0), 0.9, 15.0, 940.0),
        ((1.0, 2500.0, 800.0, 4.0), 0.84, 5.0, 858.5),
    ],
)
def test_thin_slabs_follow_with_the_time_constant_of_a_lump(layer, emissivity, h, tau_s):
    columns, steps = Columns.of([slab_of(layer)]), 400
    flux = np.full((steps, 1), emissivity * STEFAN_BOLTZMANN * 283.0**4)
    start = np.full((thresholds.LIMITS.cells, 1), 283.1)
    face, _ = march(
        columns, forcing_of(flux, 283.0, emissivity=emissivity, h=h), start, tau_s / 200.0
    )
    excess = face[:, 0] - 283.0
    assert (200.0 * tau_s / 200.0) / np.log(excess[99] / excess[299]) == pytest.approx(
        tau_s, rel=0.02
    )


def test_the_converged_reference_day():
    slabs = [slab_of(layer) for layer in LAYERS] + [slab_of(STEEL, back_w_m2_k=8.0)]
    hour, forcing = reference_day([0.6, 0.9, 0.7, 0.7], [0.92, 0.95, 0.94, 0.9])
    face = periodic_start(Columns.of(slabs), forcing)[0] - 273.15
    assert face.min(axis=0) == pytest.approx([13.40, 13.16, 10.31, 9.07], abs=0.05)
    assert face.max(axis=0) == pytest.approx([39.22, 52.47, 48.05, 44.38], abs=0.05)
    for other, times in ((2, (5.867, 18.0)), (3, (6.133, 16.267))):
        above = face[:, other] > face[:, 0]
        crossings = hour[1:][np.diff(above.astype(int)) != 0]
        assert crossings == pytest.approx(times, abs=0.1)


def test_kernels_are_the_effect_of_lost_sun():
    columns = Columns.of([slab_of(layer) for layer in LAYERS] + [slab_of(STEEL, back_w_m2_k=8.0)])
    numbers = ([0.6, 0.9, 0.7, 0.7], [0.92, 0.95, 0.94, 0.9])
    hour, lit = reference_day(*numbers, end_h=2.0)
    face, _ = periodic_start(columns, lit)
    kernel = kernels(columns, lit, face)
    for shade, error in (((11.0, 12.0), 0.02), ((12.0, 24.0), 0.1), ((0.0, 24.0), 0.3)):
        _, shaded = reference_day(*numbers, end_h=2.0, shade=shade)
        lost = periodic_start(columns, shaded)[0][-1] - face[-1]
        linear = (kernel * (shaded.flux_w_m2 - lit.flux_w_m2)).sum(axis=0)
        assert linear == pytest.approx(lost, abs=error)
    assert lost[:1] == pytest.approx(-3.7, abs=0.3)
    assert hour[-1] == 2.0 and kernel[:, 3].sum() < 0.1


@pytest.mark.parametrize("trial", range(12))
def test_any_slabs_in_any_weather_start_where_days_lead(trial):
    rng = np.random.default_rng([trial, 7])

    def layer():
        return tuple(
            10.0 ** rng.uniform(low, high)
            for low, high in ((-1.7, 2.3), (1.3, 4.0), (2.6, 3.7), (-2.0, 3.0))
        )

    slabs = []
    for number in range(5):
        numbers = {"back_w_m2_k": 10.0 ** rng.uniform(-2.0, 2.0)} | (
            {"max_c": 0.0} if number == 0 else {}
        )
        slabs.append(slab_of(*(layer() for _ in range(rng.integers(1, 4))), **numbers))
    columns = Columns.of(slabs)
    air = rng.uniform(250.0, 300.0) + rng.uniform(0.0, 20.0) * np.sin(
        2.0 * np.pi * (TIME / DAY - rng.random())
    )
    sun = (
        rng.uniform(0.0, 1100.0)
        * np.maximum(np.sin(2.0 * np.pi * (TIME / DAY - 0.25)), 0.0)
        * (rng.random(STEPS) > 0.3)
    )
    emissivity, absorptivity = rng.uniform(0.02, 1.0, 5), rng.uniform(0.0, 1.0, 5)
    sky = rng.uniform(0.5, 1.05) * STEFAN_BOLTZMANN * air[:, None] ** 4
    forcing = forcing_of(
        absorptivity * sun[:, None] + emissivity * sky,
        air,
        emissivity=emissivity,
        h=2.0,
        law=("buoyant", "mcadams", "watmuff", "constant")[trial % 4],
        wind_m_s=rng.choice([0.0, 1.0, 15.0]) * rng.random(STEPS),
        vapour_pa=vapour_pressure_pa(air.min() - rng.choice([0.0, 5.0, 20.0])),
        upward=rng.uniform(-1.0, 1.0, 5),
    )
    face, start = periodic_start(columns, forcing)
    assert march(columns, forcing, start)[0] == pytest.approx(face, abs=3e-3)
    assert (face[:, 0] <= 273.15).all()


# What infrared pictures say of themselves: too few rays, edges, metals, and what lies beyond their
# laws.


VIEW = Viewpoint(
    position_m=(0.0, -8.0, 2.0), forward=(0.0, 1.0, -0.1), shape=(12, 16), focal_px=(12.0, 12.0)
)
UP = np.array([0.0, 0.0, 1.0])


def picture_of(library="concrete", netd_k=0.3):
    tables = {
        "material": [
            {"label": "wall", "library": library},
            {"label": "paving", "library": "concrete"},
        ],
        "object": [ground("paving", 40.0), box("wall", "wall", [0.0, 0.0, 0.0])],
    }
    scene = from_mapping(NIGHT | tables, OutdoorScene, where="test")
    return infrared_radiance(
        temperatures_of(scene), scene, VIEW, band_um=(8.0, 12.0), netd_k=netd_k
    )


@pytest.fixture(scope="module")
def seen():
    return picture_of()


def test_a_picture_whose_rays_do_not_suffice_says_so(seen):
    """0.1 mK needs more than 512 rays of a pixel, 300 mK does not."""
    fine = picture_of(netd_k=1e-4)
    assert (
        fine.rays[0] == thresholds.INFRARED.max_rays
        and fine.error_k > thresholds.INFRARED.error_share * 1e-4
    )
    assert any(
        "uncertain by" in note and "more than 0.7 of the imager's 0.1 mK" in note
        for note in fine.notes
    )
    assert not any("more than 0.7" in note for note in seen.notes)
    assert seen.error_k < thresholds.INFRARED.error_share * 0.3


def test_edges_say_their_error_and_metals_that_of_the_bins(seen):
    (edges,) = (note for note in seen.notes if "where objects or faces meet" in note)
    assert "mean of 9 parts" in edges
    finer = {
        name: next(
            one.influence
            for one in picture_of(name).left_out
            if one.name == infrared_rendering.FINER
        )
        for name in ("concrete", "aluminium")
    }
    assert finer == {"concrete": 20.0, "aluminium": 100.0}


@pytest.mark.parametrize(
    ("celsius", "humidity", "elevation_deg", "range_m", "words"),
    [
        (15.0, 0.6, 40.0, 100.0, None),
        (35.0, 0.6, 40.0, 100.0, "air of 35 C and 60 % relative humidity lies beyond"),
        (15.0, 0.1, 40.0, 100.0, "air of 15 C and 10 % relative humidity lies beyond"),
        (15.0, 0.6, -0.5, 100.0, "the sun stands -0.5 degrees above the horizon"),
        (15.0, 0.6, 0.5, 100.0, "the sun stands 0.5 degrees above the horizon"),
        (15.0, 0.6, -5.0, 100.0, None),
        (15.0, 0.6, 40.0, 9500.0, "surfaces are up to 9.5 km away"),
    ],
)
def test_what_lies_beyond_the_laws_is_said(seen, celsius, humidity, elevation_deg, range_m, words):
    """Looking down there is no sky: one sentence at most."""
    angle = np.deg2rad(elevation_deg)
    sun = np.array([0.0, np.cos(angle), np.sin(angle)])
    down = replace(VIEW, forward=(0.0, 0.0, -1.0))
    truth = replace(seen.truth, range_m=np.where(seen.truth.object >= 0, range_m, np.inf))
    notes = notes_beyond_laws(humid_air((8.0, 12.0), celsius + 273.15, humidity), sun, down, truth)
    assert [note[: len(words or "")] for note in notes] == ([] if words is None else [words])


def test_sky_near_the_horizon_is_said_to_be_uncertain(seen):
    notes = notes_beyond_laws(humid_air((8.0, 12.0), 288.15, 0.6), UP, VIEW, seen.truth)
    (low,) = (note for note in notes if "less than 5 degrees above the horizon" in note)
    _, towards = VIEW.rays(*(np.indices(VIEW.shape).reshape(2, -1) + 0.5))
    sky = seen.truth.object.ravel() < 0
    share = np.mean(sky & (towards[:, 2] > 0.0) & (towards[:, 2] < np.sin(np.deg2rad(5.0))))
    assert low.startswith(f"{100.0 * share:.2g} % of the pixels")
