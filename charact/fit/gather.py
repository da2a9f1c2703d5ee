"""Which of a session's measurements the fit uses, each tied to the formula that predicts it."""

import numpy as np
from numpy.typing import NDArray

from charact.fit import forward
from charact.fit.forward import Values
from charact.fit.levels import Level
from charact.fit.observed import Observed, curve, one
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
    volts = _flat_volts(session, reference_v)
    found = [_curve(name, line, session, result) for name, line in _trusted_curves(result)]
    found += [_bars(m, session) for m in _trusted(result, "mtf") if m.frequency_cy_per_px]
    found += [_noise(m, session, volts, reference_v) for m in _trusted(result, "covariance_gain", "DN")]
    found += [_blur(m, session, volts, reference_v) for m in _trusted(result, "blur_factor")]
    found += [
        one("halo_diameter", m.value or 0.0, _sd(m), forward.halo_diameter_px, ("photocathode.gap_mm",))
        for m in _trusted(result, "halo_diameter")
    ]
    found += [_dark(m, session, levels, reference_v) for m in _trusted(result, "read_noise", "DN")]
    found += [_level(level, reference_v, len({one.mcp_v for one in levels}) > 1) for level in levels]
    return tuple(found)


def _trusted(result: Result, quantity: str, unit: str | None = None) -> list[Measurement]:
    """Return the sound measurements of a quantity, or the suspect ones where there is no sound one."""
    carrying = [m for m in result.find(quantity) if m.status != "refused" and m.interval68 and unit in (None, m.unit)]
    sound = [m for m in carrying if m.status == "ok"]
    return sound or carrying


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
    """Return frequencies along rows (cy per column pitch) and columns (cy per row pitch) of one in cy per column pitch."""
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


def _noise(m: Measurement, session: Session, volts: float, reference_v: float) -> Observed:
    mcp_v = _volts_of(m, session, volts)

    def predict(values: Values) -> Array:
        return forward.covariance_gain(values, forward.photoelectron_gain(values, mcp_v, reference_v))

    value = m.value or 0.0
    return one("covariance_gain", value, float(np.hypot(_sd(m), NOISE_MODEL_SD * value)), predict, _NOISE)


def _blur(m: Measurement, session: Session, volts: float, reference_v: float) -> Observed:
    mcp_v = _volts_of(m, session, volts)

    def predict(values: Values) -> Array:
        return forward.blur_factor(values, forward.photoelectron_gain(values, mcp_v, reference_v))

    value = m.value or 0.0
    speaks_of = (*_SPREAD, *_NOISE, "tube.post_gain_share")
    return one("blur_factor", value, float(np.hypot(_sd(m), NOISE_MODEL_SD * value)), predict, speaks_of)


def _dark(m: Measurement, session: Session, levels: tuple[Level, ...], reference_v: float) -> Observed:
    """Tie the temporal noise of the darks to reading noise and EBI; rare ion pulses are known by their range only."""
    assert session.sensor is not None
    dark = next(level for level in levels if level.illuminance_lux == 0.0)
    ions = session.sensor.parameters()["microchannel_plate.ion_event_rate_per_s_cm2"]
    sheet = {path: np.array([float(p)]) for path, p in session.sensor.parameters().items()}
    sheet["video.filter_order"] = np.array([float(session.sensor.video.filter_order)])
    usual = float(
        forward.ion_variance(sheet, forward.photoelectron_gain(sheet, dark.mcp_v, reference_v), dark.gate_s)[0]
    )
    spread = usual * ((ions.high or ions.value) - (ions.low or 0.0)) / (4.0 * ions.value) if ions.value else 0.0

    def predict(values: Values) -> Array:
        gain = forward.photoelectron_gain(values, dark.mcp_v, reference_v)
        return forward.dark_variance(values, gain, dark.gate_s) + forward.ion_variance(values, gain, dark.gate_s)

    value = m.value or 0.0
    sd = float(np.hypot(np.hypot(2.0 * value * _sd(m), NOISE_MODEL_SD * value**2), spread))
    speaks_of = ("ccd.read_noise_e", "photocathode.ebi_lm_per_cm2", *_NOISE)
    return one("variance of the darks", value**2, sd, predict, speaks_of)


def _level(level: Level, reference_v: float, several_voltages: bool) -> Observed:
    """Tie a mean level to black level and gain times photoelectrons; the clamp takes dark charge away."""

    def predict(values: Values) -> Array:
        lux = level.illuminance_lux
        events = forward.photoelectrons(values, lux, level.gate_s) + forward.background_rate(values) * level.gate_s
        gain = forward.photoelectron_gain(values, level.mcp_v, reference_v)
        load = forward.load(values, lux, level.gate_s, level.mcp_v, reference_v)
        return values["video.black_level_dn"] + gain * events / (1.0 + load)

    model_sd = np.hypot(LEVEL_MODEL_SD_DN, LEVEL_MODEL_SD * level.mean_dn)
    extra = ("microchannel_plate.gain_exponent",) if several_voltages else ()
    speaks_of = (*_LEVEL, *extra)
    return one(f"level of {level.label}", level.mean_dn, float(np.hypot(level.sd_dn, model_sd)), predict, speaks_of)


def _reference_v(session: Session) -> float:
    assert session.sensor is not None
    return float(session.sensor.microchannel_plate.reference_v)


def _flat_volts(session: Session, reference_v: float) -> float:
    known = [entry.conditions.mcp_v for entry in session.of_kind("flat") if entry.conditions.mcp_v]
    return float(np.median(known)) if known else reference_v


def _volts_of(m: Measurement, session: Session, volts: float) -> float:
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    return float(entry.conditions.mcp_v) if entry is not None and entry.conditions.mcp_v else volts
