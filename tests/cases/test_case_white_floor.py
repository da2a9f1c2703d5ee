"""A pure Gaussian behind the gain over a white floor, and blurs of other forms: no narrow answer of a wrong form."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact import noise
from charact.session_measurement import method_context
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Session, StackEntry, open_session

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT.parent / "shared" / "cases" / "p1-gaussian-blur-white-floor"
READ_DN = 3.0


@dataclass(frozen=True, kw_only=True)
class Held(StackEntry):
    """A stack that lies in memory."""

    held: FrameStack

    def read(self) -> FrameStack:
        return self.held


def entry(label, kind, data, bits, conditions):
    return Held(label=label, kind=kind, frames="", folder=Path("."), conditions=conditions,
                held=FrameStack(data=data, full_scale_dn=2.0**bits - 1.0))  # fmt: skip


def drawn(rng, blur, *, pulse_dn, floor_dn, bits, shape, frames=8, levels=(8.0, 20.0, 40.0), **told):
    """Poisson photoelectrons with exponential heights, blurred, then Poisson electrons of the CCD and read noise."""

    def stack(level, count):
        out = np.empty((count, *shape), np.uint16)
        for frame in out:
            number = rng.poisson(level, shape)
            light = blur(np.where(number > 0, rng.gamma(np.maximum(number, 1), pulse_dn), 0.0))
            electrons = floor_dn * rng.poisson(np.maximum(light, 0.0) / floor_dn)
            frame[:] = np.clip(np.rint(60.0 + electrons + READ_DN * rng.standard_normal(shape)), 0, 2**bits - 1)
        return out

    conditions = Conditions(**told)
    stacks = [entry("dark", "dark", stack(0.0, 2 * frames), bits, conditions)]
    stacks += [entry(f"flat-{level:g}", "flat", stack(level, frames), bits, conditions) for level in levels]
    return Session(folder=Path("."), name="drawn", stacks=tuple(stacks), bit_depth=bits)


def gains(session, seed):
    """Covariance gain and K of a session."""
    result = noise.measure(session, context=method_context(session, quick=True, seed=seed))
    return [next(iter(result.find(name)), None) for name in ("covariance_gain", "conversion_gain")]


def gaussian(sigma_px):
    return lambda image: gaussian_filter(image, sigma_px, mode="wrap")


def two_gaussians(image):
    return 0.85 * gaussian_filter(image, 0.8, mode="wrap") + 0.15 * gaussian_filter(image, 2.2, mode="wrap")


def exponential(image):
    """exp(-r/a), a = 0.8 px: its transfer is (1 + (2 pi f a)^2)^-1.5."""
    rows, cols = image.shape
    square = (2.0 * np.pi * 0.8) ** 2 * (np.fft.fftfreq(rows)[:, None] ** 2 + np.fft.rfftfreq(cols)[None, :] ** 2)
    return np.fft.irfft2(np.fft.rfft2(image) * (1.0 + square) ** -1.5, s=image.shape)


@pytest.mark.skipif(not CASE.is_dir(), reason="the case p1-gaussian-blur-white-floor is not beside this folder")
def test_the_case_reads_its_gain_and_its_floor():
    session = open_session(CASE)
    gain, floor = gains(session, 0)
    for found, truth in ((gain, 5.20), (floor, 1.20)):
        assert found is not None and found.status == "ok"
        assert found.interval95[0] < truth < found.interval95[1]
    assert floor.value == pytest.approx(1.20, rel=0.02)


@pytest.mark.parametrize(
    ("sigma_px", "floor_share", "bits", "shape"),
    [(0.7, 0.15, 12, (112, 144)), (0.9, 0.25, 14, (144, 120)), (1.3, 0.45, 16, (120, 120))],
)
def test_a_gaussian_over_a_white_floor_is_read_without_bias(seed, sigma_px, floor_share, bits, shape):
    pulse_dn = 2.0 ** (bits - 12) * 8.0
    floor_dn = 2.0 * pulse_dn * floor_share / (1.0 - floor_share)
    truth, errors, shares = 2.0 * pulse_dn + floor_dn, [], []
    for number in range(4):
        session = drawn(np.random.default_rng([seed, number]), gaussian(sigma_px), pulse_dn=pulse_dn,
                        floor_dn=floor_dn, bits=bits, shape=shape, levels=(20.0, 40.0, 60.0))  # fmt: skip
        gain, floor = gains(session, number)
        half = 0.5 * (gain.interval95[1] - gain.interval95[0])
        assert gain.status == "ok" and half < 0.15 * truth
        errors.append((gain.value - truth) / half)
        shares.append(gain.value / truth - 1.0)
        assert floor is None or floor.interval95[0] < floor_dn < floor.interval95[1]
    # Half 95 % intervals: one in twenty is beyond 1; four in a row are off together by a quarter of one.
    assert max(np.abs(errors)) < 1.6 and abs(np.mean(errors)) < 0.9
    assert abs(np.mean(shares)) < 0.03


@pytest.mark.parametrize("blur", [two_gaussians, exponential])
def test_blurs_of_other_forms_lie_in_the_interval(seed, blur):
    """Forms that make a cusp at frequency 0 read these 6 to 10 % high."""
    outside = 0
    for number in range(4):
        session = drawn(np.random.default_rng([seed, 9, number]), blur, pulse_dn=20.0, floor_dn=10.0, bits=14,
                        shape=(128, 128), levels=(20.0, 60.0))  # fmt: skip
        gain, _ = gains(session, number)
        half = 0.5 * (gain.interval95[1] - gain.interval95[0])
        outside += abs(gain.value - 50.0) > half
        assert abs(gain.value - 50.0) < 1.6 * half
    assert outside <= 1


def test_a_camera_that_states_no_tube_is_told_nothing_of_pulses(seed):
    session = drawn(np.random.default_rng(seed), gaussian(0.9), pulse_dn=20.0, floor_dn=10.0, bits=14, shape=(112, 112))
    result = noise.measure(session, context=method_context(session, quick=True, seed=1))
    assert not result.find("pulse_gain") and not result.find("photoelectron_gain")
