"""Light that slopes across an edge: by about one share on both sides, as one lamp makes it where black is known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Share of the step in a pixel by which light slopes on either side: in a good set-up, a fair and a poor one.
EVEN_PER_PX, SLIGHT_PER_PX, UNEVEN_PER_PX = 4e-5, 3e-4, 2e-3
# Share of a slope by which the sides may depart from one light on both: stray light falls on them alike.
APART = 0.2


@dataclass(frozen=True, kw_only=True)
class IlluminationGradient:
    """The two ways in which the light of an edge slopes.

    Parameters
    ----------
    ways
        Slopes of bright and dark side in each way, unit vectors, shape (way, side).
    together
        Whether the first way is that of one light on both sides; otherwise each side slopes by itself.
    """

    ways: Array
    together: bool

    def levels(self, distance_px: Array) -> Array:
        """Return a level and both ways of slopes at distances from the edge, shape (distance, 3), px."""
        sides = np.stack([np.maximum(distance_px, 0.0), np.minimum(distance_px, 0.0)], axis=1)
        return np.concatenate([np.ones((distance_px.size, 1)), sides @ self.ways.T], axis=1)

    def slopes_sd(self, slope_sd_per_px: float) -> Array:
        """Return the deviations of the priors of both ways from that of the bright side's slope, in its unit."""
        apart = max(APART * slope_sd_per_px, EVEN_PER_PX) if self.together else slope_sd_per_px
        return np.array([slope_sd_per_px / self.ways[0, 0], apart])

    def by_side(self, amplitude: Array) -> Array:
        """Return amplitudes that end with the slopes of bright and dark side for those that end with both ways'."""
        return np.concatenate([amplitude[:-2], amplitude[-2:] @ self.ways])


def uneven_light(dark_dn: float, bright_dn: float, black_dn: float | None) -> IlluminationGradient:
    """Return how light slopes on an edge between two levels.

    Parameters
    ----------
    black_dn
        Code at no light, as `believed_black` gives it; None: not known, and with it how much light either side gets.

    Notes
    -----
    A lamp's unevenness and a lens's shading multiply light: sides a and b over black slope by the same share of a and
    of b.
    """
    if black_dn is None or not bright_dn > max(dark_dn, black_dn):
        return IlluminationGradient(ways=np.eye(2), together=False)
    bright, dark = bright_dn - black_dn, max(dark_dn - black_dn, 0.0)
    return IlluminationGradient(
        ways=np.array([[bright, dark], [-dark, bright]]) / np.hypot(bright, dark), together=True
    )
