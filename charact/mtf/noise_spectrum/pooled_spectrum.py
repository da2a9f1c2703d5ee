"""The noise of flats as one spectrum over the whole band: its power, its dark part and how well it is known.

Only what changes from exposure to exposure is looked at: each pixel's mean over the exposures of its rows and each
exposure's own level are taken away, fields of interlaced frames apart.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.noise_spectrum.thresholds import ACCURACY, THRESHOLDS
from charact.noise.gain.series import CLIPPED_SHARE, longest_series, read_levels, series_of
from charact.noise.rounding import QUANTISATION_DN2, variance_range_before_rounding
from charact.noise.stack.spectrum import Bins, bins_of, cross_spectra
from charact.noise.stack.temporal import (
    autocovariance,
    exposures,
    fluctuations,
    n_effective_samples,
    runs_of,
    usable_lags,
)
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.session import Session

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class StackSpectra:
    """Spectra of one stack: with exposures taken as independent, and with lags allowed for."""

    bins: Bins
    plain_dn2: Array
    lagged_dn2: Array
    low_dn2: Array
    lags: NDArray[np.int64]
    time: NDArray[np.int64]
    parity: NDArray[np.int64]
    runs: int
    frames: int

    def power(self, lag: Array) -> Array:
        """Return the power of each cell, DN^2, lags allowed for where any are given."""
        return self.lagged_dn2 if len(lag) else self.plain_dn2

    def independent(self, lag: Array) -> float:
        """Return how many independent exposures are behind the power if they are correlated so in time."""
        own = self._same_parity(self.lags) if len(lag) else np.zeros(1, np.int64)
        return self.runs * n_effective_samples(self.time, self.parity, own, lag, within_parity=True)

    def _same_parity(self, lags: NDArray[np.int64]) -> NDArray[np.int64]:
        return lags[lags % 2 == 0] if len(np.unique(self.parity)) > 1 else lags


def stack_spectra(stack: FrameStack, context: Context) -> StackSpectra:
    """Return the spectra of a stack, run by run."""
    plain, lagged, low, weight = [], [], [], []
    runs = runs_of(stack)
    for first, last in runs:
        shots = exposures(stack, first, last, interlaced=context.interlaced)
        change = fluctuations(shots)
        bins = frequency_cells(change.shape[1], change.shape[2], context.pitch_ratio * shots.row_step)
        products = cross_spectra(change, shots.parity, bins)
        lags = usable_lags(shots.time, shots.parity, ACCURACY.max_lag_exposures)
        same = lags[lags % 2 == 0] if context.interlaced else lags
        none = np.zeros(1, np.int64)
        plain.append(autocovariance(products, shots.time, shots.parity, none, within_parity=True)[:, 0])
        lagged.append(autocovariance(products, shots.time, shots.parity, same, within_parity=True)[:, 0])
        pooled = np.tensordot(low_frequency_weights(bins), products, 1)
        low.append(autocovariance(pooled, shots.time, shots.parity, lags))
        weight.append(len(shots.time))
    count = min(len(part) for part in low)
    return StackSpectra(
        bins=bins,
        plain_dn2=np.average(plain, axis=0, weights=weight),
        lagged_dn2=np.average(lagged, axis=0, weights=weight),
        low_dn2=np.average([part[:count] for part in low], axis=0, weights=weight),
        lags=lags[:count],
        time=shots.time,
        parity=shots.parity,
        runs=len(runs),
        frames=len(stack),
    )


def low_frequency_weights(bins: Bins) -> Array:
    """Weights of the cells in which the correlation in time is read."""
    inside = np.hypot(bins.column_cy_per_px, bins.row_cy_per_px) < ACCURACY.lag_band_cy_per_px
    inside &= bins.row_cy_per_px * bins.row_pitch < max(
        ACCURACY.lag_row_band, 1.01 * bins.row_cy_per_px.min() * bins.row_pitch
    )
    weight = bins.modes * inside
    return weight / max(weight.sum(), 1.0)


def frequency_cells(rows: int, cols: int, row_pitch: float) -> Bins:
    """Return the cells of frequency of an image whose rows lie `row_pitch` column pitches apart, axes left out.

    Raises BadInput if fewer than 24 cells hold modes enough.
    """
    plain = bins_of(rows, cols, row_pitch)
    along = np.arange(cols // 2 + 1)[None, :]
    down = np.abs(np.round(np.fft.fftfreq(rows) * rows))[:, None]
    across, up = (int(np.clip(n // (2 * ACCURACY.modes_per_cell), 1, ACCURACY.max_cells)) for n in (cols, rows))
    cell = np.minimum(2 * along * across // cols, across - 1).astype(np.int64) * up
    cell = cell + np.minimum(2 * down * up // rows, up - 1).astype(np.int64)
    cell[(along <= ACCURACY.axis_modes) | (down <= ACCURACY.axis_modes) | (2 * along == cols)] = -1
    kept, position, modes = np.unique(cell, return_inverse=True, return_counts=True)
    position = position.reshape(cell.shape)
    full = (kept >= 0) & (modes >= ACCURACY.min_modes)
    if full.sum() < 24:
        raise BadInput(f"images must have some 48 x 48 pixels an exposure for a noise spectrum, got {rows} x {cols}")
    column, row = (np.broadcast_to(f, cell.shape).ravel() for f in (along / cols, down / rows / row_pitch))
    mean = [np.bincount(position.ravel(), f) / modes for f in (column, row)]
    select = np.where(full, np.cumsum(full) - 1, -1)[position]
    return replace(
        plain, column_cy_per_px=mean[0][full], row_cy_per_px=mean[1][full], modes=modes[full].astype(float),
        select=select,
    )  # fmt: skip


def smear(window: NDArray[np.float32]) -> float:
    """Standard deviation of the kernel |W|^2 that a window convolves a spectrum with, cycles per sample.

    Its second moment is the integral of w'^2 over (2 pi)^2 times that of w^2.
    """
    fine = window.astype(float)
    return float(np.sqrt(np.sum(np.diff(fine) ** 2) / np.sum(fine**2)) / (2.0 * np.pi))


@dataclass(frozen=True, kw_only=True)
class PooledSpectrum:
    """Mean noise spectrum of the flats of one gain, and that of their darks."""

    # column_cy_per_px, row_cy_per_px: mean frequency of each cell along rows and along columns, cycles per column
    # pitch, shape (cell,)
    column_cy_per_px: Array
    row_cy_per_px: Array
    # power_dn2, dark_dn2: power of the flats and the part of it that the dark has too, shape (cell,), DN^2; 0 without
    # darks
    power_dn2: Array
    dark_dn2: Array
    # looks, looks_lagged: independent modes behind the power if exposures are independent, and if they share light as
    # `lag` says
    looks: Array
    looks_lagged: Array
    # mode_column, mode_row, mode_cell: frequency and cell of every mode, shape (mode,)
    mode_column: Array
    mode_row: Array
    mode_cell: NDArray[np.int64]
    # smear_column, smear_row: standard deviation of what fading out the sides does to frequency, cycles per column
    # pitch
    smear_column: float
    smear_row: float
    # row_pitch, pitch_ratio: distance of the rows of one exposure and of the frame, column pitches
    row_pitch: float
    pitch_ratio: float
    lag: Array  # correlation of exposures 1, 2, ... apart; empty where none is seen.
    # lag_open, lag_tested: whether it goes on beyond the last lag, and whether there were frames enough to look for it
    lag_open: bool
    lag_tested: bool
    # what each flat alone says: label, power above its dark's (cell,), signal above its dark's (None: unknown)
    levels: tuple["FlatSpectrum", ...]
    # least and largest white power that the flats have over their darks without light: of the digitiser's steps, and of
    # noise that these hide in the dark; pooled, DN^2
    quantisation_noise_dn2: tuple[float, float]
    frames: int  # least frames of a flat
    shorter_px: float  # shorter side of the image, column pitches


@dataclass(frozen=True, kw_only=True)
class FlatSpectrum:
    """One flat above its dark; names as in `PooledSpectrum`, what is hidden that of this flat alone, DN^2."""

    label: str
    power_dn2: Array
    power_sd_dn2: Array
    signal_dn: float | None
    quantisation_noise_dn2: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class SelectedFlats:
    """Which stacks the spectrum is made of, as labels: pairs of a flat and its dark, and what was left out."""

    # flat, its dark or None, and the signal between them, DN, None without a dark
    pairs: tuple[tuple[str, str | None, float | None], ...]
    left_out: tuple[str, ...]  # flats at other gains, saturated ones and single frames
    clipped: bool  # whether a chosen stack sits at an end of the codes
    flicker: float  # largest relative standard deviation of the frames' means in a flat


def select_flats(session: Session, context: Context) -> SelectedFlats:
    """Choose the flats of one gain inside the linear range, each with the dark of its conditions."""
    darks, flats, single = read_levels(session, context=context, spectra=False)
    if darks:
        series = series_of(flats, darks, single)
        kept = [
            (flat, dark, float(signal))
            for flat, dark, signal, fitted in zip(
                series.flats, series.darks, series.signal_dn, series.fitted, strict=True
            )
            if fitted
        ]
        used = [flat for flat, _, _ in kept]
        pairs = tuple((flat.label, dark.label, signal) for flat, dark, signal in kept)
    else:
        used = [flat for flat in longest_series(flats) if flat.high_fraction <= CLIPPED_SHARE]
        pairs = tuple((flat.label, None, None) for flat in used)
    here = {flat.label for flat in used}
    clipped = any(flat.low_fraction > CLIPPED_SHARE for flat in used)
    flicker = max((float(np.std(flat.frame_mean_dn) / max(flat.mean_dn, 1e-9)) for flat in used), default=0.0)
    return SelectedFlats(
        pairs=pairs,
        left_out=(*(flat.label for flat in flats if flat.label not in here), *single),
        clipped=clipped,
        flicker=flicker,
    )


def spectrum_of(session: Session, chosen: SelectedFlats, context: Context) -> PooledSpectrum:
    """Measure the spectra of the chosen stacks and pool them, brighter flats with more weight.

    Raises BadInput if images are too small to hold enough modes.
    """
    labels = dict.fromkeys(label for flat, dark, _ in chosen.pairs for label in (flat, dark) if label is not None)
    stacks = {label: session.stack(label).read() for label in labels}
    own = {label: stack_spectra(stack, context) for label, stack in stacks.items()}
    bins = next(iter(own.values())).bins
    lag, tested, still_open = _lag([own[flat] for flat, _, _ in chosen.pairs])
    pool = _Pool(own, chosen, lag)
    whole = all(np.issubdtype(stack.data.dtype, np.integer) for stack in stacks.values())
    column, row, cell = _modes_of(bins, next(iter(stacks.values())), context)
    return PooledSpectrum(
        column_cy_per_px=bins.column_cy_per_px,
        row_cy_per_px=bins.row_cy_per_px,
        power_dn2=pool.power_dn2,
        dark_dn2=pool.dark_dn2,
        looks=pool.looks(lag[:0]),
        looks_lagged=pool.looks(lag),
        mode_column=column,
        mode_row=row,
        mode_cell=cell,
        smear_column=smear(bins.window[len(bins.window) // 2]),
        smear_row=smear(bins.window[:, bins.window.shape[1] // 2]) / bins.row_pitch,
        row_pitch=bins.row_pitch,
        pitch_ratio=context.pitch_ratio,
        lag=lag,
        lag_open=still_open,
        lag_tested=tested,
        levels=tuple(
            _flat_spectrum(flat, None if dark is None else own[dark], own[flat], signal, lag, whole=whole)
            for flat, dark, signal in chosen.pairs
        ),
        quantisation_noise_dn2=pool.quantisation_noise_dn2() if whole else (0.0, 0.0),
        frames=min(one.frames for one in pool.flats),
        shorter_px=float(min(bins.window.shape[0] * bins.row_pitch, bins.window.shape[1])),
    )


class _Pool:
    """Flats and their darks, each with its weight in the whole.

    Attributes
    ----------
    flats, weight
        Flats in the order of their pairs, and their weights.
    darks
        Dark and weight by label: that of all flats it is the dark of.
    power_dn2, dark_dn2
        Weighted power of both, shape (cell,), DN^2.
    """

    def __init__(self, own: dict[str, StackSpectra], chosen: SelectedFlats, lag: Array) -> None:
        self.flats = [own[flat] for flat, _, _ in chosen.pairs]
        self.weight = _weights(self.flats, [signal for _, _, signal in chosen.pairs])
        shares: dict[str, float] = {}
        for weight, (_, dark, _) in zip(self.weight, chosen.pairs, strict=True):
            if dark is not None:
                shares[dark] = shares.get(dark, 0.0) + weight
        self.darks = {label: (own[label], share) for label, share in shares.items()}
        self._lag = lag
        parts = zip(self.weight, self.flats, strict=True)
        self.power_dn2 = np.sum([weight * one.power(lag) for weight, one in parts], axis=0)
        none = np.zeros_like(self.power_dn2)
        self.dark_dn2 = sum((share * dark.power(lag) for dark, share in self.darks.values()), none)

    def quantisation_noise_dn2(self) -> tuple[float, float]:
        """Return the range of what whole numbers hide of the darks' noise, as the flats have it, DN^2."""
        if not self.darks:
            return sum(self.weight) * QUANTISATION_DN2, sum(self.weight) * QUANTISATION_DN2
        ranges = np.array([_quantisation_noise_dn2(dark, share) for dark, share in self.darks.values()])
        low, high = ranges.sum(axis=0)
        return float(low), float(high)

    def looks(self, correlation: Array) -> Array:
        """Return the independent modes behind the power, shape (cell,), exposures of flats correlated like this."""
        bins = self.flats[0].bins
        parts = [
            (weight, one, one.independent(correlation)) for weight, one in zip(self.weight, self.flats, strict=True)
        ]
        parts += [(share, dark, dark.independent(self._lag[:0])) for dark, share in self.darks.values()]
        square = sum((weight * one.power(self._lag)) ** 2 / number for weight, one, number in parts)
        return self.power_dn2**2 / square * (bins.modes * bins.efficiency)


def _quantisation_noise_dn2(dark: StackSpectra, share: float) -> tuple[float, float]:
    """Range of what rounding hides of one dark's noise, times its share.

    Few pulses in the dark vary more than all the rest, and tell nothing of how it is rounded between them: the rest is
    what is left at the frequencies that they do not reach.
    """
    whole = float(np.average(dark.plain_dn2, weights=dark.bins.modes))
    rest = float(np.quantile(dark.plain_dn2, ACCURACY.white_quantile))
    hidden = [
        noise + QUANTISATION_DN2 - variance
        for variance in (whole, rest)
        for noise in variance_range_before_rounding(variance)
    ]
    return share * min(hidden), share * max(hidden)


def _modes_of(bins: Bins, stack: FrameStack, context: Context) -> tuple[Array, Array, NDArray[np.int64]]:
    """Frequencies and cells of all modes that are in a cell."""
    rows, cols = len(bins.select), stack.data.shape[2]
    inside = bins.select >= 0
    column: Any = np.broadcast_to(np.fft.rfftfreq(cols)[None, :], bins.select.shape)[inside]
    row: Any = np.broadcast_to(np.abs(np.fft.fftfreq(rows))[:, None] / bins.row_pitch, bins.select.shape)[inside]
    return np.asarray(column, float), np.asarray(row, float), bins.select[inside]


def _weights(flats: list[StackSpectra], signals: list[float | None]) -> list[float]:
    """Weights near those of least variance: a flat's signal over the square of its power, times its exposures."""
    mean = [max(float(one.plain_dn2.mean()), ACCURACY.min_power_dn2) for one in flats]
    gain = [m if s is None else s for m, s in zip(mean, signals, strict=True)]
    weight = [one.runs * len(one.time) * g / m**2 for one, g, m in zip(flats, gain, mean, strict=True)]
    return [w / sum(w * g for w, g in zip(weight, gain, strict=True)) for w in weight]


def _lag(flats: list[StackSpectra]) -> tuple[Array, bool, bool]:
    """Correlation in time, whether it could be looked for, and whether it goes on beyond the last lag."""
    count = min(len(one.lags) for one in flats)
    if count < 2:
        return np.empty(0), False, False
    value, square = np.zeros(count - 1), np.zeros(count - 1)
    total = sum(one.low_dn2[0] for one in flats)
    for one in flats:
        low = low_frequency_weights(one.bins)
        modes = one.bins.efficiency * float(one.bins.modes[low > 0].sum()) * one.runs
        distance = np.abs(one.time[:, None] - one.time[None, :])
        pairs = np.array([np.sum(distance == lag) / 2.0 for lag in one.lags[1:count]])
        value += one.low_dn2[1:count] / total
        square += (one.low_dn2[0] / total) ** 2 / (2.0 * modes * np.maximum(pairs, 1.0))
    sd = 1.2 * np.sqrt(square)
    seen = bool((value[:3] > THRESHOLDS.lag_sd * sd[:3]).any())
    if not seen:
        return np.empty(0), True, False
    full = np.zeros(int(flats[0].lags[count - 1]))
    full[flats[0].lags[1:count] - 1] = value
    tail = float(np.mean(value[-3:]))
    return full, True, bool(tail > max(0.05, THRESHOLDS.lag_sd * float(sd[-3:].mean())))


def _flat_spectrum(
    label: str, dark: StackSpectra | None, flat: StackSpectra, signal: float | None, lag: Array, *, whole: bool
) -> FlatSpectrum:
    modes = flat.bins.modes * flat.bins.efficiency
    power = flat.power(lag)
    square = power**2 / (modes * flat.independent(lag))
    if dark is not None:
        below = dark.power(lag)
        power, square = power - below, square + below**2 / (modes * dark.independent(lag[:0]))
    hidden = _quantisation_noise_dn2(dark, 1.0) if dark is not None and whole else (0.0, 0.0)
    return FlatSpectrum(
        label=label, power_dn2=power, power_sd_dn2=np.sqrt(square), signal_dn=signal, quantisation_noise_dn2=hidden
    )
