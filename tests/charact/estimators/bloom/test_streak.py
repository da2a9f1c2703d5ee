"""The bright column: as long as charge in and charge a well holds say, seen as overflow only where
wells overflow.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from charact.estimators.bloom import read_point_stacks, streak_measurements, streak_of
from charact.method import Context
from tests.truth.bloom import bloom_session, noiseless_frame
from tests.truth.bloom_light import BloomScene

QUICK = Context(seed=1, quick=True)


def spots_of(scene, overloads, rng):
    """Spots at the place where the source is: finding it is tested elsewhere."""
    row, col = scene.centre
    return tuple(
        replace(one, row=row, col=col)
        for one in read_point_stacks(bloom_session(scene, overloads, rng), context=QUICK)
    )


def measured(spot) -> Any:
    return streak_measurements(spot, QUICK, method="test")


def rows_above(scene, overload):
    column = noiseless_frame(scene, overload)[:, round(scene.centre[1])]
    return float((column >= scene.dark_dn + 0.5 * scene.span_dn).sum())


@pytest.mark.parametrize(
    "settings",
    [{}, {"full_well_dn": 220.0}, {"full_well_dn": 900.0, "smear_fraction": 2e-3, "col": 50.2}],
    ids=["no overflow", "wells below full scale", "drain and smear"],
)
def test_the_bright_column_is_as_long_as_that_of_the_noiseless_picture(seed, settings):
    """Within two pixels at every level, and inside the interval as often as it says."""
    rng, overloads = np.random.default_rng(seed), (3.0, 10.0, 30.0, 100.0, 3e3)
    scene, missed, tried = BloomScene(frames=4, **settings), 0, 0
    for _ in range(4):
        for overload, spot in zip(overloads, spots_of(scene, overloads, rng), strict=True):
            (length, _) = measured(spot)
            true = rows_above(scene, overload)
            low, high = length.interval95
            missed, tried = missed + (not low <= true <= high), tried + 1
            assert abs(length.value - true) <= 2.0 + 1e-6, (overload, true, length.value)
    # Five of a hundred may miss: fewer than this many but for one run in a thousand.
    assert missed <= 5, (missed, tried)


def test_a_streak_is_seen_where_wells_overflow_and_nowhere_else(seed):
    rng = np.random.default_rng(seed)
    levels = (3.0, 30.0, 300.0, 1e4)
    for scene in (BloomScene(frames=2), BloomScene(frames=2, smear_fraction=1e-3, row=40.0)):
        for spot in spots_of(scene, levels, rng):
            assert not streak_of(spot, QUICK).overflows, (scene, spot.label)
    for spot in spots_of(BloomScene(full_well_dn=260.0, frames=2), (20.0, 30.0), rng):
        assert streak_of(spot, QUICK).overflows, spot.label


def test_the_level_of_a_streak_is_that_of_full_wells(seed):
    scene = BloomScene(full_well_dn=190.0)
    (spot,) = spots_of(scene, (20.0,), np.random.default_rng(seed))
    length, level = measured(spot)
    assert length.status == level.status == "ok"
    assert level.interval68[0] - 0.2 < 190.0 < level.interval68[1] + 0.2


def test_a_streak_at_the_highest_code_says_that_wells_hold_more(seed):
    (spot,) = spots_of(BloomScene(full_well_dn=400.0), (30.0,), np.random.default_rng(seed))
    level = measured(spot)[1]
    assert level.flags == ("clipped",) and level.value == pytest.approx(243.0, abs=0.5)


def test_a_streak_that_leaves_the_frame_says_so(seed):
    (spot,) = spots_of(BloomScene(full_well_dn=300.0), (300.0,), np.random.default_rng(seed))
    length, level = measured(spot)
    assert "window-too-small" in length.flags
    assert level.status == "refused" and "look alike" in level.reason


def test_each_field_of_an_interlaced_frame_overflows_by_itself(seed):
    """The even rows are one picture, the odd ones another with shorter streaks: the rows of both
    are counted.
    """
    rng = np.random.default_rng(seed)
    scene = BloomScene(full_well_dn=220.0, rows=200, frames=4)
    (long, short) = spots_of(scene, (30.0, 10.0), rng)[::-1]
    image = long.image.copy()
    image[1::2] = short.image[1::2]
    both = replace(long, image=image, frame_streak_px=np.zeros(0))
    rows = 0.5 * (rows_above(scene, 30.0) + rows_above(scene, 10.0))
    streak = streak_of(both, replace(QUICK, interlaced=True))
    assert streak.length_px == pytest.approx(rows, abs=2.0)
    assert streak.overflows and streak.level_dn == pytest.approx(220.0, abs=1.0)
