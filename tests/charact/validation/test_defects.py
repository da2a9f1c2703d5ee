"""Defects that a lab would mind are noticed by a number that names them, and sets without defects
pass.
"""

import re
from collections.abc import Mapping

import numpy as np
import pytest

from charact.validation import GROUPS, SCORES, VALIDATION, Numbers, Statistic, ValidationTest
from tests.charact.validation.bench_sets import BenchSets
from tests.charact.validation.defects import DEFECTS, Defect

DRAWS = VALIDATION.draws
# One defect for each group of numbers.
OF_GROUP = {
    "level": "gamma of 0.95",
    "photon-transfer": "mean of two frames",
    "linearity": "gamma of 0.95",
    "covariance": "mean of two frames",
    "autocorrelation": "interpolation of 0.25 px",
    "field": "blur of 1.5 px in the corners",
    "noise-spectrum": "rolling hum, 0.2 of the noise",
    "rows-and-columns": "row noise, 0.2 of the noise",
    "histogram": "lowest bit left out",
    "dark-events": "3 cosmic rays a frame, 40 sd",
    "fixed-pattern": "dead column, 0.8 of the signal",
    "defects": "6 hot pixels, 12 sd",
    "shading": "tilt of the light, 3 % over the width",
    "time": "a repeated frame",
    "mtf": "sharpening, 30 % of 1 px",
    "edge": "jitter of rows, 0.3 px",
    "point": "ghost of the point, 2 %",
}


def _names_the_place(statistic: Statistic, defect: Defect) -> bool:
    """Whether a failing statistic is of a group that speaks of the defect, and its worst number of
    a stack with it.
    """
    if statistic.passed or statistic.name not in defect.groups:
        return False
    if statistic.name in ("mtf", "edge", "point"):
        return {"mtf": "edge"}.get(statistic.name, statistic.name) in defect.stacks
    return any(re.search(rf"of {label}\b", statistic.worst) for label in defect.stacks)


def test_each_group_of_numbers_finds_the_defect_that_it_is_for(seed: int) -> None:
    bench = BenchSets("emccd-512", seed=seed, shape=(96, 128))
    # Fewer sets than a validation has: defects of these amounts are far outside.
    test = ValidationTest(_numbers(bench, 12), seed=seed)
    fresh = bench.frames(12)
    found = {}
    for name in set(OF_GROUP.values()):
        numbers = bench.numbers(bench.put(fresh, next(one for one in DEFECTS if one.name == name)))
        found[name] = {one.name: one for one in test.statistics(numbers)}
    assert set(OF_GROUP) == set(GROUPS)
    assert [group for group, name in OF_GROUP.items() if found[name][group].passed] == []
    # A repeated frame says nothing of target and level.
    assert all(
        found["a repeated frame"][group].passed for group in ("level", "mtf", "edge", "point")
    )
    assert found["a repeated frame"]["time"].worst == "largest correlation of two frames of bright"


def _numbers(bench: BenchSets, count: int) -> list[Mapping[str, Numbers]]:
    return [bench.numbers(bench.frames(i)) for i in range(count)]


@pytest.mark.parametrize("camera", ["emccd-512", "pulnix-ag5745ef3"])
def test_nine_of_ten_defects_are_noticed_by_a_number_that_names_them(
    camera: str, seed: int
) -> None:
    bench, fresh = BenchSets(camera, seed=seed), 8
    test = ValidationTest(_numbers(bench, DRAWS), seed=seed)
    sets = [bench.frames(DRAWS + i) for i in range(fresh)]
    defects = [one for one in DEFECTS if bench.has(one)]
    missed = []
    for index, defect in enumerate(defects):
        frames = (
            bench.frames(1000 + index, defect)
            if defect.factors
            else bench.put(sets[index % fresh], defect)
        )
        statistics = test.statistics(bench.numbers(frames))
        named = [one for one in statistics if _names_the_place(one, defect)]
        print(
            f"{defect.name}: "
            f"{'; '.join(f'{one.name}, {one.worst}' for one in named) or 'not noticed'}"
        )
        if not named:
            missed.append(defect.name)
    print(f"{camera}: {len(defects) - len(missed)} of {len(defects)} noticed, not: {missed}")
    assert len(missed) <= len(defects) // 10


def test_sets_without_defects_pass_and_their_p_values_are_no_smaller_than_stated(seed: int) -> None:
    bench = BenchSets("emccd-512", seed=seed)
    sets = _numbers(bench, DRAWS + 40)
    p_values: dict[str, list[float]] = {name: [] for name in (*GROUPS, SCORES)}
    alarms = []
    changes = bench.changes()
    # One ensemble may be narrower than others: three take part.
    for start in (0, DRAWS, 2 * DRAWS):
        inside = range(start, start + DRAWS)
        test = ValidationTest([sets[i] for i in inside], seed=seed, changes=changes)
        outside = [test.statistics(one) for i, one in enumerate(sets) if i not in inside]
        alarms.append(sum(any(not one.passed for one in statistics) for statistics in outside))
        for statistic in (one for statistics in outside for one in statistics):
            p_values[statistic.name].append(statistic.p_value)
    shares = np.array(
        [[np.mean(np.array(p) < at) for at in (0.05, 0.005, 0.5)] for p in p_values.values()]
    )
    for name, share in zip(p_values, shares, strict=True):
        print(
            f"{name}: {share[0]:.3f} below 0.05, {share[1]:.3f} below 0.005, {1.0 - share[2]:.2f} "
            "above 0.5"
        )
    print(f"false alarms of 40 sets: {alarms}")
    # 1 % of 120 sets alarm; 5 or more by chance in fewer than 1 of 100 runs, and the ensembles
    # share their sets.
    assert sum(alarms) <= 6
    # Sets of one ensemble are correlated: 16 statistics of three ensembles are known to some 2 %.
    assert shares[:, 0].mean() < 0.07
    assert shares[:, 1].mean() < 0.015
    assert shares[:, 0].max() < 0.2
