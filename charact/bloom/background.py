"""The even light behind a source, read where its own light has ended."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.polar import SECTORS
from charact.bloom.source_view import SourceView

Array = NDArray[np.float64]

# Share of the farthest ring from which on the light is taken for background, if it falls no more beyond.
OUTER = 0.6
# Standard errors, and share of itself, by which the outer half may be darker than the inner one.
FALLS_ERRORS, FALLS_SHARE = 4.0, 0.05
# A level of twice the background is no level where the background is not above the dark by this, DN and errors.
LEAST_DN, LEAST_ERRORS = 0.25, 5.0


@dataclass(frozen=True, kw_only=True)
class Background:
    """Light far from the source over dark and its standard error, DN, and whether it is even there."""

    level_dn: float
    sd_dn: float
    even: bool

    @property
    def lit(self) -> bool:
        """Whether it is clearly above the dark level."""
        return self.level_dn > max(LEAST_DN, LEAST_ERRORS * self.sd_dn)


def background_of(view: SourceView) -> Background:
    """Read the background from the sectors of the outermost rings, each median so that other sources do not count."""
    first = int(OUTER * view.polar.rings)
    half = (first + view.polar.rings) // 2
    inner, outer = _level(view, slice(first, half)), _level(view, slice(half, None))
    level, sd = _level(view, slice(first, None))
    falls = inner[0] - outer[0]
    even = falls < max(FALLS_ERRORS * float(np.hypot(inner[1], outer[1])), FALLS_SHARE * abs(level), 0.1)
    return Background(level_dn=level, sd_dn=sd, even=bool(even))


def _level(view: SourceView, rings: slice) -> tuple[float, float]:
    """Median of the sectors' means over some rings, and its standard error."""
    total, count = view.rings.total[rings].sum(axis=0), view.rings.count[rings].sum(axis=0)
    means = total[count > 0] / count[count > 0]
    middle = float(np.median(means))
    spread = 1.4826 * float(np.median(np.abs(means - middle)))
    return middle, 1.25 * spread / np.sqrt(max(len(means), 1)) + 0.01 / np.sqrt(SECTORS)
