"""Halo diameter from the steepest step of the radial profiles alone."""

from typing import Any

import numpy as np

from charact.bloom.blooms import provenance
from charact.bloom.edge import STEP_SEEN, edge_radius
from charact.bloom.finish import finished
from charact.bloom.profile import profile_of, reach_of
from charact.bloom.spot import DETECTED, read_spots
from charact.method import Context, register
from labdata.measurement import Measurement, Result, from_sd, refused
from labdata.session import Session

METHOD = "radial-profile"
# The steepest step of a blurred rim lies within about half a pixel of its edge.
RADIUS_SD_PX = 0.5


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "bloom_diameter", "streak_length"),
    scope="Halos of 16 to 90 px with a sharp edge; blur moves the steepest step by a fraction of a pixel.",
)
def radial_profile(session: Session, *, context: Context) -> Result:
    """Measure extents, and the halo from the steepest step of each profile.

    Parameters
    ----------
    session
        Session with stacks of kind "point".
    context
        Seed and settings.
    """
    spots = read_spots(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    profiles = [profile_of(s, reach_of(s), context=context) for s in spots if s.significance > DETECTED]
    seen = [(radius, score) for radius, score in map(edge_radius, profiles) if score > STEP_SEEN]
    out = [_halo(seen, **fields)]
    return finished(session, spots, out, {}, context=context, **fields)


def _halo(seen: list[tuple[float, float]], **fields: Any) -> Measurement:
    """One diameter of all levels that show an edge, each weighted by how clearly."""
    if not seen:
        reason = "no profile has a step that stands out of its noise: no halo is visible"
        return refused("halo_diameter", "px", reason, **fields)
    radius, weight = np.array(seen).T
    mean = float(np.average(radius, weights=weight**2))
    scatter = float(np.sqrt(np.average((radius - mean) ** 2, weights=weight**2) / len(seen)))
    apart = radius.max() - radius.min() > 6.0 * RADIUS_SD_PX
    return from_sd("halo_diameter", "px", 2 * mean, 2 * float(np.hypot(scatter, RADIUS_SD_PX)),
                   flags=("model-misfit",) if apart else (), **fields)  # fmt: skip
