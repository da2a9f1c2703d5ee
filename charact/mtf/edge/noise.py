"""How the noise of an edge grows with the light: between neighbours, from frame to frame, or of single pixels."""

import numpy as np

from charact.method import Context
from charact.mtf.edge.pixels.find import FoundEdge
from charact.mtf.growth import Growth, curved_ln_odds, growth_of_light, growth_of_variance

# Level over noise beyond which unequal pixels may be the noise.
QUIETEST = 80.0


def growth_of(edge: FoundEdge) -> Growth:
    """Return how the noise of an edge grows with the light, from frame to frame where there are several that differ."""
    black = edge.profile.black
    found = edge.shimmer and growth_of_light(edge.shimmer, black)
    if found:
        return found
    if len(edge.used.data) == 1 or edge.shimmer is None or not max(one.variance for one in edge.shimmer) > 0:
        return _of_one(edge)
    return growth_of_variance(edge.shimmer, black)


def bending_ln_odds(edge: FoundEdge, context: Context) -> float:
    """Return ln of how much likelier the noise is under a curved response; a described camera's is straight: -inf."""
    return curved_ln_odds(growth_of(edge)) if context.sensor is None else -np.inf


def _of_one(edge: FoundEdge) -> Growth:
    """Return how the variance of a single frame's pixels grows."""
    profile = edge.profile
    grain = profile.grain
    pixels = 0.5 * np.count_nonzero(profile.gathered.used) / max(grain.covariance_over_variance, 1.0)
    photons = None
    if profile.black is not None and profile.dark > profile.black:
        bright_dn = profile.bright - profile.black
        if bright_dn < QUIETEST * np.sqrt(grain.bright_variance):
            photons = bright_dn / (profile.dark - profile.black)
    return Growth(
        ratio=grain.bright_variance / grain.dark_variance,
        # A variance of n pixels scatters by the root of 2/n, a ratio of two by that of 4/n.
        scatter=float(np.sqrt(4.0 / max(pixels, 1.0))),
        photons=photons,
    )
