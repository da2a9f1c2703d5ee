"""Light that slopes: one share of what both sides get where black is known, each side by itself
where it is not.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import edge_parametric, usable_black_level
from charact.method import Context
from tests.truth import EdgeScene, TrueBlur

DARK, BRIGHT, BLACK = 900.0, 2400.0, 200.0


@pytest.mark.parametrize(
    ("black_dn", "believed"),
    [(None, None), (BLACK, BLACK), (DARK + 100.0, DARK + 100.0), (DARK + 200.0, None)],
)
def test_a_black_well_above_the_dark_side_is_none(black_dn, believed):
    """A tenth of the step, 150 DN, is what noise and another day's dark may make of it."""
    assert usable_black_level(black_dn, DARK, BRIGHT) == believed


def test_known_black_tells_a_halo_from_light_that_slopes(seed):
    """Both raise what is near the edge: errors of the same frames are smaller where black is
    known.
    """
    blur = TrueBlur(form="gaussian", sigma_px=0.94, halo_share=0.16, halo_px=38.0)
    scene = EdgeScene(
        blur=blur,
        rows=134,
        cols=73,
        angle_deg=203.7,
        dark_dn=2000.0,
        bright_dn=3500.0,
        snr=54.0,
        gradient=0.05,
        noise_blur_px=0.9,
        black_dn=BLACK,
        full_scale_dn=65535.0,
    )
    context = Context(quick=True, seed=seed)
    errors = []
    for number in range(8):
        stack = scene.frames_drawn(np.random.default_rng([seed, number]))
        found = [
            edge_parametric(replace(stack, black_level_dn=black), context=context).find("mtf50")[0]
            for black in (BLACK, None)
        ]
        errors.append([abs(one.value / scene.truth_mtf50 - 1.0) for one in found])
    known, unknown = np.mean(errors, axis=0)
    assert known < unknown
