"""Where the halo ends, from the steepest step of the radial profiles alone."""

import numpy as np
from numpy.typing import NDArray

from charact.bloom.profile import Profile

Array = NDArray[np.float64]

# The step over this many rings is compared with the steps just inside and outside.
STEP_RINGS = 2
FIRST_RING = 8
STEP_SEEN = 6.0


def step_significance(profile: Profile) -> Array:
    """Return by how many standard errors each ring's step exceeds its neighbours', shape (ring,); 0 where unusable.

    A smooth wing falls ever more slowly, so the step at r is about the mean of those inside and outside; at the edge
    of a disc it stands out.
    """
    mean, variance, half = profile.mean_dn, profile.sd_dn**2, STEP_RINGS
    out = np.zeros(len(mean))
    for ring in range(FIRST_RING, len(mean) - 3 * half):
        places = ring + half * np.array([-3, -1, 1, 3])
        if not profile.used[places[0] : places[3] + 1].all():
            continue
        weight = np.array([-0.5, 1.5, -1.5, 0.5])
        out[ring] = weight @ mean[places] / np.sqrt(weight**2 @ variance[places])
    return out


def edge_radius(profile: Profile) -> tuple[float, float]:
    """Return the radius where the profile falls most steeply at its most significant step, and the significance."""
    score = step_significance(profile)
    top = int(np.argmax(score))
    if score[top] <= 0:
        return float("nan"), 0.0
    near = np.arange(max(FIRST_RING, top - 4), min(len(score) - 2, top + 5))
    near = near[profile.used[near - 1] & profile.used[near + 1]]
    fall = profile.mean_dn[near - 1] - profile.mean_dn[near + 1]
    best = int(np.argmax(fall))
    if not 0 < best < len(near) - 1:
        return float(profile.radius_px[near[best]]), float(score[top])
    left, middle, right = fall[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float(profile.radius_px[near[best]] + np.clip(shift, -0.5, 0.5)), float(score[top])


def first_radius(profiles: list[Profile]) -> tuple[float, float]:
    """Return the edge of the level that shows it best, and its significance."""
    found = [edge_radius(profile) for profile in profiles]
    return max(found, key=lambda one: one[1]) if found else (float("nan"), 0.0)
