"""What flats and darks told of the noise, tied to the camera model."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fit import predicted_quantities
from charact.fit.admissible_measurements import NOISE, SHAPE, admissible_measurements, sd_of
from charact.fit.levels import StackMean
from charact.fit.observed import Observation
from charact.fit.predicted_quantities import Values
from charact.fit.prior import values_of_description
from labdata.measurement import Measurement, Result
from labdata.sensor import Sensor
from labdata.session import Session

Array = NDArray[np.float64]

# Errors of the formulas, relative and of a correlation: sampling of the chip's rows, lag.
NOISE_MODEL_SD = 0.01
CORRELATION_MODEL_SD = 0.004
# Noise of this many DN is rounded like a continuous number.
LEAST_NOISE_DN = 0.5


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """One number of the noise, predicted from values, gain per photoelectron and (blur factor, correlation)."""

    mcp_v: float
    value: float
    sd: float
    predict: Callable[[Values, Array, tuple[Array, Array]], Array]
    speaks_of: tuple[str, ...] = NOISE


def noise_observations(
    session: Session, sensor: Sensor, result: Result, levels: tuple[StackMean, ...]
) -> list[Observation]:
    """Tie covariance gain, blur factor and the darks' variance, all of one plate voltage at a time."""
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
    """Tie the correlation of neighbours in a row, in the brightest flat that neither clips nor saturates."""
    told = result.evidence.get("autocorrelation", {})
    transfer = result.evidence.get("photon-transfer", {})
    mean = dict(zip(transfer.get("label", ()), transfer.get("signal_dn", ()), strict=True))
    fitted = dict(zip(transfer.get("label", ()), transfer.get("fitted", ()), strict=True))
    rows = zip(told.get("label", ()), told.get("neighbour_correlation", ()), told.get("neighbour_sd", ()), strict=True)
    usable = [(mean[label], value, sd) for label, value, sd in rows if fitted.get(label)]
    return [
        _Noise(
            mcp_v=volts,
            value=value,
            sd=float(np.hypot(sd, CORRELATION_MODEL_SD)),
            predict=lambda values, gain, shape: shape[1],
            speaks_of=SHAPE,
        )
        for _, value, sd in sorted(usable)[-1:]
    ]


def _rounding_is_noise(sensor: Sensor) -> bool:
    """Whether the electronics' noise is wide against the digitiser's steps, so that rounding just adds to it."""
    ccd, video = sensor.ccd, sensor.video
    least_e = ccd.read_noise_e.low or float(ccd.read_noise_e)
    return least_e * float(video.conversion_gain_dn_per_e) > LEAST_NOISE_DN


def _together(parts: list[_Noise], mcp_v: float, reference_v: float) -> Observation:
    """Return numbers of one plate voltage as one, for which the blur is computed once."""

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
    """Tie the temporal noise of the darks to reading noise and EBI; rare ion pulses are known by their range only."""
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
    known = [entry.conditions.mcp_v for entry in session.of_kind("flat") if entry.conditions.mcp_v]
    # Of several voltages the session's own gain is that of the one with most flats.
    return float(max(dict.fromkeys(known), key=known.count)) if known else reference_v


def _volts_of(m: Measurement, session: Session, volts: float) -> float:
    entry = next((entry for entry in session.stacks if entry.label == m.stack), None)
    return float(entry.conditions.mcp_v) if entry is not None and entry.conditions.mcp_v else volts
