"""Laws of what a spot's noise says of the response: it grows as the light where that is straight,
else as a power.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import point_forward, point_parametric
from charact.estimators.mtf.point import nonlinearity, thresholds
from charact.method import Context
from labdata import FrameStack
from tests.truth.blur import TrueBlur
from tests.truth.photon_spots import Spot, SpotCamera
from tests.truth.point import PointScene

QUICK = Context(quick=True)
SIZE = 9


def noise(power, samples, rng):
    """Samples of pulses behind a response, beside white noise, with what they are made of."""
    y, x = (axis.ravel() - SIZE // 2 for axis in np.mgrid[:SIZE, :SIZE].astype(float))
    mean = np.exp(-0.5 * (x**2 + y**2) / 1.8**2)
    near = np.exp(-0.25 * ((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2) / 0.5**2)
    pulses = 50.0 * near * np.sqrt(np.outer(mean, mean))
    dark = 0.2 * np.eye(mean.size)
    shown = np.maximum(mean, thresholds.ACCURACY.min_light_fraction) ** (0.5 * power)
    whole = pulses * np.outer(shown, shown) + dark
    return rng.multivariate_normal(np.zeros(mean.size), whole, size=samples), mean, pulses, dark


def test_more_samples_say_more_surely_how_the_noise_grows(seed):
    rng = np.random.default_rng(seed)
    profiles = [nonlinearity.power_log_likelihoods(*noise(-0.3, 8, rng)) for _ in range(6)]
    together = nonlinearity.fit_nonlinearity(np.sum(profiles, axis=0))
    alone = [nonlinearity.fit_nonlinearity(profile) for profile in profiles]
    assert together.is_nonlinear
    assert together.significance > max(part.significance for part in alone)
    assert np.ptp(together.exponents) < min(np.ptp(part.exponents) for part in alone)


def codes(rng, gamma, width, frames):
    """Frames of a spot of 60 standard deviations, 100 e- of black and 30 e- of noise, 8 bits."""
    y, x = np.mgrid[:48, :48] - 23.6
    mean = 1800.0 * np.exp(-0.5 * (x**2 + y**2) / width**2)
    electrons = rng.poisson(mean, (frames, 48, 48)) + rng.normal(0.0, 30.0, (frames, 48, 48))
    signal = np.clip((electrons + 100.0) / 2400.0, 0.0, 1.0)
    return FrameStack(data=np.rint(255.0 * signal**gamma).astype(np.uint8), full_scale_dn=255.0)


@pytest.mark.parametrize("method", ["point-parametric", "point-spread"])
@pytest.mark.parametrize(("width", "frames"), [(1.0, 16), (1.6, 8)])
def test_light_that_is_quieter_than_darkness_tells_a_compressive_response(
    seed, method, width, frames
):
    rng = np.random.default_rng(seed)
    for gamma in (1.0 / 2.2, 1.0):
        stack = codes(rng, gamma, width, frames)
        found = mtf.measure("point", stack, method=method, context=QUICK).measurements[0]
        assert ("gamma" in found.flags) == (gamma < 1.0), (gamma, found.flags)


@pytest.mark.parametrize("method", [point_parametric, point_forward])
def test_a_response_that_noise_shows_to_be_curved_is_told_and_a_straight_one_is_not(seed, method):
    scene = {
        "blur": TrueBlur(sigma_px=1.4),
        "frames": 16,
        "photoelectrons": 1500.0,
        "background": 0.0,
    }
    for gamma, told in ((0.5, True), (1.0, False)):
        stack = PointScene(**scene, gamma=gamma).frames_drawn(np.random.default_rng(seed))
        flags = {flag for one in method(stack, context=QUICK).measurements for flag in one.flags}
        assert ("gamma" in flags) == told


def test_every_result_says_what_its_noise_leaves_open(seed):
    scene = PointScene(blur=TrueBlur(sigma_px=1.4), frames=16, photoelectrons=1500.0)
    stack = scene.frames_drawn(np.random.default_rng(seed))
    told = re.search(
        r"the noise permits exponents from ([0-9.]*[0-9]) to ([0-9.]*[0-9])", said(stack)
    )
    assert told is not None
    low, high = (float(number) for number in told.groups())
    assert 0.5 < low < 1.0 < high < 2.0
    assert "the noise permits exponents from 0.4 to 2.5" in said(
        replace(stack, data=stack.data[:1])
    )


def said(stack):
    """Notes of what was measured, as one text."""
    return " ".join(point_parametric(stack, context=QUICK).measurements[0].notes)


@pytest.mark.parametrize(
    ("stretch", "apart_px", "told"),
    [(0.0, 0.0, False), (0.2, 0.0, False), (0.6, 0.0, False), (0.0, 3.0, True)],
)
def test_light_in_two_places_is_two_sources_and_an_ellipse_is_one(seed, stretch, apart_px, told):
    """An ellipse of 1.8 : 1 is that of astigmatism; Gaussians 1.1 full widths apart are two."""
    rng = np.random.default_rng(seed)
    spots = [Spot(width=1.2, stretch=stretch), Spot(width=1.2, col_px=apart_px)]
    stacks = [SpotCamera(snr=60.0).taken(spot, rng) for spot in spots[: 1 + (apart_px > 0.0)]]
    data = np.sum([stack.data.astype(float) for stack in stacks], axis=0)
    flags = point_parametric(replace(stacks[0], data=data), context=QUICK).measurements[0].flags
    assert ("several-targets" in flags) == told
