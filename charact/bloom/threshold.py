"""Halo diameter from bloom diameters alone: against the light they step up to the halo, then hardly grow."""

from typing import Any

import numpy as np

from charact.bloom.blooms import provenance
from charact.bloom.finish import finished
from charact.bloom.spot import Spot, read_spots
from charact.method import Context, register
from labdata.measurement import Measurement, Result, from_sd, refused
from labdata.session import Session

METHOD = "threshold"
# Growth of the plateau with the light, d ln D / d ln light, at most.
PLATEAU = 0.06
# The step: so many times wider, and the squared diameter so many times steeper against ln light than behind it. That of
# a Gaussian core is a straight line, that of a wing bends upward.
STEP, STEEPER = 1.5, 2.0
# The edge of a blurred disc lies on the contour only where the plateau is twice the level, px.
EDGE_SD_PX = 0.7


@register(
    "bloom",
    METHOD,
    quantities=("halo_diameter", "bloom_diameter", "streak_length"),
    scope="Series of stated light, three levels or more of which two lie on the halo's plateau, a factor of a hundred "
    "apart at most; blur of the edge makes the halo seem up to a few pixels wider.",
)
def threshold(session: Session, *, context: Context) -> Result:
    """Measure extents, and the halo from the plateau of the bloom diameter at half of full scale.

    Parameters
    ----------
    session
        Session with stacks of kind "point".
    context
        Seed and settings.

    Notes
    -----
    A core grows as the root of the logarithm of the light, a wing as a power of it; neither ever steps up and then
    stays. Physics reference, 2.1.
    """
    spots = read_spots(session, context=context)
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    out = [_halo(spots, **fields)]
    return finished(session, spots, out, {}, context=context, **fields)


def _halo(spots: tuple[Spot, ...], **fields: Any) -> Measurement:
    """The diameter right after the step, if a plateau follows."""
    usable = [one for one in spots if one.half is not None and not one.half.touches_border and one.half.determined]
    light = [one.conditions.illuminance_lux or 0.0 for one in usable]
    if len(usable) < 3 or not all(light):
        reason = f"a plateau needs three levels or more of stated light with a bloom, got {len(usable)}"
        return refused("halo_diameter", "px", reason, **fields)
    gates = [one.conditions.gate_ns or 1.0 for one in usable]
    dose = np.array(light) * np.array(gates)
    order = np.argsort(dose)
    diameter, log = np.array([one.bloom_px for one in usable])[order], np.log(dose[order])
    apart = np.maximum(np.diff(log), 1e-3)
    growth, steepness = np.diff(np.log(diameter)) / apart, np.diff(diameter**2) / apart
    step = (diameter[1:-1] > STEP * diameter[:-2]) & (growth[1:] < PLATEAU) & (steepness[:-1] > STEEPER * steepness[1:])
    if not step.any():
        reason = "the bloom diameter does not step up to a plateau: no halo shows in it"
        return refused("halo_diameter", "px", reason, **fields)
    after = int(np.flatnonzero(step)[-1]) + 1
    # Between the last level before the edge and the first on it the true edge lies; more light only widens its blur.
    rise = 0.5 * float(diameter[after + 1] - diameter[after])
    return from_sd(
        "halo_diameter", "px", float(diameter[after]) - 0.5 * rise, float(np.hypot(rise, EDGE_SD_PX)), **fields
    )
