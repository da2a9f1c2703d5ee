"""The flats of one gain with their darks: which stacks belong together and which of them a gain may be fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.stack.parallel_reading import read_levels_of
from charact.noise.stack.stack_statistics import StackStatistics
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.session import Session

Array = NDArray[np.float64]

# EMVA 1288 Release 4, 6.5: gain and responsivity are fitted up to 70 % of saturation.
FIT_SHARE = 0.7
# Share of values at the highest code above which a level's variance is cut short by it.
CLIPPED_SHARE = 1e-4
# Conditions that set the gain.
GAINS = ("mcp_v", "gain_control", "em_gain", "camera_gain_db")


@dataclass(frozen=True, kw_only=True)
class FlatSeries:
    """Flats at one gain in order of rising level, each with the dark it is measured against.

    Parameters
    ----------
    flats
        Levels.
    darks
        The dark of each flat, as many.
    all_darks
        Every dark of the session.
    signal_dn, variance_dn2, variance_sd_dn2
        Mean and variance above the dark's, shape (flat,), and the standard error of the variance.
    fitted
        Which flats a gain is fitted to, shape (flat,).
    peak
        Index of the flat where the variance peaks, or None while it still rises.
    reference
        "dark" or "lowest flat": what the signal is counted from.
    left_out
        Flats at another gain, which took no part.
    single
        Stacks of a single frame, which took no part either.
    """

    flats: tuple[StackStatistics, ...]
    darks: tuple[StackStatistics, ...]
    all_darks: tuple[StackStatistics, ...]
    signal_dn: Array
    variance_dn2: Array
    variance_sd_dn2: Array
    fitted: NDArray[np.bool_]
    peak: int | None
    reference: str
    left_out: tuple[str, ...] = ()
    single: tuple[str, ...] = ()


def without_noise(single: Sequence[str]) -> str:
    """Say which stacks take no part as they have a single frame, such as a dark that others averaged; "" for none."""
    return f"left out, of a single frame, which shows no noise: {', '.join(single)}" if single else ""


def read_levels(
    session: Session, *, context: Context, spectra: bool, cubes: bool = False
) -> tuple[list[StackStatistics], list[StackStatistics], list[str]]:
    """Read every dark and flat of a session, part by part.

    Returns
    -------
    darks, flats, single
        Their statistics, and the labels of stacks with a single frame, which have none.

    Raises
    ------
    BadInput
        If the images are not all of one size.
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
    """What sets the gain: the plate's voltage or control word, the register's multiplication, the camera's own gain."""
    return tuple(getattr(conditions, name) for name in GAINS)


def longest_series(flats: list[StackStatistics]) -> list[StackStatistics]:
    """The flats of the gain that most of them were taken at, in order of rising level.

    Of gains with as many, the one with the brightest flat that is not cut by the highest code: its noise stands
    furthest above that of the camera and above its steps.
    """

    def worth(group: list[StackStatistics]) -> tuple[int, float]:
        return len(group), max((flat.mean_dn for flat in group if flat.high_fraction <= CLIPPED_SHARE), default=-np.inf)

    groups: dict[tuple, list[StackStatistics]] = {}
    for flat in flats:
        groups.setdefault(gain_of(flat.conditions), []).append(flat)
    chosen = max(groups.values(), key=worth) if groups else []
    return sorted(chosen, key=lambda level: level.mean_dn)


def series_of(flats: list[StackStatistics], darks: list[StackStatistics], single: Sequence[str] = ()) -> FlatSeries:
    """Set the flats of the gain that most were taken at against their darks."""
    chosen = longest_series(flats)
    here = {flat.label for flat in chosen}
    left_out = tuple(flat.label for flat in flats if flat.label not in here)
    return replace(series_of_one_gain(chosen, darks), left_out=left_out, single=tuple(single))


def series_of_one_gain(chosen: list[StackStatistics], darks: list[StackStatistics]) -> FlatSeries:
    """Set flats of one gain, in order of rising level, against their darks; find where a gain may be fitted."""
    reference = "dark"
    if not darks:
        reference = "lowest flat"
        darks, chosen = chosen[:1], chosen[1:]
    matched = tuple(_dark_of(flat, darks) for flat in chosen)
    signal = np.array([f.mean_dn - d.mean_dn for f, d in zip(chosen, matched, strict=True)])
    variance = np.array([f.variance_dn2 - d.variance_dn2 for f, d in zip(chosen, matched, strict=True)])
    sd = np.array([np.hypot(f.variance_sd_dn2, d.variance_sd_dn2) for f, d in zip(chosen, matched, strict=True)])
    peak = _peak(chosen, signal)
    high = np.array([flat.high_fraction for flat in chosen])
    fitted = (signal > 0) & (high <= CLIPPED_SHARE)
    if peak is not None:
        fitted &= signal <= FIT_SHARE * signal[peak]
    return FlatSeries(flats=tuple(chosen), darks=matched, all_darks=tuple(darks) if reference == "dark" else (),
                  signal_dn=signal, variance_dn2=variance, variance_sd_dn2=sd, fitted=fitted, peak=peak,
                  reference=reference)  # fmt: skip


def _dark_of(flat: StackStatistics, darks: list[StackStatistics]) -> StackStatistics:
    """The dark whose conditions agree in most; of equals the one of the nearest exposure, then of most frames."""

    def unlike(dark: StackStatistics) -> tuple[int, float, int]:
        here, there = flat.conditions, dark.conditions
        same = sum(
            getattr(here, name) is not None and getattr(here, name) == getattr(there, name)
            for name in (*GAINS, "exposure_s", "gate_ns", "temperature_c")
        )
        known = here.exposure_s is not None and there.exposure_s is not None
        return -same, abs((here.exposure_s or 0) - (there.exposure_s or 0)) if known else 0.0, -dark.frames

    return min(darks, key=unlike)


def _peak(flats: list[StackStatistics], signal: Array) -> int | None:
    """Index of the variance peak if the variance falls beyond it, and levels below it show that it rose before."""
    if len(flats) < 3:
        return None
    variance = np.array([flat.variance_dn2 for flat in flats])
    top = int(np.argmax(variance))
    beyond = variance[top + 1 :]
    rose = signal.min() < FIT_SHARE * signal[top]
    return top if rose and len(beyond) and beyond.min() < 0.9 * variance[top] else None
