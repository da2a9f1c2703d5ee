"""The study of agreement: its cameras have the MTF they say, and a target out of focus is found and
named.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.consistency_scenes import SessionScene, TrueCameraChain
from benchmarks.studies.consistency_table import CrossingComparison, judge_session, row
from tests.truth.blur import TrueBlur


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
    edge = beside["edge-parametric mtf10 along rows"]
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
