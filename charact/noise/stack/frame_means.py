"""Means of successive exposures: spectrum, flicker line and drift."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.thresholds import STACK

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FrameMeans:
    """Means of the exposures of one stack.

    Parameters
    ----------
    mean_dn
        Mean of each exposure about the mean of its parity, shape (exposure,), DN.
    frequency_cy_per_exposure
        Frequencies above zero, shape (frequency,), cycles per exposure.
    power_dn2
        Variance of the means at each frequency without drift, shape (frequency,), DN^2.
    exposure_period_s
        Exposure period, s; None without time stamps.
    drift_dn, drift_seen
        Linear change from first to last exposure, DN, and whether it is significant.
    line
        Index of the strongest frequency if significant, else None.
    """

    mean_dn: Array
    frequency_cy_per_exposure: Array
    power_dn2: Array
    exposure_period_s: float | None
    drift_dn: float
    drift_seen: bool
    line: int | None

    @property
    def line_rms_dn(self) -> float:
        """Root mean square of the flicker line, DN; 0 for none."""
        return 0.0 if self.line is None else float(np.sqrt(self.power_dn2[self.line]))

    @property
    def line_hz(self) -> float | None:
        """Frequency of the line, or of its alias below half of the exposure rate, Hz."""
        if self.line is None or self.exposure_period_s is None:
            return None
        return float(self.frequency_cy_per_exposure[self.line] / self.exposure_period_s)


def frame_means(field_mean_dn: Array, time_s: NDArray) -> FrameMeans:
    """Search the means of exposures for drift and a flicker line.

    Parameters
    ----------
    field_mean_dn
        Mean of every frame of each field, shape (field, frame), DN, at least four frames.
    time_s
        Time of each frame, shape (frame,), s; empty if unknown.

    Notes
    -----
    The largest of m powers of white noise exceeds the fraction g of their sum with probability m (1 - g)^(m - 1)
    (Fisher, Proc. R. Soc. A 125, 54 (1929), first term).
    """
    fields = len(field_mean_dn)
    series = (field_mean_dn - field_mean_dn.mean(axis=1, keepdims=True)).T.ravel()
    drift, seen, rest = _drift(series, fields)
    power = 2.0 * np.abs(np.fft.rfft(rest)[1:]) ** 2 / len(rest) ** 2
    if len(rest) % 2 == 0:
        power[-1] /= 2.0
    frequency = np.asarray(np.fft.rfftfreq(len(rest))[1:], np.float64)
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return FrameMeans(mean_dn=series, frequency_cy_per_exposure=frequency, power_dn2=power,
                      exposure_period_s=step / fields if step > 0 else None, drift_dn=drift, drift_seen=seen,
                      line=_line(power))  # fmt: skip


def _drift(series: Array, taken: int) -> tuple[float, bool, Array]:
    """Return the linear change from first to last, whether it is significant, and the residual."""
    from scipy.special import fdtrc

    place = np.linspace(-0.5, 0.5, len(series))
    slope = float(place @ series / (place @ place))
    rest = series - slope * place
    free = len(series) - taken - 1
    explained, left = slope**2 * float(place @ place), float(rest @ rest) / free
    if left <= 0:
        return slope, slope != 0, rest
    return slope, bool(fdtrc(1, free, explained / left) < STACK.false_alarm), rest


def _line(power: Array) -> int | None:
    """Return the index of a significant power."""
    if power.sum() <= 0:
        return None
    strongest = int(np.argmax(power))
    share = float(power[strongest] / power.sum())
    return strongest if len(power) * (1.0 - share) ** (len(power) - 1) < STACK.false_alarm else None
