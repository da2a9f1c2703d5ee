"""Noise correlated between pixels or exposures, which lowers the variance, and filters in the
camera.

A test sensitive to 2 % either detects the correlation or leaves the gain unchanged; a weaker test
widens the interval of the gain by what it cannot exclude.
"""

from dataclasses import dataclass

import numpy as np

from charact.estimators.noise.findings import finding
from charact.estimators.noise.gain.series import FlatSeries
from charact.estimators.noise.linear_fit import linear_fit, weighted_mean
from charact.estimators.noise.thresholds import CORRELATION
from charact.frames.stack_statistics import StackStatistics
from charact.verdict import Finding
from labdata import Array, open_lazy_stack


@dataclass(frozen=True, kw_only=True)
class UndetectedEffect:
    """Relative loss of gain by a correlation."""

    # fraction, sd: the loss and its standard error, dimensionless; the error is infinite if
    # untestable
    fraction: float
    sd: float

    @property
    def is_detected(self) -> bool:
        """Whether the effect exceeds its noise and matters."""
        return abs(self.fraction) > CORRELATION.min_effect + CORRELATION.significant_sd * self.sd

    @property
    def is_untestable(self) -> bool:
        """Whether even a large effect would not be detected."""
        return not CORRELATION.significant_sd * self.sd < CORRELATION.untestable

    @property
    def allowance(self) -> float:
        """Relative standard deviation that the effect adds to the gain; 0 if 2 % would have been
        detected.
        """
        if CORRELATION.min_effect + CORRELATION.significant_sd * self.sd <= CORRELATION.negligible:
            return 0.0
        return self._largest

    @property
    def posterior_rms(self) -> float:
        """Root mean square of the effect under a prior with equal odds of zero and of a uniform
        distribution up to `CORRELATION.max_fraction`.
        """
        if not self.sd > 0:
            return min(abs(self.fraction), CORRELATION.untestable)
        none = (
            np.exp(-0.5 * (self.fraction / self.sd) ** 2)
            * CORRELATION.max_fraction
            / (self.sd * np.sqrt(2.0 * np.pi))
        )
        return self._largest / float(np.sqrt(1.0 + none))

    @property
    def _largest(self) -> float:
        """Root of the squared effect and its error, each up to that of a void test."""
        sizes = np.minimum([abs(self.fraction), self.sd], CORRELATION.untestable)
        return float(np.hypot(*sizes))


def allowance_of(neighbours: UndetectedEffect, exposures: UndetectedEffect, *, tube: bool) -> float:
    """Return the relative standard deviation that undetected correlations add to the gain.

    Behind a tube, correlations are expected, so everything a test cannot exclude counts. Without
    one the gain is the slope of the variance between frames (EMVA 1288 Release 4, 6.6), whatever
    they have in common; crosstalk of neighbours that is detected has its own finding.
    """
    if tube:
        return float(np.hypot(neighbours.allowance, exposures.allowance))
    return 0.0 if neighbours.is_detected else neighbours.posterior_rms


def spatially_correlated_fraction(series: FlatSeries) -> UndetectedEffect:
    """Return the fraction of the covariance sum that lies between a pixel and its eight neighbours.

    Row and column noise of the dark cancels. Blur is assumed separable: a diagonal correlation is
    the product of both.
    """
    chosen = np.flatnonzero(series.fitted & (series.variance_dn2 > 0))
    right, right_sd = weighted_mean(
        [light_correlation(series, int(i), "neighbour") for i in chosen]
    )
    lower, lower_sd = weighted_mean([light_correlation(series, int(i), "below") for i in chosen])
    return UndetectedEffect(
        fraction=2.0 * (right + lower + 2.0 * right * lower),
        sd=2.0 * float(np.hypot(right_sd, lower_sd)),
    )


def light_correlation(series: FlatSeries, index: int, name: str) -> tuple[float, float]:
    """Return the correlation of neighbours in the noise above the dark's, and its standard
    error.
    """
    flat, dark = series.flats[index], series.darks[index]
    variance = series.variance_dn2[index]
    covariance, sd = (
        [getattr(level, f"{name}_{what}") * level.variance_dn2 for level in (flat, dark)]
        for what in ("correlation", "sd")
    )
    return float((covariance[0] - covariance[1]) / variance), float(np.hypot(*sd) / variance)


def temporally_correlated_fraction(series: FlatSeries) -> UndetectedEffect:
    """Return the fraction of the variance that is correlated with earlier and later exposures.

    Near pairs of frames are compared with far ones. With three frames or fewer, the covariance of
    different frames is fitted against signal: PRNU is quadratic in the signal, image lag linear.
    """
    levels = [flat for flat, fitted in zip(series.flats, series.fitted, strict=True) if fitted]
    known = [(level.successor_correlation, level.successor_sd) for level in levels]
    value, sd = weighted_mean(known)
    longest = max(level.frames for level in levels)
    # Image lag lowers the variance by two correlations, earlier and later; subtracting the mean of
    # few frames by more.
    loss = 2.0 + 2.0 / longest
    successors = UndetectedEffect(fraction=loss * value, sd=loss * sd)
    if longest > CORRELATION.few_frames:
        return successors
    common = _common_variance_fraction(series, loss)
    return (
        common
        if successors.is_untestable or (common.is_detected and not successors.is_detected)
        else successors
    )


def _common_variance_fraction(series: FlatSeries, loss: float) -> UndetectedEffect:
    """Return the linear part of the covariance of different frames over that of the temporal
    variance.
    """
    chosen = np.flatnonzero(series.fitted)
    signal = series.signal_dn[chosen]
    if len(np.unique(np.round(np.log(signal) / 0.05))) < 3:
        return UndetectedEffect(fraction=0.0, sd=np.inf)
    common = np.array(
        [
            series.flats[i].spatial_variance_dn2 - series.darks[i].spatial_variance_dn2
            for i in chosen
        ]
    )
    sd = np.array(
        [np.hypot(series.flats[i].spatial_sd_dn2, series.darks[i].spatial_sd_dn2) for i in chosen]
    )
    columns = [signal, signal**2 / signal.max()]
    if np.linalg.cond(np.stack(columns) / np.maximum(sd, 1e-12)) ** 2 > CORRELATION.max_condition:
        return UndetectedEffect(fraction=0.0, sd=np.inf)
    fit = linear_fit(columns, common, sd)
    slope = float(series.variance_dn2[chosen] @ signal / (signal @ signal))
    # Dark and illuminated patterns may be correlated, which adds a linear part that is no image
    # lag.
    error = fit.stretch(len(chosen)) * float(np.sqrt(fit.covariance[0, 0]))
    return UndetectedEffect(
        fraction=loss * float(fit.best[0]) / slope, sd=loss * error / abs(slope)
    )


def processing_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of filters in the camera, from the noise of a series."""
    lit = [flat for flat, fitted in zip(series.flats, series.fitted, strict=True) if fitted]
    return [
        *_sharpening_findings(lit),
        *_temporal_filter_findings(series.all_darks),
        *_level_smoothing_findings(series),
        *_median_findings(lit),
    ]


def _sharpening_findings(levels: list[StackStatistics]) -> list[Finding]:
    """Return findings of noise that is stronger at high than at low frequency, which blur cannot
    cause.
    """
    for direction, correlations in (
        ("in a row", [(level.neighbour_correlation, level.neighbour_sd) for level in levels]),
        ("in a column", [(level.below_correlation, level.below_sd) for level in levels]),
    ):
        value, sd = weighted_mean(correlations)
        if value < -CORRELATION.min_correlation - CORRELATION.processing_sd * sd:
            word = f"the noise of neighbours {direction} is anticorrelated ({100 * value:.2g} %)"
            sharpens = "the camera sharpens its images, which raises the variance"
            return [finding("processed", f"{word}: {sharpens}")]
    value, sd = weighted_mean([_rise(level) for level in levels])
    if value > CORRELATION.min_rise + CORRELATION.processing_sd * sd:
        word = f"the noise power is {100 * value:.2g} % larger at high than at low frequency"
        return [finding("processed", f"{word}: the camera sharpens its images")]
    return []


def _rise(level: StackStatistics) -> tuple[float, float]:
    """Return the noise power of the outer over the inner band, less one, and its standard error."""
    radius = np.hypot(level.bins.column_cy_per_px, level.bins.row_cy_per_px)
    exposures = level.runs * (len(level.time) - len(np.unique(level.parity)))
    power, modes = [], []
    for low, high in (CORRELATION.inner_cy_per_px, CORRELATION.outer_cy_per_px):
        ring = (radius >= low) & (radius < high)
        if not ring.any():
            return 0.0, np.inf
        power.append(
            float(np.average(level.few_lags.power_dn2[ring, 0], weights=level.bins.modes[ring]))
        )
        modes.append(float(level.bins.modes[ring].sum()) * level.bins.efficiency * exposures)
    if min(power) <= 0:
        return 0.0, np.inf
    ratio = power[1] / power[0]
    return ratio - 1.0, ratio * float(np.sqrt(1.0 / modes[0] + 1.0 / modes[1]))


def _temporal_filter_findings(darks: tuple[StackStatistics, ...]) -> list[Finding]:
    """Return findings of temporal noise reduction: darks correlated in time and not in space."""
    known = [dark for dark in darks if dark.frames > CORRELATION.few_frames]
    value, sd = weighted_mean([(dark.successor_correlation, dark.successor_sd) for dark in known])
    around = [
        weighted_mean([(d.neighbour_correlation, d.neighbour_sd) for d in known]),
        weighted_mean([(d.below_correlation, d.below_sd) for d in known]),
    ]
    if (
        value < CORRELATION.min_correlation + CORRELATION.processing_sd * sd
        or max(part for part, _ in around) > CORRELATION.max_spatial_ratio * value
    ):
        return []
    word = (
        f"noise of successive dark frames is correlated ({100 * value:.2g} %), that of "
        f"neighbouring pixels is not"
    )
    return [finding("processed", f"{word}: the camera reduces noise in time")]


def _level_smoothing_findings(series: FlatSeries) -> list[Finding]:
    """Return findings of a neighbour correlation that changes with level.

    Blur and linear filters correlate the noise of all levels alike; an edge-preserving filter
    smooths weak noise more than strong noise.
    """
    chosen = np.flatnonzero(series.fitted & (series.variance_dn2 > 0))
    if len(chosen) < 2:
        return []
    span = np.log(series.signal_dn[chosen])
    span = (span - span.min()) / max(float(np.ptp(span)), 1e-12)
    for direction, name in (("in a row", "neighbour"), ("in a column", "below")):
        correlation, sd = np.array([light_correlation(series, int(i), name) for i in chosen]).T
        (low, high), covariance, _ = linear_fit(
            [1.0 - span, span], correlation, np.maximum(sd, 1e-9)
        )
        error = float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2.0 * covariance[0, 1]))
        if abs(high - low) > CORRELATION.min_change + CORRELATION.processing_sd * error:
            effect = (
                f"noise of neighbours {direction} is correlated by {100 * low:.2g} % in the "
                f"dimmest flat and by {100 * high:.2g} % in the brightest: the camera smooths "
                "nonlinearly"
            )
            return [finding("processed", effect)]
    return []


# Medians of white normal noise, rows by columns: correlation of neighbours in rows and in columns,
# and covariance sum over that before the filter (SciPy's median of 1200 x 1200 px; errors of .002
# and .05).
MEDIANS = {
    "3 x 3": (0.570, 0.570, 1.29),
    "5 x 5": (0.734, 0.734, 1.33),
    "7 x 7": (0.811, 0.811, 1.40),
    "1 x 3": (0.552, 0.0, 1.17),
    "3 x 1": (0.0, 0.552, 1.17),
    "3 x 3 cross": (0.318, 0.318, 1.19),
}


def _median_findings(levels: list[StackStatistics]) -> list[Finding]:
    """Return the finding of neighbours that are equal more often than their noise explains.

    A median hands the value of one pixel to several, which no linear filter does: the covariance
    sum then is no longer that before the filter. Of noise of standard deviation s the difference of
    two pixels is 0 with a chance proportional to 1/s, as of pixels far apart, whatever the steps.
    """
    level = max(levels, key=lambda level: level.variance_dn2, default=None)
    if level is None or level.entry is None or min(level.size) <= 2 * CORRELATION.far_px:
        return []
    frame = open_lazy_stack(level.entry).frames(0, 1)[0].astype(np.float64)
    excess = []
    for image in (frame, frame.T):
        near = np.diff(image, axis=1)
        far = image[:, CORRELATION.far_px :] - image[:, : -CORRELATION.far_px]
        ratio = float(np.std(far) / max(np.std(near), 1e-12))
        n_equal = np.count_nonzero(near == 0.0), np.count_nonzero(far == 0.0)
        expected = ratio * n_equal[1] / far.size
        sd = float(np.sqrt(n_equal[0] + ratio**2 * n_equal[1] + 1.0)) / far.size
        excess.append(n_equal[0] / near.size - expected - CORRELATION.processing_sd * sd)
    if max(excess) < CORRELATION.min_equal:
        return []
    seen = np.array([level.neighbour_correlation, level.below_correlation])
    known = {
        name: factor
        for name, (*correlations, factor) in MEDIANS.items()
        if np.all(np.abs(seen - correlations) < CORRELATION.median_tolerance)
    }
    name = next((f"a median of {name}" for name in known), "a median, or repeated pixels")
    effect = (
        f"{100.0 * max(excess):.2g} % of the neighbours in {level.label} are equal beyond chance: "
        f"the camera smooths by {name}"
    )
    if known:
        effect += f", of which the covariance sum is {max(known.values()):.3g} times the true one"
    return [finding("processed", effect)]


def gamma_of_light(light: Array, signal: Array) -> list[Finding]:
    """Return the finding of a signal that is a power of the light, shapes (level,)."""
    if len(light) < CORRELATION.min_power_law_levels or signal.min() <= 0:
        return []
    power, off = _power(light, signal)
    is_linear = CORRELATION.linear_exponents[0] < power < CORRELATION.linear_exponents[1]
    if (
        is_linear
        or not CORRELATION.gamma_exponents[0] < power < CORRELATION.gamma_exponents[1]
        or off > CORRELATION.power_law_tolerance
    ):
        return []
    word = (
        f"the signal is proportional to the power {power:.2f} of the light within {100 * off:.2g} %"
    )
    return [finding("gamma", f"{word}: a gamma curve, or a gain that follows the light")]


def gamma_of_noise(signal: Array, gain: Array, sd: Array) -> list[Finding]:
    """Return the finding of variance over signal that is a power of the signal, shapes (level,).

    The dark's variance is included, because a gamma curve is steep at its start and amplifies dark
    noise. For v = u^gamma and a variance of u proportional to u, the variance of v over v is
    proportional to v^(1 - 1/gamma).
    """
    if (
        len(signal) < CORRELATION.min_power_law_levels
        or gain.min() <= 0
        or np.any(sd > CORRELATION.power_law_tolerance * gain)
    ):
        return []
    power, off = _power(signal, gain)
    if power >= 1.0 or off > CORRELATION.power_law_tolerance:
        return []
    gamma = 1.0 / (1.0 - power)
    if CORRELATION.linear_exponents[0] < gamma < CORRELATION.linear_exponents[1]:
        return []
    word = (
        f"variance over signal is proportional to the power {power:.2f} of the signal within "
        f"{100 * off:.2g} %"
    )
    return [finding("gamma", f"{word}, as behind a gamma of {gamma:.2f}")]


def _power(x: Array, y: Array) -> tuple[float, float]:
    """Return the exponent of a power law, and the largest relative deviation from it."""
    slope, level = np.polyfit(np.log(x), np.log(y), 1)
    return float(slope), float(np.abs(np.expm1(np.log(y) - level - slope * np.log(x))).max())
