"""Steps that look at their own frames: stop when the mean is known well enough, find the light that saturates."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class StopCriterion:
    """When a step may stop before it has all its frames.

    Parameters
    ----------
    mean_within_dn
        Stop when the 95 % interval of the level's mean reaches at most this far to either side, DN.
    least_frames
        Take at least so many frames.
    """

    mean_within_dn: float
    least_frames: int = 8

    def __post_init__(self) -> None:
        if not self.mean_within_dn > 0:
            raise BadInput(f"mean_within_dn must be positive, got {self.mean_within_dn:g}")
        if self.least_frames < 4:
            raise BadInput(f"least_frames must be at least 4, got {self.least_frames}")


@dataclass(frozen=True, kw_only=True)
class SaturationSearch:
    """Find the light at which the level saturates: doubled until it does, then halved in between.

    Parameters
    ----------
    most_illuminance_lux
        Never more light than this, lux.
    within_percent
        Stop when the lowest light that saturates is at most so much above the highest that does not, %.
    """

    most_illuminance_lux: float
    within_percent: float = 10.0

    def __post_init__(self) -> None:
        if not self.most_illuminance_lux > 0:
            raise BadInput(f"most_illuminance_lux must be positive, got {self.most_illuminance_lux:g}")
        if not self.within_percent > 0:
            raise BadInput(f"within_percent must be positive, got {self.within_percent:g}")

    def next_lux(self, begin_lux: float, seen: Sequence[tuple[float, bool]]) -> float | None:
        """Return the light to try next, lux; None when the search is over.

        Parameters
        ----------
        begin_lux
            Light to begin with, lux.
        seen
            Light tried so far, lux, and whether it saturated.
        """
        dark = max((lux for lux, saturated in seen if not saturated), default=None)
        bright = min((lux for lux, saturated in seen if saturated), default=None)
        if not seen:
            return begin_lux
        if bright is None:
            return None if dark == self.most_illuminance_lux else min(2.0 * (dark or 0.0), self.most_illuminance_lux)
        if dark is None:
            # Light goes down as fast as it went up, and never below what any lamp can be set to.
            return bright / 2.0 if bright > begin_lux / 1024.0 else None
        return None if bright <= dark * (1.0 + self.within_percent / 100.0) else math.sqrt(dark * bright)

    def verdict(self, seen: Sequence[tuple[float, bool]]) -> str:
        """Say in a sentence what was found."""
        dark = [lux for lux, saturated in seen if not saturated]
        bright = [lux for lux, saturated in seen if saturated]
        after = f"after {len(seen)} levels"
        if not bright:
            return f"no level up to {max(dark):.4g} lux saturates, {after}"
        if not dark:
            return f"every level down to {min(bright):.4g} lux saturates, {after}"
        return f"saturation begins between {max(dark):.4g} and {min(bright):.4g} lux, {after}"

    def most_levels(self, begin_lux: float) -> int:
        """Return how many levels the search takes at most where its first level does not saturate."""
        doublings = max(0, math.ceil(math.log2(self.most_illuminance_lux / begin_lux)))
        return 1 + doublings + max(0, math.ceil(math.log2(math.log(2.0) / math.log1p(self.within_percent / 100.0))))
