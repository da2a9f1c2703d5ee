"""What a camera does to its pictures before they are seen: sharpening, noise reduction, and a gamma curve."""

import numpy as np
from numpy.typing import NDArray

from charact.noise.findings import Finding
from charact.noise.gain.series import FlatSeries
from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.undetected_correlation import FEW_FRAMES, inverse_variance_mean, light_correlation

Array = NDArray[np.float64]

# A share of the noise is seen where it is beyond this and so many standard errors.
LEAST_SHARE = 0.02
SIGNIFICANT = 4.0
# Rings of the spectrum that are compared, cycles per column pitch: blur only ever lowers the outer one.
INNER_CY_PER_PX = (0.0, 0.08)
OUTER_CY_PER_PX = (0.15, 0.25)
LEAST_RISE = 0.1
# Glow of pulses is shared by pixels as well; noise reduction in time leaves pixels alone.
SHARED_IN_SPACE = 0.25
# Change over the levels of how much of the light's noise neighbours share: no blur and no gain makes it larger.
LEAST_CHANGE = 0.05
# Powers of the light that are no straight line, departure from such a power that still is one, and levels needed.
LINEAR_POWER = (0.85, 1.15)
GAMMA_POWER = (0.3, 3.0)
POWER_ERROR = 0.05
LEAST_LEVELS = 4


def processing_findings(series: FlatSeries) -> list[Finding]:
    """Return what the noise of a series tells of filters in the camera."""
    lit = [flat for flat, fitted in zip(series.flats, series.fitted, strict=True) if fitted]
    return [
        *_sharpening_findings(lit),
        *_temporal_filter_findings(series.all_darks),
        *_level_smoothing_findings(series),
    ]


def _sharpening_findings(levels: list[StackStatistics]) -> list[Finding]:
    """Whether noise is stronger in fine detail than in coarse, which no blur can make it."""
    for place, correlations in (
        ("in a row", [(level.neighbour_correlation, level.neighbour_sd) for level in levels]),
        ("in a column", [(level.below_correlation, level.below_sd) for level in levels]),
    ):
        value, sd = inverse_variance_mean(correlations)
        if value < -LEAST_SHARE - SIGNIFICANT * sd:
            word = f"the noise of neighbours {place} is opposed ({100 * value:.2g} %)"
            return [("processed", f"{word}: the camera sharpens its pictures, and the variance reads high")]
    value, sd = inverse_variance_mean([_rise(level) for level in levels])
    if value > LEAST_RISE + SIGNIFICANT * sd:
        word = f"the noise is {100 * value:.2g} % stronger in fine detail than in coarse"
        return [("processed", f"{word}: the camera sharpens its pictures")]
    return []


def _rise(level: StackStatistics) -> tuple[float, float]:
    """Power of the noise in the outer ring over that in the inner one, less one, and its standard error."""
    radius = np.hypot(level.bins.column_cy_per_px, level.bins.row_cy_per_px)
    exposures = level.runs * (len(level.time) - len(np.unique(level.parity)))
    power, modes = [], []
    for low, high in (INNER_CY_PER_PX, OUTER_CY_PER_PX):
        ring = (radius >= low) & (radius < high)
        if not ring.any():
            return 0.0, np.inf
        power.append(float(np.average(level.few.power_dn2[ring, 0], weights=level.bins.modes[ring])))
        modes.append(float(level.bins.modes[ring].sum()) * level.bins.efficiency * exposures)
    if min(power) <= 0:
        return 0.0, np.inf
    ratio = power[1] / power[0]
    return ratio - 1.0, ratio * float(np.sqrt(1.0 / modes[0] + 1.0 / modes[1]))


def _temporal_filter_findings(darks: tuple[StackStatistics, ...]) -> list[Finding]:
    """Whether dark frames share noise in time that pixels do not share in space: no light glows on so."""
    known = [dark for dark in darks if dark.frames > FEW_FRAMES]
    value, sd = inverse_variance_mean([(dark.successor_correlation, dark.successor_sd) for dark in known])
    around = [inverse_variance_mean([(d.neighbour_correlation, d.neighbour_sd) for d in known]),
              inverse_variance_mean([(d.below_correlation, d.below_sd) for d in known])]  # fmt: skip
    if value < LEAST_SHARE + SIGNIFICANT * sd or max(part for part, _ in around) > SHARED_IN_SPACE * value:
        return []
    word = f"successive dark frames hold {100 * value:.2g} % of their noise in common, neighbouring pixels none"
    return [("processed", f"{word}: the camera reduces noise in time")]


def _level_smoothing_findings(series: FlatSeries) -> list[Finding]:
    """Whether neighbours share more of the light's noise at one level than at another.

    Blur after the gain, and every filter that treats all pictures alike, spread the noise of each level by one form. A
    filter that spares edges smooths what differs by less than a threshold: weak noise more, strong noise less.
    """
    chosen = np.flatnonzero(series.fitted & (series.variance_dn2 > 0))
    if len(chosen) < 2:
        return []
    span = np.log(series.signal_dn[chosen])
    span = (span - span.min()) / max(float(np.ptp(span)), 1e-12)
    design = np.stack([1.0 - span, span])
    for place, name in (("in a row", "neighbour"), ("in a column", "below")):
        share, sd = np.array([light_correlation(series, int(i), name) for i in chosen]).T
        weight = 1.0 / np.maximum(sd, 1e-9) ** 2
        covariance = np.linalg.pinv(design * weight @ design.T)
        low, high = covariance @ (design * weight @ share)
        error = float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]))
        if abs(high - low) > LEAST_CHANGE + SIGNIFICANT * error:
            word = f"neighbours {place} share {100 * low:.2g} % of the light's noise in the dimmest flat"
            return [("processed", f"{word} and {100 * high:.2g} % in the brightest: the camera smooths some more")]
    return []


def gamma_of_light(light: Array, signal: Array) -> list[Finding]:
    """Whether the signal goes as one power of the light, shapes (level,)."""
    if len(light) < LEAST_LEVELS or signal.min() <= 0:
        return []
    power, off = _power(light, signal)
    straight = LINEAR_POWER[0] < power < LINEAR_POWER[1]
    if straight or not GAMMA_POWER[0] < power < GAMMA_POWER[1] or off > POWER_ERROR:
        return []
    word = f"the signal goes as the power {power:.2f} of the light, to {100 * off:.2g} %"
    return [("gamma", f"{word}: a gamma curve, or a gain that follows the light")]


def gamma_of_noise(signal: Array, gain: Array, sd: Array) -> list[Finding]:
    """Whether variance over signal goes as a power of the signal, shapes (level,).

    The dark's variance stays in it: where a gamma curve begins it is steep, and the dark's noise grows beyond that of
    the flats. Behind v = u^gamma light of variance proportional to u shows a variance proportional to
    u^(2 gamma - 1), which over v goes as the power 1 - 1/gamma of v.
    """
    if len(signal) < LEAST_LEVELS or gain.min() <= 0 or np.any(sd > POWER_ERROR * gain):
        return []
    power, off = _power(signal, gain)
    if power >= 1.0 or off > POWER_ERROR:
        return []
    gamma = 1.0 / (1.0 - power)
    if LINEAR_POWER[0] < gamma < LINEAR_POWER[1]:
        return []
    word = f"variance over signal goes as the power {power:.2f} of the signal, to {100 * off:.2g} %"
    return [("gamma", f"{word}, as behind a gamma of {gamma:.2f}")]


def _power(x: Array, y: Array) -> tuple[float, float]:
    """Exponent of a power law, and the largest relative departure from it."""
    slope, level = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope), float(np.abs(np.expm1(np.log(y) - level - slope * np.log(x))).max())
