"""Light that slopes: one share of what both sides get where black is known, each side by itself
where it is not.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf.edge.parametric import edge_parametric
from charact.estimators.mtf.edge.pixels.prepare_edge import prepare_edge
from charact.estimators.mtf.edge.pixels.profile import UNEVEN_PER_PX
from charact.estimators.mtf.edge.thresholds import THRESHOLDS
from charact.estimators.mtf.mean_frame import usable_black_level
from charact.method import Context
from tests.truth.blur import TrueBlur
from tests.truth.edge import EdgeScene

DISTANCE = np.linspace(-30.0, 40.0, 141)
DARK, BRIGHT, BLACK = 900.0, 2400.0, 200.0


@pytest.fixture(scope="module")
def profile():
    scene = EdgeScene(rows=60, cols=60)
    edge = prepare_edge(scene.frames_drawn(np.random.default_rng(0)), None, Context(quick=True))
    return replace(edge.profile, dark=DARK, bright=BRIGHT, black=BLACK, distance=DISTANCE)


@pytest.mark.parametrize("share_per_px", [-3e-3, 2e-4])
def test_one_light_on_both_sides_slopes_in_the_first_way_alone(profile, share_per_px):
    """Light that gains a share per pixel makes ramps of that share of either level over black."""
    ramp = share_per_px * np.where(
        DISTANCE > 0, (BRIGHT - BLACK) * DISTANCE, (DARK - BLACK) * DISTANCE
    )
    level, together, apart = np.linalg.lstsq(profile.levels, 500.0 + ramp, rcond=None)[0]
    assert level == pytest.approx(500.0, rel=1e-12)
    assert apart == pytest.approx(0.0, abs=1e-9 * abs(together))
    sides = np.array([together, apart]) @ profile.gradient_ways
    assert sides == pytest.approx(share_per_px * np.array([BRIGHT - BLACK, DARK - BLACK]), rel=1e-9)


def test_the_bright_side_slopes_as_much_as_asked_and_the_dark_one_with_it(profile):
    """Under the prior: the sides' deviations, and a correlation that leaves stray light some
    room.
    """
    variance = (profile.slopes_sd(UNEVEN_PER_PX) / profile.step) ** 2
    covariance = profile.gradient_ways.T @ np.diag(variance) @ profile.gradient_ways
    ratio = (DARK - BLACK) / (BRIGHT - BLACK)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(
        UNEVEN_PER_PX, rel=THRESHOLDS.gradient_asymmetry**2
    )
    assert covariance[0, 1] / covariance[0, 0] == pytest.approx(
        ratio, rel=2 * THRESHOLDS.gradient_asymmetry**2
    )
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert 0.7 < correlation < 0.99


@pytest.mark.parametrize(
    ("dark_dn", "black_dn", "asymmetry"),
    [(DARK, None, 1.0), (DARK, 2500.0, 1.0), (BLACK - 1.0, BLACK, THRESHOLDS.gradient_asymmetry)],
)
def test_without_a_black_or_light_on_the_dark_side_each_side_slopes_by_itself(
    profile, dark_dn, black_dn, asymmetry
):
    """No black, or one above the light: no share of what a side gets can be told; a dark side
    hardly slopes.
    """
    own = replace(profile, dark=dark_dn, black=black_dn)
    assert np.array_equal(own.gradient_ways, np.eye(2))
    assert own.slopes_sd(UNEVEN_PER_PX) / own.step == pytest.approx(
        [UNEVEN_PER_PX, asymmetry * UNEVEN_PER_PX]
    )


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
