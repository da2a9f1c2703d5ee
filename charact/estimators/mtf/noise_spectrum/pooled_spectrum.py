"""Noise spectrum of flats over the whole band: power, dark part and number of independent modes.

Only temporal noise counts: each pixel's mean over the exposures of its rows and each exposure's
mean are subtracted, separately for the fields of interlaced frames.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.noise_spectrum.thresholds import ACCURACY, THRESHOLDS
from charact.estimators.noise.gain.series import (
    CLIPPED_SHARE,
    dark_shares,
    longest_series,
    read_levels,
    series_of,
)
from charact.frames.rounding import QUANTISATION_DN2, variance_range_before_rounding
from charact.frames.spectrum import Bins, bins_of
from charact.frames.stack_statistics import StackStatistics
from charact.frames.temporal import n_effective_samples, same_row_lags
from charact.method import Context
from labdata import Array, BadInput, Session, open_lazy_stack


def frequency_cells(rows: int, cols: int, row_pitch: float) -> Bins:
    """Return the cells of frequency of an image with a row pitch of `row_pitch` column pitches,
    without the axes.

    Raises BadInput if fewer than 24 cells contain enough modes.
    """
    plain = bins_of(rows, cols, row_pitch)
    along = np.arange(cols // 2 + 1)[None, :]
    down = np.abs(np.round(np.fft.fftfreq(rows) * rows))[:, None]
    across, up = (
        int(np.clip(n // (2 * ACCURACY.modes_per_cell), 1, ACCURACY.max_cells))
        for n in (cols, rows)
    )
    cell = np.minimum(2 * along * across // cols, across - 1).astype(np.int64) * up
    cell = cell + np.minimum(2 * down * up // rows, up - 1).astype(np.int64)
    cell[(along <= ACCURACY.axis_modes) | (down <= ACCURACY.axis_modes) | (2 * along == cols)] = -1
    cells, position, modes = np.unique(cell, return_inverse=True, return_counts=True)
    position = position.reshape(cell.shape)
    full = (cells >= 0) & (modes >= ACCURACY.min_modes)
    if full.sum() < 24:
        raise BadInput(
            f"images must have some 48 x 48 pixels an exposure for a noise spectrum, got {rows} x "
            f"{cols}"
        )
    column, row = (
        np.broadcast_to(f, cell.shape).ravel() for f in (along / cols, down / rows / row_pitch)
    )
    mean = [np.bincount(position.ravel(), f) / modes for f in (column, row)]
    select = np.where(full, np.cumsum(full) - 1, -1)[position]
    return replace(
        plain,
        column_cy_per_px=mean[0][full],
        row_cy_per_px=mean[1][full],
        modes=modes[full].astype(float),
        select=select,
    )


@dataclass(frozen=True, kw_only=True)
class SelectedFlats:
    """Stacks of the spectrum, read in its cells."""

    # flat, its dark or None, and the signal between them, DN, None without a dark
    pairs: tuple[tuple[StackStatistics, StackStatistics | None, float | None], ...]
    left_out: tuple[str, ...]  # flats at other gains, saturated ones and single frames
    clipped: bool  # whether a chosen stack has values at 0 DN
    flicker: float  # largest relative standard deviation of the frame means of a flat
    digitised: bool  # whether all values are integers


def select_flats(session: Session, context: Context) -> SelectedFlats:
    """Read the flats, and choose those of one gain inside the linear range, each with the dark of
    its conditions.
    """
    darks, flats, single = read_levels(session, context=context, spectra=frequency_cells)
    if darks:
        series = series_of(flats, darks, single)
        every = zip(
            series.flats, series.darks, series.signal_dn.tolist(), series.fitted, strict=True
        )
        pairs = tuple((flat, dark, signal) for flat, dark, signal, fitted in every if fitted)
    else:
        pairs = tuple(
            (flat, None, None)
            for flat in longest_series(flats)
            if flat.high_fraction <= CLIPPED_SHARE
        )
    flats_in_range = [flat for flat, _, _ in pairs]
    labels = {flat.label for flat in flats_in_range}
    stacks = labels | {dark.label for _, dark, _ in pairs if dark is not None}
    return SelectedFlats(
        pairs=pairs,
        left_out=(*(flat.label for flat in flats if flat.label not in labels), *single),
        clipped=any(flat.low_fraction > CLIPPED_SHARE for flat in flats_in_range),
        flicker=max(
            (
                float(np.std(flat.frame_mean_dn) / max(flat.mean_dn, 1e-9))
                for flat in flats_in_range
            ),
            default=0.0,
        ),
        digitised=all(
            np.issubdtype(open_lazy_stack(session.stack(label)).dtype, np.integer)
            for label in stacks
        ),
    )


@dataclass(frozen=True, kw_only=True)
class FlatSpectrum:
    """One flat above its dark; names as in `PooledSpectrum`."""

    label: str
    power_dn2: Array
    power_sd_dn2: Array
    signal_dn: float | None
    quantisation_noise_dn2: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PooledSpectrum:
    """Mean noise spectrum of the flats of one gain, and that of their darks."""

    bins: Bins
    power_dn2: Array  # power of the flats, shape (cell,)
    dark_dn2: Array  # the part of it in the darks, shape (cell,); 0 without darks
    looks: Array  # independent modes of independent exposures, shape (cell,)
    looks_lagged: Array  # the same of exposures correlated by `lag`
    pitch_ratio: float  # row pitch of the frame, column pitches
    lag: Array  # correlation of exposures 1, 2, ... apart; empty if none is detected
    lag_open: bool  # whether it extends beyond the last lag
    levels: tuple[FlatSpectrum, ...]
    # Smallest and largest white power of the flats above their darks without light: by
    # quantisation, and by noise that quantisation hides in the dark; pooled.
    quantisation_noise_dn2: tuple[float, float]
    frames: int  # fewest frames of a flat
    signal_dn: float | None  # mean signal of the flats, weighted as their power; None without darks

    @property
    def column_cy_per_px(self) -> Array:
        """Mean frequency of each cell along rows, cycles per column pitch, shape (cell,)."""
        return self.bins.column_cy_per_px

    @property
    def row_cy_per_px(self) -> Array:
        """Mean frequency of each cell along columns, cycles per column pitch, shape (cell,)."""
        return self.bins.row_cy_per_px

    @property
    def shorter_px(self) -> float:
        """Shorter side of the image, column pitches."""
        rows, cols = self.bins.window.shape
        return float(min(rows * self.bins.row_pitch, cols))

    @property
    def modes(self) -> tuple[Array, Array, NDArray[np.int64]]:
        """Frequencies along rows and columns, and cell, of all modes inside a cell, shape
        (mode,).
        """
        (rows, cols), select = self.bins.window.shape, self.bins.select
        column = np.broadcast_to(np.fft.rfftfreq(cols)[None, :], select.shape)
        row = np.broadcast_to(
            np.abs(np.fft.fftfreq(rows))[:, None] / self.bins.row_pitch, select.shape
        )
        return (
            column[select >= 0].astype(float),
            row[select >= 0].astype(float),
            select[select >= 0],
        )


def spectrum_of(chosen: SelectedFlats, context: Context) -> PooledSpectrum:
    """Pool the spectra of the chosen stacks, weighted near those of least variance."""
    flats = [flat for flat, _, _ in chosen.pairs]
    lag, still_open = _lag(flats)
    # A flat's signal over the square of its power, times its exposures.
    mean = [
        max(float(flat.few_lags.power_dn2[:, 0].mean()), ACCURACY.min_power_dn2) for flat in flats
    ]
    gain = np.array(
        [
            m if signal is None else signal
            for m, (_, _, signal) in zip(mean, chosen.pairs, strict=True)
        ]
    )
    weight = np.array([flat.runs * len(flat.time) for flat in flats]) * gain / np.array(mean) ** 2
    weight /= weight @ gain
    has_signal = all(signal is not None for *_, signal in chosen.pairs)
    darks = dark_shares((dark for _, dark, _ in chosen.pairs), weight)
    parts = [(float(flat_weight), flat) for flat_weight, flat in zip(weight, flats, strict=True)]
    power = np.sum([flat_weight * _power(flat, lag) for flat_weight, flat in parts], axis=0)
    dark_power = np.sum(
        [np.zeros_like(power), *(dark_weight * _power(dark, lag) for dark, dark_weight in darks)],
        axis=0,
    )
    bins = flats[0].bins

    def looks(correlation: Array) -> Array:
        every = [
            (flat_weight, flat, _independent(flat, correlation)) for flat_weight, flat in parts
        ]
        every += [(dark_weight, dark, _independent(dark, lag[:0])) for dark, dark_weight in darks]
        square = sum(
            (stack_weight * _power(stack, lag)) ** 2 / number
            for stack_weight, stack, number in every
        )
        return power**2 / square * (bins.modes * bins.efficiency)

    ranges = [_quantisation_noise_dn2(dark, dark_weight) for dark, dark_weight in darks]
    low, high = np.sum(ranges, axis=0) if ranges else 2 * (float(weight.sum()) * QUANTISATION_DN2,)
    return PooledSpectrum(
        bins=bins,
        power_dn2=power,
        dark_dn2=dark_power,
        looks=looks(lag[:0]),
        looks_lagged=looks(lag),
        pitch_ratio=context.pitch_ratio,
        lag=lag,
        lag_open=still_open,
        levels=tuple(
            _flat_spectrum(*pair, lag, digitised=chosen.digitised) for pair in chosen.pairs
        ),
        quantisation_noise_dn2=(float(low), float(high)) if chosen.digitised else (0.0, 0.0),
        frames=min(flat.frames for flat in flats),
        signal_dn=1.0 / float(weight.sum()) if has_signal else None,
    )


def _power(stack: StackStatistics, lag: Array) -> Array:
    """Return the power of each cell, with all lags if image lag is detected, DN^2."""
    return (stack.many_lags if len(lag) else stack.few_lags).power_dn2[:, 0]


def _independent(stack: StackStatistics, lag: Array) -> float:
    """Return the number of independent exposures for a correlation in time."""
    row_lags = (
        same_row_lags(stack.many_lags.lags, stack.parity) if len(lag) else np.zeros(1, np.int64)
    )
    return stack.runs * n_effective_samples(
        stack.time, stack.parity, row_lags, lag, within_parity=True
    )


def _quantisation_noise_dn2(dark: StackStatistics, dark_weight: float) -> tuple[float, float]:
    """Return the range of noise that rounding hides in a dark, times its share.

    A few pulses in the dark have most of the variance, but not of the pixels; the remaining noise
    is that at the frequencies beyond their blur.
    """
    power = dark.few_lags.power_dn2[:, 0]
    mean_dn2 = float(np.average(power, weights=dark.bins.modes))
    hidden = [
        noise + QUANTISATION_DN2 - variance
        for variance in (mean_dn2, float(np.quantile(power, ACCURACY.white_quantile)))
        for noise in variance_range_before_rounding(variance)
    ]
    return dark_weight * min(hidden), dark_weight * max(hidden)


def _lag(flats: list[StackStatistics]) -> tuple[Array, bool]:
    """Return the correlation in time, empty if not detected, and whether it extends beyond the last
    lag.
    """
    count = min(len(flat.many_lags.lags) for flat in flats)
    if count < 2:
        return np.empty(0), False
    value, square = np.zeros(count - 1), np.zeros(count - 1)
    low = [_low_frequency_weights(flat.bins) for flat in flats]
    low_powers = [
        weight @ flat.many_lags.power_dn2[:, :count]
        for weight, flat in zip(low, flats, strict=True)
    ]
    total = sum(part[0] for part in low_powers)
    for flat, weight, part in zip(flats, low, low_powers, strict=True):
        modes = flat.bins.efficiency * float(flat.bins.modes[weight > 0].sum()) * flat.runs
        distance = np.abs(flat.time[:, None] - flat.time)
        pairs = np.array([np.sum(distance == lag) / 2.0 for lag in flat.many_lags.lags[1:count]])
        value += part[1:] / total
        square += (part[0] / total) ** 2 / (2.0 * modes * np.maximum(pairs, 1.0))
    sd = 1.2 * np.sqrt(square)
    if not (value[:3] > THRESHOLDS.lag_sd * sd[:3]).any():
        return np.empty(0), False
    lags = flats[0].many_lags.lags[1:count]
    full = np.zeros(int(lags[-1]))
    full[lags - 1] = value
    return full, bool(np.mean(value[-3:]) > max(0.05, THRESHOLDS.lag_sd * float(sd[-3:].mean())))


def _low_frequency_weights(bins: Bins) -> Array:
    """Return the weights of the cells in which the correlation in time is measured."""
    low_band = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px) < ACCURACY.lag_band_cy_per_px
    row = bins.row_cy_per_px * bins.row_pitch
    weight = bins.modes * (low_band & (row < max(ACCURACY.lag_row_band, 1.01 * row.min())))
    return weight / max(weight.sum(), 1.0)


def _flat_spectrum(
    flat: StackStatistics,
    dark: StackStatistics | None,
    signal: float | None,
    lag: Array,
    *,
    digitised: bool,
) -> FlatSpectrum:
    """Return the spectrum of one flat above its dark."""
    modes = flat.bins.modes * flat.bins.efficiency
    power = _power(flat, lag)
    square = power**2 / (modes * _independent(flat, lag))
    if dark is not None:
        dark_power = _power(dark, lag)
        power, square = (
            power - dark_power,
            square + dark_power**2 / (modes * _independent(dark, lag[:0])),
        )
    hidden = _quantisation_noise_dn2(dark, 1.0) if dark is not None and digitised else (0.0, 0.0)
    return FlatSpectrum(
        label=flat.label,
        power_dn2=power,
        power_sd_dn2=np.sqrt(square),
        signal_dn=signal,
        quantisation_noise_dn2=hidden,
    )
