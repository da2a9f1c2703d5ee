"""A session that never was: what unerring methods would have told of a specimen drawn from the
prior, with noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from charact.fitting import (
    Model,
    SessionStacks,
    model_of,
    observations_of,
    predicted_quantities,
    prior_of,
    stacks_of,
    tube_observations,
    values_of_description,
)
from charact.observables import StackLevel, Values
from labdata import (
    Camera,
    Curve,
    Measurement,
    Result,
    StackEntry,
    Target,
    load_sensor,
    measurement_from_sd,
)
from tests.truth.sessions import session_in_memory

GATE_S = 0.016
LUX = (0.0, 2e-5, 8e-5, 1.6e-4, 3e-4)
MCP_V = 800.0
ANGLE_DEG = 5.0


@dataclass(frozen=True, kw_only=True)
class Told:
    """A specimen and what was told of it."""

    truth: dict[str, float]
    stacks: SessionStacks
    model: Model


@pytest.fixture(scope="session")
def sheet() -> Camera:
    return load_sensor("pulnix-ag5745ef3")


@pytest.fixture(scope="session")
def told_of(sheet: Camera) -> Callable[[int], Told]:
    """Return what was told of the specimen of a seed."""

    def told(seed: int) -> Told:
        rng = np.random.default_rng([seed, 77])
        prior = prior_of(
            sheet, tuple(dict.fromkeys((*tube_observations.SHAPE, *tube_observations.LEVEL)))
        )
        point = prior.draw(rng, 1)
        drawn = dict(zip(prior.names, prior.parameters(point).T, strict=True))
        values = {**values_of_description(sheet), **drawn}
        stacks = (
            StackEntry(
                label="edge",
                kind="edge",
                frames="-",
                target=Target(angle_deg=ANGLE_DEG),
                folder=Path(),
            ),
        )
        session = session_in_memory(stacks, camera=sheet, bit_depth=8)
        result = Result(
            measurements=_numbers(values, rng), curves={"mtf:edge": _curve(values, rng)}
        )
        levels = _levels(values, rng)
        stacks = stacks_of(session, sheet, result, levels)
        model = model_of(sheet, observations_of(stacks))
        truth = {path: float(value[0]) for path, value in drawn.items()}
        return Told(truth=truth, stacks=stacks, model=model)

    return told


def _numbers(values: Values, rng: np.random.Generator) -> tuple[Measurement, ...]:
    gain = predicted_quantities.photoelectron_gain(values, MCP_V)
    exact = {
        ("covariance_gain", "DN"): predicted_quantities.covariance_gain(values, gain),
        ("blur_factor", "1"): predicted_quantities.blur_factor(values, gain),
        ("halo_diameter", "px"): predicted_quantities.halo_diameter_px(values),
    }
    out = [
        measurement_from_sd(
            name,
            unit,
            float(x[0] * (1 + 0.01 * rng.standard_normal())),
            0.01 * float(x[0]),
            method="told",
        )
        for (name, unit), x in exact.items()
    ]
    edge = predicted_quantities.mtf(values, np.linspace(0.0, 0.5, 501))[0]
    half = float(np.interp(-0.5, -edge, np.linspace(0.0, 0.5, 501)))
    return (*out, measurement_from_sd("mtf50", "cy/px", half, 0.002, method="told", stack="edge"))


def _curve(values: Values, rng: np.random.Generator) -> Curve:
    frequency = np.arange(0.0, 0.5, 0.01)
    angle = np.deg2rad(ANGLE_DEG)
    across, along = frequency * np.cos(angle), frequency * np.sin(angle) * 13.0 / 11.0
    sd = np.full(frequency.size, 0.006)
    # Errors of a curve go together over some distance in frequency.
    apart = np.abs(frequency[:, None] - frequency[None, :])
    root = np.linalg.cholesky(np.exp(-apart / 0.08) + 1e-9 * np.eye(frequency.size))
    value = predicted_quantities.mtf(values, across, along)[0] + sd * (
        root @ rng.standard_normal(frequency.size)
    )
    return Curve(
        frequency_cy_per_px=frequency,
        value=value,
        interval68=np.array([value - 0.994458 * sd, value + 0.994458 * sd]),
        stack="edge",
    )


def _levels(values: Values, rng: np.random.Generator) -> tuple[StackLevel, ...]:
    gain = predicted_quantities.photoelectron_gain(values, MCP_V)
    out = []
    for lux in LUX:
        background = predicted_quantities.background_rate(values) + predicted_quantities.ion_light(
            values
        )
        events = predicted_quantities.photoelectrons(values, lux, GATE_S) + background * GATE_S
        load = predicted_quantities.mcp_load(values, lux, GATE_S, MCP_V)
        mean = float((values["video.black_level_dn"] + gain * events / (1.0 + load))[0])
        out.append(
            StackLevel(
                label=f"flat {lux:g}",
                mean_dn=mean * (1.0 + 0.002 * float(rng.standard_normal())),
                mean_sd_dn=0.02,
                noise_dn=5.0,
                illuminance_lux=lux,
                gate_s=GATE_S,
                exposure_s=1.0 / 59.94,
                mcp_v=MCP_V,
            )
        )
    return tuple(out)
