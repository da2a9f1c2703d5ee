"""Observations of the successive frames of a tube's flats: image lag, line noise, PRNU parted from
coarser patterns.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.fitting import predicted_quantities as predicted
from charact.fitting.predicted_quantities import LINE_NOISE
from charact.fitting.prior import rounds_its_darks
from charact.fitting.stack_levels import SessionStacks
from charact.fitting.thresholds import FRAMES, PATTERN
from charact.fitting.tube_frames import block_means, frames_of
from charact.fitting.tube_light import field_products
from charact.frames.image_lag import DECAY
from charact.observables import Case, Estimates, Observable, Values, observable
from charact.observables.fixed_pattern import PRNU_FRACTION
from charact.observables.stack_level import StackLevel
from labdata import Array, Camera

EVENT = ("tube.post_gain_share", "tube.mtf_frequency_lp_per_mm", "tube.mtf_exponent")


@dataclass(frozen=True, kw_only=True)
class Fields:
    """Frames of a steady scene as deviations from the mean of each pixel and each field, and their
    conditions.
    """

    deviation: NDArray[np.float32]  # shape (frame, row, col), DN
    fields_per_frame: int
    signal_dn: float  # mean level above black, DN
    gate_s: float
    mcp_v: float

    @property
    def setting(self) -> tuple[int, float, float]:
        """Number of frames, gate and MCP voltage."""
        return len(self.deviation), self.gate_s, self.mcp_v

    @property
    def lags(self) -> range:
        """Lags whose correlation is observed, frames, and 0."""
        return range(min(FRAMES.largest_lag, len(self.deviation) // 2) + 1)


def fields_of(level: StackLevel, camera: Camera, black_dn: float) -> Fields | None:
    """Return the deviations of a stack's successive frames, or None where `frames_of` has none."""
    data = frames_of(level)
    if data is None:
        return None
    for parity in range(camera.fields):
        field = data[:, parity :: camera.fields]
        field -= field.mean(axis=(1, 2), keepdims=True, dtype=np.float64).astype(np.float32)
    data -= data.mean(axis=0)
    return Fields(
        deviation=data,
        fields_per_frame=camera.fields,
        signal_dn=level.mean_dn - black_dn,
        gate_s=level.gate_s,
        mcp_v=level.mcp_v,
    )


def _noisy(stacks: SessionStacks) -> list[StackLevel]:
    """Return the flats in which rounding adds noise of its own, the brightest first."""
    return [flat for flat in stacks.brightest if flat.noise_dn > FRAMES.least_noise_dn]


def weighted_mean(parts: list[tuple[float, float]]) -> Estimates:
    """Return the weighted mean of values with their variances."""
    value, variance = np.array(parts).T
    weight = 1.0 / variance
    return Estimates.of_number(
        float(np.sum(weight * value) / weight.sum()), float(weight.sum() ** -0.5)
    )


@observable
class LineNoise(Observable[None]):
    """Variance of an offset common to a line, DN^2, from all stacks with enough noise together."""

    name = "line noise"
    order = 70
    tube = True
    depends = moved_by = (LINE_NOISE,)

    def cases(self, stacks: SessionStacks) -> Iterator[Case[None]]:
        """Yield the weighted mean of all stacks."""
        # Rounding multiplies the offset of a line where the noise of its pixels is small.
        darks = () if rounds_its_darks(stacks.camera) else stacks.all_darks
        known = LINE_NOISE in stacks.camera.parameters()
        parts = [
            measure_line_variance(fields)
            for level in ((*_noisy(stacks), *darks) if known else ())
            if (fields := fields_of(level, stacks.camera, stacks.black_dn))
        ]
        if parts:
            yield Case(estimates=weighted_mean(parts), of=None)

    def number(self, values: Values, shown: None) -> Array:
        return predicted.line_variance(values)


@observable
class ImageLag(Observable[Fields]):
    """Correlations of frames of flats of one setting: they hardly depend on the signal."""

    name = "image lag"
    order = 71
    model_sd = FRAMES.correlation_model_sd
    tube = True
    moved_by = DECAY
    depends = (*DECAY, *EVENT)

    def cases(self, stacks: SessionStacks) -> Iterator[Case[Fields]]:
        """Yield the mean correlations of the brightest flats of the setting of the brightest, at
        their mean signal.
        """
        known = [
            fields
            for level in _noisy(stacks)[: FRAMES.most_flats]
            if (fields := fields_of(level, stacks.camera, stacks.black_dn)) is not None
        ]
        flats = [flat for flat in known if flat.setting == known[0].setting]
        if flats:
            correlations, errors = zip(*map(measure_correlations, flats), strict=True)
            signal_dn = float(np.mean([flat.signal_dn for flat in flats]))
            yield Case(
                estimates=Estimates(
                    value=np.mean(correlations, axis=0),
                    covariance=np.sum(errors, axis=0) / len(flats) ** 2,
                ),
                of=replace(flats[0], signal_dn=signal_dn),
            )

    def predict(self, values: Values, shown: Fields) -> Array:
        """Return the correlations, shape (n, k), dimensionless.

        Pulses of the signal s have, j fields apart, the covariance s k F^2 B c_j with the blur
        factor B and the products c_j of `field_products`; what the detector adds, s K sum w^2 and
        the noise of the dark, is of one field alone. The deviations from the means of n frames have
        the covariance P C P, P = 1 - 1/n.
        """
        count, step = len(shown.deviation), shown.fields_per_frame
        gain = predicted.photoelectron_gain(values, shown.mcp_v)
        event = gain * predicted.excess_noise_factor(values)
        shape = predicted.pulse_covariance(values, ((0.0, 0.0), (0.0, 0.5)))
        decay = field_products(values, shown.gate_s, step * count)
        pulses = (shown.signal_dn * event)[:, None] * decay
        same = pulses[:, ::step] * shape[:, :1]
        same[:, 0] += predicted.detector_variance(values, shown.signal_dn)
        expected = same @ diagonal_means(count, tuple(shown.lags), 0).T
        if step > 1:
            later = pulses[:, 1::2] * shape[:, 1:]
            # Of neighbours in time one is a frame later in half of the pairs.
            next_field = diagonal_means(count, (0, -1), 1).mean(axis=0)
            expected = np.concatenate([expected, later @ next_field[:, None]], axis=1)
        return expected[:, 1:] / expected[:, :1]


@observable
class WhitePattern(Observable[None]):
    """Relative variance of the pattern of the brightest flats that is white from row to row: PRNU,
    and a residue of the borders of multi-fibres.
    """

    name = "PRNU"
    order = 77
    tube = True
    depends = (PRNU_FRACTION,)
    relative_model_sd = PATTERN.pattern_sd

    def cases(self, stacks: SessionStacks) -> Iterator[Case[None]]:
        """Yield the weighted mean of the flats, unless their noise hides the pattern."""
        camera = stacks.camera
        parts = [
            white_pattern(data, flat.mean_dn - stacks.black_dn, camera.fields)
            for flat in stacks.brightest[: FRAMES.most_flats]
            if (data := frames_of(flat)) is not None and len(data) >= PATTERN.least_frames
        ]
        if not parts:
            return
        mean, sd = weighted_mean(parts).number
        borders = PATTERN.border_residue * float(camera.taper.pattern_contrast) ** 2
        estimates = Estimates.of_number(mean, float(np.hypot(sd, borders)))
        variance = estimates.covariance + self.model_covariance(estimates, None)
        high = camera.parameters()[PRNU_FRACTION].high
        if high is not None and variance.item() < high**4:
            yield Case(estimates=estimates, of=None)

    def number(self, values: Values, shown: None) -> Array:
        """Return the variance behind the video filter, shape (n,)."""
        return values[PRNU_FRACTION] ** 2 * predicted.filter_covariance(values, 1)[:, 0]


def measure_correlations(fields: Fields) -> tuple[Array, Array]:
    """Return the correlations of a pixel with itself in later frames and, of interlaced video, with
    the next field.

    The next field's is that of a row with its neighbours of the other field. The covariance of the
    errors is from the scatter over blocks of the image.
    """
    x, count = fields.deviation, len(fields.deviation)
    maps = [
        block_means(np.einsum("frc,frc->rc", x[: count - lag], x[lag:]) / (count - lag))
        for lag in fields.lags
    ]
    if fields.fields_per_frame > 1:
        maps.append(block_means(_next_field(x)))
    table = np.stack(maps)
    mean = table.mean(axis=1)
    ratio = mean[1:] / mean[0]
    departure = (table[1:] - ratio[:, None] * table[0]) / mean[0]
    return ratio, np.cov(departure) / departure.shape[1]


def _next_field(x: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean product of rows with their neighbours of the next field, shape (row, col) of
    a field.
    """
    rows = (x.shape[1] - 1) // 2
    upper, middle, lower = (
        x[:, 0 : 2 * rows : 2],
        x[:, 1 : 2 * rows : 2],
        x[:, 2 : 2 * rows + 1 : 2],
    )
    neighbours = 0.5 * (upper[:, : len(middle[0])] + lower)
    same = np.einsum("frc,frc->rc", neighbours, middle) / len(x)
    # Of the two fields of a frame either may be the first: the neighbour in time correlates more.
    even_first = np.einsum("frc,frc->rc", middle[:-1], neighbours[1:]) / (len(x) - 1)
    odd_first = np.einsum("frc,frc->rc", neighbours[:-1], middle[1:]) / (len(x) - 1)
    return 0.5 * (same + (even_first if even_first.mean() >= odd_first.mean() else odd_first))


@lru_cache(maxsize=16)
def diagonal_means(count: int, diagonals: tuple[int, ...], later: int) -> Array:
    """Return the means of diagonals of P C P for unit covariances at each lag, shape (diagonal,
    count).

    C is that of frames, or where `later` is 1 that of first fields with second ones, 1, 3, 5, ...
    fields apart.
    """
    field = 2 * np.arange(count)
    separation = np.abs(np.subtract.outer(field, field + later))
    project = np.eye(count) - 1.0 / count
    means = []
    for lag in range(count):
        projected = project @ (separation == 2 * lag + later) @ project
        means.append([np.diagonal(projected, offset).mean() for offset in diagonals])
    return np.array(means).T


def measure_line_variance(fields: Fields) -> tuple[float, float]:
    """Return the variance of an offset common to a line and the square of its standard error, DN^2
    and DN^4.

    Half the covariance between distant parts of the difference of a line to the next of its field:
    pulses are shared by neighbouring parts alone, and an offset of a whole field cancels. The error
    is from the scatter over lines and frames.
    """
    x, step = fields.deviation, fields.fields_per_frame
    count, rows, columns = x.shape
    parts = (
        x[:, :, : columns - columns % FRAMES.line_parts]
        .reshape(count, rows, FRAMES.line_parts, -1)
        .mean(axis=3, dtype=np.float64)
    )
    line = parts[:, step:] - parts[:, :-step]
    pair_products = (
        line.sum(axis=2) ** 2
        - np.sum(line**2, axis=2)
        - 2.0 * np.sum(line[:, :, 1:] * line[:, :, :-1], axis=2)
    )
    pairs = FRAMES.line_parts**2 - FRAMES.line_parts - 2 * (FRAMES.line_parts - 1)
    line_variance = pair_products / pairs / 2.0 / (1.0 - 1.0 / count)
    # Differences of overlapping lines are correlated: blocks of lines, every frame on its own.
    groups = np.array_split(line_variance, max(rows // 25, 2), axis=1)
    means = np.concatenate([group.mean(axis=1) for group in groups])
    return float(line_variance.mean()), float(means.var(ddof=1) / means.size)


def white_pattern(data: NDArray[np.float32], signal_dn: float, step: int) -> tuple[float, float]:
    """Return the relative variance of the pattern that is white from row to row, and the square of
    its error.

    `data`: frames of a flat, shape (frame, row, col); `step`: fields of a frame.

    Notes
    -----
    The covariance of the mean frames of two halves is that of the fixed pattern. What the optics
    have blurred is even and smooth over rows, c(y) = c(0) (1 - a y^2): its part of the variance is
    (4 c(1) - c(2))/3, from the covariances one and two rows apart.
    """
    half = (len(data) - min(PATTERN.gap_frames, len(data) // 4)) // 2
    early, late = (_pattern(part, step) for part in (data[:half], data[-half:]))
    middle, rows = slice(2, early.shape[0] - 2), early.shape[0] - 4

    def covariance(row_offset: int) -> Array:
        upper, lower = (
            late[2 + offset : 2 + offset + rows] for offset in (-row_offset, row_offset)
        )
        return early[middle] * (upper + lower) / 2.0

    white = covariance(0) - (4.0 * covariance(1) - covariance(2)) / 3.0
    block_variance = block_means(white) / signal_dn**2
    return float(white.mean()) / signal_dn**2, float(
        block_variance.var(ddof=1) / block_variance.size
    )


def _pattern(frames: NDArray[np.float32], step: int) -> Array:
    """Return the mean frame without the mean of each field."""
    mean = frames.mean(axis=0, dtype=np.float64)
    for parity in range(step):
        mean[parity::step] -= mean[parity::step].mean()
    return mean
