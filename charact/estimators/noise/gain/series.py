"""Flat series: flats of one gain with their darks, and the range of the gain fit."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.thresholds import GAIN
from charact.frames.frame_block import Spectra
from charact.frames.stack_statistics import StackStatistics, read_levels_of
from charact.method import Context
from charact.observables import Stacks
from labdata import Array, BadInput, Conditions, Session, has_tube
from labdata.conditions import GAINS

# Fraction of values at full scale above which clipping lowers the variance.
CLIPPED_SHARE = 1e-4


@dataclass(frozen=True, kw_only=True)
class FlatSeries:
    """Flats of one gain in order of rising level, each with its dark."""

    flats: tuple[StackStatistics, ...]  # statistics of the flats
    darks: tuple[StackStatistics, ...]  # the dark of each flat
    all_darks: tuple[StackStatistics, ...]  # every dark of the session
    # signal_dn, variance_dn2, variance_sd_dn2: mean and variance above the dark's, and standard
    # error of the variance, shape (flat,), DN and DN^2
    signal_dn: Array
    variance_dn2: Array
    variance_sd_dn2: Array
    fitted: NDArray[np.bool_]  # whether each flat is in the range of the gain fit, shape (flat,)
    peak: int | None  # index of the flat of peak variance; None if the variance still rises
    reference: str  # "dark" or "lowest flat": reference of the signal
    left_out: tuple[str, ...] = ()  # flats at another gain, excluded
    single: tuple[str, ...] = ()  # stacks of a single frame, excluded

    @property
    def stacks(self) -> Stacks[StackStatistics]:
        """All darks, and the flats with theirs."""
        return Stacks(darks=self.all_darks, flats=self.flats, references=self.darks)

    @property
    def fitted_stacks(self) -> Stacks[StackStatistics]:
        """The flats in the range of the gain fit with their darks."""
        chosen = [
            flat for flat, is_fitted in zip(self.flats, self.fitted, strict=True) if is_fitted
        ]
        return self.stacks.only(flats=chosen)


def without_noise(single: Sequence[str]) -> str:
    """Return the note on stacks excluded for having a single frame; "" for none."""
    return f"excluded (single frame, no noise): {', '.join(single)}" if single else ""


def read_levels(
    session: Session, *, context: Context, spectra: Spectra, cubes: bool = False
) -> tuple[list[StackStatistics], list[StackStatistics], list[str]]:
    """Read the statistics of every dark and flat of a session.

    Returns statistics, and the labels of stacks with a single frame.

    Raises BadInput if the images differ in size.
    """
    darks, flats, single = [], [], []
    entries = session.of_kind("dark", "flat")
    read = read_levels_of(entries, context=context, spectra=spectra, cubes=cubes)
    for entry, level in zip(entries, read, strict=True):
        if level is None:
            single.append(entry.label)
        else:
            (darks if entry.kind == "dark" else flats).append(level)
    sizes = {level.size for level in (*darks, *flats)}
    if len(sizes) > 1:
        shown = ", ".join(f"{rows} x {cols}" for rows, cols in sorted(sizes))
        raise BadInput(f"darks and flats must be images of one size, got {shown} rows and columns")
    return darks, flats, single


def gain_of(conditions: Conditions) -> tuple[float | None, ...]:
    """Return the conditions that set the gain: MCP voltage or control word, register gain, camera
    gain.
    """
    return tuple(getattr(conditions, name) for name in GAINS)


def group_by_gain(levels: Iterable[StackStatistics]) -> list[list[StackStatistics]]:
    """Return stacks of equal gain, in order of first appearance."""
    groups: dict[tuple, list[StackStatistics]] = {}
    for level in levels:
        groups.setdefault(gain_of(level.conditions), []).append(level)
    return list(groups.values())


def longest_series(flats: list[StackStatistics]) -> list[StackStatistics]:
    """Return the flats of the most frequent gain, in order of rising level.

    Of equally frequent gains, the one with the brightest unclipped flat, where read and
    quantisation noise matter least.
    """

    def worth(group: list[StackStatistics]) -> tuple[int, float]:
        return len(group), max(
            (flat.mean_dn for flat in group if flat.high_fraction <= CLIPPED_SHARE), default=-np.inf
        )

    return sorted(max(group_by_gain(flats), key=worth, default=[]), key=lambda level: level.mean_dn)


def series_of(
    flats: list[StackStatistics], darks: list[StackStatistics], single: Sequence[str] = ()
) -> FlatSeries:
    """Return the series of the most frequent gain."""
    chosen = longest_series(flats)
    chosen_labels = {flat.label for flat in chosen}
    left_out = tuple(flat.label for flat in flats if flat.label not in chosen_labels)
    return replace(series_of_one_gain(chosen, darks), left_out=left_out, single=tuple(single))


def series_of_one_gain(chosen: list[StackStatistics], darks: list[StackStatistics]) -> FlatSeries:
    """Return the series of flats of one gain, in order of rising level, with the range of the gain
    fit.
    """
    reference = "dark"
    if not darks:
        reference = "lowest flat"
        darks, chosen = chosen[:1], chosen[1:]
    matched = tuple(_dark_of(flat, darks) for flat in chosen)
    signal = np.array([f.mean_dn - d.mean_dn for f, d in zip(chosen, matched, strict=True)])
    variance = np.array(
        [f.variance_dn2 - d.variance_dn2 for f, d in zip(chosen, matched, strict=True)]
    )
    sd = np.array(
        [
            np.hypot(f.variance_sd_dn2, d.variance_sd_dn2)
            for f, d in zip(chosen, matched, strict=True)
        ]
    )
    peak = _peak(chosen, signal)
    high = np.array([flat.high_fraction for flat in chosen])
    fitted = (signal > 0) & (high <= CLIPPED_SHARE)
    if peak is not None:
        fitted &= signal <= GAIN.fit_fraction * signal[peak]
    return FlatSeries(
        flats=tuple(chosen),
        darks=matched,
        all_darks=tuple(darks) if reference == "dark" else (),
        signal_dn=signal,
        variance_dn2=variance,
        variance_sd_dn2=sd,
        fitted=fitted,
        peak=peak,
        reference=reference,
    )


def _dark_of(flat: StackStatistics, darks: list[StackStatistics]) -> StackStatistics:
    """Return the dark with most equal conditions; of equals the one of nearest exposure, then of
    most frames.
    """

    def unlike(dark: StackStatistics) -> tuple[int, float, int]:
        of_flat, of_dark = flat.conditions, dark.conditions
        same = sum(
            getattr(of_flat, name) is not None and getattr(of_flat, name) == getattr(of_dark, name)
            for name in (*GAINS, "exposure_s", "gate_ns", "temperature_c")
        )
        known = of_flat.exposure_s is not None and of_dark.exposure_s is not None
        return (
            -same,
            abs((of_flat.exposure_s or 0) - (of_dark.exposure_s or 0)) if known else 0.0,
            -dark.frames,
        )

    return min(darks, key=unlike)


def _peak(flats: list[StackStatistics], signal: Array) -> int | None:
    """Return the index of the variance peak if the variance rises before and falls after it."""
    if len(flats) < 3:
        return None
    variance = np.array([flat.variance_dn2 for flat in flats])
    top = int(np.argmax(variance))
    falling = variance[top + 1 :]
    rose = signal.min() < GAIN.fit_fraction * signal[top]
    return top if rose and len(falling) and falling.min() < 0.9 * variance[top] else None


def dark_shares(
    darks: Iterable[StackStatistics | None], weight: Iterable[float]
) -> list[tuple[StackStatistics, float]]:
    """Return each dark once with the sum of the weights of its flats, whose error it has in
    common.
    """
    shares: dict[str, tuple[StackStatistics, float]] = {}
    for dark, flat_weight in zip(darks, weight, strict=True):
        if dark is not None:
            shares[dark.label] = dark, shares.get(dark.label, (dark, 0.0))[1] + float(flat_weight)
    return list(shares.values())


def gain_obstacle(series: FlatSeries) -> str | None:
    """Return why a series cannot give a gain, or None."""
    if not len(series.flats):
        return "flats need at least two frames each, and darks or a second level as reference"
    error = np.array(
        [np.sqrt(f.variance_dn2 / (f.pixels * f.frames)) + 1e-12 for f in series.flats]
    )
    brighter = series.signal_dn > 5.0 * np.sqrt(50.0) * error
    if not brighter.any():
        return (
            "no flat is brighter than its dark: the largest difference is "
            f"{series.signal_dn.max():.3g} DN"
        )
    noisier = series.variance_dn2 > 5.0 * series.variance_sd_dn2
    if not (brighter & noisier).any():
        return (
            "no flat is noisier than its dark: the largest difference is "
            f"{series.variance_dn2.max():.3g} DN2"
        )
    if not (series.fitted & brighter & noisier).any():
        return "every flat is saturated: none lies within 70 % of saturation and below full scale"
    return None


# Conditions that imply an intensifier.
OF_TUBES = ("mcp_v", "gain_control", "luminous_gain", "brightness_control")


def has_intensifier(conditions: Iterable[Conditions], context: Context) -> bool:
    """Return whether an intensifier is described, or one of its settings stated."""
    return has_tube(context.camera) or any(
        getattr(stated, name) is not None for stated in conditions for name in OF_TUBES
    )


def has_multiplication(session: Session, context: Context) -> bool:
    """Return whether single electrons are multiplied, in a tube or in a register."""
    known = [entry.conditions for entry in session.of_kind("dark", "flat")]
    return (
        has_intensifier(known, context)
        or (context.camera is not None and context.camera.multiplies)
        or any((c.em_gain or 1.0) > 1.0 for c in known)
    )
