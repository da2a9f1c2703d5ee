"""Covariance gain from the noise power nearest frequency 0, without a model of the blur: its mean, or a parabola."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.noise.gain.covariance_sum import QUANTITIES, measured
from charact.noise.gain.reach import settled
from charact.noise.gain.summary import Summary
from labdata.measurement import Result
from labdata.session import Session

Array = NDArray[np.float64]

RADII_CY_PER_PX = (0.24, 0.12, 0.06, 0.03)
# Bins that a parabola of three coefficients takes at least.
LEAST_BINS = 4


@register(
    "flats",
    "spectrum-plateau",
    quantities=QUANTITIES,
    scope="As covariance-sum, without its model: the noise power is taken for flat near frequency 0; what it falls "
    "there is charged to its interval.",
)
def spectrum_plateau(session: Session, *, context: Context) -> Result:
    """Measure the covariance gain as the mean noise power over the lowest frequencies; all else as `covariance_sum`."""
    return measured(session, context=context, method="spectrum-plateau", estimate=lambda _, one: plateau(one))


@register(
    "flats",
    "spectrum-parabola",
    quantities=QUANTITIES,
    scope="As covariance-sum, with a parabola for its model: wings of the blur make a cusp at frequency 0, which is "
    "charged to its interval.",
)
def spectrum_parabola(session: Session, *, context: Context) -> Result:
    """Measure the covariance gain as the top of a parabola through the noise power; all else as `covariance_sum`."""
    return measured(session, context=context, method="spectrum-parabola", estimate=lambda _, one: parabola(one))


def plateau(summary: Summary) -> tuple[float, float]:
    """Return the mean power within the radius of least error, and its standard error, DN."""
    return _near_zero(summary, lambda x, y: np.ones((1, len(x))))


def parabola(summary: Summary) -> tuple[float, float]:
    """Return a of the power a + b x^2 + c y^2 within the radius of least error, and its standard error, DN."""
    return _near_zero(summary, lambda x, y: np.stack([np.ones_like(x), x**2, y**2]))


def _near_zero(summary: Summary, terms: Callable[[Array, Array], Array]) -> tuple[float, float]:
    """Fit the terms by least squares within every radius and settle on one."""
    x, y = summary.column_cy_per_px, summary.row_cy_per_px
    rows = []
    for radius in RADII_CY_PER_PX:
        weight = summary.modes * (np.hypot(x, y) <= radius)
        if np.count_nonzero(weight) < LEAST_BINS:
            break
        design = terms(x, y)
        rows.append(np.linalg.solve(design * weight @ design.T, design * weight)[0])
    linear = np.array(rows)
    values = linear @ summary.power_dn
    covariance = linear * summary.power_sd_dn**2 @ linear.T + summary.height_sd**2 * np.outer(values, values)
    return settled(values, covariance)
