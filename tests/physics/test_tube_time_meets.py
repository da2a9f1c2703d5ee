"""Lag, blur and darks as the fit predicts them are those of the simulated camera; neither knows the
other's formula.
"""

from dataclasses import replace

import numpy as np
import pytest

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
from labdata import Camera, Conditions, Kind, Result, Target, load_camera, measurement_from_sd
from simulate import LabBench
from simulate.camera import PhosphorDecay, VideoFilter, true_quantities
from tests.truth.sessions import session_in_memory, stack_in_memory

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
GATE_S = 0.0158
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
    decay = PhosphorDecay(components=components, gate_s=GATE_S, field_s=field_s)
    shares = decay.pulse_shares
    light = tube_light.field_light(values, GATE_S, 6)[0]
    assert light == pytest.approx(decay.weights[:6], abs=2e-3)
    products = tube_light.field_products(values, GATE_S, 6)[0]
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
    told = true_quantities.true_quantities(specimen, Conditions(mcp_v=800.0, gate_ns=GATE_S * 1e9))
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
    shared = Conditions(mcp_v=800.0, gate_ns=GATE_S * 1e9)
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
