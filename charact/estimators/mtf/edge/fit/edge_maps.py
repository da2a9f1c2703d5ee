"""Linear maps from a transfer function at a few frequencies to the bins of an edge profile, and its
likelihood.

Bin means are linear in the transfer and in the levels, so chi squared of a transfer is a quadratic
form: once the maps are made, a likelihood costs the same whatever the size of the frame.
"""

import math

import numpy as np
from numba import njit
from scipy.linalg.blas import dtrmm  # pyright: ignore[reportAttributeAccessIssue]
from scipy.linalg.lapack import dpotrf, dtrtri  # pyright: ignore[reportAttributeAccessIssue]

from charact.estimators.mtf.edge.fit.esf_from_mtf import edge_weights, nodes
from charact.estimators.mtf.edge.pixels.profile import EdgeProfile
from charact.estimators.mtf.known_transfer import KnownTransfer
from labdata import Array


class EdgeMaps:
    """Maps from transfers at the nodes, real and imaginary parts side by side, to the bins of a
    profile.

    Parameters
    ----------
    profile
        The measured profile with the covariance of its bins.
    known
        Known part of the transfer: aperture and video filter.
    fine
        Whether the nodes follow the ripples of a wide halo; None: where the window is wide.

    Attributes
    ----------
    grid, fixed
        Nodes, cy/px, shape (node,); known transfer there, real and imaginary, shape (2, node).
    plain, white
        Maps to bins and to whitened bins, shape (2 node, bin).
    levels, data
        Whitened level and illumination slopes, shape (3, bin), and whitened bin means, shape
        (bin,).
    """

    def __init__(
        self, profile: EdgeProfile, known: KnownTransfer, *, fine: bool | None = None
    ) -> None:
        self.profile = profile
        self.grid = nodes(fine=profile.gathered.half_width_px > 24.0 if fine is None else fine)
        fixed = known(self.grid)
        self.fixed = np.stack([fixed.real, fixed.imag])
        root, failed = dpotrf(profile.covariance.T, lower=1, clean=1)
        if failed:
            raise np.linalg.LinAlgError("the covariance of the bins is not positive definite")
        self.root = dtrtri(root, lower=1)[0]
        self.data = self.root @ profile.value
        self.levels = np.ascontiguousarray((self.root @ profile.levels).T)
        self._build_around(0.0)

    def _build_around(self, shift_px: float) -> None:
        self.centre_px = shift_px
        plain = np.concatenate(
            edge_weights(self.grid, self.profile.distance - shift_px, self.profile.spread_px),
            axis=1,
        )
        self.plain = np.ascontiguousarray(plain.T)
        # Half the work of a product: the root is a triangle.
        self.white = np.ascontiguousarray(
            dtrmm(1.0, self.root, plain.T, side=1, lower=1, trans_a=1)
        )

    def rebuild_for(self, shift_px: float) -> None:
        """Make the maps anew where the nodes do not carry the phase of a shift."""
        if abs(shift_px - self.centre_px) > 0.25:
            self._build_around(shift_px)

    def transfers(self, modulus: Array, shift_px: float) -> Array:
        """Return transfers at a shift, known part included, shape (n, node) -> (n, 2 node)."""
        self.rebuild_for(shift_px)
        turns = np.broadcast_to((shift_px - self.centre_px) * self.grid, modulus.shape)
        return apply_phases(np.ascontiguousarray(modulus), np.ascontiguousarray(turns), self.fixed)

    def level_power(self) -> float:
        """Return chi squared of a level alone."""
        level = self.levels[0]
        return float(self.data @ self.data - (level @ self.data) ** 2 / (level @ level))

    def best_profile(self, transfer: Array, level_precision: Array) -> tuple[Array, Array]:
        """Return the best profile of a transfer (2 node,) at the bins, DN, and its step, level and
        slopes.
        """
        linear = np.concatenate([(transfer @ self.white)[None], self.levels])
        normal = linear @ linear.T + np.diag([0.0, *level_precision])
        amplitude = np.asarray(np.linalg.solve(normal, linear @ self.data), float)
        return transfer @ self.plain * amplitude[0] + self.profile.levels @ amplitude[1:], amplitude

    def ln_level_volume(self, level_precision: Array) -> float:
        """Return ln of what marginalising level and slopes costs, up to a constant: priors of
        slopes compare by it.
        """
        volume = np.linalg.slogdet(self.levels @ self.levels.T + np.diag(level_precision))[1]
        return -0.5 * float(volume) + 0.5 * float(
            np.sum(np.log(level_precision[level_precision > 0]))
        )


class Marginal:
    """ln likelihood of transfers on one profile, with step, level and slopes marginalised.

    Parameters
    ----------
    white, levels, data
        As of `EdgeMaps`.
    level_precision
        Precision of the priors of level and slopes, DN^-2; 0 for a free one.
    step_dn
        Unit in which the prior of the step is flat, DN.

    Notes
    -----
    Gaussian priors are further bins without data; what level and slopes explain is projected out of
    map and data.
    """

    def __init__(
        self, white: Array, levels: Array, data: Array, level_precision: Array, step_dn: float
    ) -> None:
        span = np.linalg.qr(np.concatenate([levels, np.diag(np.sqrt(level_precision))], axis=1).T)[
            0
        ]
        stacked = np.concatenate([white, data[None]])
        stacked = np.concatenate([stacked, np.zeros((len(stacked), len(levels)))], axis=1)
        stacked -= (stacked @ span) @ span.T
        self._map, self._data = np.ascontiguousarray(stacked[:-1]), stacked[-1]
        self._step_dn = step_dn
        self.power = float(self._data @ self._data)

    def log_likelihood(self, stacked: Array) -> Array:
        """Return ln likelihood of transfers, shape (n, 2 node) -> (n,)."""
        overlap, curvature = self._seen(stacked)
        return -0.5 * (self.power - overlap**2 / curvature + np.log(curvature * self._step_dn**2))

    def chi2(self, stacked: Array) -> Array:
        """Return chi squared at the best step of transfers, shape (n, 2 node) -> (n,)."""
        overlap, curvature = self._seen(stacked)
        return self.power - overlap**2 / curvature

    def _seen(self, stacked: Array) -> tuple[Array, Array]:
        spread = stacked @ self._map
        return spread @ self._data, np.maximum(np.einsum("ij,ij->i", spread, spread), 1e-300)


@njit(cache=True)
def apply_phases(modulus: Array, turns: Array, fixed: Array) -> Array:
    """Return transfers delayed by phases, real and imaginary parts side by side, shape (n, 2 node).

    Parameters
    ----------
    modulus, turns
        Modulus and delay of each node in turns (shift times frequency), shape (n, node).
    fixed
        Known part of the transfer, real and imaginary, shape (2, node).

    Notes
    -----
    Sine and cosine by their series within an eighth of a turn, accurate to 1e-15, which vectorises.
    """
    count, size = modulus.shape
    out = np.empty((count, 2 * size))
    for i in range(count):
        for j in range(size):
            quarters = 4.0 * turns[i, j]
            quarter = math.floor(quarters + 0.5)
            sine, cosine = _series((quarters - quarter) * (0.5 * math.pi))
            half = math.floor(0.5 * quarter)
            sign = 1.0 - 2.0 * (half - 2.0 * math.floor(0.5 * half))
            crossed = quarter != 2.0 * half
            real = sign * (-sine if crossed else cosine)
            imaginary = sign * (cosine if crossed else sine)
            out[i, j] = modulus[i, j] * (fixed[0, j] * real + fixed[1, j] * imaginary)
            out[i, size + j] = modulus[i, j] * (fixed[1, j] * real - fixed[0, j] * imaginary)
    return out


@njit(cache=True, inline="always")
def _series(angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle of at most an eighth of a turn, rad, by Taylor's
    series.
    """
    square = angle * angle
    sine = 1.0 - square * (1.0 / 210.0)
    cosine = 1.0 - square * (1.0 / 240.0)
    sine, cosine = 1.0 - square * (1.0 / 156.0) * sine, 1.0 - square * (1.0 / 182.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 110.0) * sine, 1.0 - square * (1.0 / 132.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 72.0) * sine, 1.0 - square * (1.0 / 90.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 42.0) * sine, 1.0 - square * (1.0 / 56.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 20.0) * sine, 1.0 - square * (1.0 / 30.0) * cosine
    sine, cosine = 1.0 - square * (1.0 / 6.0) * sine, 1.0 - square * (1.0 / 12.0) * cosine
    return angle * sine, 1.0 - 0.5 * square * cosine
