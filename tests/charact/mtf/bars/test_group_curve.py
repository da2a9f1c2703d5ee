"""Groups of bars together tell one curve; Coltman's readings have their known bias."""

from dataclasses import replace

import numpy as np
import pytest
from bar_frames import frames_of, gaussian, mtf_of, strip, tube
from test_strip import read

from charact.method import Context
from charact.mtf.bars.group_curve import fit_group_curve
from labdata.errors import BadInput
from labdata.measurement import measurement_from_sd

FREQUENCIES = (0.05, 0.1, 0.2, 0.3)


def reading(frequency: float, value: float, sd: float, angle_deg: float = 0.0):
    return measurement_from_sd(
        "mtf", "1", value, sd, method="bars-forward", frequency_cy_per_px=frequency, orientation_deg=angle_deg
    )


@pytest.mark.parametrize("core", [gaussian(0.9), tube(0.25, 1.1)])
def test_groups_give_one_curve_that_covers_the_truth(core, seed: int) -> None:
    """Of 60 curves at least 49 cover mtf at 0.15 cy/px at 95 %, which chance undercuts once in a million."""
    rng = np.random.default_rng(seed)
    covered = 0
    for _ in range(60):
        sd = 0.02
        groups = [reading(f, mtf_of(core, f, 0.0) + sd * rng.standard_normal(), sd) for f in FREQUENCIES]
        found = fit_group_curve(groups, context=Context(seed=1, quick=True))
        curve = found.curves["mtf"]
        index = int(np.argmin(np.abs(curve.frequency_cy_per_px - 0.15)))
        low, high = curve.interval95[0][index], curve.interval95[1][index]
        covered += low <= mtf_of(core, 0.15, 0.0) <= high
    assert covered >= 49


def test_frames_of_several_groups_give_mtf50(seed: int) -> None:
    rng = np.random.default_rng(seed)
    groups = [read(frames_of(strip(gaussian(0.8), f, 4.0, 0.2), rng, snr=20.0), f) for f in FREQUENCIES]
    mtf50 = fit_group_curve(groups, context=Context(seed=1)).find("mtf50")[0]
    assert mtf50.posterior.sampler == "emcee"
    assert mtf_of(gaussian(0.8), mtf50.interval95[0], 4.0) > 0.48
    assert mtf_of(gaussian(0.8), mtf50.interval95[1], 4.0) < 0.52


def test_groups_that_do_not_belong_together_say_so() -> None:
    groups = [reading(f, mtf_of(gaussian(0.8), f, 0.0), 0.01) for f in FREQUENCIES]
    context = Context(seed=1, quick=True)
    assert fit_group_curve(groups, context=context).measurements[0].status == "ok"
    groups[1] = replace(groups[1], value=groups[1].value - 0.2, interval68=None, interval95=None)
    low = mtf_of(gaussian(0.8), 0.1, 0.0) - 0.2
    groups[1] = reading(0.1, low, 0.01)
    assert "model-misfit" in fit_group_curve(groups, context=context).measurements[0].flags


def test_one_group_is_no_curve_and_directions_do_not_mix() -> None:
    context = Context(seed=1, quick=True)
    one = reading(0.1, 0.8, 0.01)
    assert fit_group_curve([one], context=context).measurements[0].status == "refused"
    with pytest.raises(BadInput, match="degrees"):
        fit_group_curve([one, reading(0.2, 0.5, 0.01, angle_deg=90.0)], context=context)


def test_coltmans_first_term_is_low_where_harmonics_are_and_always_suspect(seed: int) -> None:
    """physics: 18.6 % low at 0.05 cy/px under a blur of 0.8 px, right at 0.25."""
    rng = np.random.default_rng(seed)
    for frequency, bias in ((0.05, -0.186), (0.25, 0.0)):
        stack = frames_of(strip(gaussian(0.8), frequency, 4.0, 0.2), rng, snr=300.0)
        found = read(stack, frequency, method="bars-coltman")
        assert found.status == "suspect"
        assert found.value / mtf_of(gaussian(0.8), frequency, 4.0) - 1.0 == pytest.approx(bias, abs=0.03)
