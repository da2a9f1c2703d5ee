"""Cameras drawn at random over all that goes wrong: a number is right within its interval, or it
carries a flag.
"""

import numpy as np
import pytest

from charact.estimators import noise
from tests.truth.counted_pulses import METHODS, QUICK, Pulses, flat_series, gaussian, memory_of

SESSIONS = 8
# A silent failure is this many standard errors and this share away from the truth.
ERRORS, SHARE = 4.0, 0.02


def drawn(pulses, keeping, rng):
    """A camera with, on average, one or two ailments."""

    def ailing(healthy, *others):
        return others[rng.integers(len(others))] if rng.random() < 0.25 else healthy

    intensified = bool(rng.random() < 0.5)
    blur = ailing(0.7, 0.0, 0.3, 0.5, 1.0, 1.5) if intensified else ailing(0.0, 0.3, 0.5, 1.0, 1.5)
    drift = ailing(0.0, 0.01, 0.05, 0.1)
    count = int(ailing(8, 2, 3, 5, 16, 32))
    top_dn = float(ailing(600.0, 60.0, 200.0, 2000.0))
    camera = pulses(
        gain_dn=10.0 if intensified else 0.0,
        electron_gain_dn=0.05 if intensified else 0.5,
        transfer=gaussian(blur) if intensified and blur else None,
        smoothing_px=0.0 if intensified else blur,
        memory=keeping(ailing(0.0, 0.05, 0.1, 0.3, 0.6, 0.8)) if intensified else (1.0,),
        black_dn=float(ailing(100.0, 4.0, 1.0)),
        full_scale_dn=float(ailing(65535.0, 100.0 + top_dn, 110.0 + 0.9 * top_dn)),
        # Less than 2 % at the top is within the scope of both methods and goes unflagged.
        bend_per_dn=ailing(0.0, 0.05, 0.1, 0.2) / top_dn,
        pattern=ailing(0.01, 0.0, 0.05),
        offset_dn=ailing(1.0, 0.0, 3.0),
        shape=(112, 144),
        light_of_frame=lambda frame: 1.0 + drift * frame / max(1, count - 1),
    )
    unit = camera.gain_dn or camera.electron_gain_dn
    levels = tuple(top_dn / unit * np.linspace(0.0, 1.0, int(ailing(4, 1, 2, 6)) + 1)[1:])
    return camera, levels, count


def truths(camera) -> dict[tuple[str, str], float]:
    """What the camera was made with."""
    gain = camera.covariance_gain_dn if camera.gain_dn else camera.electron_gain_dn
    found = {
        ("covariance_gain", "DN"): gain * (1.0 + camera.pattern**2),
        ("system_gain", "DN/e-"): gain,
    }
    if not camera.smoothing_px:
        found["read_noise", "DN"] = float(np.hypot(camera.read_noise_dn, np.sqrt(1 / 12)))
        if not camera.bend_per_dn and camera.pattern:
            spread = np.random.default_rng(7).standard_normal(camera.shape).std()
            found["prnu", "%"] = 100.0 * camera.pattern * spread
    return found


@pytest.mark.parametrize("method", METHODS)
def test_no_number_is_wrong_without_a_flag(seed, method):
    silent, trusted = [], 0
    for index in range(SESSIONS):
        rng = np.random.default_rng((seed, index))
        camera, levels, frames = drawn(Pulses, memory_of, rng)
        session = flat_series(camera, rng, levels, frames=frames, dark_frames=max(frames, 4))
        result = noise.measure(session, method=method, context=QUICK)
        for key, truth in truths(camera).items():
            for found in (m for m in result.find(key[0]) if m.unit == key[1] and m.status == "ok"):
                trusted += 1
                low, high = found.interval68
                away = abs(found.value - truth)
                if away > max(ERRORS * 0.5 * (high - low), SHARE * truth):
                    silent.append((index, key, found.value, truth, camera, frames))
    assert not silent
    # Most cameras ail; of those that do not, numbers must still come out.
    assert trusted > 0.2 * SESSIONS


@pytest.mark.parametrize("frames", [2, 4])
def test_the_interval_of_few_frames_covers_or_says_that_they_are_too_few(seed, frames):
    """95 % intervals of 6 sessions of small frames miss at most 3 times: once in some 10,000 by
    chance.
    """
    camera = Pulses(transfer=gaussian(0.7), shape=(96, 128))
    missed = 0
    for index in range(6):
        session = flat_series(
            camera, np.random.default_rng((seed, frames, index)), (5.0, 15.0, 30.0), frames=frames
        )
        (gain,) = noise.measure(session, context=QUICK).find("covariance_gain")
        low, high = gain.interval95
        missed += (
            "too-few-frames" not in gain.flags and not low <= camera.covariance_gain_dn <= high
        )
    assert missed <= 3
