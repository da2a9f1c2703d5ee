"""Whether the pixels of a fitted target are better described by another number of bars."""

from dataclasses import replace

import numpy as np

from charact.estimators.mtf.bars.bar_image_model import (
    BarImageModel,
    BarLikelihood,
    initial_parameters,
    table_of,
)
from charact.estimators.mtf.bars.fit import BarFit, fit_bars
from charact.estimators.mtf.bars.thresholds import ACCURACY, LIMITS


def likelier_bar_count(fit: BarFit, problem: BarLikelihood) -> int | None:
    """Return the number of bars, one fewer or one more, that fits the pixels better; None if none
    does.
    """
    cost = fit.cost
    begun = {
        n: _chi2_of_count(fit, problem, n)
        for n in (fit.target.bars - 1, fit.target.bars + 1)
        if n > 1
    }
    chi2_of_count = {
        n: _fit_count(fit, problem, n, shift_px).cost
        for n, (chi2, shift_px) in begun.items()
        if chi2 < LIMITS.max_count_chi2_ratio * cost
    }
    if not chi2_of_count:
        return None
    best = min(chi2_of_count, key=chi2_of_count.__getitem__)
    shared = fit.noise.correlation_sum
    # A wrong number leaves residuals that resemble correlated noise; no other number then saves a
    # third of them.
    return (
        best
        if cost - chi2_of_count[best]
        > min(LIMITS.min_count_chi2_gain * shared, LIMITS.min_count_chi2_fraction * cost)
        else None
    )


def _chi2_of_count(fit: BarFit, problem: BarLikelihood, bars: int) -> tuple[float, float]:
    """Return the smallest chi squared of another number of bars at the fitted transfer, and their
    shift, px.
    """
    image = BarImageModel(problem, fit.target)
    across, along = image.places(fit["angle_rad"], 0.0, 0.0)
    half_size_px = (
        image.reach[0] + max(ACCURACY.count_shifts_periods) / fit.target.frequency,
        image.reach[1],
    )
    table = table_of(replace(fit.shape, bars=bars), *half_size_px)
    weight = 1.0 / np.sqrt(problem.variance)
    background = (
        np.stack([np.ones_like(across), across / half_size_px[0], along / half_size_px[1]]) * weight
    )
    data, chi2_of_shift = problem.image[problem.window] * weight, {}
    for shift_px in np.array(ACCURACY.count_shifts_periods) / fit.target.frequency:
        design = np.concatenate(
            [(table.at(across - shift_px, along)[0] * weight)[None], background]
        )
        amplitude = np.linalg.lstsq(design @ design.T, design @ data, rcond=1e-12)[0]
        chi2_of_shift[float(shift_px)] = float(np.sum((data - amplitude @ design) ** 2))
    best = min(chi2_of_shift, key=chi2_of_shift.__getitem__)
    return chi2_of_shift[best], best


def _fit_count(fit: BarFit, problem: BarLikelihood, bars: int, shift_px: float) -> BarFit:
    """Return a rough fit of another number of bars."""
    moved = {"angle_rad": fit["angle_rad"], "across_px": shift_px}
    return fit_bars(
        problem,
        replace(fit.target, bars=bars),
        initial_parameters(problem, fit.target) | moved,
        fit.noise,
        tolerance=ACCURACY.rough_tolerance,
    )
