"""Light beyond the core of an edge's blur: whether it is worth a fit, where to begin; other departures of a form."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.mtf.blur_models.one_dimensional import BlurModel, ExtendedComponent
from charact.mtf.edge.fit.model_fit import BlurModelFit, BlurModelFitter
from charact.mtf.edge.fit.optimum_statistics import amplitudes, chi2_explained

Array = NDArray[np.float64]
Departures = Callable[[Array, float], NDArray[np.complex128]]

# Sizes of light beyond the core among which a fit begins.
SIZES = 9
# Steps after which one of several starts is chosen.
FIRST_ITERATIONS = 5
# Shares of light, of the range that they may have, over which evidence is summed; ln of the largest that is told.
SHARES, LARGEST = 100, 50.0
MIN_BAYES_FACTOR = 1e-300
# How far apart in ln two sizes must be to lead elsewhere.
APART = 0.5


@dataclass(frozen=True, kw_only=True)
class ExtendedComponentScore:
    """What light beyond a core may gain.

    Parameters
    ----------
    core, wide
        The core as it was fitted, under the prior of the light's slopes that is asked about, and the light beyond it.
    gains
        Of chi squared by each size, to first order, shape (size,); light that would have to be taken away gains
        nothing.
    odds
        Evidence for such light of any share and size over that for none, to first order.
    ln_weight
        ln of its probability before the data over that of none.
    points, shares, shapes
        Where a fit with each size begins: the core's parameters, the share of light and its shape, shapes
        (size, parameter), (size,) and (size, shape).
    """

    core: BlurModelFit
    wide: ExtendedComponent
    gains: Array
    odds: float
    ln_weight: float
    points: Array
    shares: Array
    shapes: Array

    @property
    def log_evidence(self) -> float:
        """ln of the evidence of the core with such light, to first order."""
        return self.core.log_evidence + float(np.log(max(self.odds, MIN_BAYES_FACTOR))) + self.ln_weight

    def start(self, size: int) -> Array:
        """Return where a fit with one of the sizes begins."""
        return np.concatenate([self.points[size], self.shares[size, None], self.shapes[size]])


@dataclass(frozen=True, kw_only=True)
class ComponentFit:
    """Light beyond the core of some sizes, the same for many edges.

    Parameters
    ----------
    wide
        Its kind.
    shapes
        Its sizes and what else shapes it, shape (size, parameter).
    unit
        Share of light for a share of one in its parameters, shape (size,).
    change
        Its transfer less one, shape (size, node).
    """

    wide: ExtendedComponent
    shapes: Array
    unit: Array
    change: Array


@lru_cache(maxsize=64)
def trial_components(wide: ExtendedComponent, grid_bytes: bytes) -> ComponentFit:
    """Return light of some sizes beyond the core, on the nodes of the transfer."""
    bounds = np.array([bound for _, bound in wide.parameters.values()])
    sizes = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** np.linspace(0.05, 0.95, SIZES)
    others = np.array([[0.1], [0.9]]) if len(bounds) > 2 else np.zeros((1, 0))
    shapes = np.array([[size, *other] for other in others for size in sizes])
    change = wide.transfer(np.frombuffer(grid_bytes), shapes) - 1.0
    return ComponentFit(wide=wide, shapes=shapes, unit=wide.share_unit(shapes)[:, 0], change=change)


def score_extended_components(
    fitter: BlurModelFitter, fit: BlurModelFit, wides: tuple[ExtendedComponent, ...], least_gains: Mapping[float, float]
) -> list[ExtendedComponentScore]:
    """Return what each kind of light beyond a core may gain; before the data all are together as likely as none.

    Parameters
    ----------
    least_gains
        For each prior of the illumination's slopes that is asked about the gain of chi squared that is worth telling.
    """
    if not wides:
        return []
    maps, step = fitter.maps, abs(fitter.profile.step)
    asked = [trial_components(wide, maps.grid.tobytes()) for wide in wides]
    core = maps.shift_transfers(fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0]))
    away = maps.white(core * np.concatenate([one.change for one in asked])) * step
    return [
        promise
        for slope, least_gain in least_gains.items()
        for promise in _score_components(fitter, fitter.under(fit, slope), asked, away, least_gain)
    ]


def _score_components(
    fitter: BlurModelFitter, fit: BlurModelFit, asked: Sequence[ComponentFit], away: Array, least_gain: float
) -> Iterator[ExtendedComponentScore]:
    """Yield what each kind of light beyond a core gains, where enough, from whitened shapes, shape (size, bin)."""
    scale = abs(fitter.profile.step) / fit.amplitude[0]
    amplitude, precision, moved = amplitudes(fit.residual, fit.design, fit.off, fit.precision, away)
    amplitude, precision = amplitude * scale, precision / scale**2
    gains = np.where(amplitude > 0, amplitude * (amplitude * precision), 0.0)
    low, high = fitter.bounds(fit.family).T
    first = 0
    for one in asked:
        own = slice(first, first := first + len(one.shapes))
        if gains[own].max() < least_gain:
            continue
        yield ExtendedComponentScore(
            core=fit,
            wide=one.wide,
            gains=gains[own],
            odds=ln_bayes_factor_of(one, amplitude[own], precision[own]),
            ln_weight=-float(np.log(len(asked))),
            # Half a step of the core: what the light beyond it changes is not small.
            points=np.clip(fit.point + 0.5 * moved[own], low, high),
            shares=np.minimum(np.clip(amplitude[own], 0.02, 0.3) / one.unit, one.wide.fraction[1]),
            shapes=one.shapes,
        )


def ln_bayes_factor_of(light: ComponentFit, amplitude: Array, precision: Array) -> float:
    """Return the evidence for light beyond the core over that for none: shares and sizes even within their bounds."""
    sizes = light.shapes[:, 0]
    return float(_mean_ratios(*light.wide.fraction, light.unit, amplitude, precision) @ sizes) / float(sizes.sum())


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


def fit_extended_component(
    fitter: BlurModelFitter, promise: ExtendedComponentScore, hopeless_cost: float
) -> BlurModelFit | None:
    """Fit a core with light beyond it, from the size that promises most and another far from it.

    Returns
    -------
    FamilyFit or None
        The best fit; None where its beginning costs more than is hopeless.
    """
    core, wide = promise.core, promise.wide
    order = np.argsort(-promise.gains)
    family, slope = BlurModel(core=core.family.core, wide=wide), core.slope_sd_per_px
    sizes = np.log(promise.shapes[order, 0])
    apart = order[np.abs(sizes - sizes[0]) > APART]
    begun = [fitter.optimise(family, promise.start(i), slope, FIRST_ITERATIONS) for i in (order[0], *apart[:1])]
    point, reached = min(begun, key=lambda one: one[1][-1])
    return None if reached[-1] > hopeless_cost else fitter.fit(family, point, slope, promise.ln_weight)


def departure_gain(fitter: BlurModelFitter, fit: BlurModelFit, shapes_at: Departures) -> tuple[float, int]:
    """Return the gain in chi squared from smooth departures of modulus and phase, to first order, and how many.

    Parameters
    ----------
    shapes_at
        Departures of the transfer's logarithm, complex, from frequencies and the half frequency.
    """
    maps = fitter.maps
    transfer = maps.shift_transfers(fit.family.modulus(fit.point[None, 1:], maps.grid), float(fit.point[0]))
    moved = maps.white(transfer * shapes_at(maps.grid, float(np.exp(fit.point[1])))) * abs(fitter.profile.step)
    both, none = np.concatenate([fit.design, moved]), np.zeros(len(moved))
    off, precision = np.concatenate([fit.off, none]), np.concatenate([fit.precision, none])
    with_them = chi2_explained(fit.residual, both, off, precision)
    return with_them - chi2_explained(fit.residual, fit.design, fit.off, fit.precision), len(moved)
