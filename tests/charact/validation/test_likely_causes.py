"""Named changes are compared by the likelihood of all numbers, with a size; what none explains has
no name.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from charact.estimators.noise.findings import COARSE
from charact.validation import VALIDATION, ValidationTest
from charact.validation.ensemble import Ensemble
from charact.validation.likely_causes import (
    Alternative,
    CauseTest,
    LikelyCause,
    alternatives_of,
    likely_causes,
)
from tests.charact.validation.bench_sets import BenchSets
from tests.charact.validation.defects import DEFECTS

SIZE = 12
LABELS = tuple(str(i) for i in range(SIZE))
# Directions in which two changes move the numbers: close to each other, at 37 degrees.
FIRST = np.repeat((1.0, 0.0), SIZE // 2)
SECOND = np.where(np.arange(SIZE) < SIZE // 2, 1.0, 0.75)


def _groups(values: np.ndarray) -> dict[str, dict[str, float]]:
    return {"level": dict(zip(LABELS, values.tolist(), strict=True))}


def _alternative(name: str, direction: np.ndarray, *, power: int = 1) -> Alternative:
    def numbers_at(size: float) -> dict[str, dict[str, float]]:
        return _groups(direction * size**power)

    return Alternative(
        name=name, cause=COARSE, flag="quantised", stacks="all", numbers_at=numbers_at, power=power
    )


ALTERNATIVES = (_alternative("first", FIRST), _alternative("second", SECOND, power=2))


def _causes(
    rng: np.random.Generator, shift: np.ndarray, *, largest_size: float = np.inf
) -> tuple[LikelyCause, ...]:
    """Return the causes named of a set of unit variance that is shifted."""
    sets, measured = rng.standard_normal((VALIDATION.draws, SIZE)), rng.standard_normal(SIZE)
    ensemble = Ensemble(values=sets, least_sd=np.full(SIZE, 1e-6), seed=0)
    test = CauseTest(
        {"level": (LABELS, ensemble)}, _groups(np.zeros(SIZE)), _groups(measured + shift)
    )
    return likely_causes(test, [replace(one, largest_size=largest_size) for one in ALTERNATIVES])


def test_the_change_that_was_made_is_named_with_its_size(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = [_causes(rng, 12.0 * FIRST)[0] for _ in range(20)]
    second = [_causes(rng, 12.0 * SECOND)[0] for _ in range(20)]
    assert sum(cause.name == "first" for cause in first) >= 19
    assert sum(cause.name == "second" for cause in second) >= 19
    # Of 20 sets: an error of a size is 1 over the root of the squares of its direction.
    error = 1.0 / np.linalg.norm(FIRST) / np.sqrt(20.0) * 1.2
    assert np.mean([cause.size for cause in first]) == pytest.approx(12.0, abs=4.0 * error)
    # Numbers that follow the square of a size.
    sizes = [cause.size for cause in second if cause.name == "second"]
    assert np.mean(sizes) == pytest.approx(np.sqrt(12.0), rel=0.05)
    assert all(cause.explained > 0.8 for cause in first)


def test_what_no_change_explains_is_not_named_nor_is_one_of_the_other_sign(seed: int) -> None:
    rng = np.random.default_rng(seed)
    across = np.where(np.arange(SIZE) % 2, 12.0, -12.0)
    assert [_causes(rng, across) for _ in range(10)] == [()] * 10
    assert [_causes(rng, -12.0 * FIRST) for _ in range(10)] == [()] * 10


def test_a_change_larger_than_any_is_no_cause(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for largest, named in ((15.0, ["first"]), (6.0, ["second"]), (2.0, [])):
        causes = _causes(rng, 12.0 * FIRST, largest_size=largest)
        assert [cause.name for cause in causes][:1] == named


@pytest.fixture(scope="module")
def named_cause(seed: int) -> Callable[[str], LikelyCause]:
    """Return the likeliest cause of frames with a defect of the corpus."""
    bench = BenchSets("machine-vision", seed=seed, shape=(96, 128))
    first, further = bench.frames(0), bench.frames(VALIDATION.draws)
    test = ValidationTest([bench.numbers(bench.frames(i)) for i in range(VALIDATION.draws)], seed=1)
    alternatives = [
        replace(one, numbers_at=cache(one.numbers_at))
        for one in alternatives_of(first, bench.chosen, bench.numbers, bench.top)
        if one.stacks != "all stacks"
    ]

    def cause_of(defect: str) -> LikelyCause:
        frames = bench.put(further, next(one for one in DEFECTS if one.name == defect))
        causes = CauseTest(test.ensembles, bench.numbers_of(0), bench.numbers(frames))
        return likely_causes(causes, alternatives)[0]

    return cause_of


@pytest.mark.parametrize(
    ("defect", "name", "size"),
    [
        ("row noise, 0.2 of the noise", "noise of rows", None),
        ("a repeated frame", "a repeated frame", None),
        ("drift of 2 % over the stack", "drift over the stack", 2.0),
        ("tilt of the light, 3 % over the width", "tilt of the light over the width", 3.0),
        ("jitter of rows, 0.3 px", "jitter of rows", 0.3),
        ("5 dust spots, 10 %", "dust in spots of 3.5 px", None),
    ],
)
def test_defects_of_frames_are_named_with_their_size(
    named_cause: Callable[[str], LikelyCause], defect: str, name: str, size: float | None
) -> None:
    cause = named_cause(defect)
    assert cause.name == name
    if size is not None:
        assert cause.size == pytest.approx(size, rel=0.2)


def test_a_noise_of_one_stack_is_in_dn_and_of_all_stacks_in_percent_of_each(seed: int) -> None:
    chosen, rng = BenchSets("machine-vision", seed=seed).chosen, np.random.default_rng(seed)
    shots = enumerate(chosen.compared, 1)
    frames = {s.label: 2.0 * n * rng.standard_normal((400, 8, 8)) for n, s in shots}
    units = {
        one.stacks: (one.unit, one.scale)
        for one in alternatives_of(frames, chosen, lambda frames: {}, 4095.0)
        if one.name == "noise of rows"
    }
    assert units["all stacks"] == ("% of the noise", 100.0)
    assert units["bright"] == ("DN", pytest.approx(8.0, rel=0.02))
