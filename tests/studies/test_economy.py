"""Studies of the economy of light, and of the agreement of targets."""

from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from benchmarks.studies.consistency_scenes import SessionScene, TrueCameraChain
from benchmarks.studies.consistency_table import CrossingComparison, judge_session, row
from benchmarks.studies.effect_selection import (
    DRAWN_MOST,
    load_outcomes,
    measure_case,
    read,
    summarise_outcomes,
    temporal_noise,
    write_table,
)
from benchmarks.studies.effect_selection_scenes import case_of
from tests.truth.blur import TrueBlur

# The table of light's economy is what its program finds: plans, and how far their frames are from
# exact ones.


OUTCOMES = read()


@pytest.mark.parametrize(
    "before",
    sorted(OUTCOMES, key=lambda one: one.planned_s + one.exact_s)[:2],
    ids=lambda one: f"case {one.number}",
)
def test_a_case_measured_again_comes_out_as_in_the_table(before):
    again = measure_case(before.number)
    for name in ("light", "sensor", "bands", "bounces"):
        assert getattr(again, name) == getattr(before, name)
    assert again.left_out == before.left_out
    # Other rays where the program has changed: the root mean square over some tens of pixels
    # scatters.
    assert again.difference == pytest.approx(before.difference, rel=0.5, abs=0.03)


def test_noise_of_few_large_pulses_is_found_from_as_many_frames_as_it_needs():
    rng, drawn = np.random.default_rng(3), []

    def frames(rate, size):
        for number in count():
            drawn.append(number)
            yield rng.normal(0.0, 1.0, (6, 8)) + size * rng.poisson(rate, (6, 8))

    plain = temporal_noise(frames(0.0, 0.0))
    assert plain == pytest.approx(1.0, rel=0.4) and len(drawn) < 200
    drawn.clear()
    rare = temporal_noise(frames(0.01, 100.0))
    assert rare == pytest.approx(np.hypot(1.0, 10.0), rel=0.5)
    assert 500 < len(drawn) <= 2 * DRAWN_MOST


def test_a_picture_short_of_the_rays_that_it_needs_says_so():
    seen = case_of(4).night.render(tolerance=0.2, seed=1, threads=1)
    assert seen.chance < 1.1 * seen.plan.chance and not seen.short
    assert not any("most rays" in note for note in seen.notes)
    limit = np.full(seen.picture.variance.shape, (2.0 * seen.plan.chance) ** 2)
    variance = limit * seen.eye.noise_floor(seen.picture.signal) ** 2
    short = replace(seen, picture=replace(seen.picture, variance=variance))
    assert short.chance == pytest.approx(2.0 * seen.plan.chance) and short.short
    assert any("more than the 12 % of the plan" in note for note in short.notes)


def test_cases_beyond_the_tolerance_are_counted_by_whether_the_plan_said_so():
    whole = summarise_outcomes(OUTCOMES)
    assert whole["within"] + whole["beyond_and_told"] + whole["beyond_and_untold"] == len(OUTCOMES)
    assert whole["exact_known_to_a_third"] <= len(OUTCOMES)


def test_cases_that_other_sources_made_are_not_kept(tmp_path):
    table = tmp_path / "table.json"
    assert load_outcomes(table) == []
    write_table(OUTCOMES[:2], table)
    assert load_outcomes(table) == OUTCOMES[:2]
    table.write_text(table.read_text().replace('"sources": "', '"sources": "0'))
    assert load_outcomes(table) == [] and read(table) == OUTCOMES[:2]


# The study of agreement: its cameras have the MTF they say, and a target out of focus is found and
# named.


def test_two_gaussian_blurs_add_in_squares_and_defocus_widens_both() -> None:
    chain, f = TrueCameraChain(TrueBlur(sigma_px=0.6), 0.8), np.linspace(0.0, 0.5, 11)
    whole = TrueBlur(sigma_px=1.0)
    assert np.allclose(chain.mtf(f, 20.0), whole.mtf(f, 20.0), rtol=1e-12)
    assert np.allclose(
        chain.with_defocus(0.1).mtf(f, 0.0), TrueBlur(sigma_px=1.1).mtf(f, 0.0), rtol=1e-12
    )


def test_a_camera_drawn_anew_is_another_and_the_same_seed_gives_it_back() -> None:
    one, same, other = (SessionScene.drawn(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one == same
    assert one != other


def test_a_target_out_of_focus_by_15_percent_is_found_and_named() -> None:
    one = judge_session(2, made="closed form", seed=0, defocus=0.15, of="edge")
    assert not one.inside
    assert not one.ok
    assert one.differs_most == "edge"


@pytest.fixture(scope="module")
def whole():
    return judge_session(2, made="closed form", seed=0)


def test_sessions_are_summed_up(whole) -> None:
    assert whole.targets >= 6
    assert whole.inside
    summed = row([whole, whole], made="closed form", defocus=0.0, of="edge")
    assert summed["agree"] == summed["sessions"] == 2
    beside = {one["name"]: one for one in summed["beside_truth"]}
    assert {"joint mtf50 along rows", "point-parametric mtf10 along columns"} <= set(beside)
    edge = beside["edge-free mtf10 along rows"]
    assert edge["numbers"] == edge["ok"] == 2
    (off,) = (one.off for one in whole.beside if one.name == edge["name"])
    assert edge["rms_standard_errors"] == pytest.approx(1.96 * abs(off))


def test_a_number_far_off_its_truth_is_silent_only_without_a_flag(whole) -> None:
    away = tuple(
        CrossingComparison(name="edge mtf10 along rows", ok=ok, off=off)
        for ok, off in [(True, -2.5), (False, 9.0), (True, 1.5)]
    )
    (summed,) = row([replace(whole, beside=away)], made="closed form", defocus=0.0, of="edge")[
        "beside_truth"
    ]
    assert (summed["numbers"], summed["ok"], summed["missed"], summed["silent"]) == (3, 2, 2, 1)
