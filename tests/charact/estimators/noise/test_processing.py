"""A camera that sharpens, averages over frames or bends its response is found out; its plain twin
is not accused.
"""

import numpy as np
import pytest

from charact.estimators import noise
from labdata import Conditions, FrameStack
from tests.truth.counted_pulses import METHODS, QUICK, Pulses, gaussian, memory_of, session_of

# Electrons, and the light that brings them.
LEVELS = (400.0, 1000.0, 2500.0, 6000.0, 12000.0)


def electrons(rng, level, count):
    return rng.poisson(level, (count, 112, 144)).astype(float)


def plain(charge, read):
    return 100.0 + 0.5 * charge + read


def sharpened(charge, read):
    """What an aperture correction adds: a part of the difference from both neighbours in the
    row.
    """
    picture = plain(charge, read)
    return picture + 0.1 * (
        2.0 * picture - np.roll(picture, 1, axis=2) - np.roll(picture, -1, axis=2)
    )


def averaged(charge, read):
    """A recursive filter in time that keeps a share of the last frame."""
    out = [plain(charge[:1], read[:1])[0]]
    for frame in plain(charge, read)[1:]:
        out.append(0.3 * out[-1] + 0.7 * frame)
    return np.array(out)


def blurred(charge, read):
    from scipy.ndimage import gaussian_filter

    return gaussian_filter(plain(charge, read), (0.0, 0.5, 0.5), mode="wrap")


def spared(charge, read):
    """A filter that spares edges: the mean of a pixel and of neighbours that differ by no more than
    some 30 DN.
    """
    picture = plain(charge, read)
    total, weight = picture.copy(), np.ones_like(picture)
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        beside = np.roll(picture, step, axis=(1, 2))
        near = np.exp(-0.5 * ((beside - picture) / 30.0) ** 2)
        total, weight = total + near * beside, weight + near
    return total / weight


def gamma(charge, read):
    return 100.0 + 10.0 * np.maximum(0.5 * charge + read, 0.0) ** 0.6


def series(in_memory, rng, camera, *, lit=True, count=10):
    """Darks and flats of a camera; the light in the books or not."""
    stacks = []
    for level in (0.0, *LEVELS):
        read = 2.0 * rng.standard_normal((count, 112, 144))
        data = np.clip(np.rint(camera(electrons(rng, level, count), read)), 0, 65535).astype(
            np.uint16
        )
        light = Conditions(illuminance_lux=level) if lit else Conditions()
        stacks.append(
            (f"level-{level:g}", "flat" if level else "dark", FrameStack(data=data), light)
        )
    return in_memory(stacks)


def flags_of(session, method):
    result = noise.measure(session, method=method, context=QUICK)
    return {
        flag
        for name in ("system_gain", "covariance_gain")
        for m in result.find(name)
        for flag in m.flags
    }


@pytest.mark.parametrize(
    ("method", "camera", "flag"),
    [
        ("covariance-sum", plain, None),
        ("covariance-sum", blurred, None),
        ("variance", blurred, None),
        ("covariance-sum", sharpened, "processed"),
        ("variance", sharpened, "processed"),
        ("covariance-sum", averaged, "processed"),
        ("covariance-sum", spared, "processed"),
    ],
)
def test_filters_in_the_camera_are_found_and_blur_is_none(seed, method, camera, flag):
    seen = flags_of(series(session_of, np.random.default_rng(seed), camera), method)
    assert ("processed" in seen) == (flag == "processed")
    assert "gamma" not in seen


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("lit", [True, False])
def test_a_gamma_curve_is_told_by_the_light_or_by_the_noise_alone(seed, method, lit):
    assert "gamma" in flags_of(
        series(session_of, np.random.default_rng(seed), gamma, lit=lit), method
    )
    assert (
        flags_of(series(session_of, np.random.default_rng(seed), plain, lit=lit), method) == set()
    )


def test_the_glow_of_dark_pulses_is_no_noise_reduction(seed):
    """Scintillations of the dark are kept by the screen from frame to frame, and shared by
    neighbours.
    """
    camera = Pulses(transfer=gaussian(0.9), memory=memory_of(0.3))
    rng = np.random.default_rng(seed)
    stacks = [
        (
            f"level-{level}",
            "flat" if level > 1 else "dark",
            camera.frames(rng, level, 12),
            Conditions(),
        )
        for level in (0.2, 4.0, 12.0, 36.0)
    ]
    assert "processed" not in flags_of(session_of(stacks), "covariance-sum")
