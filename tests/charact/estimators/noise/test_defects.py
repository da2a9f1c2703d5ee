"""Hot, dead and restless pixels are counted where they were put; a sound camera and pulses of light
have none.
"""

import numpy as np
import pytest

from charact.estimators import noise
from charact.method import Context
from labdata import Conditions, FrameStack
from tests.truth.counted_pulses import QUICK, Pulses, gaussian, session_of

HOT = ((3, 5), (40, 77), (95, 127))
DEAD = ((10, 10), (60, 3))
RESTLESS = ((20, 100), (70, 50), (71, 51), (80, 9))


def frames(rng, level, count=16, *, hot=(), dead=(), restless=(), restless_dn=60.0):
    """Frames of a CCD with shading, unequal pixels and defects."""
    shape = (96, 128)
    unequal = np.random.default_rng(5).standard_normal(shape)
    light = level * (1.0 - 0.2 * np.linspace(-1.0, 1.0, shape[1]) ** 2) * (1.0 + 0.005 * unequal)
    for place in dead:
        light[place] = 0.0
    read = (
        100.0
        + unequal
        + 0.5 * rng.poisson(light / 0.5, (count, *shape))
        + 2.0 * rng.standard_normal((count, *shape))
    )
    for row, col in hot:
        read[:, row, col] += 40.0
    for row, col in restless:
        read[:, row, col] += restless_dn * rng.standard_normal(count)
    return FrameStack(data=np.clip(np.rint(read), 0, 65535).astype(np.uint16))


def measured(in_memory, rng, interlaced=False, **defects):
    stacks = [("dark", "dark", frames(rng, 0.0, **defects), Conditions(exposure_s=1.0))]
    stacks += [
        (f"flat-{i}", "flat", frames(rng, i * 300.0, **defects), Conditions()) for i in (1, 2, 3)
    ]
    return noise.measure(
        in_memory(stacks),
        method="variance",
        context=Context(seed=1, quick=True, interlaced=interlaced),
    )


def counts(result):
    return {m.stack: m for m in result.find("defect_pixels")}


@pytest.mark.parametrize("interlaced", [False, True])
def test_every_defect_is_counted_once_and_named(seed, interlaced):
    found = counts(
        measured(
            session_of,
            np.random.default_rng(seed),
            interlaced,
            hot=HOT,
            dead=DEAD,
            restless=RESTLESS,
        )
    )
    # In the dark a dead pixel is like any other.
    assert found["dark"].value == len(HOT) + len(RESTLESS)
    # In the light the noise of photons hides the restless ones.
    assert "2 faint" in found["flat-3"].notes[0]
    assert "4 blinking" in found["dark"].notes[0]
    assert all(str(place) in found["dark"].notes[1] for place in HOT)


def test_a_sound_camera_has_none(seed):
    result = measured(session_of, np.random.default_rng(seed))
    for m in counts(result).values():
        assert (m.value, m.interval95, m.status) == (0.0, (0.0, 0.0), "ok")
    assert all("defects" not in m.flags for m in result.measurements)


def test_blinking_pixels_are_left_out_of_the_noise(seed):
    rng = np.random.default_rng(seed)
    many = tuple((row, 64) for row in range(0, 96, 4))
    spoiled = measured(session_of, rng, restless=many)
    (random,) = spoiled.find("noise_tvh", stack="dark")
    (read_noise,) = spoiled.find("read_noise", unit="DN")
    # 2 DN of any sound pixel and the steps; the pixels put in would make it 2.9.
    for one in (random, read_noise):
        assert one.status == "ok" and one.value == pytest.approx(
            np.hypot(2.0, 12.0**-0.5), rel=0.01
        )
    assert any("24 defective pixels" in note for note in read_noise.notes)


def test_pulses_of_light_are_no_defects(seed):
    """Rare bright events of a tube change a pixel once, not half of the time."""
    camera = Pulses(shape=(96, 128), transfer=gaussian(0.7))
    rng = np.random.default_rng(seed)
    dim = session_of([("dark", "dark", camera.frames(rng, 0.02, 32), Conditions())])
    (found,) = noise.measure(dim, method="variance", context=QUICK).find("defect_pixels")
    assert "0 blinking" in found.notes[0]


def test_pairs_of_frames_show_defects_too(seed):
    rng = np.random.default_rng(seed)
    stacks = [
        (kind, kind, frames(rng, level, 2, hot=HOT, dead=DEAD), Conditions())
        for kind, level in (("dark", 0.0), ("flat", 900.0))
    ]
    found = counts(noise.measure(session_of(stacks), method="variance", context=QUICK))
    assert (found["dark"].value, found["flat"].value) == (len(HOT), len(DEAD))


def test_images_of_a_few_pixels_count_no_defects(seed):
    rng = np.random.default_rng(seed)
    stacks = [
        (kind, kind, FrameStack(data=rng.poisson(level, (8, 3, 3)).astype(np.uint16)), Conditions())
        for kind, level in (("dark", 100.0), ("flat", 400.0))
    ]
    (found,) = noise.measure(session_of(stacks), method="variance", context=QUICK).find(
        "defect_pixels"
    )
    assert found.status == "refused" and "32 x 32 px" in found.reason
