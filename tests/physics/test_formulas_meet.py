"""Formulas of the likelihoods and of the simulator were written apart: here they meet."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf.session.mtf_budget import MeasuredCurve, MeasuredCurves, fit_mtf_budget
from charact.estimators.mtf.session.stage_transfers import STAGES, Direction, StageModel
from charact.fitting import (
    levels_of,
    observations_of,
    predicted_quantities,
    prior_of,
    stacks_of,
    tube_light,
    values_of_description,
)
from charact.observables import Values
from labdata import (
    Camera,
    Conditions,
    Kind,
    Result,
    Target,
    load_camera,
    load_sensor,
    measurement_from_sd,
)
from simulate import LabBench
from simulate.camera import PhosphorDecay, VideoFilter, true_quantities
from simulate.virtual_bench import true_sensor
from tests.truth.sessions import session_in_memory, stack_in_memory

# The fit's formulas and the simulator's were written apart: here they meet, at specimens that
# nobody chose.


GATE_S = 0.0133
IN_FRAMES = (
    "image lag",
    "line noise",
    "ion events",
    "noise between pulses",
    "DSNU",
    "dark events",
    "mean of dark events",
)
MCP_V = 780.0
FREQUENCY = np.linspace(0.02, 0.6, 30)


@pytest.fixture(scope="module", params=range(4))
def specimen(request: pytest.FixtureRequest, seed: int) -> Camera:
    return true_sensor.draw_true_sensor(load_sensor("pulnix-ag5745ef3"), seed + request.param)


@pytest.fixture(scope="module")
def values(specimen: Camera) -> Values:
    known = {
        path: np.array([float(parameter)]) for path, parameter in specimen.parameters().items()
    }
    return {**known, "video.filter_order": np.array([float(specimen.video.filter_order)])}


def test_the_mtf_is_the_same_in_both_directions(specimen: Camera, values: Values) -> None:
    pitch_ratio = float(specimen.ccd.pitch_y_um) / float(specimen.ccd.pitch_x_um)
    for direction, at in (
        ("horizontal", (FREQUENCY,)),
        ("vertical", (0.0 * FREQUENCY, FREQUENCY * pitch_ratio)),
    ):
        expected = true_quantities.true_mtf(specimen, FREQUENCY, direction)
        assert predicted_quantities.mtf(values, *at)[0] == pytest.approx(
            expected, rel=1e-3, abs=1e-6
        )


def test_every_quantity_of_the_camera_is_the_same(specimen: Camera, values: Values) -> None:
    told = true_quantities.true_quantities(specimen, Conditions(mcp_v=MCP_V, gate_ns=GATE_S * 1e9))
    gain = predicted_quantities.photoelectron_gain(values, MCP_V)
    for name, found, within in (
        ("photoelectron_gain", gain, 1e-6),
        ("excess_noise_factor", predicted_quantities.excess_noise_factor(values), 1e-9),
        ("covariance_gain", predicted_quantities.covariance_gain(values, gain), 1e-6),
        ("blur_factor", predicted_quantities.blur_factor(values, gain), 0.02),
        ("halo_diameter", predicted_quantities.halo_diameter_px(values), 1e-9),
        ("ebi", predicted_quantities.background_rate(values), 1e-6),
        ("photoelectrons_per_lux", predicted_quantities.photoelectrons(values, 1.0, GATE_S), 1e-6),
        ("decay_factor", tube_light.field_products(values, GATE_S, 1)[:, 0], 1e-3),
    ):
        assert found[0] == pytest.approx(told[name], rel=within), name


def test_blur_table_of_the_physics_reference() -> None:
    """Row pairs of a tube with fc 26.25 lp/mm and n 1.184, its video filter aside: 0.331 at a share
    of 0.8 (5.2).
    """
    sensor = load_sensor("pulnix-ag5745ef3")
    known = {path: np.array([float(parameter)]) for path, parameter in sensor.parameters().items()}
    # The table's taper is a Gaussian of 80 lp/mm at the cathode without fibres, and its pixel clock
    # is not filtered.
    known |= {
        "video.filter_order": np.array([3.0]),
        "video.bandwidth_mhz": np.array([1e3]),
        "taper.fibre_pitch_um": np.array([1e-3]),
        "taper.interface_mtf_lp_per_mm": np.array([80.0 * 18.0 / 11.0]),
    }
    for share, expected in ((1.0, 0.282), (0.8, 0.331), (0.5, 0.434), (0.25, 0.562)):
        known["tube.post_gain_share"] = np.array([share])
        assert predicted_quantities.blur_factor(known, np.array([10.0]))[0] == pytest.approx(
            expected, rel=0.03
        )


# The stages of a budget and the simulator's were written apart: here they meet, at specimens that
# nobody chose.


STAGE_FREQUENCY = np.linspace(0.02, 0.48, 24)
DIRECTIONS: tuple[Direction, ...] = ("horizontal", "vertical")


def per_pitch(sensor: Camera, direction: Direction) -> float:
    """Pitches of the direction's pixels in a column pitch."""
    return (
        float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
        if direction == "vertical"
        else 1.0
    )


@pytest.mark.parametrize("name", ["pulnix-ag5745ef3", "gen3-digital-iccd"])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_product_of_the_stages_is_the_simulated_camera(
    name: str, direction: Direction, seed: int
) -> None:
    described = load_sensor(name)
    for number in range(3):
        sensor = true_sensor.draw_true_sensor(described, seed + number)
        model = StageModel.of(sensor, interlaced=sensor.video.interlaced, halo=True)
        found = model.mtf(
            model.mean[None], STAGE_FREQUENCY * per_pitch(sensor, direction), direction
        )[0]
        assert found == pytest.approx(
            true_quantities.true_mtf(sensor, STAGE_FREQUENCY, direction), abs=2e-3
        )


def test_stages_of_specimens_lie_in_their_intervals(seed: int) -> None:
    """Of 12 specimens' stages at 0.2 cycles per column pitch 95 % intervals hold as many, within 4
    standard errors.

    Curves exact to 0.004, each with a description whose ranges the specimen was drawn from.
    """
    described, rng = load_sensor("pulnix-ag5745ef3"), np.random.default_rng(seed)
    held = []
    for number in range(12):
        specimen = true_sensor.draw_true_sensor(described, seed + number)
        curves = [
            MeasuredCurves(
                curves=(
                    MeasuredCurve(
                        direction=direction,
                        frequency_cy_per_px=STAGE_FREQUENCY * per_pitch(specimen, direction),
                        value=true_quantities.true_mtf(specimen, STAGE_FREQUENCY, direction)
                        + 0.004 * rng.standard_normal(STAGE_FREQUENCY.size),
                    ),
                ),
                covariance=0.004**2 * np.eye(STAGE_FREQUENCY.size),
            )
            for direction in DIRECTIONS
        ]
        # Pitches of a specimen are those of its description; the gap is what its point sources
        # told.
        gap = {"photocathode.gap_mm": specimen.photocathode.gap_mm}
        found = fit_mtf_budget(
            curves, described.with_parameters(gap), interlaced=True, seed=1, quick=True, halo=True
        )
        assert found.chance > 1e-4
        exact = StageModel.of(specimen, interlaced=True, halo=True)
        logs = exact.log_stages(exact.mean[None], np.array([0.2]), "horizontal")[:, 0, 0]
        for stage, value in zip(STAGES, np.exp(logs), strict=True):
            low, high = np.quantile(
                found.product((stage,), np.array([0.2]), "horizontal"), [0.025, 0.975]
            )
            if stage not in found.known:
                held.append(low <= value <= high)
    assert abs(np.mean(held) - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 12), np.mean(held)


# Lag, blur and darks as the fit predicts them are those of the simulated camera; neither knows the
# other's formula.


NAMES = ("pulnix-ag5745ef3", "gen3-digital-iccd")
DRAWN = (
    "photocathode.ebi_lm_per_cm2",
    "tube.luminous_gain",
    "tube.post_gain_share",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "phosphor.fast_fraction",
    "phosphor.fast_decay_ms",
    "phosphor.slow_decay_ms",
    "ccd.read_noise_e",
    "ccd.dsnu_e",
    "video.line_noise_dn",
    "video.black_level_dn",
    "microchannel_plate.ion_event_rate_per_s_cm2",
    "microchannel_plate.ion_event_size_pe",
)
OPEN_S = 0.0158
IN_FRAMES = (
    "image lag",
    "line noise",
    "ion events",
    "noise between pulses",
    "DSNU",
    "dark events",
    "mean of dark events",
)


def specimen_of(name: str, seed: int) -> Camera:
    """Return a device drawn from the ranges of a description, on a small chip."""
    sheet = load_camera(name)
    prior = prior_of(sheet, DRAWN)
    drawn = prior.parameters(prior.draw(np.random.default_rng([seed, 7]), 1))[0]
    specimen = sheet.with_values(dict(zip(prior.names, drawn.tolist(), strict=True)))
    return replace(specimen, ccd=replace(specimen.ccd, rows=200, columns=260))


@pytest.mark.parametrize("number", range(3))
def test_the_light_of_later_fields_is_the_same(seed: int, number: int) -> None:
    specimen = specimen_of("pulnix-ag5745ef3", seed + number)
    values, phosphor = values_of_description(specimen), specimen.phosphor
    field_s = 1.0 / float(specimen.video.field_rate_hz)
    fast = float(phosphor.fast_fraction)
    components = (
        (fast, float(phosphor.fast_decay_ms) * 1e-3),
        (1.0 - fast, float(phosphor.slow_decay_ms) * 1e-3),
    )
    decay = PhosphorDecay(components=components, gate_s=OPEN_S, field_s=field_s)
    shares = decay.pulse_shares
    light = tube_light.field_light(values, OPEN_S, 6)[0]
    assert light == pytest.approx(decay.weights[:6], abs=2e-3)
    products = tube_light.field_products(values, OPEN_S, 6)[0]
    expected = [
        np.mean(np.sum(shares[:, : shares.shape[1] - lag] * shares[:, lag:], axis=1))
        for lag in range(6)
    ]
    assert products == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_pulses_cover_their_neighbours_alike(seed: int, name: str) -> None:
    specimen = specimen_of(name, seed)
    found = predicted_quantities.pulse_covariance(
        values_of_description(specimen), ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    )[0]
    told = true_quantities.true_quantities(specimen, Conditions(mcp_v=800.0, gate_ns=OPEN_S * 1e9))
    # The blur factor told is that of pulses and of the electrons they are counted by, one in a
    # thousand of the noise.
    assert found[0] == pytest.approx(told["blur_factor"], rel=0.01)
    assert found[1] / found[0] == pytest.approx(told["correlation_horizontal"], abs=5e-3)
    assert found[2] / found[0] == pytest.approx(told["correlation_vertical"], abs=5e-3)


def test_filtered_noise_has_the_covariances_of_the_impulse_response() -> None:
    specimen = load_camera("pulnix-ag5745ef3")
    bandwidth, clock, order = specimen.video.low_pass or (0.0, 0.0, 0)
    response = VideoFilter(
        bandwidth_mhz=bandwidth, pixel_clock_mhz=clock, order=order
    ).impulse_response()
    expected = [np.sum(response[: response.size - lag] * response[lag:]) for lag in range(3)]
    found = predicted_quantities.filter_covariance(values_of_description(specimen), 3)[0]
    assert found == pytest.approx(expected, abs=1e-5)


def observed_of(name: str, seed: int) -> tuple[list, Values]:
    """Return what the fit observes in a dark and a flat of a specimen by its sheet, and the
    specimen's values.
    """
    specimen = specimen_of(name, seed)
    bench, values = LabBench(specimen), values_of_description(specimen)
    shared = Conditions(mcp_v=800.0, gate_ns=OPEN_S * 1e9)
    signal, lux = 0.0, 1e-7
    while signal < 60.0 * 2.0 ** (specimen.video.bit_depth - 8):
        lux *= 1.5
        mean = bench.mean("flat", Target(), replace(shared, illuminance_lux=lux)).mean(dtype=float)
        signal = mean - float(specimen.video.black_level_dn)
    shown: tuple[tuple[Kind, Conditions], ...] = (
        ("dark", shared),
        ("flat", replace(shared, illuminance_lux=lux)),
    )
    stacks = tuple(
        stack_in_memory(
            kind, bench.expose(kind, Target(), conditions, frames=16, seed=seed), conditions
        )
        for kind, conditions in shown
    )
    session = session_in_memory(stacks, camera=specimen, bit_depth=specimen.video.bit_depth)
    gain = true_quantities.true_quantities(specimen, shared)["covariance_gain"]
    told = Result(
        measurements=(
            measurement_from_sd("covariance_gain", "DN", gain, 0.01 * gain, method="told"),
        )
    )
    stacks = stacks_of(session, load_camera(name), told, levels_of(session))
    return [observed for observed in observations_of(stacks) if observed.name in IN_FRAMES], values


@pytest.mark.parametrize("name", NAMES)
def test_what_is_observed_in_frames_lies_where_the_camera_predicts_it(seed: int, name: str) -> None:
    seen: dict[str, int] = {}
    for number in range(2):
        observed, values = observed_of(name, seed + number)
        for one in observed:
            away = (one.predict(values)[0] - one.value) / np.sqrt(np.diag(one.covariance))
            assert np.abs(away).max() < 4.5, (one.name, away)
            seen[one.name] = seen.get(one.name, 0) + 1
    always = (
        ("image lag", "line noise", "ion events")
        if name == NAMES[0]
        else ("noise between pulses", "DSNU", "mean of dark events", "ion events")
    )
    assert all(seen.get(each) == 2 for each in always)
