"""Light beyond the core of an edge's blur: whether it is worth a fit, where to begin; other departures of a form."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.edge.fit.family_fit import FamilyFit, FamilyFitter
from charact.mtf.edge.fit.peak import amplitudes, explained
from charact.mtf.forms.families import Family, Wide

Array = NDArray[np.float64]
Departures = Callable[[Array, float], NDArray[np.complex128]]

# Sizes of light beyond the core among which a fit begins.
SIZES = 9
# Steps after which one of several starts is chosen.
FIRST_ITERATIONS = 5
# Shares of light, of the range that they may have, over which evidence is summed; ln of the largest that is told.
SHARES, LARGEST = 100, 50.0
# How far apart in ln two sizes must be to lead elsewhere.
APART = 0.5


@dataclass(frozen=True, kw_only=True)
class Promise:
    """What light beyond a core may gain.

    Parameters
    ----------
    core, wide
        The fitted core and the light beyond it.
    gains
        Of chi squared by each size, to first order, shape (size,); light that would have to be taken away gains
        nothing.
    odds
        Evidence for such light of any share and size over that for none, to first order.
    ln_weight
        ln of its probability before the data over that of none.
    starts
        Where a fit with each size begins, shape (size, parameter).
    """

    core: FamilyFit
    wide: Wide
    gains: Array
    odds: float
    ln_weight: float
    starts: Array


def promises(fitter: FamilyFitter, fit: FamilyFit, wides: tuple[Wide, ...]) -> list[Promise]:
    """Return what each kind of light beyond a core may gain; before the data all are together as likely as none."""
    if not wides:
        return []
    maps, step = fitter.maps, abs(fitter.profile.step)
    shapes, changes = zip(*(_tried(wide, maps.grid.tobytes()) for wide in wides), strict=True)
    core = maps.shifted(fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0]))
    away = maps.white(core * np.concatenate(changes)) * step
    amplitude, precision, moved = amplitudes(fit.residual, fit.design, fit.off, fit.precision, away)
    amplitude, precision = amplitude * step / fit.amplitude[0], precision * (fit.amplitude[0] / step) ** 2
    limits = fitter.bounds(fit.family)
    # Half a step of the core: what the light beyond it changes is not small.
    cores = np.clip(fit.point + 0.5 * moved, limits[:, 0], limits[:, 1])
    ends = np.cumsum([len(shape) for shape in shapes])[:-1]
    parts = zip(wides, shapes, *(np.split(one, ends) for one in (amplitude, precision, cores)), strict=True)
    return [
        Promise(
            core=fit,
            wide=wide,
            gains=np.where(height > 0, height * (height * power), 0.0),
            odds=_odds(wide, shape, height, power),
            ln_weight=-float(np.log(len(wides))),
            starts=np.concatenate([start, _share(wide, shape, height)[:, None], shape], axis=1),
        )
        for wide, shape, height, power, start in parts
    ]


@lru_cache(maxsize=64)
def _tried(wide: Wide, grid_bytes: bytes) -> tuple[Array, Array]:
    """Return sizes and shapes of light beyond the core, and its transfer less one: the same for many edges."""
    bounds = np.array([bound for _, bound in wide.parameters.values()])
    sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(0.05, 0.95, SIZES)
    others = np.array([[0.1], [0.9]]) if len(bounds) > 2 else np.zeros((1, 0))
    shapes = np.array([[size, *other] for other in others for size in sizes])
    return shapes, wide.transfer(np.frombuffer(grid_bytes), shapes) - 1.0


def _odds(wide: Wide, shape: Array, amplitude: Array, precision: Array) -> float:
    """Return the evidence for light beyond the core over that for none: shares and sizes even within their bounds."""
    unit = wide.share_unit(shape)[:, 0]
    return float(_mean_ratios(*wide.fraction, unit, amplitude, precision) @ shape[:, 0]) / float(shape[:, 0].sum())


@njit(cache=True)
def _mean_ratios(low: float, high: float, unit: Array, amplitude: Array, precision: Array) -> Array:
    """Return at each size the evidence for light over that for none, its share even between two bounds.

    Notes
    -----
    The mean over shares q of exp(a q p - q^2 p / 2), a their Gaussian estimate and p its precision.
    """
    out = np.zeros(unit.size)
    for i in range(unit.size):
        for k in range(SHARES):
            share = unit[i] * (low + (high - low) * (k + 0.5) / SHARES)
            out[i] += np.exp(min(precision[i] * share * (amplitude[i] - 0.5 * share), LARGEST)) / SHARES
    return out


def _share(wide: Wide, shape: Array, amplitude: Array) -> Array:
    """Return the share of light with which a fit begins."""
    return np.minimum(np.clip(amplitude, 0.02, 0.3) / wide.share_unit(shape)[:, 0], wide.fraction[1])


def fit_wide(fitter: FamilyFitter, promise: Promise, hopeless_cost: float) -> FamilyFit | None:
    """Fit a core with light beyond it, from the size that promises most and another far from it.

    Returns
    -------
    FamilyFit or None
        The best fit; None where its beginning costs more than is hopeless.
    """
    core, wide, starts = promise.core, promise.wide, promise.starts
    order = np.argsort(-promise.gains)
    family, slope = Family(core=core.family.core, wide=wide), core.slope_sd_per_px
    sizes = np.log(starts[order, -wide.after_size])
    apart = order[np.abs(sizes - sizes[0]) > APART]
    begun = [fitter.climbed(family, starts[i], slope, FIRST_ITERATIONS) for i in (order[0], *apart[:1])]
    point, reached = min(begun, key=lambda one: one[1][-1])
    return None if reached[-1] > hopeless_cost else fitter.fit(family, point, slope, promise.ln_weight)


def departure_gain(fitter: FamilyFitter, fit: FamilyFit, shapes_at: Departures) -> tuple[float, int]:
    """Return the gain in chi squared from smooth departures of modulus and phase, to first order, and how many.

    Parameters
    ----------
    shapes_at
        Departures of the transfer's logarithm, complex, from frequencies and the half frequency.
    """
    maps = fitter.maps
    transfer = maps.shifted(fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0]))
    moved = maps.white(transfer * shapes_at(maps.grid, float(np.exp(fit.point[1])))) * abs(fitter.profile.step)
    both, none = np.concatenate([fit.design, moved]), np.zeros(len(moved))
    off, precision = np.concatenate([fit.off, none]), np.concatenate([fit.precision, none])
    with_them = explained(fit.residual, both, off, precision)
    return with_them - explained(fit.residual, fit.design, fit.off, fit.precision), len(moved)
