"""Smear is told from halo, wing and streak, and held against the light of the columns that make
it.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from charact.estimators.bloom import read_point_stacks, smear_measurement
from charact.method import Context
from tests.truth.bloom import bloom_session
from tests.truth.bloom_light import BloomScene

QUICK = Context(seed=1, quick=True)
LEVELS = (0.5, 30.0, 300.0, 3e3)


def smear_of(scene, rng, overloads=LEVELS) -> Any:
    row, col = scene.centre
    spots = read_point_stacks(bloom_session(scene, overloads, rng), context=QUICK)
    return smear_measurement(
        tuple(replace(one, row=row, col=col) for one in spots), QUICK, method="test"
    )[0]


@pytest.mark.parametrize(
    "settings",
    [
        {"smear_fraction": 1e-3},
        {
            "smear_fraction": 1e-3,
            "wing_share": 0.1,
            "halo_fraction": 0.3,
            "halo_elastic_share": 0.0,
        },
        {"smear_fraction": 1e-2, "full_well_dn": 4000.0, "col": 60.3, "row": 70.0},
    ],
    ids=["alone", "among wing and peaked halo", "beside a streak"],
)
def test_the_fraction_is_unbiased_and_its_interval_honest(seed, settings):
    rng, scene, pulls = np.random.default_rng(seed), BloomScene(frames=4, **settings), []
    for _ in range(5):
        found = smear_of(scene, rng)
        assert found.status == "ok", found
        pulls.append(
            (found.value - scene.smear_fraction)
            / (0.5 * (found.interval68[1] - found.interval68[0]))
        )
    assert max(np.abs(pulls)) < 4.0
    assert abs(np.mean(pulls)) < 4.0 / np.sqrt(5)


def test_without_smear_the_number_is_refused_with_its_bound(seed):
    for scene in (
        BloomScene(frames=4),
        BloomScene(frames=4, wing_share=0.2, halo_elastic_share=1.0),
    ):
        found = smear_of(scene, np.random.default_rng(seed))
        assert found.status != "ok" and (found.reason is None or "at most" in found.reason)


def test_a_streak_over_the_whole_column_is_not_called_smear(seed):
    found = smear_of(
        BloomScene(frames=4, full_well_dn=250.0), np.random.default_rng(seed), (0.5, 3e2, 3e3)
    )
    assert found.status == "refused" and "streak" in found.reason


def test_one_full_column_among_shorter_ones_is_not_called_smear(seed):
    """A core whose middle column spills to the frame's ends and whose outer ones do not."""
    scene = BloomScene(frames=4, full_well_dn=272.0, core_sigma_px=1.73, halo_fraction=0.15)
    found = smear_of(scene, np.random.default_rng(seed), (0.4, 4.0, 40.0))
    assert found.status == "refused", found


def test_a_plate_that_tires_is_not_taken_for_less_smear(seed):
    """Light on the columns no longer follows the stated light: never a number that passes for
    sure.
    """
    scene = BloomScene(frames=4, smear_fraction=3e-3, plate_saturation_dn=2000.0)
    assert smear_of(scene, np.random.default_rng(seed), (0.5, 30.0, 300.0, 3e3, 3e4)).status != "ok"


def test_a_core_that_all_levels_saturate_has_no_known_light(seed):
    found = smear_of(
        BloomScene(frames=2, smear_fraction=1e-3), np.random.default_rng(seed), (30.0, 300.0)
    )
    assert found.status == "refused" and "saturates" in found.reason


def test_one_stack_alone_proves_no_proportion(seed):
    found = smear_of(
        BloomScene(frames=4, smear_fraction=1e-3), np.random.default_rng(seed), (0.5, 3e3)
    )
    assert "extrapolated" in found.flags
