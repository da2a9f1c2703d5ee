"""Edges of intensified cameras: the scene against plain statistics of its own, and what methods
make of it.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf.edge import checks
from charact.method import Context
from tests.truth import PulseEdge, TrueBlur


@pytest.mark.parametrize("seed_of_scene", range(3))
def test_noise_of_two_fields_is_not_taken_for_that_of_one(seed_of_scene, seed):
    """Wide pulses before an interlaced camera: chi squared per bin was 2 to 3.4, its noise told too
    small.
    """
    scene = PulseEdge(
        blur=TrueBlur(sigma_px=1.2),
        pulse_px=0.87,
        photoelectrons=10.0,
        bright_dn=150.0,
        dark_share=0.2,
        frames=8,
        rows=80,
        cols=80,
        angle_deg=20.0 + 3.0 * seed_of_scene,
        interlaced=True,
    )
    found = mtf.measure(
        "edge",
        scene.frames_drawn(np.random.default_rng([seed, seed_of_scene])),
        method="edge-parametric",
        context=Context(quick=True, interlaced=True),
    )
    shown = found.evidence["edge-spread"]
    free = shown["degrees_of_freedom"]
    assert shown["chi_squared"] / free == pytest.approx(1.0, abs=0.1 + 4.0 * np.sqrt(2.0 / free))


@pytest.mark.parametrize("tied", [False, True], ids=["white", "tied"])
def test_rows_that_share_noise_make_no_bow(tied, seed):
    """Of 2,000 straight courses at most 0.6 % are bowed (1.5 % of tied ones before); a bow of 8
    errors is.
    """
    rng = np.random.default_rng(seed)
    course = rng.standard_normal((2000, 96))
    if tied:
        course = course + np.roll(course, 1, axis=1) + np.roll(course, 2, axis=1)
    place = np.linspace(-1.0, 1.0, 96)
    design = np.polynomial.legendre.legvander(place, 1)
    course -= (course @ np.linalg.pinv(design).T) @ design.T
    assert np.mean([checks.bow_of(one) > 0.0 for one in course]) <= 0.006
    error = course.std() * np.sqrt((3.0 if tied else 1.0) / 96 * 5.0)
    bow = 8.0 * error * np.polynomial.legendre.legval(place, [0.0, 0.0, 1.0])
    assert np.mean([checks.bow_of(one + bow) > 0.0 for one in course[:200]]) > 0.95


@pytest.mark.parametrize(
    "scene",
    [
        PulseEdge(
            blur=TrueBlur(form="moffat", moffat_px=2.11, moffat_exponent=1.73),
            pulse_px=0.55,
            photoelectrons=7.86,
            bright_dn=34.5,
            dark_share=0.396,
            gain_spread=0.53,
            read_dn=0.74,
            row_noise_dn=10.7,
            rows=119,
            cols=95,
            frames=16,
            angle_deg=271.75,
            interlaced=True,
        ),
        PulseEdge(
            blur=TrueBlur(form="exponential", frequency_cy_per_px=0.304, exponent=1.95),
            pulse_px=0.55,
            photoelectrons=226.0,
            bright_dn=1226.0,
            dark_share=0.233,
            gain_spread=0.68,
            read_dn=1.9,
            rows=107,
            cols=111,
            frames=8,
            angle_deg=22.4,
        ),
    ],
    ids=["noise of rows", "full scale"],
)
def test_rows_of_noise_and_a_side_of_nothing_but_full_scale_end_in_a_verdict(scene, seed):
    """A profile too short for a slope, and a bright side without noise: a verdict, no traceback."""
    frames = scene.frames_drawn(np.random.default_rng(seed))
    context = Context(quick=True, interlaced=scene.interlaced, full_scale_dn=scene.full_scale_dn)
    found = mtf.measure("edge", frames, method="edge-parametric", context=context).find("mtf50")
    assert all(one.status != "ok" for one in found)
