"""How the noise of an edge grows with the light: between neighbours, from frame to frame, or of single pixels."""

import numpy as np

from charact.method import Context
from charact.mtf.edge.pixels.prepare_edge import PreparedEdge
from charact.mtf.nonlinearity import (
    PlateauNoiseRatio,
    covariance_ratio,
    ln_bayes_factor_nonlinear,
    variance_ratio,
)

# Level over noise beyond which unequal pixels may be the noise.
QUIETEST = 80.0


def growth_of(edge: PreparedEdge) -> PlateauNoiseRatio:
    """Return how the noise of an edge grows with the light, from frame to frame where there are several that differ."""
    black = edge.profile.black
    found = edge.plateau_noise and covariance_ratio(edge.plateau_noise, black)
    if found:
        return found
    if (
        len(edge.used.data) == 1
        or edge.plateau_noise is None
        or not max(one.variance for one in edge.plateau_noise) > 0
    ):
        return _single_frame_growth(edge)
    return variance_ratio(edge.plateau_noise, black)


def edge_ln_bayes_factor_nonlinear(edge: PreparedEdge, context: Context) -> float:
    """Return ln of how much likelier the noise is under a curved response; a described camera's is straight: -inf."""
    return ln_bayes_factor_nonlinear(growth_of(edge)) if context.sensor is None else -np.inf


def _single_frame_growth(edge: PreparedEdge) -> PlateauNoiseRatio:
    """Return how the variance of a single frame's pixels grows."""
    profile = edge.profile
    grain = profile.grain
    pixels = 0.5 * np.count_nonzero(profile.gathered.used) / max(grain.covariance_over_variance, 1.0)
    photons = None
    if profile.black is not None and profile.dark > profile.black:
        bright_dn = profile.bright - profile.black
        if bright_dn < QUIETEST * np.sqrt(grain.bright_variance):
            photons = bright_dn / (profile.dark - profile.black)
    return PlateauNoiseRatio(
        ratio=grain.bright_variance / grain.dark_variance,
        # A variance of n pixels scatters by the root of 2/n, a ratio of two by that of 4/n.
        scatter=float(np.sqrt(4.0 / max(pixels, 1.0))),
        photon_ratio=photons,
    )
