"""Observations of the fit: a session's measurements with covariance and predicted quantity."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fit import predicted_quantities
from charact.fit.admissible_measurements import (
    LEVEL,
    NOISE,
    SHAPE,
    SPREAD,
    Observation,
    StackMean,
    admissible_measurements,
    curve_observation,
    one,
    sd_of,
)
from charact.fit.predicted_quantities import Values
from charact.fit.prior import values_of_description
from labdata.measurement import Curve, Measurement, Result
from labdata.sensor import Sensor
from labdata.session import Session

Array = NDArray[np.float64]
# Model error of the MTF, and spacing of its points; closer points are correlated.
MTF_MODEL_SD = 0.004
MTF_SPACING_CY_PER_PX = 0.04


def mtf_observations(session: Session, sensor: Sensor, result: Result) -> list[Observation]:
    """Return the observations of MTF curves and bar targets, each along its own direction."""
    found = [_curve(name, line, session, sensor, result) for name, line in _admissible_curves(result)]
    return found + [_bars(m, session, sensor) for m in _of_bars(session, result)]


def _of_bars(session: Session, result: Result) -> list[Measurement]:
    """Return the MTF measurements of bar targets."""
    bars = {entry.label for entry in session.of_kind("bars")}
    return [m for m in admissible_measurements(result, "mtf") if m.stack in bars and m.frequency_cy_per_px]


def _admissible_curves(result: Result) -> list[tuple[str, Curve]]:
    """Return the MTF curves with an admissible MTF50."""
    curves = [(n, c) for n, c in result.curves.items() if n.split(":")[0] in ("mtf", "mtf_vertical")]
    curves = [(n, c) for n, c in curves if c.interval68 is not None]
    stacks = {m.stack for m in admissible_measurements(result, "mtf50")}
    return [(n, c) for n, c in curves if _stack_of(n, c) in stacks]


def _stack_of(name: str, line: Curve) -> str | None:
    """Return the stack of a curve."""
    return line.stack or (name.split(":", 1)[1] if ":" in name else None)


def _curve(name: str, line: Curve, session: Session, sensor: Sensor, result: Result) -> Observation:
    """Observe an MTF curve at frequencies far enough apart."""
    wanted = np.arange(MTF_SPACING_CY_PER_PX, 0.45 + 1e-9, MTF_SPACING_CY_PER_PX)
    frequency = np.asarray(line.frequency_cy_per_px, float)
    low, high = np.asarray(line.interval68, float)
    value = np.interp(wanted, frequency, line.value)
    sd = np.interp(wanted, frequency, (high - low) / (2.0 * 0.994458))
    used = (wanted >= frequency[0]) & (wanted <= frequency[-1]) & (value > 0.03)
    angle_deg = _angle_deg(name, line, session, result)
    fx, fy = _components(wanted[used], angle_deg, sensor)
    return curve_observation(
        name, value[used], sd[used], wanted[used], lambda values: predicted_quantities.mtf(values, fx, fy), SPREAD,
        correlation_length=0.08, model_sd=MTF_MODEL_SD,
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
    angles = [m.orientation_deg for m in result.find("mtf50") if m.orientation_deg is not None and m.stack == stack]
    return angles[0] if angles else 0.0


def _components(frequency: Array, angle_deg: float, sensor: Sensor) -> tuple[Array, Array]:
    """Split frequencies in cy per column pitch: along rows in the same, along columns in cy per row pitch."""
    pitch_ratio = float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
    angle = np.deg2rad(angle_deg)
    return frequency * abs(np.cos(angle)), frequency * abs(np.sin(angle)) * pitch_ratio


def _bars(m: Measurement, session: Session, sensor: Sensor) -> Observation:
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    angle_deg = m.orientation_deg if m.orientation_deg is not None else entry and entry.target.angle_deg
    fx, fy = _components(np.array([m.frequency_cy_per_px or 0.0]), angle_deg or 0.0, sensor)
    sd = float(np.hypot(sd_of(m), MTF_MODEL_SD))
    return one(
        f"mtf of {m.stack}", m.value or 0.0, sd, lambda values: predicted_quantities.mtf(values, fx, fy)[:, 0], SPREAD
    )


# Relative model error of noise quantities: sampling of the sensor rows, image lag.
NOISE_MODEL_SD = 0.01
# Minimum noise at which quantisation is additive, DN.
LEAST_NOISE_DN = 0.5


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """One noise quantity, predicted from values, photoelectron gain and (blur factor, correlation)."""

    mcp_v: float
    value: float
    sd: float
    predict: Callable[[Values, Array, tuple[Array, Array]], Array]
    speaks_of: tuple[str, ...] = NOISE


def noise_observations(
    session: Session, sensor: Sensor, result: Result, levels: tuple[StackMean, ...]
) -> list[Observation]:
    """Observe covariance gain, blur factor and dark variance, grouped by MCP voltage."""
    reference_v = float(sensor.microchannel_plate.reference_v)
    volts = _flat_volts(session, reference_v)
    found = []
    for m in admissible_measurements(result, "covariance_gain", "DN"):
        value = m.value or 0.0
        sd = float(np.hypot(sd_of(m), NOISE_MODEL_SD * value))
        found.append(
            _Noise(
                mcp_v=_volts_of(m, session, volts),
                value=value,
                sd=sd,
                predict=lambda values, gain, shape: predicted_quantities.covariance_gain(values, gain),
            )
        )
    for m in admissible_measurements(result, "blur_factor"):
        value = m.value or 0.0
        sd = float(np.hypot(sd_of(m), NOISE_MODEL_SD * value))
        found.append(
            _Noise(
                mcp_v=_volts_of(m, session, volts),
                value=value,
                sd=sd,
                predict=lambda values, gain, shape: shape[0],
                speaks_of=SHAPE,
            )
        )
    found += _neighbours(result, volts)
    darks = [level for level in levels if level.illuminance_lux == 0.0]
    if darks and _rounding_is_noise(sensor):
        own = {level.label: level for level in darks}
        reads = admissible_measurements(result, "read_noise", "DN")
        found += [_dark(m, own.get(m.stack or "", darks[0]), sensor, reference_v) for m in reads]
    return [
        _together([one for one in found if one.mcp_v == mcp_v], mcp_v, reference_v)
        for mcp_v in dict.fromkeys(one.mcp_v for one in found)
    ]


def _neighbours(result: Result, volts: float) -> list[_Noise]:
    """Observe the horizontal neighbour correlation of the brightest flat that is neither clipped nor saturated."""
    measured = result.evidence.get("autocorrelation", {})
    transfer = result.evidence.get("photon-transfer", {})
    mean = dict(zip(transfer.get("label", ()), transfer.get("signal_dn", ()), strict=True))
    fitted = dict(zip(transfer.get("label", ()), transfer.get("fitted", ()), strict=True))
    rows = zip(
        measured.get("label", ()),
        measured.get("neighbour_correlation", ()),
        measured.get("neighbour_sd", ()),
        strict=True,
    )
    usable = [(mean[label], value, sd) for label, value, sd in rows if fitted.get(label)]
    return [
        _Noise(
            mcp_v=volts,
            value=value,
            sd=float(np.hypot(sd, 0.004)),
            predict=lambda values, gain, shape: shape[1],
            speaks_of=SHAPE,
        )
        for _, value, sd in sorted(usable)[-1:]
    ]


def _rounding_is_noise(sensor: Sensor) -> bool:
    """Whether the read noise is large against the quantisation step, so that rounding is additive."""
    ccd, video = sensor.ccd, sensor.video
    least_e = ccd.read_noise_e.low or float(ccd.read_noise_e)
    return least_e * float(video.conversion_gain_dn_per_e) > LEAST_NOISE_DN


def _together(parts: list[_Noise], mcp_v: float, reference_v: float) -> Observation:
    """Combine quantities of one MCP voltage, so that the blur is computed once."""

    def predict(values: Values) -> Array:
        gain = predicted_quantities.photoelectron_gain(values, mcp_v, reference_v)
        shape = predicted_quantities.noise_shape(values, gain)
        return np.stack(np.broadcast_arrays(*(part.predict(values, gain, shape) for part in parts)), axis=1)

    return Observation(
        name="noise",
        value=np.array([part.value for part in parts]),
        covariance=np.diag([part.sd**2 for part in parts]),
        predict=predict,
        speaks_of=tuple(dict.fromkeys(path for part in parts for path in part.speaks_of)),
    )


def _dark(m: Measurement, dark: StackMean, sensor: Sensor, reference_v: float) -> _Noise:
    """Observe the temporal noise of darks: read noise and EBI; ion feedback enters by its prior range."""
    ions = sensor.microchannel_plate.ion_event_rate_per_s_cm2
    sheet = values_of_description(sensor)
    gain = predicted_quantities.photoelectron_gain(sheet, dark.mcp_v, reference_v)
    usual = float(
        predicted_quantities.ion_variance(sheet, gain, predicted_quantities.blur_factor(sheet, gain), dark.gate_s)[0]
    )
    low, high = (float(ions) if end is None else end for end in (ions.low, ions.high))
    spread = usual * (high - low) / (4.0 * float(ions)) if float(ions) > 0 else 0.0
    variance = (m.value or 0.0) ** 2

    def predict(values: Values, gain: Array, shape: tuple[Array, Array]) -> Array:
        own = predicted_quantities.dark_variance(values, gain, shape[0], dark.gate_s)
        return own + predicted_quantities.ion_variance(values, gain, shape[0], dark.gate_s)

    return _Noise(
        mcp_v=dark.mcp_v,
        value=variance,
        sd=float(np.hypot.reduce([2.0 * (m.value or 0.0) * sd_of(m), NOISE_MODEL_SD * variance, spread])),
        predict=predict,
        speaks_of=("ccd.read_noise_e", "photocathode.ebi_lm_per_cm2", *NOISE),
    )


def _flat_volts(session: Session, reference_v: float) -> float:
    """Return the MCP voltage with most flats."""
    known = [entry.conditions.mcp_v for entry in session.of_kind("flat") if entry.conditions.mcp_v]
    # Of several voltages, the one with most flats is the session's.
    return float(max(dict.fromkeys(known), key=known.count)) if known else reference_v


def _volts_of(m: Measurement, session: Session, volts: float) -> float:
    """Return the MCP voltage of a measurement's stack."""
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    return float(entry.conditions.mcp_v) if entry is not None and entry.conditions.mcp_v else volts


def observations(
    session: Session, sensor: Sensor, result: Result, levels: tuple[StackMean, ...]
) -> tuple[Observation, ...]:
    """Return the observations in the order MTF, noise, halo, stack means.

    A mildly suspect measurement is used only if there is none with status ok; refused and otherwise flagged ones are
    excluded.
    """
    reference_v = float(sensor.microchannel_plate.reference_v)
    found = mtf_observations(session, sensor, result) + noise_observations(session, sensor, result, levels)
    found += [_halo(m) for m in admissible_measurements(result, "halo_diameter")]
    found += [_halo_share(m) for m in admissible_measurements(result, "halo_fraction")]
    found += [_levels(levels, reference_v)] if levels else []
    return tuple(found)


def _halo(m: Measurement) -> Observation:
    # The halo edge is located on pixels.
    sd = float(np.hypot(sd_of(m), 0.1))
    speaks_of = ("photocathode.gap_mm", "taper.demagnification")
    return one("halo diameter", m.value or 0.0, sd, predicted_quantities.halo_diameter_px, speaks_of)


def _halo_share(m: Measurement) -> Observation:
    speaks_of = ("photocathode.halo_fraction",)
    return one("halo fraction", m.value or 0.0, sd_of(m), lambda values: values[speaks_of[0]], speaks_of)


def _levels(levels: tuple[StackMean, ...], reference_v: float) -> Observation:
    """Observe stack means: black level plus gain times photoelectrons; the clamp removes dark charge."""
    lux, gate_s, mcp_v = (
        np.array([getattr(level, name) for level in levels]) for name in ("illuminance_lux", "gate_s", "mcp_v")
    )
    mean = np.array([level.mean_dn for level in levels])
    own = np.array([level.sd_dn for level in levels])

    def predict(values: Values) -> Array:
        one = {path: value[:, None] for path, value in values.items()}
        events = (
            predicted_quantities.photoelectrons(one, lux, gate_s) + predicted_quantities.background_rate(one) * gate_s
        )
        gain = predicted_quantities.photoelectron_gain(one, mcp_v, reference_v)
        load = predicted_quantities.mcp_load(one, lux, gate_s, mcp_v, reference_v)
        return one["video.black_level_dn"] + gain * events / (1.0 + load)

    # With little noise the mean is attracted to whole numbers.
    leaning = np.array([0.1 if level.noise_dn < LEAST_NOISE_DN else 0.0 for level in levels])
    variance = own**2 + 0.03**2 + (0.003 * mean) ** 2 + leaning**2
    extra = ("microchannel_plate.gain_exponent",) if len(set(mcp_v.tolist())) > 1 else ()
    return Observation(
        name="levels", value=mean, covariance=np.diag(variance), predict=predict, speaks_of=(*LEVEL, *extra)
    )
