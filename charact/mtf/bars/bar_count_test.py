"""Test of the number of bars: fits with one bar more and one fewer."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.bar_image_model import BarImageModel, BarLikelihood, initial_parameters
from charact.mtf.bars.bar_spectrum import table_of
from charact.mtf.bars.fit import ROUGHLY, BarFit, fit_bars

Array = NDArray[np.float64]

# Where other bars may lie beside those fitted, periods.
SHIFTS_PERIODS = (-0.5, 0.0, 0.5)
# Chi squared over that of the number fitted from which on no fit of another is tried.
MAX_CHI2_RATIO = 2.0
# Chi squared that another number must save, over the sum of the noise's correlation, or its share of all.
MIN_CHI2_GAIN, MIN_CHI2_FRACTION = 25.0, 1.0 / 3.0


def likelier_bar_count(fit: BarFit, problem: BarLikelihood) -> int | None:
    """Return the number of bars, one fewer or one more, that fits the pixels better; None if none does."""
    asked = fit.cost
    begun = {n: _chi2_of_count(fit, problem, n) for n in (fit.target.bars - 1, fit.target.bars + 1) if n > 1}
    left = {
        n: _fit_count(fit, problem, n, shift_px).cost
        for n, (least, shift_px) in begun.items()
        if least < MAX_CHI2_RATIO * asked
    }
    if not left:
        return None
    best = min(left, key=left.__getitem__)
    shared = fit.noise.tied
    # A wrong number leaves residuals that resemble correlated noise; no other number then saves a third of them.
    return best if asked - left[best] > min(MIN_CHI2_GAIN * shared, MIN_CHI2_FRACTION * asked) else None


def _chi2_of_count(fit: BarFit, problem: BarLikelihood, bars: int) -> tuple[float, float]:
    """Return the smallest chi squared of another number of bars at the fitted transfer, and their shift, px."""
    picture = BarImageModel(problem, fit.target)
    across, along = picture.places(fit["angle_rad"], 0.0, 0.0)
    reach = picture.reach[0] + max(SHIFTS_PERIODS) / fit.target.frequency, picture.reach[1]
    table = table_of(replace(fit.shape, bars=bars), *reach)
    weight = 1.0 / np.sqrt(problem.variance)
    ground = np.stack([np.ones_like(across), across / reach[0], along / reach[1]]) * weight
    data, left = problem.image[problem.window] * weight, {}
    for shift_px in np.array(SHIFTS_PERIODS) / fit.target.frequency:
        design = np.concatenate([(table.at(across - shift_px, along)[0] * weight)[None], ground])
        amplitude = np.linalg.lstsq(design @ design.T, design @ data, rcond=1e-12)[0]
        left[float(shift_px)] = float(np.sum((data - amplitude @ design) ** 2))
    best = min(left, key=left.__getitem__)
    return left[best], best


def _fit_count(fit: BarFit, problem: BarLikelihood, bars: int, shift_px: float) -> BarFit:
    """Return a rough fit of another number of bars."""
    start = initial_parameters(problem, fit.target)
    start |= {"angle_rad": fit["angle_rad"], "across_px": shift_px}
    return fit_bars(problem, replace(fit.target, bars=bars), start, fit.noise, tolerance=ROUGHLY)
