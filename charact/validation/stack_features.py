"""Numbers that frames of darks and flats are compared by: levels, noise in space and time, fixed
pattern, defects.
"""

import itertools
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Frames = NDArray[np.floating]
# Lags (row, col) whose correlation is compared, and the range of the summed covariance, px.
LAGS = ((0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0), (1, 1))
REACH = 6
# Squared distance from the centre over that of a corner, below and above which noise is that of the
# centre and of the corners: each some fifth of the picture.
CENTRE_SQUARE, CORNER_SQUARE = 0.12, 0.58
# Shares of the values whose mean describes a tail of the temporal noise.
TAILS = (0.001, 0.01, 0.1)
# Lowest bits of a value whose share of ones is compared.
BITS = 8
# Edges of the bands of a noise spectrum, cy/px; the last ends in the corner.
BANDS = (0.0, 0.05, 0.2, 0.35, 0.5, 0.71)
# Standard deviations of a pixel that is no noise, in time.
EVENT_SD = (5.0, 10.0)
# Number of highest values whose mean is compared: of events in a stack, of pixels, and of spots.
HIGHEST_EVENTS, HIGHEST_PIXELS, HIGHEST_SPOTS = 30, 8, 10
# Standard deviations of the two Gaussians whose difference shows a spot, px: shadows of dust are
# some 10 px wide.
SPOT_PX = (3.0, 9.0)


class StackView:
    """A stack of frames, split into its mean frame and what changes from frame to frame.

    `mean`: mean frame, shape (row, col); `steady`: mean frame of the middle half of each pixel's
    values, in which pulses of single frames leave no trace; `change`: frames less the mean frame,
    scaled so that their variance is that of a frame, shape (frame, row, col); `interlaced`: whether
    odd rows were exposed at another time than even ones; `bits`: fraction of ones in the lowest
    bits of whole DN, shape (bit,).
    """

    def __init__(self, label: str, frames: NDArray, *, interlaced: bool = False) -> None:
        self.label = label
        self.interlaced = interlaced
        data = np.asarray(frames, np.float32)
        count = len(data)
        self.mean = data.mean(axis=0)
        self.steady = np.sort(data, axis=0)[count // 4 : count - count // 4].mean(axis=0)
        codes = np.rint(frames[0]).astype(np.int64)
        self.bits = np.array([np.mean(codes >> bit & 1) for bit in range(BITS)])
        self.change = (data - self.mean) * np.float32(np.sqrt(count / (count - 1.0)))
        self.covariance = _autocovariance(self.change)
        self.power = self.spectrum(self.change)
        # A plane and a bowl are shading, not pattern.
        self.shading, self.pattern = _without_shading(self.mean)

    @property
    def level(self) -> float:
        """Mean, DN."""
        return float(self.mean.mean())

    @property
    def variance(self) -> float:
        """Variance of a pixel in time, DN^2."""
        # Frames that repeat each other have none.
        return max(float(self.covariance[REACH, REACH]), 1e-12)

    @cached_property
    def ordered(self) -> Frames:
        """Changes in ascending order, shape (frame * row * col,)."""
        return np.sort(self.change, axis=None)

    @property
    def robust_sd(self) -> float:
        """Half the range of the central 68 % of changes, DN; the step of whole numbers where it is
        0.
        """
        low, high = self.ordered[[int(fraction * self.ordered.size) for fraction in (0.159, 0.841)]]
        return max(float(high - low) / 2.0, 0.3)

    @cached_property
    def line_variances(self) -> Mapping[str, float]:
        """Variance in time of the means of rows and columns less those of their frames, DN^2."""
        lines = {"rows": self.change.mean(axis=2), "columns": self.change.mean(axis=1)}
        return {
            name: float((line - line.mean(axis=1, keepdims=True)).var())
            for name, line in lines.items()
        }

    @staticmethod
    def spectrum(images: Frames) -> Array:
        """Return the mean power of images per pixel, 1 for white noise of variance 1, shape (row,
        col / 2 + 1).
        """
        rows, cols = images.shape[-2:]
        power = np.abs(np.fft.rfft2(images)) ** 2 / (rows * cols)
        return power.reshape(-1, *power.shape[-2:]).mean(axis=0)


def level_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return the level of the dark, DN, and the logarithm of the brightest flat's signal above
    it.
    """
    flat = flats[-1]
    return {
        f"level of {dark.label}, DN": dark.level,
        f"ln signal of {flat.label}": _log(flat.level - dark.level),
    }


def transfer_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return logarithms of the dark's variance, and of variance over signal of the brightest
    flat.
    """
    flat = flats[-1]
    return {
        f"ln variance of {dark.label}": _log(dark.variance),
        f"ln variance/signal of {flat.label}": _log(_variance_over_signal(flat, dark)),
    }


def linearity_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return signal, and variance over signal, of each dimmer flat over that of the brightest.

    Neither depends on gain or sensitivity where the response is linear.
    """
    *dimmer, brightest = flats
    features = {}
    for dim_flat in dimmer:
        of = f"of {dim_flat.label} over {brightest.label}"
        features[f"signal {of}"] = (dim_flat.level - dark.level) / (brightest.level - dark.level)
        ratio = _variance_over_signal(dim_flat, dark) / _variance_over_signal(brightest, dark)
        features[f"variance/signal {of}"] = ratio
    return features


def field_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return how noise near the corners of the brightest flat differs from that near its centre.

    The correlation of neighbours in time, and the logarithm of variance over signal: a blur that
    grows with the distance from the centre raises the first and lowers the second.
    """
    flat = flats[-1]
    rows, cols = flat.mean.shape
    y, x = (np.linspace(-1.0, 1.0, size) for size in (rows, cols))
    square = (y[:, None] ** 2 + x[None, :] ** 2) / 2.0
    regions = [square < CENTRE_SQUARE, square > CORNER_SQUARE]
    power = np.mean(flat.change**2, axis=0)
    variance = [max(float(power[region].mean()), 1e-12) for region in regions]
    features = {}
    for row, col in ((0, 1), (1, 0)):
        product = np.mean(
            flat.change[:, row:, col:] * flat.change[:, : rows - row, : cols - col], axis=0
        )
        middle, corner = (
            float(product[region[row:, col:]].mean()) / region_variance
            for region, region_variance in zip(regions, variance, strict=True)
        )
        features[
            f"correlation at {row},{col} px near the corners less the centre of {flat.label}"
        ] = corner - middle
    signal = [max(float(flat.mean[region].mean()) - dark.level, 1e-12) for region in regions]
    features[f"ln variance/signal near the corners over the centre of {flat.label}"] = float(
        np.log(variance[1] / signal[1]) - np.log(variance[0] / signal[0])
    )
    return features


def covariance_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return the summed covariance over signal of each flat, DN.

    Of a dim flat the sum may be negative by chance, so that it has no logarithm.
    """
    return {
        f"covariance/signal of {flat.label}, DN": float(
            flat.covariance.sum() - dark.covariance.sum()
        )
        / (flat.level - dark.level)
        for flat in flats
    }


def correlation_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return the correlation of neighbours in the brightest flat, and along rows and columns in the
    dark.
    """
    flat = flats[-1]
    features = {
        f"correlation at {row},{col} px of {flat.label}": float(
            flat.covariance[REACH + row, REACH + col]
        )
        / flat.variance
        for row, col in LAGS
    }
    for row, col in ((0, 1), (1, 0)):
        name = f"correlation at {row},{col} px of {dark.label}"
        features[name] = float(dark.covariance[REACH + row, REACH + col]) / max(
            dark.variance, 1e-12
        )
    return features


def spectrum_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return temporal noise power over its mean in bands of both cuts and over all directions, and
    its peaks.
    """
    features: dict[str, float] = {}
    for stack in (dark, flats[-1]):
        features |= _bands(
            stack.power, np.full_like(stack.power, stack.power.mean()), f"noise of {stack.label}"
        )
    return features


def row_and_column_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return variances in time of means of frames, rows and columns of dark and brightest flat.

    Each is over that of white noise of the same variance. Cube roots of variances, and of powers,
    are nearly Gaussian (Wilson and Hilferty 1931).
    """
    features = {}
    for stack in (dark, flats[-1]):
        _, rows, cols = stack.change.shape
        variances = {"frames": float(stack.change.mean(axis=(1, 2)).var()), **stack.line_variances}
        for (name, value), pixels in zip(variances.items(), (rows * cols, cols, rows), strict=True):
            features[f"variance of means of {name} of {stack.label}"] = _root(
                value * pixels / max(stack.variance, 1e-12)
            )
    return features


def histogram_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return means of the tails of temporal noise over its standard deviation, and shares of ones
    of the low bits.

    Notes
    -----
    The mean of a tail changes smoothly where the values are few whole DN, unlike its quantile. A
    bit that is stuck or left out has no ones or no zeros; bits of more than the noise depend on the
    level.
    """
    features = {}
    for stack in (dark, *flats):
        ordered = stack.ordered / np.float32(np.sqrt(max(stack.variance, 1e-12)))
        for fraction in TAILS:
            size = max(1, round(fraction * ordered.size))
            features[f"mean of the lowest {100.0 * fraction:g} % of {stack.label}"] = float(
                ordered[:size].mean()
            )
            features[f"mean of the highest {100.0 * fraction:g} % of {stack.label}"] = float(
                ordered[-size:].mean()
            )
    flat = flats[-1]
    return features | {
        f"share of ones of bit {bit} of {flat.label}": float(x) for bit, x in enumerate(flat.bits)
    }


def event_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return roots of the number of bright and dark events of the dark, and the height of the
    highest.
    """
    sd = dark.robust_sd
    features = {}
    for limit in EVENT_SD:
        for sign, name in ((1.0, "bright"), (-1.0, "dark")):
            hit = sign * dark.change > limit * sd
            features[f"root of {name} events above {limit:g} sd of {dark.label}"] = float(
                np.sqrt(np.sum(hit) + 0.375)
            )
    features[f"ln height of the highest events of {dark.label}"] = _log(
        _highest(dark.change, HIGHEST_EVENTS) / sd
    )
    return features


def pattern_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return fixed over temporal variance of pixels, rows and columns, and of bands of their
    spectra.

    The fixed part is the mean frame, with its residual temporal noise; over the temporal
    variance, neither gain nor light enters where there is no fixed pattern. The difference of odd
    and even rows, and columns, over the level shows fields or taps of unequal gain.
    """
    features: dict[str, float] = {}
    for stack in (dark, flats[-1]):
        rows, cols = stack.pattern.mean(axis=1), stack.pattern.mean(axis=0)
        fixed = {
            "pixels": (stack.pattern - rows[:, None] - cols).var(),
            "rows": rows.var(),
            "columns": cols.var(),
        }
        temporal = {"pixels": stack.variance, **stack.line_variances}
        for name, variance in fixed.items():
            ratio = float(variance) * len(stack.change) / max(temporal[name], 1e-12)
            features[f"fixed over temporal variance of {name} of {stack.label}"] = _root(ratio)
        for name, line in (("rows", rows), ("columns", cols)):
            features[f"odd less even {name} of {stack.label}"] = (
                float(line[1::2].mean() - line[::2].mean()) / stack.level
            )
        features |= _bands(
            StackView.spectrum(stack.pattern[None]), stack.power, f"fixed pattern of {stack.label}"
        )
    return features


def defect_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return logarithms of the heights and depths of the most deviating pixels and spots, of dark
    and brightest flat.

    Notes
    -----
    Pixels are those of the mean of each pixel's middle values less the median of 5 x 5 pixels,
    spots those of the mean frame behind a difference of Gaussians. The mean of several highest
    values is a smooth number, with a narrow distribution where nothing is defective; a count of
    pixels above a limit is 0 in nearly all sets, and its distribution unknown.
    """
    import cv2

    features = {}
    for stack in (dark, flats[-1]):
        inner, outer = (cv2.GaussianBlur(stack.pattern, (0, 0), size) for size in SPOT_PX)
        pixels, spots = stack.steady - cv2.medianBlur(stack.steady, 5), (inner - outer)[::3, ::3]
        for name, local, count in (
            ("pixels", pixels, HIGHEST_PIXELS),
            ("spots", spots, HIGHEST_SPOTS),
        ):
            for sign, side in ((1.0, "bright"), (-1.0, "dark")):
                # Half a step of whole DN keeps the logarithm smooth where all pixels are equal.
                height = _highest(sign * local, count) + 0.5
                features[f"ln height of the {count} most {side} {name} of {stack.label}, DN"] = (
                    _log(height)
                )
    return features


def shading_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return slopes and curvatures of the mean frames over the picture: of flats over the signal,
    of the dark in DN.
    """
    features = {}
    for stack in (dark, flats[-1]):
        scale = 1.0 if stack is dark else stack.level - dark.level
        for name, value in zip(
            ("slope x", "slope y", "x²", "y²", "xy"), stack.shading, strict=True
        ):
            features[f"{name} of {stack.label}"] = float(value) / scale
    return features


def time_features(dark: StackView, flats: list[StackView]) -> Mapping[str, float]:
    """Return correlations of frames, and of fields of interlaced video, with each other, and
    changes in time.

    Correlations are those of successive ones and the largest of any two, without pulses: a few of
    them would rule.
    """
    features = {}
    for stack in (dark, flats[-1]):
        limit = EVENT_SD[0] * stack.robust_sd
        change = np.clip(stack.change, -limit, limit)
        features |= _correlations(
            change, (1, 2), f"{'dark ' if stack is dark else ''}frames of {stack.label}"
        )
        if stack.interlaced:
            count, rows, cols = change.shape
            fields = change[:, : rows - rows % 2].reshape(count, rows // 2, 2, cols).swapaxes(1, 2)
            features |= _correlations(
                fields.reshape(2 * count, rows // 2, cols), (1,), f"fields of {stack.label}"
            )
        means = stack.change.mean(axis=(1, 2))
        at = np.arange(len(means)) - (len(means) - 1) / 2.0
        features[f"drift of {stack.label}, DN a frame"] = float(at @ means / (at @ at))
        variances = np.log(np.maximum(change.var(axis=(1, 2)), 1e-12))
        features[f"range of the variances of frames of {stack.label}"] = _root(
            float(np.ptp(variances))
        )
    return features


def _correlations(images: Frames, lags: tuple[int, ...], what: str) -> dict[str, float]:
    """Return the mean correlation of images at lags, and the largest of any two, of images (image,
    row, col).
    """
    flat = images.reshape(len(images), -1)
    gram = flat @ flat.T
    gram = gram / max(float(np.trace(gram)) / len(gram), 1e-12)
    features = {
        f"correlation of {what}, {lag} apart": float(np.diag(gram, lag).mean())
        for lag in lags
        if lag < len(gram)
    }
    return features | {
        f"largest correlation of two {what}": float(gram[np.triu_indices(len(gram), 1)].max())
    }


def _variance_over_signal(flat: StackView, dark: StackView) -> float:
    """Return the variance of a flat above the dark's over its signal, DN."""
    return (flat.variance - dark.variance) / (flat.level - dark.level)


def _highest(values: Frames, count: int) -> float:
    """Return the mean of the highest values."""
    flat = values.ravel()
    return float(np.partition(flat, flat.size - count)[-count:].mean())


def _bands(power: Array, reference: Array, what: str) -> dict[str, float]:
    """Return the power over a reference in bands along both axes and over all directions, and its
    highest peak.
    """
    rows, half = power.shape
    x, y = np.fft.rfftfreq(2 * (half - 1))[:half], np.abs(np.fft.fftfreq(rows))
    cuts = {
        "horizontal": (x, power[0], reference[0]),
        "vertical": (y, power[:, 0], reference[:, 0]),
        "radial": (np.hypot(y[:, None], x), power, reference),
    }
    features = {}
    for name, (frequency, cut_power, other) in cuts.items():
        for low, high in itertools.pairwise(BANDS):
            band = (frequency > low) & (frequency <= high)
            if band.any():
                ratio = float(cut_power[band].mean()) / max(float(other[band].mean()), 1e-12)
                features[f"{name} {what}, {low:g} to {high:g} cy/px"] = _root(ratio)
    highest = float(power.ravel()[1:].max()) / max(float(power.mean()), 1e-12)
    return features | {f"ln peak in the {what}": _log(highest)}


def _without_shading(mean: Frames) -> tuple[Array, Frames]:
    """Return slopes and curvatures of a frame over coordinates -1..1, and the frame without
    them.
    """
    y, x = (np.linspace(-1.0, 1.0, size, dtype=np.float32) for size in mean.shape)
    terms = np.stack(
        np.broadcast_arrays(
            np.float32(1.0),
            x[None, :],
            y[:, None],
            x[None, :] ** 2,
            y[:, None] ** 2,
            x[None, :] * y[:, None],
        )
    ).reshape(6, -1)
    coefficients = np.linalg.solve(
        (terms @ terms.T).astype(float), (terms @ mean.ravel()).astype(float)
    )
    return coefficients[1:], mean - (coefficients.astype(np.float32) @ terms).reshape(mean.shape)


def _autocovariance(change: Frames) -> Array:
    """Return the autocovariance of changes (frame, row, col), averaged over frames and pairs of
    pixels.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2

    count, rows, cols = change.shape
    shape = (next_fast_len(rows + REACH), next_fast_len(cols + REACH))
    spectrum = np.asarray(rfft2(change, s=shape))
    full = np.asarray(irfft2((np.abs(spectrum) ** 2).sum(axis=0), s=shape))
    lags = np.arange(-REACH, REACH + 1)
    return full[np.ix_(lags, lags)] / (np.outer(rows - np.abs(lags), cols - np.abs(lags)) * count)


def _log(value: float) -> float:
    return float(np.log(max(value, 1e-12)))


def _root(value: float) -> float:
    return float(np.cbrt(value))
