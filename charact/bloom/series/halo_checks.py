"""Whether a fitted disc is a halo: its edge is tied to one place, and every level alone has it there."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.bloom.series.levenberg_marquardt import optimise, slopes_at
from charact.bloom.series.likelihood import RingSeries, SeriesLikelihood, select_levels
from charact.bloom.series.model_selection import FittedHaloModel
from charact.bloom.series.rings import SECTORS

Array = NDArray[np.float64]

# What a form without an edge must be worse by, in its criterion.
CLEARLY_WORSE = 15.0
# What a diameter off by these factors must cost in log-probability: wings without an edge pass for any disc.
OFF, OFF_COST = (0.8, 1.25), 12.5
# Standard errors of the halo's share in one level at which its own diameter is looked at.
SEEN_LEVEL = 8.0
# Share of the light by which rings are off from which on the form is called wrong.
MISFIT_SHARE = 0.12
# Sectors that differ by this share of their ring's light, and by so many standard errors, in rings on end, show
# something besides the source; rings nearer than this are too small to be divided.
UNEVEN_SHARE, UNEVEN_SD, UNEVEN_RINGS, INNERMOST_PX = 0.5, 4.0, 3, 6.0


def halo_refusal_reason(found: list[FittedHaloModel]) -> str | None:
    """Why the data bear no halo with an edge, as a sentence; None where they do."""
    best = found[0]
    if best.form.halo != "disc":
        return f"the data bear a {best.name} best: no halo with an edge is visible"
    rival = min((one for one in found if one.form.halo != "disc"), key=lambda one: one.bic)
    if rival.bic - best.bic < CLEARLY_WORSE:
        return f"the data bear a {rival.name} nearly as well as a halo with an edge"
    return None if edge_is_tied(best) else "the light falls off smoothly: discs of quite other diameters fit as well"


def edge_is_tied(best: FittedHaloModel) -> bool:
    """Whether any other diameter costs much, all else free."""
    problem, at = best.problem, best.form.names.index("halo_diameter")
    low, high = best.form.bounds[at]
    for factor in OFF:
        start = best.peak.point.copy()
        start[at] = np.clip(factor * start[at], low, high)
        other = optimise(problem, start, held=(at,), iterations=8)
        if best.peak.log_probability - other.log_probability < OFF_COST:
            return False
    return True


def own_diameters(best: FittedHaloModel) -> tuple[Array, Array, Array]:
    """Diameter and standard error that each level alone gives, core and profile as all have them, and how clearly.

    Returns
    -------
    diameter_px, sd_px, significance
        Shape (level,) each; NaN where a level does not show the halo.
    """
    names = best.form.names
    held = tuple(i for i, name in enumerate(names) if name not in ("halo_diameter", "halo_fraction"))
    at, share = names.index("halo_diameter"), names.index("halo_fraction")
    number = np.arange(len(best.problem.series.data))
    out = np.full((3, len(number)), np.nan)
    for one in number:
        alone = replace(best.problem, series=select_levels(best.problem.series, number == one))
        seen = _significance(alone, best.peak.point, share)
        out[2, one] = seen
        if seen > SEEN_LEVEL:
            peak = optimise(alone, best.peak.point, held=held, iterations=6)
            free = [i for i in range(len(names)) if i not in held]
            out[0, one], out[1, one] = peak.point[at], _sd(alone, peak.point, free, at)
    return out[0], out[1], out[2]


def _significance(alone: SeriesLikelihood, point: Array, share: int) -> float:
    """Root of what a level's log-probability loses without a halo."""
    bare = point.copy()
    bare[share] = alone.form.bounds[share, 0]
    with_halo, without = alone.log_probability(np.array([point, bare]))
    return float(np.sqrt(max(2.0 * (with_halo - without), 0.0)))


def _sd(alone: SeriesLikelihood, point: Array, free: list[int], at: int) -> float:
    """Standard error of one of the free parameters."""
    slopes = slopes_at(alone, point)[:, free]
    covariance = np.linalg.pinv(slopes.T @ slopes)
    place = free.index(at)
    return float(np.sqrt(max(covariance[place, place], 0.0)))


def is_uneven(series: RingSeries) -> bool:
    """Whether rings of some level are much brighter on one side than on the other: two sources, a tail, a border."""
    variance = SECTORS * np.diagonal(series.own_covariance, axis1=1, axis2=2)
    excess = np.maximum(series.sector_sd**2 - variance, 0.0)
    clear = (excess > UNEVEN_SD**2 * variance) & (excess > (UNEVEN_SHARE * series.light) ** 2)
    clear &= ~series.cut & (series.radius_px > INNERMOST_PX)
    on_end = np.array([np.convolve(one, np.ones(UNEVEN_RINGS)) for one in clear])
    return bool(on_end.max() >= UNEVEN_RINGS)
