"""What lowers a variance without showing in it: noise shared by neighbours, and light shared by successive exposures.

Either makes the variance over signal read low. A test that could see an effect of 2 % finds it or leaves the gain
alone; a weaker one leaves what it cannot exclude in the gain's interval.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.series import FlatSeries

Array = NDArray[np.float64]

# An effect on the gain is seen where it is beyond this and so many standard errors.
LEAST_EFFECT = 0.01
SIGNIFICANT = 3.0
# An effect that may be smaller than this and still unseen harms nothing.
HARMLESS = 0.02
# Where a test cannot exclude this much, it is no test.
BLIND = 0.1
# Largest share of the covariance sum that lies with neighbours in a chip: each of four gets 5 % of the charge.
MOST = 0.4
# Flats of fewer frames have too few pairs of frames to set near ones against far ones.
FEW_FRAMES = 3
# Levels of such unequal certainty tell no law.
WORST_CONDITION = 1e12


@dataclass(frozen=True, kw_only=True)
class UndetectedEffect:
    """A share of the gain that goes missing.

    Parameters
    ----------
    share, sd
        The share and its standard error, dimensionless; infinite where nothing could be compared.
    """

    share: float
    sd: float

    @property
    def seen(self) -> bool:
        """Whether it is there beyond its noise and large enough to move a number."""
        return abs(self.share) > LEAST_EFFECT + SIGNIFICANT * self.sd

    @property
    def is_untestable(self) -> bool:
        """Whether even a large effect would go unseen."""
        return not SIGNIFICANT * self.sd < BLIND

    @property
    def allowance(self) -> float:
        """Relative standard deviation that the effect adds to the gain: none where 2 % would have been seen."""
        if LEAST_EFFECT + SIGNIFICANT * self.sd <= HARMLESS:
            return 0.0
        return float(np.hypot(min(abs(self.share), BLIND), min(self.sd, BLIND)))

    @property
    def expected(self) -> float:
        """Root mean square of the effect where none at all is as likely beforehand as any up to `MOST`."""
        if not self.sd > 0:
            return min(abs(self.share), BLIND)
        none = np.exp(-0.5 * (self.share / self.sd) ** 2) * MOST / (self.sd * np.sqrt(2.0 * np.pi))
        return float(np.sqrt(np.hypot(min(abs(self.share), BLIND), min(self.sd, BLIND)) ** 2 / (1.0 + none)))


def allowance_of(neighbours: UndetectedEffect, exposures: UndetectedEffect, *, tube: bool) -> float:
    """Return the relative standard deviation that what is hidden adds to the gain.

    A screen glows on and a tube blurs: what a test cannot exclude is allowed for. Most chips do neither.
    """
    parts = [one.allowance if tube else one.expected for one in (neighbours, exposures)]
    return float(np.hypot(parts[0], parts[1]))


def spatially_correlated_fraction(series: FlatSeries) -> UndetectedEffect:
    """Return the share of the light's covariance sum that lies with the eight neighbours of a pixel.

    Noise of whole rows and columns that the dark holds as well cancels. Separable blur is taken for granted: a diagonal
    neighbour shares the product of both correlations.
    """
    chosen = np.flatnonzero(series.fitted & (series.variance_dn2 > 0))
    beside, beside_sd = inverse_variance_mean([light_correlation(series, int(i), "neighbour") for i in chosen])
    below, below_sd = inverse_variance_mean([light_correlation(series, int(i), "below") for i in chosen])
    return UndetectedEffect(
        share=2.0 * (beside + below + 2.0 * beside * below), sd=2.0 * float(np.hypot(beside_sd, below_sd))
    )


def light_correlation(series: FlatSeries, index: int, name: str) -> tuple[float, float]:
    """Return the correlation of neighbours in what the light adds to the noise of the dark, and its standard error."""
    flat, dark = series.flats[index], series.darks[index]
    variance = series.variance_dn2[index]
    covariance, sd = (
        [getattr(level, f"{name}_{what}") * level.variance_dn2 for level in (flat, dark)]
        for what in ("correlation", "sd")
    )
    return float((covariance[0] - covariance[1]) / variance), float(np.hypot(*sd) / variance)


def temporally_correlated_fraction(series: FlatSeries) -> UndetectedEffect:
    """Return the share of the variance that successive exposures hold in common, earlier and later ones.

    Near pairs of frames are set against far ones. With three frames and fewer, the covariance of different frames is
    set against the signal instead: what unequal pixels put there goes with the square of the signal, and what the
    light of earlier frames puts there with the signal itself.
    """
    levels = [flat for flat, fitted in zip(series.flats, series.fitted, strict=True) if fitted]
    known = [(level.successor_correlation, level.successor_sd) for level in levels]
    value, sd = inverse_variance_mean(known)
    most = max(level.frames for level in levels)
    # Memory itself takes two correlations from the variance, earlier and later; the mean of few frames takes more.
    taken = 2.0 + 2.0 / most
    near = UndetectedEffect(share=taken * value, sd=taken * sd)
    if most > FEW_FRAMES:
        return near
    common = _common_variance_fraction(series, taken)
    return common if near.is_untestable or (common.seen and not near.seen) else near


def inverse_variance_mean(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    """Return the weighted mean of values of finite standard error, and its own; infinite for none."""
    known = np.array([pair for pair in pairs if np.isfinite(pair[1])])
    if not len(known):
        return 0.0, np.inf
    weight = 1.0 / np.maximum(known[:, 1], 1e-9) ** 2
    return float(weight @ known[:, 0] / weight.sum()), float(1.0 / np.sqrt(weight.sum()))


def _common_variance_fraction(series: FlatSeries, taken: float) -> UndetectedEffect:
    """Linear part of the covariance of different frames over that of the temporal variance."""
    chosen = np.flatnonzero(series.fitted)
    signal = series.signal_dn[chosen]
    if len(np.unique(np.round(np.log(signal) / 0.05))) < 3:
        return UndetectedEffect(share=0.0, sd=np.inf)
    common = np.array([series.flats[i].spatial_variance_dn2 - series.darks[i].spatial_variance_dn2 for i in chosen])
    sd = np.array([np.hypot(series.flats[i].spatial_sd_dn2, series.darks[i].spatial_sd_dn2) for i in chosen])
    weight = 1.0 / np.maximum(sd, 1e-12) ** 2
    design = np.stack([signal, signal**2 / signal.max()])
    curvature = design * weight @ design.T
    if np.linalg.cond(curvature) > WORST_CONDITION:
        return UndetectedEffect(share=0.0, sd=np.inf)
    covariance = np.linalg.inv(curvature)
    linear, square = covariance @ (design * weight @ common)
    rest = common - linear * design[0] - square * design[1]
    excess = float(weight @ rest**2) / max(1, len(chosen) - 2)
    slope = float(series.variance_dn2[chosen] @ signal / (signal @ signal))
    # The pattern of unequal pixels may be alike in the dark and in the light: a linear part that is no lag.
    error = np.sqrt(max(1.0, excess) * covariance[0, 0])
    return UndetectedEffect(share=taken * linear / slope, sd=taken * float(error) / abs(slope))
