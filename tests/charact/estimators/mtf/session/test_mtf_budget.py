"""The stage budget against closed-form curves: the cascade of the physics reference, section
1.12.
"""

import numpy as np
import pytest

from charact.estimators.mtf import Direction, MeasuredCurve, MeasuredCurves, fit_mtf_budget
from labdata import load_sensor

SENSOR = load_sensor("pulnix-ag5745ef3")


def low_pass(frequency):
    """Third-order Butterworth of 6.5 MHz at 14.318 MHz a pixel, complex."""
    s = 1j * np.asarray(frequency) * 14.318 / 6.5
    return 1.0 / ((s + 1.0) * (s**2 + s + 1.0))


def video(frequency):
    """Stairs one clock wide through the low pass, read once a clock: their aliases added up."""
    at = np.asarray(frequency)[..., None] + np.arange(-60, 61)
    return np.abs(np.sum(np.sinc(at) * np.exp(-1j * np.pi * at) * low_pass(at), axis=-1))


def cascade(
    direction: Direction,
    frequency,
    *,
    after_gain=False,
    cut_off=26.25,
    exponent=1.184,
    share=0.8,
    halo_share=0.0,
):
    """Product of section 1.12 by formula: 4 um lens, Johnson's tube, 6 um fibres and interfaces,
    pixel, 6.5 MHz.

    The halo is four gaps of 0.21 mm wide, 30 % of its electrons elastic.
    """
    from scipy.special import j1, sici

    along = direction == "horizontal"
    detector = frequency / (0.011 if along else 0.013)
    cathode = detector * 11.0 / 18.0
    x = np.pi * 0.006 * detector
    pupil = 1.0 - 4.0 / np.pi * cathode * 0.7e-3 * 1.4
    lens = pupil * np.exp(-2.0 * (np.pi * cathode * 0.004) ** 2)
    tube = np.exp(-((cathode / cut_off) ** exponent))
    rest = (
        2.0
        * j1(x)
        / x
        * np.exp(-((detector / 120.0) ** 2))
        * np.abs(np.sinc(frequency * (1.0 if along else 2.0)))
    )
    if along:
        rest = rest * video(frequency)
    u = np.pi * cathode * 0.84
    halo = 1.0 - halo_share + halo_share * (0.3 * np.sin(u) / u + 0.7 * sici(u)[0] / u)
    return tube**share * rest if after_gain else lens * halo * tube * rest


def curve(direction: Direction, sd: float, rng=None, bump=0.0, **more) -> MeasuredCurves:
    frequency = np.linspace(0.02, 0.45 if direction == "horizontal" else 0.3, 15)
    value = cascade(direction, frequency, **more) + bump * np.sin(20.0 * frequency)
    noise = 0.0 if rng is None else sd * rng.standard_normal(frequency.size)
    one = MeasuredCurve(
        direction=direction,
        after_gain=more.get("after_gain", False),
        frequency_cy_per_px=frequency,
        value=value + noise,
    )
    return MeasuredCurves(curves=(one,), covariance=sd**2 * np.eye(frequency.size))


BOTH: tuple[Direction, ...] = ("horizontal", "vertical")


def budget(curves, **more):
    return fit_mtf_budget(tuple(curves), SENSOR, interlaced=True, seed=1, quick=True, **more)


def test_without_the_curve_after_the_gain_the_tube_is_a_product(seed):
    rng = np.random.default_rng(seed)
    found = budget([curve(d, 0.002, rng) for d in BOTH])
    assert (
        "tube before the gain" not in found.identified
        and "tube after the gain" not in found.identified
    )
    assert any(
        {"tube before the gain", "tube after the gain"} <= set(group) for group in found.products
    )
    assert any("only the product of" in sentence for sentence in found.statement)
    assert "pixel" in found.known


def test_a_halo_lowers_the_whole_and_is_found_where_it_is_looked_for(seed):
    """A quarter of the light, 2.1 prior standard deviations above the description, within 4.5
    standard errors.
    """
    rng = np.random.default_rng(seed)
    curves = [curve(d, 0.002, rng, halo_share=0.25) for d in BOTH]
    found = budget(curves, halo=True)
    share = found.posterior["photocathode.halo_fraction"]
    assert abs(np.mean(share) - 0.25) < 4.5 * np.std(share)
    assert "halo" in found.identified
    assert found.chance > 1e-3
    without = budget(curves)
    assert without.chance < 1e-6
    assert "halo" not in (*without.camera.stages, *without.known)
    assert not any("halo" in sentence for sentence in without.statement)


def test_a_curve_told_twice_with_the_same_errors_tells_no_more_than_once(seed):
    one = curve("horizontal", 0.01, np.random.default_rng(seed))
    twice = MeasuredCurves(
        curves=one.curves * 2, covariance=np.kron(np.ones((2, 2)), one.covariance)
    )
    once, same, independent = (budget(curves) for curves in ([one], [twice], [one, one]))
    sd, doubled, halved = (
        np.std(found.product(found.camera.stages, np.array([0.2]), "horizontal"))
        for found in (once, same, independent)
    )
    # Two standard deviations of n draws each differ by 1/sqrt(n) of themselves; 4.5 standard errors
    # are allowed.
    assert doubled == pytest.approx(sd, rel=4.5 / np.sqrt(len(once.posterior.draws)))
    assert halved < 0.85 * sd


def test_a_camera_that_no_stages_describe_is_said(seed):
    assert any(
        "do not describe" in sentence
        for sentence in budget([curve("horizontal", 0.002, bump=0.05)]).statement
    )
