"""Verdicts that 20 simulated sets leave open are settled by further ones of the same stacks."""

from dataclasses import replace

import numpy as np
import pytest

from charact.observables import FrameView, Stacks
from charact.observables.size import Size, Tolerance
from charact.validation import GROUPS, VALIDATION, Numbers, Statistic, ValidationTest, ensemble
from charact.validation import side_by_side as command
from charact.validation.frame_features import FrameFeatures, stacks_for
from charact.validation.statistic import with_departure
from tests.charact.validation.bench_sets import BenchSets

SIZES = {"level": {"": Size(unit="DN", factor=1.0)}}
CHOSEN = BenchSets("machine-vision", seed=1).chosen
OPEN = Statistic(
    name="level",
    title="Level",
    distance=1.0,
    p_value=0.5,
    level=1e-3,
    least_p=2e-4,
    departure=0.1,
    departure95=(-0.9, 1.1),
    tolerance=1.0,
    least_spread=1.0,
)


@pytest.fixture(autouse=True)
def few_replicates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ensemble, "VALIDATION", replace(VALIDATION, replicates=1000))


@pytest.mark.parametrize(
    ("changes", "is_sure"),
    [
        ({}, False),
        ({"least_spread": 0.6}, True),
        ({"least_spread": 1.6}, True),
        # Chance near the level matters where the departure would.
        ({"least_spread": 0.6, "p_value": 3e-3, "departure95": (-0.4, 0.6)}, True),
        (
            {"least_spread": 0.6, "p_value": 3e-3, "departure": 3.0, "departure95": (2.4, 3.6)},
            False,
        ),
        ({"p_value": 2e-4, "departure": 3.0, "departure95": (2.4, 3.6)}, True),
        ({"p_value": 2e-4, "departure95": (-0.75, 0.95)}, False),
        ({"departure": None, "departure95": None}, True),
    ],
)
def test_a_verdict_is_sure_where_the_errors_of_20_sets_leave_it(changes, is_sure) -> None:
    assert replace(OPEN, **changes).is_sure(20) is is_sure
    # The spread of a hundred times as many is known to 2 %.
    assert replace(OPEN, least_spread=0.94).is_sure(2000)


class Draws:
    """Bench whose numbers are normal, and no frames."""

    def __init__(self, seed: int, sd: float) -> None:
        self.rng, self.sd, self.asked = np.random.default_rng(seed), sd, 0
        self.chosen = CHOSEN

    def numbers_of_next_draw(self, names) -> dict[str, Numbers]:
        self.asked += 1
        return {name: {"level of flat, DN": self.sd * self.rng.standard_normal()} for name in names}


def settle(seed: int, sd: float) -> tuple[str, str, int]:
    """Return the verdict by 20 sets, that by as many as settle it, and the number of further ones,
    of a level that is where it is predicted.
    """
    bench = Draws(seed, sd)
    sets = [bench.numbers_of_next_draw(["level"]) for _ in range(VALIDATION.draws)]
    test = ValidationTest(sets, seed=seed)
    features = FrameFeatures(
        groups={"level": {"level of flat, DN": 0.0}},
        sizes=SIZES,
        mean_dn=(),
        variance_dn2=(),
        covariance_dn2=(),
    )
    tolerances = (Tolerance(unit="DN", max=1.0),)
    (first,) = test.statistics(features.groups, sizes=SIZES, tolerances=tolerances)
    bench.asked = 0
    (last,) = command._settled_statistics(bench, test, (features, {}), tolerances)  # type: ignore[arg-type]
    return first.verdict, last.verdict, bench.asked


def test_further_sets_settle_a_spread_near_the_tolerance_and_only_there(seed: int) -> None:
    """Student's half of 95 % of 20 sets is 2.14 standard deviations, of 60 it is 2.02."""
    near = [settle(seed + number, 0.42) for number in range(40)]
    wrong = [sum(verdicts[which] != "agrees" for verdicts in near) for which in (0, 1)]
    print(f"could not have seen it: {wrong} of 40")
    assert wrong[1] < 0.5 * wrong[0]
    # A level is that of a dark and three flats.
    assert max(asked for *_, asked in near) == VALIDATION.most_further // 4
    far = [settle(seed + number, 0.15) for number in range(10)]
    assert {verdicts[:2] for verdicts in far} == {("agrees", "agrees")}
    assert sum(asked for *_, asked in far) == 0


def test_only_the_stacks_of_a_statistic_are_simulated_again() -> None:
    labels = {
        name: [shot.label for shot in stacks_for([name], CHOSEN).compared]
        for name in ("point", "mtf", "dark-events", "level")
    }
    assert labels == {
        "point": ["dark", "point"],
        "mtf": ["dark", "edge"],
        "dark-events": ["dark"],
        "level": ["dark", "low", "mid", "bright"],
    }
    assert CHOSEN.point is not None
    # Its light is that of a flat.
    lit = replace(CHOSEN, point=replace(CHOSEN.point, like="mid"))
    assert len(stacks_for(["point"], lit).flats) == 3


@pytest.mark.parametrize("count", [2, 3, 5, 8, 16])
def test_middle_values_and_tails_are_those_of_sorted_frames(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    frames = rng.integers(90, 110, (count, 40, 50)).astype(np.float32)
    view = FrameView("flat", frames)
    middle = np.sort(frames, axis=0)[count // 4 : count - count // 4].mean(axis=0)
    assert np.array_equal(view.steady, middle)
    values = np.sort(view.change, axis=None)
    size = values.size
    for tail in (round(0.01 * size), round(0.1 * size)):
        assert view.ordered[:tail].mean() == pytest.approx(values[:tail].mean(), rel=1e-5)
        assert view.ordered[-tail:].mean() == pytest.approx(values[-tail:].mean(), rel=1e-5)
    low, high = values[[int(0.159 * size), int(0.841 * size)]]
    assert view.robust_sd == pytest.approx(max((high - low) / 2.0, 0.3), rel=1e-6)


@pytest.mark.parametrize("events", [0.0, 3.0, 10.0, 40.0])
def test_chance_alone_hides_no_number_of_dark_events(seed: int, events: float) -> None:
    """Poisson numbers of a few events spread by more than themselves, but by less than ten."""
    rng = np.random.default_rng(seed)
    dark = FrameView("dark", rng.standard_normal((8, 40, 50)))
    size = GROUPS["dark-events"].sizes(Stacks(darks=(dark,), flats=()))["root of"]
    roots = np.sqrt(rng.poisson(events, 4000) + 0.375)
    ends = size.departure(np.quantile(roots, (0.025, 0.975)), float(np.sqrt(events + 0.375)))
    assert np.diff(ends)[0] / 2.0 < 80.0


def test_a_number_without_a_size_has_no_part_in_the_least_spread() -> None:
    """A logarithm of nothing is no size; the result is written to a file of finite numbers."""
    numbers = {"labels": ("a", "b"), "measured": (0.0, 0.0), "low95": (-1.0, -1e3)}
    statistic = Statistic(
        name="n", title="N", distance=1.0, p_value=0.5, level=0.01, high95=(1.0, 1e3), **numbers
    )
    over = Size(unit="DN", of=np.exp)
    with np.errstate(over="ignore"):
        shown = with_departure(statistic, {"a": (SIZES["level"][""], 5.0), "b": (over, 5.0)}, 20)
    assert shown.least_spread == pytest.approx(2.0930 / 1.96 / 5.0, rel=1e-3)
