"""Forward model of an edge profile: parametric transfer function with free model departures.

The transfer function is the pixel aperture (and the video filter of a described camera) times exp(-ln 2 (f/f2)^n),
which covers Gaussian lenses (n = 2) and intensifier tubes (n about 1.1), times a smooth model departure whose size is
selected by evidence, times the halo. Its phase is free: a causal filter or a nonlinear response makes edges
asymmetric.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.mtf.blur_models import transfer as forms
from charact.mtf.blur_models.one_dimensional import (
    EXPONENT,
    EXPONENT_PRIOR,
    HALF_FREQUENCY,
    HALF_FREQUENCY_PRIOR,
    ExtendedComponent,
)
from charact.mtf.edge.fit.sufficient_statistics import ProfileStatistics, apply_phases
from charact.mtf.known_transfer import KnownTransfer
from charact.video_filter import powers

Array = NDArray[np.float64]

# Where the departure bends, in units of the half frequency: from a third of it to where little contrast is left.
KNOTS = np.array([0.35, 0.6, 0.9, 1.3, 1.8, 2.5])
# The phase bends freely at these multiples of the half frequency, with these prior standard deviations, rad.
PHASE_KNOTS = np.array([1.0, 1.5, 2.1, 2.8])
PHASE_SD = np.array([0.2, 0.3, 0.5, 0.7])


# Shift, half frequency, exponent, departures and phases: what every model has.
PARAMETERS = 3 + KNOTS.size + PHASE_KNOTS.size


@dataclass(frozen=True, kw_only=True)
class EdgeModel:
    """Possible transfers of an edge and their probability.

    Parameters
    ----------
    grid
        Nodes, shape (node,), cycles per pixel.
    known
        Known part of the transfer: aperture and video filter, whose bandwidth may be one more parameter.
    evidence
        The data.
    scale
        Half frequency about which the departure's knots lie, cycles per pixel.
    departure_sd
        Prior standard deviation of ln of the departure at each knot.
    halo
        None: no halo.
    """

    grid: Array
    known: KnownTransfer
    evidence: ProfileStatistics
    scale: float
    departure_sd: float
    halo: ExtendedComponent | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        core = ("edge_shift_px", "ln_half_frequency", "exponent")
        departures = tuple(f"departure_{index}" for index in range(KNOTS.size))
        phases = tuple(f"phase_{index}" for index in range(PHASE_KNOTS.size))
        return (*core, *departures, *phases, *self._tail)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters."""
        tail = [unit for unit, _ in self._tail.values()]
        return ("px", "ln(cy/px)", "1", *("1" for _ in KNOTS), *("rad" for _ in PHASE_KNOTS), *tail)

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        low, high = np.log(HALF_FREQUENCY)
        phases = [(-6.0 * sd, 6.0 * sd) for sd in PHASE_SD]
        core = [(-6.0, 6.0), (low, high), EXPONENT, *[(-6.0, 6.0)] * KNOTS.size, *phases]
        return np.array([*core, *(bound for _, bound in self._tail.values())])

    @cached_property
    def _tail(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of what only some cameras have: halo, then the video's bandwidth."""
        return {**(self.halo.parameters if self.halo else {}), **self._video}

    @property
    def _video(self) -> dict[str, tuple[str, tuple[float, float]]]:
        return self.known.video.parameters if self.known.video else {}

    def start(self, half_frequency: float, exponent: float) -> Array:
        """Return a starting point of the optimisation."""
        wide = [0.6 * low + 0.4 * high for _, (low, high) in self.halo.parameters.values()] if self.halo else []
        tail = [*wide, *(0.0 for _ in self._video)]
        return np.array([0.0, np.log(half_frequency), exponent, *np.zeros(KNOTS.size + PHASE_KNOTS.size), *tail])

    def modulus(self, theta: Array, grid: Array | None = None) -> Array:
        """Return the transfer over its known part, without phase, shape (n, node)."""
        f = self.grid if grid is None else grid
        log_core = forms.exponential(f, np.exp(theta[:, 1]), theta[:, 2])
        shapes = self._shapes if grid is None else self.departures(grid)
        log_core = log_core + self.departure_sd * theta[:, 3 : 3 + KNOTS.size] @ shapes
        bend = self._bend if grid is None else self.known.bend(grid)
        if bend is not None:
            log_core = log_core + powers(theta[:, -1]) @ bend.real
        core = np.exp(log_core)
        if self.halo is None:
            return core
        tail = theta[:, PARAMETERS : PARAMETERS + len(self.halo.parameters)]
        return core * (1.0 - tail[:, :1] + tail[:, :1] * self.halo.transfer(f, tail[:, 1:]))

    @cached_property
    def _bend(self) -> NDArray[np.complex128] | None:
        return self.known.bend(self.grid)

    def departures(self, frequency: Array) -> Array:
        """Return the shapes of the departure, shape (knot, frequency)."""
        return _cosine_shapes(frequency / self.scale, KNOTS)

    @cached_property
    def _shapes(self) -> Array:
        return self.departures(self.grid)

    @cached_property
    def _bends(self) -> Array:
        return _cosine_shapes(self.grid / self.scale, PHASE_KNOTS)

    def transfer_at_nodes(self, theta: Array) -> Array:
        """Return the transfer at the nodes, real and imaginary parts side by side, shape (n, 2 node)."""
        bend = theta[:, 3 + KNOTS.size : PARAMETERS] @ self._bends
        if self._bend is not None:
            bend = bend + powers(theta[:, -1]) @ self._bend.imag
        late = theta[:, :1] * self.grid - bend / (2.0 * np.pi)
        return apply_phases(self.modulus(theta), late, self._fixed)

    @cached_property
    def _fixed(self) -> Array:
        fixed = self.known(self.grid)
        return np.stack([fixed.real, fixed.imag])

    def mtf(self, theta: Array, grid: Array) -> Array:
        """Return the MTF at other frequencies, shape (n, frequency)."""
        return np.abs(self.known(grid)) * self.modulus(theta, grid)

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds."""
        bounds = self.bounds
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        median, half_sd = HALF_FREQUENCY_PRIOR
        mean, sd = EXPONENT_PRIOR
        count = KNOTS.size
        phases = theta[:, 3 + count : PARAMETERS] / PHASE_SD
        normal = -0.5 * ((theta[:, 1] - np.log(median)) / half_sd) ** 2
        normal = normal - 0.5 * ((theta[:, 2] - mean) / sd) ** 2 - 0.5 * np.sum(phases**2, axis=1)
        normal = normal - 0.5 * np.sum(theta[:, 3 : 3 + count] ** 2, axis=1) - 0.5 * count * np.log(2 * np.pi)
        if self.halo:
            normal = normal - np.log(np.prod([high - low for _, (low, high) in self.halo.parameters.values()]))
        if self.known.video is not None and self._video:
            normal = normal + self.known.video.log_prior(theta[:, -1])
        return np.where(inside, normal, -np.inf)

    def log_probability(self, theta: Array) -> Array:
        """Return ln of the posterior up to a constant, shape (n, parameter) -> (n,)."""
        return self.log_tempered(theta, 1.0)

    def log_tempered(self, theta: Array, share: float) -> Array:
        """Return ln of the prior times a power of the likelihood."""
        value = self.log_prior(theta)
        inside = np.isfinite(value)
        if inside.any():
            value[inside] += share * self.evidence.marginal.log_likelihood(self.transfer_at_nodes(theta[inside]))
        return value


def departure_shapes(frequency: Array, half_frequency: float) -> NDArray[np.complex128]:
    """Return smooth departures of a transfer's logarithm, modulus and phase, shape (departure, frequency)."""
    ratio = frequency / half_frequency
    return np.concatenate([_cosine_shapes(ratio, KNOTS), 1j * _cosine_shapes(ratio, PHASE_KNOTS)]).astype(np.complex128)


def _cosine_shapes(ratio: Array, knots: Array) -> Array:
    """Return cosine bumps in the logarithm of a ratio, one at each knot and the last one held, shape (knot, ratio)."""
    place = np.interp(np.log(ratio), np.log(knots), np.arange(knots.size))
    entry = (np.log(ratio) - np.log(knots[0])) / np.log(knots[1] / knots[0])
    place = np.where(entry < 0, np.maximum(entry, -1.0), place)
    away = np.clip(np.abs(place - np.arange(knots.size)[:, None]), 0.0, 1.0)
    return 0.5 * (1.0 + np.cos(np.pi * away))
