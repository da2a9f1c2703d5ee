"""A departure that is put into frames is printed with its size, and counts beside its tolerance."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from charact.cli import sessions
from charact.comparison import check, load_limits
from charact.observables import FrameView, Numbers, Stacks
from charact.observables.size import Size, Tolerance, size_of
from charact.validation import (
    GROUPS,
    SCORES,
    ParameterChange,
    Statistic,
    Validation,
    ValidationControl,
    ValidationTest,
    load,
    save,
    validate,
)
from charact.validation.statistic import with_departure
from labdata import BadInput, Result, Session, load_camera
from tests.charact.cli.runner import charact

# Frames, rows and columns of each stack; noise of the dark, signal and noise of the flat, DN.
SHAPE, DRAWS = (8, 64, 192), 20
BLACK_DN, DARK_SD, SIGNAL_DN, FLAT_SD = 100.0, 4.0, 1000.0, 20.0
OF_FRAMES = tuple(name for name in GROUPS if name not in ("linearity", "mtf", "edge", "point"))
Frames = NDArray[np.float64]


def stacks_of(
    rng: np.random.Generator, put: Callable[[Frames], Frames] = lambda noise: noise, spread=1.0
) -> Stacks[FrameView]:
    """Dark and flat of white Gaussian noise; `put` makes the flat's signal and noise of its noise,
    `spread` multiplies all noise.
    """
    dark, noise = spread * rng.standard_normal((2, *SHAPE))
    flat = put(FLAT_SD * noise)
    flat += 0.0 if flat.mean() > 0.5 * SIGNAL_DN else SIGNAL_DN
    views = (
        FrameView("dark", BLACK_DN + DARK_SD * dark),
        FrameView("flat", BLACK_DN + flat),
    )
    return Stacks(darks=views[:1], flats=views[1:])


def numbers_of(stacks: Stacks[FrameView]) -> dict[str, Numbers]:
    return {name: GROUPS[name].numbers(stacks) for name in OF_FRAMES}


def sizes_of(stacks: Stacks[FrameView]) -> dict[str, dict[str, Size]]:
    return {name: dict(GROUPS[name].sizes(stacks)) for name in OF_FRAMES}


@pytest.fixture(scope="module")
def test_of_frames(seed: int) -> ValidationTest:
    rng = np.random.default_rng(seed)
    return ValidationTest([numbers_of(stacks_of(rng)) for _ in range(DRAWS)], seed=seed)


def statistics_of(
    test: ValidationTest, stacks: Stacks[FrameView], *tolerances: Tolerance
) -> dict[str, Statistic]:
    from charact.validation.thresholds import TOLERANCES

    found = test.statistics(
        numbers_of(stacks), sizes=sizes_of(stacks), tolerances=(*TOLERANCES, *tolerances)
    )
    return {statistic.name: statistic for statistic in found}


def fixed_columns(noise: Frames) -> Frames:
    return noise + 0.2 * FLAT_SD * np.random.default_rng(5).standard_normal(SHAPE[2])


def rows_in_time(noise: Frames) -> Frames:
    return noise + 0.2 * FLAT_SD * np.random.default_rng(5).standard_normal((*SHAPE[:2], 1))


def tilt(noise: Frames) -> Frames:
    return noise + SIGNAL_DN * (1.0 + 0.02 * np.linspace(-1.0, 1.0, SHAPE[2]))


# What a pattern or noise of lines of 0.2 of the noise adds to that of their means, in percent.
def of_lines(mean_of: float) -> float:
    return 100.0 * (np.sqrt(0.04 + 1.0 / mean_of) - np.sqrt(1.0 / mean_of))


@pytest.mark.parametrize(
    ("put", "name", "size", "unit", "lines"),
    [
        (lambda noise: 1.1 * noise, "photon-transfer", 10.0, "% of noise", 0),
        (lambda noise: noise + 1.03 * SIGNAL_DN, "level", 3.0, "% of level", 0),
        (tilt, "shading", 2.0, "% of level", 0),
        (fixed_columns, "fixed-pattern", of_lines(8 * 64), "% of noise", 192),
        (rows_in_time, "rows-and-columns", of_lines(192), "% of noise", 7 * 64),
    ],
)
def test_a_departure_put_into_frames_has_its_size(
    test_of_frames: ValidationTest, put, name: str, size: float, unit: str, lines: int, seed: int
) -> None:
    stacks = stacks_of(np.random.default_rng([seed, 1]), put)
    found = statistics_of(test_of_frames, stacks)[name]
    assert found.departure is not None and found.departure95 is not None
    half = (found.departure95[1] - found.departure95[0]) / 2.0
    # A sample of lines has a variance of its own.
    of_sample = 20.0 / np.sqrt(2.0 * lines) if lines else 0.0
    assert found.departure == pytest.approx(size, abs=4.5 * np.hypot(half / 2.0, of_sample))
    assert found.departure_unit == unit
    assert found.verdict == "differs"


def test_a_departure_within_its_tolerance_does_not_count_however_sure(
    test_of_frames: ValidationTest, seed: int
) -> None:
    stacks = stacks_of(np.random.default_rng([seed, 1]), lambda noise: 1.03 * noise)
    found = statistics_of(test_of_frames, stacks)
    assert not found["photon-transfer"].passed
    assert found["photon-transfer"].verdict == "within"
    assert "differs" not in {statistic.verdict for statistic in found.values()}
    stricter = statistics_of(
        test_of_frames, stacks, Tolerance(unit="% of noise", max=1.0, statistic="photon-transfer")
    )
    assert {name for name, one in stricter.items() if one.verdict == "differs"} == {
        "photon-transfer"
    }


def test_what_predictions_spread_too_far_for_could_not_have_been_seen(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sets = [numbers_of(stacks_of(rng, spread=rng.uniform(0.7, 1.4))) for _ in range(DRAWS)]
    found = statistics_of(ValidationTest(sets, seed=seed), stacks_of(rng))
    assert found["photon-transfer"].passed
    assert found["photon-transfer"].verdict == "unseen"
    assert set(found["photon-transfer"].unseen) == set(found["photon-transfer"].labels)
    # The level does not depend on the noise.
    assert found["level"].verdict == "agrees"
    assert replace(GOOD, statistics=tuple(found.values())).verdict == "undecided"


def test_the_interval_of_a_departure_holds_it_as_often_as_promised(seed: int) -> None:
    """Of 20 sets whose mean and spread are estimates, Student's interval is one of 95 %."""
    rng, held, tries = np.random.default_rng(seed), 0, 4000
    sets = rng.standard_normal((tries, DRAWS + 1))
    centre, sd = sets[:, 1:].mean(axis=1), sets[:, 1:].std(axis=1, ddof=1)
    half = 1.96 * sd * np.sqrt(1.0 + 1.0 / DRAWS)
    scales = {"a": (Size(unit="DN", factor=1.0), 1.0)}
    for measured, low, high in zip(sets[:, 0] + 3.0, centre - half, centre + half, strict=True):
        numbers = {"labels": ("a",), "measured": (measured,), "low95": (low,), "high95": (high,)}
        found = with_departure(
            Statistic(name="n", title="N", distance=1.0, p_value=0.5, level=0.01, **numbers),
            scales,
            DRAWS,
        )
        assert found.departure95 is not None
        held += found.departure95[0] <= 3.0 <= found.departure95[1]
    assert held / tries == pytest.approx(0.95, abs=3.3 * np.sqrt(0.95 * 0.05 / tries))


def test_of_the_numbers_beyond_chance_the_largest_over_its_tolerance_counts() -> None:
    """A departure that is small but sure does not hide a large one."""
    statistic = Statistic(
        name="n",
        title="N",
        distance=9.0,
        p_value=1e-4,
        level=0.01,
        labels=("sure", "large", "by chance"),
        measured=(1.0, 3.0, 50.0),
        low95=(-0.01, -0.5, -60.0),
        high95=(0.01, 0.5, 60.0),
        part="right",
    )
    scales = {label: (Size(unit="DN", factor=1.0), 2.0) for label in statistic.labels}
    found = with_departure(statistic, scales, DRAWS)
    assert (found.worst, found.departure, found.verdict) == ("large, right", 3.0, "differs")
    assert found.unseen == ("by chance",)
    # Where chance explains all, the number shown is one that could have been seen.
    calm = replace(statistic, p_value=0.5, measured=(0.005, 0.2, 50.0))
    shown = with_departure(calm, scales, DRAWS)
    assert (shown.worst, shown.verdict, shown.unseen) == ("sure, right", "agrees", ("by chance",))


def test_every_number_has_a_size_but_bits_above_the_noise(seed: int) -> None:
    stacks = stacks_of(np.random.default_rng(seed))
    sizes = sizes_of(stacks)
    without = [
        label
        for name, numbers in numbers_of(stacks).items()
        for label in numbers
        if size_of(label, sizes[name]) is None
    ]
    # A step of 2^5 DN is more than the noise of 20 DN.
    assert without == [f"excess ones of bit {bit} of flat" for bit in range(5, 8)]


def test_bands_of_a_spectrum_are_parts_of_the_noise_that_make_up_the_whole(seed: int) -> None:
    """Squares of the parts of all directions sum to that of white noise."""
    sizes = sizes_of(stacks_of(np.random.default_rng(seed)))["noise-spectrum"]
    for cut, whole in (("radial", 1.0), ("horizontal", 1.0 / 64), ("vertical", 1.0 / 192)):
        parts = [
            size.of(np.array(1.0))
            for name, size in sizes.items()
            if name.startswith(f"{cut} noise of flat")
        ]
        # The column of frequency 0 counts twice in the half plane, the mean not at all.
        assert np.sum(np.square(parts)) == pytest.approx(whole, rel=0.03), cut


def test_a_parameter_may_err_as_far_as_no_number_leaves_its_tolerance(seed: int) -> None:
    rng, slopes = np.random.default_rng(seed), {"a": 40.0, "b": 10.0}

    def numbers(gain_error: float) -> dict[str, Numbers]:
        draws = rng.standard_normal(2)
        return {
            "level": {
                k: float(x + gain_error * slopes[k]) for k, x in zip("ab", draws, strict=True)
            }
        }

    plain = {"level": {"a": 0.0, "b": 0.0}}
    change = ParameterChange(
        title="gain", plain=plain, changed={"level": {"a": 12.0, "b": 3.0}}, change=0.3
    )
    test = ValidationTest([numbers(0.0) for _ in range(DRAWS)], seed=seed, changes=[change])
    measured, sizes = numbers(0.2), {"level": {"": Size(unit="DN", factor=1.0)}}

    def statistic_of(*tolerances: Tolerance) -> Statistic:
        tolerances = (Tolerance(unit="DN", max=2.0), *tolerances)
        found = test.statistics(measured, sizes=sizes, tolerances=tolerances)
        return next(one for one in found if one.name == SCORES)

    found = statistic_of()
    # 2 DN over a slope of 40 DN.
    assert found.tolerance == pytest.approx(5.0)
    assert found.departure_unit == "% of the parameter"
    assert found.departure == pytest.approx(20.0, abs=4.5 * 100.0 / np.hypot(40.0, 10.0) * 1.3)
    assert found.verdict == "differs"
    stated = statistic_of(Tolerance(unit="% of the parameter", max=60.0, statistic=SCORES))
    assert (stated.tolerance, stated.verdict) == (60.0, "within")
    # An error that moves no number by its tolerance is tolerated, up to a factor of 100.
    assert statistic_of(Tolerance(unit="DN", max=1e6)).tolerance == pytest.approx(9900.0)


def _control(name: str, p_value: float) -> ValidationControl:
    statistic = Statistic(name="n", title="N", distance=1.0, p_value=p_value, level=0.01)
    return ValidationControl(name=name, title=name, statistics=(statistic,))


SMALL = Statistic(
    name="level",
    title="Level",
    distance=5.0,
    p_value=1e-5,
    level=0.01,
    worst="ln signal of flat",
    departure=0.6,
    departure95=(0.5, 0.7),
    departure_unit="% of level",
    tolerance=1.0,
)
LARGE = replace(SMALL, departure=3.0, departure95=(2.8, 3.2), matters="radiometry", cause="a lamp")
BLIND = replace(SMALL, p_value=0.5, departure95=(-4.0, 5.2))
STRADDLES = replace(SMALL, departure95=(-0.1, 1.3))
GOOD = Validation(
    session="s",
    sensor="fitted",
    seed=0,
    draws=DRAWS,
    seconds=1.0,
    statistics=(SMALL,),
    controls=(_control("null", 0.5), _control("negative", 1e-9)),
)


@pytest.mark.parametrize(
    ("validation", "verdict", "passed", "code", "words"),
    [
        (GOOD, "agrees", True, 0, "differs by 0.600 ± 0.100 % of level, within its tolerance of 1"),
        (replace(GOOD, statistics=(SMALL, LARGE)), "differs", False, 3, "DIFFERS by 3.00 ± 0.20"),
        (replace(GOOD, statistics=(BLIND,)), "undecided", True, 4, "COULD NOT HAVE SEEN"),
        (replace(GOOD, statistics=(STRADDLES,)), "undecided", True, 4, "COULD NOT HAVE SEEN"),
        (replace(GOOD, converged=False), "undecided", False, 4, "note: the posterior of the fit"),
        (
            replace(GOOD, controls=(_control("null", 1e-9), _control("negative", 1e-9))),
            "undecided",
            False,
            4,
            "note: a null control did not hold",
        ),
        (replace(GOOD, statistics=(LARGE,), converged=False), "differs", False, 3, "DIFFERS by"),
    ],
)
def test_the_verdict_is_the_exit_code_and_is_read_back(
    validation: Validation,
    verdict: str,
    passed: bool,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert (validation.verdict, validation.passed) == (verdict, passed)
    monkeypatch.setattr(sessions, "validate_and_save", lambda *_, **__: validation)
    done = charact("validate", tmp_path)
    assert done.exit_code == code, done.output
    assert words in done.stdout
    if not validation.converged:
        assert "did not converge" in done.stdout.splitlines()[0]
    save(validation, tmp_path)
    assert load(tmp_path) == validation


def test_tolerances_stand_in_a_file_of_limits(tmp_path: Path) -> None:
    file = tmp_path / "limits.toml"
    file.write_text('[[tolerance]]\nstatistic = "level"\nunit = "% of level"\nmax = 2.5\n')
    (tolerance,) = load_limits(file).tolerance
    assert (tolerance.statistic, tolerance.unit, tolerance.max) == ("level", "% of level", 2.5)
    # A check of no limit passes nothing.
    with pytest.raises(BadInput, match="at least one"):
        check(Result(), load_limits(file))
    file.write_text('[[tolerance]]\nunit = "percent"\nmax = 2.5\n')
    with pytest.raises(BadInput, match="unit"):
        load_limits(file)
    with pytest.raises(BadInput, match="max of a tolerance"):
        Tolerance(unit="DN", max=0.0)


def test_a_tolerance_of_an_unknown_statistic_is_refused_before_any_work() -> None:
    tolerance = Tolerance(unit="DN", max=1.0, statistic="levels")
    with pytest.raises(BadInput, match=r"one of level, .*'levels'"):
        validate(
            Session(name="s", folder=Path(), stacks=()),
            load_camera("emccd-512"),
            tolerances=(tolerance,),
        )
