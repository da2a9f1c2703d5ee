"""The mean of every exposure in the order of time: its spectrum, a line of flicker in it and drift."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# A line or a drift is seen where chance would make one as strong in so small a share of steady stacks.
CHANCE = 1e-4


@dataclass(frozen=True, kw_only=True)
class FrameMeans:
    """Means of the exposures of one stack, and what they tell of the light and the electronics.

    Parameters
    ----------
    mean_dn
        Mean of each exposure, fields of interlaced frames one after the other, each parity about its own mean,
        shape (exposure,), DN.
    frequency_cy_per_exposure
        Frequencies above zero, shape (frequency,), cycles per exposure.
    power_dn2
        Share of the variance of the means at each frequency, drift taken away, shape (frequency,), DN^2.
    exposure_period_s
        Time from one exposure to the next, s; None where the stack has no time stamps.
    drift_dn, drift_seen
        Straight line's change from first to last exposure, DN, and whether it is beyond chance.
    line
        Index of the strongest frequency where it stands out beyond chance, else None.
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
        """Root mean square of the line, DN; 0 for none."""
        return 0.0 if self.line is None else float(np.sqrt(self.power_dn2[self.line]))

    @property
    def line_hz(self) -> float | None:
        """Frequency of the line, or of its alias below half of the exposures' rate, Hz."""
        if self.line is None or self.exposure_period_s is None:
            return None
        return float(self.frequency_cy_per_exposure[self.line] / self.exposure_period_s)


def frame_means(field_mean_dn: Array, time_s: NDArray) -> FrameMeans:
    """Look for drift and for a line of flicker in the means of exposures.

    Parameters
    ----------
    field_mean_dn
        Mean of every frame of each field, shape (field, frame), DN, at least four frames.
    time_s
        Time of each frame, shape (frame,), s; empty if unknown.

    Notes
    -----
    The strongest of m powers of white noise holds more than the share g of them all with the probability
    m (1 - g)^(m - 1) (Fisher, Proc. R. Soc. A 125, 54 (1929), first term).
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
    """Change along a straight line from first to last, whether it is beyond chance, and what is left."""
    from scipy.special import fdtrc

    place = np.linspace(-0.5, 0.5, len(series))
    slope = float(place @ series / (place @ place))
    rest = series - slope * place
    free = len(series) - taken - 1
    explained, left = slope**2 * float(place @ place), float(rest @ rest) / free
    if left <= 0:
        return slope, slope != 0, rest
    return slope, bool(fdtrc(1, free, explained / left) < CHANCE), rest


def _line(power: Array) -> int | None:
    """Index of a power that no chance makes stand out so."""
    if power.sum() <= 0:
        return None
    strongest = int(np.argmax(power))
    share = float(power[strongest] / power.sum())
    return strongest if len(power) * (1.0 - share) ** (len(power) - 1) < CHANCE else None
