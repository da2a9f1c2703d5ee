"""Which of a session's measurements the fit uses, each tied to the formula that predicts it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fit import forward
from charact.fit.forward import Values
from charact.fit.levels import Level
from charact.fit.observed import Observed, curve, one
from charact.fit.prior import fixed_values
from labdata.measurement import Curve, Measurement, Result
from labdata.session import Session

Array = NDArray[np.float64]

_SPREAD = (
    "optics.aberration_blur_um",
    "photocathode.gap_mm",
    "photocathode.halo_fraction",
    "photocathode.halo_elastic_share",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "taper.demagnification",
    "taper.interface_mtf_lp_per_mm",
    "video.bandwidth_mhz",
)
_GAIN = (
    "photocathode.luminous_sensitivity_ua_per_lm",
    "tube.luminous_gain",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "video.conversion_gain_dn_per_e",
)
_NOISE = (*_GAIN, "microchannel_plate.detection_probability", "microchannel_plate.pulse_height_shape")
_LEVEL = (
    *_GAIN,
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.strip_current_ua_per_cm2",
    "video.black_level_dn",
    "taper.demagnification",
)

# What the chain's formulas leave out of an MTF, and points nearer than the correlation length are hardly independent.
MTF_MODEL_SD = 0.004
MTF_CORRELATION_CY_PER_PX = 0.08
MTF_SPACING_CY_PER_PX = 0.04
HIGHEST_CY_PER_PX = 0.45
LEAST_MTF = 0.03
# Relative errors of the formulas for the noise (sampling of the chip's rows, lag) and the levels (uneven tube).
NOISE_MODEL_SD = 0.01
LEVEL_MODEL_SD = 0.003
LEVEL_MODEL_SD_DN = 0.03


def observations(session: Session, result: Result, levels: tuple[Level, ...]) -> tuple[Observed, ...]:
    """Return what the fit compares its model with, in the order curves, points of curves, noise, halo, levels.

    A measurement that is suspect is used only where no sound one of its kind is there; a refused one never.
    """
    reference_v = _reference_v(session)
    found = [_curve(name, line, session, result) for name, line in _trusted_curves(result)]
    found += [_bars(m, session) for m in _of_bars(session, result)]
    found += _noises(session, result, levels, reference_v)
    found += [
        one("halo_diameter", m.value or 0.0, _sd(m), forward.halo_diameter_px, ("photocathode.gap_mm",))
        for m in _trusted(result, "halo_diameter")
    ]
    found += [_levels(levels, reference_v)] if levels else []
    return tuple(found)


def _trusted(result: Result, quantity: str, unit: str | None = None) -> list[Measurement]:
    """Return the sound measurements of a quantity, or the suspect ones where there is no sound one."""
    carrying = [m for m in result.find(quantity) if m.status != "refused" and m.interval68 and unit in (None, m.unit)]
    sound = [m for m in carrying if m.status == "ok"]
    return sound or carrying


def _of_bars(session: Session, result: Result) -> list[Measurement]:
    """Return what bar targets told of the MTF; pinned points of an edge's curve are in the curve already."""
    bars = {entry.label for entry in session.of_kind("bars")}
    return [m for m in _trusted(result, "mtf") if m.stack in bars and m.frequency_cy_per_px]


def _sd(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (np.nan, np.nan)
    return (high - low) / (2.0 * 0.994458)


def _trusted_curves(result: Result) -> list[tuple[str, Curve]]:
    """Return the MTF curves whose own MTF50 is sound, or all that have intervals where none is."""
    curves = [(n, c) for n, c in result.curves.items() if n.split(":")[0] in ("mtf", "mtf_vertical")]
    curves = [(n, c) for n, c in curves if c.interval68 is not None]
    sound_stacks = {m.stack for m in result.find("mtf50", status="ok")}
    sound = [(n, c) for n, c in curves if _stack_of(n, c) in sound_stacks]
    return sound or curves


def _stack_of(name: str, line: Curve) -> str | None:
    return line.stack or (name.split(":", 1)[1] if ":" in name else None)


def _curve(name: str, line: Curve, session: Session, result: Result) -> Observed:
    """Tie an MTF curve to the model at frequencies far enough apart."""
    wanted = np.arange(MTF_SPACING_CY_PER_PX, HIGHEST_CY_PER_PX + 1e-9, MTF_SPACING_CY_PER_PX)
    frequency = np.asarray(line.frequency_cy_per_px, float)
    low, high = np.asarray(line.interval68, float)
    value = np.interp(wanted, frequency, line.value)
    sd = np.interp(wanted, frequency, (high - low) / (2.0 * 0.994458))
    used = (wanted >= frequency[0]) & (wanted <= frequency[-1]) & (value > LEAST_MTF)
    angle_deg = _angle_deg(name, line, session, result)
    fx, fy = _components(wanted[used], angle_deg, session)
    return curve(
        name, value[used], sd[used], wanted[used], lambda values: forward.mtf(values, fx, fy), _SPREAD,
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


def _components(frequency: Array, angle_deg: float, session: Session) -> tuple[Array, Array]:
    """Split frequencies in cy per column pitch: along rows in the same, along columns in cy per row pitch."""
    assert session.sensor is not None
    pitch_ratio = float(session.sensor.ccd.pitch_y_um) / float(session.sensor.ccd.pitch_x_um)
    angle = np.deg2rad(angle_deg)
    return frequency * abs(np.cos(angle)), frequency * abs(np.sin(angle)) * pitch_ratio


def _bars(m: Measurement, session: Session) -> Observed:
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    told = m.orientation_deg if m.orientation_deg is not None else entry and entry.target.angle_deg
    fx, fy = _components(np.array([m.frequency_cy_per_px or 0.0]), told or 0.0, session)
    sd = float(np.hypot(_sd(m), MTF_MODEL_SD))
    return one(f"mtf of {m.stack}", m.value or 0.0, sd, lambda values: forward.mtf(values, fx, fy)[:, 0], _SPREAD)


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """One number of the noise, predicted from values, gain per photoelectron and blur factor."""

    mcp_v: float
    value: float
    sd: float
    predict: Callable[[Values, Array, Array], Array]
    speaks_of: tuple[str, ...] = _NOISE


def _noises(session: Session, result: Result, levels: tuple[Level, ...], reference_v: float) -> list[Observed]:
    """Tie covariance gain, blur factor and the darks' variance, all of one plate voltage at a time."""
    volts = _flat_volts(session, reference_v)
    found = []
    for m in _trusted(result, "covariance_gain", "DN"):
        value = m.value or 0.0
        sd = float(np.hypot(_sd(m), NOISE_MODEL_SD * value))
        found.append(
            _Noise(
                mcp_v=_volts_of(m, session, volts),
                value=value,
                sd=sd,
                predict=lambda values, gain, blur: forward.covariance_gain(values, gain),
            )
        )
    for m in _trusted(result, "blur_factor"):
        value = m.value or 0.0
        sd = float(np.hypot(_sd(m), NOISE_MODEL_SD * value))
        speaks_of = (*_SPREAD, *_NOISE, "tube.post_gain_share")
        found.append(
            _Noise(
                mcp_v=_volts_of(m, session, volts),
                value=value,
                sd=sd,
                predict=lambda values, gain, blur: blur,
                speaks_of=speaks_of,
            )
        )
    darks = [level for level in levels if level.illuminance_lux == 0.0]
    found += [_dark(m, darks[0], session, reference_v) for m in _trusted(result, "read_noise", "DN") if darks]
    return [
        _together([one for one in found if one.mcp_v == mcp_v], mcp_v, reference_v)
        for mcp_v in dict.fromkeys(one.mcp_v for one in found)
    ]


def _together(parts: list[_Noise], mcp_v: float, reference_v: float) -> Observed:
    """Return numbers of one plate voltage as one, for which the blur is computed once."""

    def predict(values: Values) -> Array:
        gain = forward.photoelectron_gain(values, mcp_v, reference_v)
        blur = forward.blur_factor(values, gain)
        return np.stack(np.broadcast_arrays(*(part.predict(values, gain, blur) for part in parts)), axis=1)

    return Observed(
        name="noise",
        value=np.array([part.value for part in parts]),
        covariance=np.diag([part.sd**2 for part in parts]),
        predict=predict,
        speaks_of=tuple(dict.fromkeys(path for part in parts for path in part.speaks_of)),
    )


def _dark(m: Measurement, dark: Level, session: Session, reference_v: float) -> _Noise:
    """Tie the temporal noise of the darks to reading noise and EBI; rare ion pulses are known by their range only."""
    assert session.sensor is not None
    ions = session.sensor.microchannel_plate.ion_event_rate_per_s_cm2
    sheet = fixed_values(session.sensor)
    gain = forward.photoelectron_gain(sheet, dark.mcp_v, reference_v)
    usual = float(forward.ion_variance(sheet, gain, forward.blur_factor(sheet, gain), dark.gate_s)[0])
    low, high = (float(ions) if end is None else end for end in (ions.low, ions.high))
    spread = usual * (high - low) / (4.0 * float(ions)) if float(ions) > 0 else 0.0
    variance = (m.value or 0.0) ** 2

    def predict(values: Values, gain: Array, blur: Array) -> Array:
        own = forward.dark_variance(values, gain, blur, dark.gate_s)
        return own + forward.ion_variance(values, gain, blur, dark.gate_s)

    return _Noise(
        mcp_v=dark.mcp_v,
        value=variance,
        sd=float(np.hypot.reduce([2.0 * (m.value or 0.0) * _sd(m), NOISE_MODEL_SD * variance, spread])),
        predict=predict,
        speaks_of=("ccd.read_noise_e", "photocathode.ebi_lm_per_cm2", *_NOISE),
    )


def _levels(levels: tuple[Level, ...], reference_v: float) -> Observed:
    """Tie mean levels to black level and gain times photoelectrons; the clamp takes dark charge away."""
    lux, gate_s, mcp_v = (
        np.array([getattr(level, name) for level in levels]) for name in ("illuminance_lux", "gate_s", "mcp_v")
    )
    mean = np.array([level.mean_dn for level in levels])
    own = np.array([level.sd_dn for level in levels])

    def predict(values: Values) -> Array:
        one = {path: value[:, None] for path, value in values.items()}
        events = forward.photoelectrons(one, lux, gate_s) + forward.background_rate(one) * gate_s
        gain = forward.photoelectron_gain(one, mcp_v, reference_v)
        load = forward.load(one, lux, gate_s, mcp_v, reference_v)
        return one["video.black_level_dn"] + gain * events / (1.0 + load)

    variance = own**2 + LEVEL_MODEL_SD_DN**2 + (LEVEL_MODEL_SD * mean) ** 2
    extra = ("microchannel_plate.gain_exponent",) if len(set(mcp_v.tolist())) > 1 else ()
    return Observed(
        name="levels", value=mean, covariance=np.diag(variance), predict=predict, speaks_of=(*_LEVEL, *extra)
    )


def _reference_v(session: Session) -> float:
    assert session.sensor is not None
    return float(session.sensor.microchannel_plate.reference_v)


def _flat_volts(session: Session, reference_v: float) -> float:
    known = [entry.conditions.mcp_v for entry in session.of_kind("flat") if entry.conditions.mcp_v]
    return float(np.median(known)) if known else reference_v


def _volts_of(m: Measurement, session: Session, volts: float) -> float:
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    return float(entry.conditions.mcp_v) if entry is not None and entry.conditions.mcp_v else volts
