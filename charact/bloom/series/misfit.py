"""By what share of the light the rings of a form are off: about the core, and beyond it.

Rings about the core are a few pixels of steep light each: that a camera is not round shows there ten times more than
where a hundred pixels average it away. One share for all would be that of the many rings beyond, and take the few by
which the light of a core is compared with that of its halo for much surer than they are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Rings up to here are about the core, column pitches: some 20 pixels each at most.
ABOUT_CORE_PX = 4.0
# All shares tried.
SHARES = np.concatenate([[1e-5], np.geomspace(5e-4, 0.2, 14)])


@dataclass(frozen=True, kw_only=True)
class Misfit:
    """Share of the light by which rings are off in every form, as cameras are not round.

    Parameters
    ----------
    share
        Of rings beyond the core, dimensionless.
    core
        Of rings about the core, no less than of the others, dimensionless.
    """

    share: float
    core: float

    def of_rings(self, radius_px: Array) -> Array:
        """Return the share of each ring, shape (ring,)."""
        return np.where(about_core(radius_px), self.core, self.share)


# What is guessed at first.
FIRST_MISFIT = Misfit(share=0.02, core=0.02)


def about_core(radius_px: Array) -> NDArray[np.bool_]:
    """Return which rings are about the core, shape (ring,)."""
    return radius_px < ABOUT_CORE_PX


@dataclass(frozen=True, kw_only=True)
class Modes:
    """Noise of some rings over their light, taken apart.

    Parameters
    ----------
    variance
        Of each mode, shape (level, mode).
    modes
        Shape (level, ring, mode).
    """

    variance: Array
    modes: Array

    def log_likelihoods(self, residual: Array) -> Array:
        """Log-likelihood of the rings' residuals over their light, (level, ring), with each share, shape (share,)."""
        squares = (self.modes.transpose(0, 2, 1) @ residual[..., None])[..., 0] ** 2
        total = self.variance + SHARES[:, None, None] ** 2
        return -0.5 * (squares / total + np.log(total)).sum(axis=(1, 2))


def modes_of(covariance: Array) -> Modes:
    """Take a covariance over the light of the rings apart, shape (level, ring, ring)."""
    variance, modes = np.linalg.eigh(covariance)
    return Modes(variance=np.maximum(variance, 0.0), modes=modes)


def most_likely_misfit(of_core: Array, beyond: Array) -> tuple[Misfit, float]:
    """Return the likeliest shares of the rings about the core and of those beyond, and the log-likelihood of both.

    Parameters
    ----------
    of_core, beyond
        Log-likelihoods with each share, shape (share,).
    """
    share = int(np.argmax(beyond))
    # Of few rings, to which the core was fitted besides, chance makes some look surer than all those beyond.
    core = share + int(np.argmax(of_core[share:]))
    return Misfit(share=float(SHARES[share]), core=float(SHARES[core])), float(beyond[share] + of_core[core])
