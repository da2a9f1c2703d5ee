"""What edges, points and bars told of the MTF, tied to the camera model."""

import numpy as np
from numpy.typing import NDArray

from charact.fit import predicted_quantities
from charact.fit.admissible_measurements import SPREAD, admissible_measurements, sd_of
from charact.fit.observed import Observation, curve_observation, one
from labdata.measurement import Curve, Measurement, Result
from labdata.sensor import Sensor
from labdata.session import Session

Array = NDArray[np.float64]

# What the chain's formulas leave out of an MTF, and points nearer than the correlation length are hardly independent.
MTF_MODEL_SD = 0.004
MTF_CORRELATION_CY_PER_PX = 0.08
MTF_SPACING_CY_PER_PX = 0.04
HIGHEST_CY_PER_PX = 0.45
LEAST_MTF = 0.03


def mtf_observations(session: Session, sensor: Sensor, result: Result) -> list[Observation]:
    """Return curves and bars, each tied to the MTF along its own direction."""
    found = [_curve(name, line, session, sensor, result) for name, line in _admissible_curves(result)]
    return found + [_bars(m, session, sensor) for m in _of_bars(session, result)]


def _of_bars(session: Session, result: Result) -> list[Measurement]:
    """Return what bar targets told of the MTF; pinned points of an edge's curve are in the curve already."""
    bars = {entry.label for entry in session.of_kind("bars")}
    return [m for m in admissible_measurements(result, "mtf") if m.stack in bars and m.frequency_cy_per_px]


def _admissible_curves(result: Result) -> list[tuple[str, Curve]]:
    """Return the MTF curves whose own MTF50 is sound, or the mildly suspect ones where none is."""
    curves = [(n, c) for n, c in result.curves.items() if n.split(":")[0] in ("mtf", "mtf_vertical")]
    curves = [(n, c) for n, c in curves if c.interval68 is not None]
    stacks = {m.stack for m in admissible_measurements(result, "mtf50")}
    return [(n, c) for n, c in curves if _stack_of(n, c) in stacks]


def _stack_of(name: str, line: Curve) -> str | None:
    return line.stack or (name.split(":", 1)[1] if ":" in name else None)


def _curve(name: str, line: Curve, session: Session, sensor: Sensor, result: Result) -> Observation:
    """Tie an MTF curve to the model at frequencies far enough apart."""
    wanted = np.arange(MTF_SPACING_CY_PER_PX, HIGHEST_CY_PER_PX + 1e-9, MTF_SPACING_CY_PER_PX)
    frequency = np.asarray(line.frequency_cy_per_px, float)
    low, high = np.asarray(line.interval68, float)
    value = np.interp(wanted, frequency, line.value)
    sd = np.interp(wanted, frequency, (high - low) / (2.0 * 0.994458))
    used = (wanted >= frequency[0]) & (wanted <= frequency[-1]) & (value > LEAST_MTF)
    angle_deg = _angle_deg(name, line, session, result)
    fx, fy = _components(wanted[used], angle_deg, sensor)
    return curve_observation(
        name, value[used], sd[used], wanted[used], lambda values: predicted_quantities.mtf(values, fx, fy), SPREAD,
        correlation_length=MTF_CORRELATION_CY_PER_PX, model_sd=MTF_MODEL_SD,
    )  # fmt: skip


def _angle_deg(name: str, line: Curve, session: Session, result: Result) -> float:
    """Return the direction of a curve's frequencies, degrees from the row direction."""
    if name.startswith("mtf_vertical"):
        return 90.0
    stack = _stack_of(name, line)
    entry = next((entry for entry in session.stacks if entry.label == stack), None)
    if entry is not None and entry.kind == "point":
        return 0.0
    if entry is not None and entry.target.angle_deg is not None:
        return entry.target.angle_deg
    told = [m.orientation_deg for m in result.find("mtf50") if m.orientation_deg is not None and m.stack == stack]
    return told[0] if told else 0.0


def _components(frequency: Array, angle_deg: float, sensor: Sensor) -> tuple[Array, Array]:
    """Split frequencies in cy per column pitch: along rows in the same, along columns in cy per row pitch."""
    pitch_ratio = float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
    angle = np.deg2rad(angle_deg)
    return frequency * abs(np.cos(angle)), frequency * abs(np.sin(angle)) * pitch_ratio


def _bars(m: Measurement, session: Session, sensor: Sensor) -> Observation:
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    told = m.orientation_deg if m.orientation_deg is not None else entry and entry.target.angle_deg
    fx, fy = _components(np.array([m.frequency_cy_per_px or 0.0]), told or 0.0, sensor)
    sd = float(np.hypot(sd_of(m), MTF_MODEL_SD))
    return one(
        f"mtf of {m.stack}", m.value or 0.0, sd, lambda values: predicted_quantities.mtf(values, fx, fy)[:, 0], SPREAD
    )
