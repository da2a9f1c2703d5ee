"""Whether the stacks of a point series belong together, and the frames of each: gain, dark, place and light at rest.

What a bright source does to the rest of the picture and to later frames is measured here; where it spoils the numbers
of a stack, or of the halo that all stacks share, flags say so.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.bloom.background_depression import (
    dark_level_error,
    depressions,
    faintest,
    has_background_fallen,
    is_dark_inconsistent,
)
from charact.bloom.over_time import FrameSeries, frame_series
from charact.bloom.point_stack import DETECTED, PointStack
from charact.bloom.recovery import frames_before_switch_off, recoveries
from charact.bloom.stationarity import relative_drift, travel_px
from charact.method import Context
from labdata.measurement import Measurement
from labdata.session import Session

# Least side of a frame that holds a source and a background beside it, px.
LEAST_SIDE_PX = 24


@dataclass(frozen=True, kw_only=True)
class SeriesConsistency:
    """What does not stay as it is in a series.

    Parameters
    ----------
    flags
        Flags of each stack's measurements, by label; empty where nothing changes.
    measurements
        Background depression of every stack but the faintest, and recovery times.
    evidence
        What the report draws.
    """

    flags: dict[str, tuple[str, ...]]
    measurements: tuple[Measurement, ...]
    evidence: dict[str, dict[str, Any]]

    @property
    def halo_flags(self) -> tuple[str, ...]:
        """Flags of what all stacks share."""
        return tuple(sorted({flag for flags in self.flags.values() for flag in flags}))


def check_consistency(
    session: Session, spots: tuple[PointStack, ...], context: Context, **fields: Any
) -> SeriesConsistency:
    """Follow a series from stack to stack and from frame to frame.

    Parameters
    ----------
    session
        Where the frames of the spots are, each stack read once more, and the dark ones.
    spots
        Its point sources.
    context
        Seed and pitches.
    fields
        Method and provenance of the measurements.

    Notes
    -----
    Flags: `agc` where the background falls below that of the faintest stack at the same settings; `drift` where the
    source moves, or light or background run off; `lag` where the source goes out and what follows is its afterglow;
    `dark-mismatch` where noise says that the level without light is not that of the dark frames, or the background is
    below it. Afterglow of a source at rest changes no mean and is not flagged.
    """
    ratio = context.pitch_ratio
    shown = [spot for spot in spots if spot.significance >= DETECTED and min(spot.image.shape) >= LEAST_SIDE_PX]
    watched = tuple(frame_series(spot, session.stack(spot.label).read(), ratio) for spot in shown)
    flags: dict[str, tuple[str, ...]] = {spot.label: () for spot in spots}
    flags |= {one.label: _in_time(one) for one in watched}
    for label, told in _between(watched, flags, _dark_variance(session)).items():
        flags[label] += told
    # A source that leaves its place has not gone out.
    still = tuple(one for one in watched if "lag" in flags[one.label])
    out = [*depressions(watched, flags, **fields), *recoveries(still, context.seed, **fields)]
    return SeriesConsistency(
        flags=flags, measurements=tuple(out), evidence={"bloom-constancy": _evidence(watched, flags)}
    )


def _in_time(watched: FrameSeries) -> tuple[str, ...]:
    """Flags of one stack's frames."""
    if travel_px(watched) > 0:
        return ("drift",)
    if frames_before_switch_off(watched) is not None:
        return ("lag",)
    return ("drift",) if relative_drift(watched) > 0 else ()


def _between(
    watched: tuple[FrameSeries, ...], flags: dict[str, tuple[str, ...]], dark_variance: float | None
) -> dict[str, tuple[str, ...]]:
    """Flags of each stack that the others tell."""
    out: dict[str, tuple[str, ...]] = {}
    # A source that moves in one stack may do so, less clearly, in others, and what moves varies as noise does.
    rest = not any("drift" in told for told in flags.values())
    for one in watched:
        fallen = has_background_fallen(faintest(watched, one), one)
        # Stacks of one dark level share its fault.
        same = tuple(other for other in watched if other.dark_dn == one.dark_dn and not flags[other.label])
        misfit = dark_level_error(same, dark_variance) if one.dark_known and rest else None
        below = one.dark_known and one.background_dn < -max(4.0 * one.background_sd_dn, 0.3)
        wrong = below or is_dark_inconsistent(misfit, faintest(watched, one).background_dn)
        out[one.label] = (("agc",) if fallen else ()) + (("dark-mismatch",) if wrong else ())
    return out


def _dark_variance(session: Session) -> float | None:
    """Variance in time of the dark frames, DN^2; None where there are not two."""
    variances = [
        float(stack.data.var(axis=0, ddof=1, dtype=np.float64).mean())
        for entry in session.of_kind("dark")
        if len(stack := entry.read()) > 1
    ]
    return float(np.median(variances)) if variances else None


def _evidence(watched: tuple[FrameSeries, ...], flags: dict[str, tuple[str, ...]]) -> dict[str, Any]:
    """Background of each stack, and place and light of its frames."""
    return {
        "figure": "bloom-constancy",
        "label": [one.label for one in watched],
        "flags": [list(flags[one.label]) for one in watched],
        "background_dn": [one.background_dn for one in watched],
        "background_sd_dn": [one.background_sd_dn for one in watched],
        "time_s": [one.time_s.tolist() for one in watched],
        "row_px": [_finite_or_none(one.centre_px[:, 0]) for one in watched],
        "col_px": [_finite_or_none(one.centre_px[:, 1]) for one in watched],
        "light": [_finite_or_none(one.light_by_frame) for one in watched],
    }


def _finite_or_none(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
