"""Noise correlated between pixels or exposures, which lowers the variance, and filters in the camera.

A test sensitive to 2 % either detects the correlation or leaves the gain unchanged; a weaker test widens the interval
of the gain by what it cannot exclude.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import FlatSeries
from charact.noise.thresholds import CORRELATION

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class UndetectedEffect:
    """Relative loss of gain by a correlation.

    Parameters
    ----------
    share, sd
        The loss and its standard error, dimensionless; the error is infinite if untestable.
    """

    share: float
    sd: float

    @property
    def seen(self) -> bool:
        """Whether the effect exceeds its noise and matters."""
        return abs(self.share) > CORRELATION.min_effect + CORRELATION.significant_sd * self.sd

    @property
    def is_untestable(self) -> bool:
        """Whether even a large effect would not be detected."""
        return not CORRELATION.significant_sd * self.sd < CORRELATION.untestable

    @property
    def allowance(self) -> float:
        """Relative standard deviation that the effect adds to the gain; 0 if 2 % would have been detected."""
        if CORRELATION.min_effect + CORRELATION.significant_sd * self.sd <= CORRELATION.negligible:
            return 0.0
        return float(np.hypot(min(abs(self.share), CORRELATION.untestable), min(self.sd, CORRELATION.untestable)))

    @property
    def expected(self) -> float:
        """Root mean square of the effect under a prior with equal odds of zero and of a uniform distribution up to
        `CORRELATION.max_fraction`."""
        if not self.sd > 0:
            return min(abs(self.share), CORRELATION.untestable)
        none = np.exp(-0.5 * (self.share / self.sd) ** 2) * CORRELATION.max_fraction / (self.sd * np.sqrt(2.0 * np.pi))
        return float(
            np.sqrt(
                np.hypot(min(abs(self.share), CORRELATION.untestable), min(self.sd, CORRELATION.untestable)) ** 2
                / (1.0 + none)
            )
        )


def allowance_of(neighbours: UndetectedEffect, exposures: UndetectedEffect, *, tube: bool) -> float:
    """Return the relative standard deviation that undetected correlations add to the gain.

    Behind a tube, correlations are expected, so everything a test cannot exclude counts.
    """
    parts = [one.allowance if tube else one.expected for one in (neighbours, exposures)]
    return float(np.hypot(parts[0], parts[1]))


def spatially_correlated_fraction(series: FlatSeries) -> UndetectedEffect:
    """Return the fraction of the covariance sum that lies between a pixel and its eight neighbours.

    Row and column noise of the dark cancels. Blur is assumed separable: a diagonal correlation is the product of both.
    """
    chosen = np.flatnonzero(series.fitted & (series.variance_dn2 > 0))
    beside, beside_sd = inverse_variance_mean([light_correlation(series, int(i), "neighbour") for i in chosen])
    below, below_sd = inverse_variance_mean([light_correlation(series, int(i), "below") for i in chosen])
    return UndetectedEffect(
        share=2.0 * (beside + below + 2.0 * beside * below), sd=2.0 * float(np.hypot(beside_sd, below_sd))
    )


def light_correlation(series: FlatSeries, index: int, name: str) -> tuple[float, float]:
    """Return the correlation of neighbours in the noise above the dark's, and its standard error."""
    flat, dark = series.flats[index], series.darks[index]
    variance = series.variance_dn2[index]
    covariance, sd = (
        [getattr(level, f"{name}_{what}") * level.variance_dn2 for level in (flat, dark)]
        for what in ("correlation", "sd")
    )
    return float((covariance[0] - covariance[1]) / variance), float(np.hypot(*sd) / variance)


def temporally_correlated_fraction(series: FlatSeries) -> UndetectedEffect:
    """Return the fraction of the variance that is correlated with earlier and later exposures.

    Near pairs of frames are compared with far ones. With three frames or fewer, the covariance of different frames is
    fitted against signal: PRNU is quadratic in the signal, image lag linear.
    """
    levels = [flat for flat, fitted in zip(series.flats, series.fitted, strict=True) if fitted]
    known = [(level.successor_correlation, level.successor_sd) for level in levels]
    value, sd = inverse_variance_mean(known)
    most = max(level.frames for level in levels)
    # Image lag lowers the variance by two correlations, earlier and later; subtracting the mean of few frames by more.
    taken = 2.0 + 2.0 / most
    near = UndetectedEffect(share=taken * value, sd=taken * sd)
    if most > CORRELATION.few_frames:
        return near
    common = _common_variance_fraction(series, taken)
    return common if near.is_untestable or (common.seen and not near.seen) else near


def inverse_variance_mean(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the weighted mean of values of finite standard error, and its standard error; infinite without values."""
    known = np.array([pair for pair in pairs if np.isfinite(pair[1])])
    if not len(known):
        return 0.0, np.inf
    weight = 1.0 / np.maximum(known[:, 1], 1e-9) ** 2
    return float(weight @ known[:, 0] / weight.sum()), float(1.0 / np.sqrt(weight.sum()))


def _common_variance_fraction(series: FlatSeries, taken: float) -> UndetectedEffect:
    """Return the linear part of the covariance of different frames over that of the temporal variance."""
    chosen = np.flatnonzero(series.fitted)
    signal = series.signal_dn[chosen]
    if len(np.unique(np.round(np.log(signal) / 0.05))) < 3:
        return UndetectedEffect(share=0.0, sd=np.inf)
    common = np.array([series.flats[i].spatial_variance_dn2 - series.darks[i].spatial_variance_dn2 for i in chosen])
    sd = np.array([np.hypot(series.flats[i].spatial_sd_dn2, series.darks[i].spatial_sd_dn2) for i in chosen])
    weight = 1.0 / np.maximum(sd, 1e-12) ** 2
    design = np.stack([signal, signal**2 / signal.max()])
    curvature = design * weight @ design.T
    if np.linalg.cond(curvature) > CORRELATION.max_condition:
        return UndetectedEffect(share=0.0, sd=np.inf)
    covariance = np.linalg.inv(curvature)
    linear, square = covariance @ (design * weight @ common)
    rest = common - linear * design[0] - square * design[1]
    excess = float(weight @ rest**2) / max(1, len(chosen) - 2)
    slope = float(series.variance_dn2[chosen] @ signal / (signal @ signal))
    # Dark and illuminated patterns may be correlated, which adds a linear part that is no image lag.
    error = np.sqrt(max(1.0, excess) * covariance[0, 0])
    return UndetectedEffect(share=taken * linear / slope, sd=taken * float(error) / abs(slope))
