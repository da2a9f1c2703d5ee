"""Which targets of a frame are measured where there are more than may be."""

import pytest

from charact.estimators.mtf import LocatedTarget, spread_over_frame

SHAPE = (400, 600)


def at(row: int, col: int) -> LocatedTarget:
    return LocatedTarget(region=(row - 10, col - 10, 20, 20))


def quarter(target: LocatedTarget) -> tuple[bool, bool]:
    row, col, height, width = target.region
    return row + height / 2 >= SHAPE[0] / 2, col + width / 2 >= SHAPE[1] / 2


CORNER = [at(20 + 20 * i, 20 + 30 * j) for i in range(4) for j in range(5)]
ELSEWHERE = [at(50, 500), at(350, 80), at(350, 500)]


def test_every_part_of_the_frame_has_its_say_before_any_has_two() -> None:
    chosen = spread_over_frame([*CORNER, *ELSEWHERE], SHAPE, 4)[:4]
    assert {quarter(one) for one in chosen} == {
        (down, right) for down in (False, True) for right in (False, True)
    }


@pytest.mark.parametrize("max_targets", [1, 2, 3, 7, 24, 100])
def test_nothing_is_lost_and_the_best_comes_first(max_targets: int) -> None:
    found = [*CORNER, *ELSEWHERE]
    ordered = spread_over_frame(found, SHAPE, max_targets)
    assert ordered[0] == found[0]
    assert sorted(one.region for one in ordered) == sorted(one.region for one in found)
