"""Lamps too small for rays are in the picture, with the light that reaches the lens."""

import numpy as np
import pytest

from simulate.radiance.transport.allotment import Rays
from simulate.radiance.transport.effort import Effort
from simulate.radiance.transport.picture import picture
from simulate.radiance.world.shapes import shape
from simulate.radiance.world.viewpoint import Viewpoint
from tests.simulate.radiance.staging import at, lamp, staged, upright


def test_a_lamp_whose_light_on_surfaces_is_left_out_is_seen_all_the_same():
    wall = at(upright(shape("plane", (100.0, 100.0))), 0.0, 20.0, 0.0)
    stage = staged([("wall", "grey", wall)], {"grey": 0.5}, lamps=(lamp((0.1, 10.0, 0.1), 3.0),))
    view = Viewpoint(position_m=(0.0, 0.0, 0.0), forward=(0.0, 1.0, 0.0), shape=(12, 16), focal_px=(20.0, 20.0))
    effort = Effort(bounces=0, hidden_sky=False, left_out=frozenset({"lamp"}))
    seen = picture(stage, view, Rays(shared=None), effort, weight=np.ones(2), seed=1).cube.radiance[0]
    row, col = (axis.ravel() + 0.5 for axis in np.indices(view.shape))
    at_the_lens = np.sum(seen.ravel() * view.solid_angle_sr(row, col))
    assert np.count_nonzero(seen) == 1
    assert at_the_lens == pytest.approx(3.0 / (10.0**2 + 2 * 0.1**2), rel=0.01)
