"""Cores and forms of bars: what a form states in closed form is what its attenuation implies."""

import numpy as np
import pytest

from charact.transfer import (
    AIRY,
    CORES,
    EXPONENTIAL,
    GAUSSIAN,
    MOFFAT,
    ON_BARS,
    ON_POINTS,
    Core,
    TwoGaussians,
)

FREQUENCY = np.geomspace(0.01, 1.0, 40)
THETA = {"exponential": [1.4], "moffat": [2.6], "two gaussians": [0.2, 1.2]}


def point_of(core):
    return np.array([[np.log(0.2), *THETA.get(core.name, [])]])


@pytest.mark.parametrize("core", [GAUSSIAN, EXPONENTIAL, MOFFAT, AIRY], ids=lambda core: core.name)
def test_a_stated_transfer_and_its_slopes_are_those_of_the_attenuation(core):
    theta = point_of(core)
    implied = Core.transfer(core, theta, FREQUENCY)
    assert core.transfer(theta, FREQUENCY) == pytest.approx(implied, abs=1e-3)
    slopes = Core.derivatives(core, theta[0], FREQUENCY)
    assert core.derivatives(theta[0], FREQUENCY) == pytest.approx(slopes, abs=0.02)


@pytest.mark.parametrize(
    "core", [*CORES.values(), *(core for core, _ in ON_POINTS.values()), TwoGaussians()]
)
def test_a_core_is_one_at_zero_and_one_half_at_its_half_frequency(core):
    shape = [0.0 if "_square" in part.name else part.start for part in core.shape]
    at = core.transfer(np.array([[np.log(0.2), *shape]]), np.array([1e-5, 0.2]))[0]
    assert at == pytest.approx([1.0, 0.5], abs=3e-3)


@pytest.mark.parametrize("form", ON_BARS, ids=lambda form: form.name)
def test_a_form_of_bars_has_its_attenuation_at_the_bar_frequency_and_slopes_that_are_its_own(form):
    start = form.first.start, form.second.start
    for attenuation in (0.3, 2.0):
        ln, by_ln_attenuation, *_ = form.derivatives(np.zeros(1), attenuation, *start)
        assert ln[0] == pytest.approx(-attenuation, rel=2e-3)
        assert by_ln_attenuation[0] == pytest.approx(-attenuation, rel=0.02)
