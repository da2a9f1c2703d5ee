"""What the noise of an edge's two sides says of the response."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import prepare_edge
from charact.estimators.mtf.edge import nonlinearity
from charact.estimators.mtf.edge.pixels import plateau_noise
from charact.method import Context
from tests.truth import EdgeScene, PulseEdge, TrueBlur

STRAIGHT = EdgeScene(
    blur=TrueBlur(sigma_px=1.0),
    rows=110,
    cols=110,
    angle_deg=8.0,
    dark_dn=1300.0,
    bright_dn=2800.0,
    snr=20.0,
    shot_share=1.0,
    black_dn=200.0,
    full_scale_dn=3080.0,
)


PULSES = PulseEdge(
    blur=TrueBlur(sigma_px=1.0),
    photoelectrons=8.0,
    bright_dn=160.0,
    dark_share=0.2,
    read_dn=0.5,
    frames=16,
    rows=90,
    cols=90,
    full_scale_dn=1023.0,
)


def edges(scene, seed, count=10):
    """Edges found in drawings of a scene."""
    drawn = (scene.frames_drawn(np.random.default_rng([seed, n])) for n in range(count))
    return [prepare_edge(stack, None, Context(quick=True)) for stack in drawn]


@pytest.mark.parametrize(
    ("gamma", "shot_share", "told"),
    [(1.0, 1.0, 0), (1.3, 1.0, 10), (1.8, 0.8, 10)],
    ids=["straight", "1.3", "1.8"],
)
def test_noise_that_rises_faster_than_light_is_a_curved_response(gamma, shot_share, told, seed):
    """Photons' variance grows as the level over black; of 10 frames at most one is told wrongly."""
    found = edges(replace(STRAIGHT, gamma=gamma, shot_share=shot_share), seed)
    flagged = sum(plateau_noise.noise_flags(edge.noise_growth) == ("gamma",) for edge in found)
    assert abs(flagged - told) <= 1


@pytest.mark.parametrize("shot_share", [1.0, 0.8, 0.0])
def test_growth_is_that_of_the_light(shot_share, seed):
    """Photons' share of the variance grows as 2600 to 1100 DN over black, read noise not at all."""
    found = [edge.noise_growth for edge in edges(replace(STRAIGHT, shot_share=shot_share), seed)]
    bright, dark = (shot_share * level / 1850.0 + 1.0 - shot_share for level in (2600.0, 1100.0))
    ratios = np.array([growth.ratio for growth in found])
    scatter = np.mean([growth.scatter for growth in found])
    assert found[0].photon_ratio == pytest.approx(2600.0 / 1100.0, rel=0.02)
    assert np.log(ratios).mean() == pytest.approx(
        np.log(bright / dark), abs=4 * scatter / np.sqrt(len(found))
    )
    # The root of twice the degrees of freedom is the relative error of a standard deviation.
    assert np.log(ratios).std(ddof=1) == pytest.approx(
        scatter, rel=4 / np.sqrt(2 * (len(found) - 1))
    )


def test_noise_that_grows_as_photons_do_speaks_for_a_straight_response(seed):
    odds = [
        nonlinearity.ln_bayes_factor_nonlinear(edge.noise_growth)
        for edge in edges(replace(STRAIGHT, shot_share=0.8), seed)
    ]
    assert np.mean(odds) < -0.5
    assert max(odds) < 1.0


@pytest.mark.parametrize("unknown", ["black", "quiet"])
def test_noise_says_nothing_where_it_may_be_something_else(unknown, seed):
    """No black, pixels so quiet that unequal gain is seen."""
    edge = edges(replace(STRAIGHT, snr=70.0) if unknown == "quiet" else STRAIGHT, seed, count=1)[0]
    black = None if unknown == "black" else edge.profile.black
    growth = replace(edge, profile=replace(edge.profile, black=black)).noise_growth
    assert growth.photon_ratio is None
    assert nonlinearity.ln_bayes_factor_nonlinear(growth) == 0.0


@pytest.mark.parametrize(
    ("gamma", "frames", "told"),
    [(1.0, 16, 0), (1.25, 16, 3), (0.8, 16, 3), (1.0, 1, 0), (0.5, 1, 3), (2.0, 1, 3)],
)
def test_pulses_tell_a_curved_response(gamma, frames, told, seed):
    """What neighbours share grows as the light, neither more nor less, whatever the fixed pattern
    and the flicker.
    """
    more = {"pattern": 0.1, "flicker": 0.1} if frames > 1 else {}
    found = [
        edge.noise_growth
        for edge in edges(replace(PULSES, gamma=gamma, frames=frames, **more), seed, count=3)
    ]
    # A response that steepens may leave the dark side too little for that; the variance tells it
    # then.
    assert all(one.of_light for one in found) or gamma > 1.0
    assert abs(sum(plateau_noise.noise_flags(one) == ("gamma",) for one in found) - told) <= 1


@pytest.mark.parametrize("row_noise_dn", [0.0, 3.0])
def test_what_neighbours_share_is_light_and_nothing_that_a_row_has_in_common(row_noise_dn, seed):
    """Read-out's noise of 8 DN, white or of whole rows besides: the ratio stays that of the
    light.
    """
    found = [
        one.noise_growth
        for one in edges(replace(PULSES, read_dn=8.0, row_noise_dn=row_noise_dn), seed, count=4)
    ]
    away = np.array(
        [np.log(one.ratio / one.photon_ratio) / one.scatter for one in found if one.of_light]
    )
    assert len(away) == 4
    assert away.mean() == pytest.approx(0.0, abs=4.0 / np.sqrt(4))
    # Chi squared of three is above 15.9 once in a thousand.
    assert away.std(ddof=1) < 2.3
