"""Admissible measurements, stack means and observations of the fit."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.fit.predicted_quantities import Values
from labdata.measurement import Measurement, Result
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]
SPREAD = (
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
GAIN = (
    "photocathode.luminous_sensitivity_ua_per_lm",
    "tube.luminous_gain",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "video.conversion_gain_dn_per_e",
)
NOISE = (*GAIN, "microchannel_plate.detection_probability", "microchannel_plate.pulse_height_shape")
SHAPE = (*SPREAD, *NOISE, "tube.post_gain_share")
LEVEL = (
    *GAIN,
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.strip_current_ua_per_cm2",
    "video.black_level_dn",
    "taper.demagnification",
)
# Flags that add no bias; any other flag excludes a measurement from the fit.
MILD = {"defects", "drift", "flicker", "gradient", "low-signal", "not-converged", "prior-bound", "too-few-frames"}


def is_admissible(m: Measurement) -> bool:
    """Whether a measurement is ok, or suspect only for reasons that add no bias."""
    return m.status != "refused" and m.interval68 is not None and set(m.flags) <= MILD


def admissible_measurements(result: Result, quantity: str, unit: str | None = None) -> list[Measurement]:
    """Return the measurements of a quantity with status ok, or the mildly suspect ones where there are none."""
    found = [m for m in result.find(quantity) if is_admissible(m) and unit in (None, m.unit)]
    return [m for m in found if m.status == "ok"] or found


def sd_of(m: Measurement) -> float:
    """Return half the 68 % interval: the standard deviation of a Gaussian one."""
    low, high = m.interval68 or (float("nan"), float("nan"))
    return (high - low) / (2.0 * 0.994458)


Predict = Callable[[Values], Array]


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Measured numbers with Gaussian errors and their predicted values."""

    name: str  # name of the quantity, for messages
    value: Array  # measured numbers, shape (k,)
    covariance: Array  # covariance of their errors, model error included, shape (k, k)
    predict: Predict  # predictions for parameter draws: values of shape (n,) each -> (n, k)
    speaks_of: tuple[str, ...]  # paths of the sensor parameters that it depends on

    def chi_squared(self, values: Values) -> Array:
        """Return each draw's chi squared, shape (n,)."""
        away = (self.predict(values) - self.value) @ self._whitening
        return np.sum(away**2, axis=1)

    def scale_errors(self, factor: float) -> "Observation":
        """Return the same numbers with all errors larger by a factor."""
        return replace(self, covariance=self.covariance * factor**2)

    @cached_property
    def _whitening(self) -> Array:
        """Root of the inverse covariance: residuals times it are independent and of unit variance."""
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)).T, np.float64)


def one(
    name: str, value: float, sd: float, predict: Callable[[Values], Array], speaks_of: tuple[str, ...]
) -> Observation:
    """Return an observation of one number; its prediction has shape (n,)."""
    return Observation(
        name=name,
        value=np.array([value]),
        covariance=np.array([[sd**2]]),
        predict=lambda values: predict(values)[:, None],
        speaks_of=speaks_of,
    )


def curve_observation(
    name: str,
    value: Array,
    sd: Array,
    frequency: Array,
    predict: Callable[[Values], Array],
    speaks_of: tuple[str, ...],
    *,
    correlation_length: float,
    model_sd: float,
) -> Observation:
    """Return an observation of a curve with errors correlated over a frequency range.

    Covariance sd_i sd_j exp(-|f_i - f_j|/L) + model_sd^2 on the diagonal: closely spaced points add little information.
    """
    apart = np.abs(frequency[:, None] - frequency[None, :])
    covariance = np.outer(sd, sd) * np.exp(-apart / correlation_length) + model_sd**2 * np.eye(value.size)
    return Observation(name=name, value=value, covariance=covariance, predict=predict, speaks_of=speaks_of)


@dataclass(frozen=True, kw_only=True)
class StackMean:
    """Mean of one stack."""

    label: str  # label of the stack
    mean_dn: float  # mean over frames and pixels, DN
    sd_dn: float  # its standard error, from the scatter of the frames' means, DN
    noise_dn: float  # robust noise of a pixel, DN: half the range of the central 68 %
    # illuminance_lux, gate_s, exposure_s, mcp_v: conditions; a dark has no illuminance
    illuminance_lux: float
    gate_s: float
    exposure_s: float
    mcp_v: float


def levels_of(session: Session) -> tuple[StackMean, ...]:
    """Return the means of the session's darks and flats within the linear range."""
    found = (_level(session, entry) for entry in session.of_kind("dark", "flat"))
    return tuple(level for level in found if level is not None)


def _level(session: Session, entry: StackEntry) -> StackMean | None:
    conditions = entry.conditions
    illuminance = 0.0 if entry.kind == "dark" else conditions.illuminance_lux
    if illuminance is None or session.sensor is None:
        return None
    stack = entry.read()
    top = stack.full_scale_dn or float(2**session.sensor.video.bit_depth - 1)
    means = stack.data.mean(axis=(1, 2), dtype=np.float64)
    if np.mean(stack.data >= top) > 1e-3 or means.mean() > 0.85 * top:
        return None
    scatter = float(means.std(ddof=1)) / np.sqrt(len(means)) if len(means) > 1 else float(stack.data.std()) / 10.0
    field_s = 1.0 / float(session.sensor.video.field_rate_hz)
    exposure_s = conditions.exposure_s or field_s
    gate_s = exposure_s if conditions.gate_ns is None else min(conditions.gate_ns * 1e-9, exposure_s)
    reference_v = float(session.sensor.microchannel_plate.reference_v)
    return StackMean(
        label=entry.label,
        mean_dn=float(means.mean()),
        sd_dn=scatter,
        noise_dn=_noise_dn(stack.data[0]),
        illuminance_lux=float(illuminance),
        gate_s=float(gate_s),
        exposure_s=float(exposure_s),
        mcp_v=float(conditions.mcp_v or reference_v),
    )


def _noise_dn(frame: NDArray) -> float:
    """Return half the width of the central 68 % of the grey values, sub-DN where one value dominates."""
    codes, counts = np.unique(frame, return_counts=True)
    share = float(counts.max()) / frame.size
    if share < 0.38 or len(codes) < 2:
        low, high = np.quantile(frame, (0.16, 0.84))
        return float(high - low) / 2.0
    from scipy.special import erfinv

    return float(0.5 / (np.sqrt(2.0) * erfinv(min(share, 1.0 - 1e-9))))
