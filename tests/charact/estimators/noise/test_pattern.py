"""The fixed pattern of unequal pixels is neither the noise of the frames nor the light they keep
from each other.
"""

import numpy as np
import pytest

from charact.estimators import noise
from charact.frames.frame_block import measure_fixed_pattern
from charact.frames.pixels import pixel_sums
from charact.frames.spectrum import NO_BINS
from charact.frames.temporal import order_of
from tests.truth.counted_pulses import METHODS, QUICK, Pulses, flat_series, gaussian, memory_of


def pattern_of(image):
    order = order_of(np.arange(len(image)), interlaced=False)
    return measure_fixed_pattern(order, pixel_sums(image, order, NO_BINS), 1)


def kept(rng, share, count, shape=(96, 128)):
    """Noise of unit variance that keeps a share from frame to frame."""
    frames = [rng.standard_normal(shape)]
    for _ in range(count - 1):
        frames.append(share * frames[-1] + np.sqrt(1 - share**2) * rng.standard_normal(shape))
    return np.array(frames)


@pytest.mark.parametrize("blur_px", [0.0, 1.5])
def test_its_standard_error_holds_for_blurred_noise_too(seed, blur_px):
    """Blurred noise has fewer independent pixels: the scatter over repeats is what the error
    says.
    """
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    pulls = []
    for _ in range(60):
        white = rng.standard_normal((6, 64, 64))
        image = gaussian_filter(white, (0, blur_px, blur_px), mode="wrap") if blur_px else white
        found = pattern_of(image)
        pulls.append(found.variance_dn2 / found.sd_dn2)
    # What near pairs might share is in the error as well, so that it is too large rather than too
    # small.
    assert 0.3 < np.sqrt(np.mean(np.square(pulls))) < 1.0 + 4.5 / np.sqrt(120)


@pytest.mark.parametrize("share", [0.3, 0.6])
def test_noise_that_fades_is_waited_for(seed, share):
    rng = np.random.default_rng(seed)
    fixed = 0.5 * rng.standard_normal((96, 128))
    found = pattern_of(fixed + kept(rng, share, 32))
    assert found.settled
    assert abs(found.variance_dn2 - fixed.var()) < 4.5 * found.sd_dn2


@pytest.mark.parametrize(("share", "frames"), [(0.0, 8), (0.2, 2), (0.2, 8), (0.8, 16), (0.6, 32)])
def test_non_uniformity_of_an_intensified_camera_is_right_or_flagged(seed, share, frames):
    camera = Pulses(
        gain_dn=5.0,
        transfer=gaussian(0.7),
        memory=memory_of(share),
        pattern=0.02,
        offset_dn=1.0,
        shape=(128, 160),
    )
    session = flat_series(
        camera, np.random.default_rng(seed), (40.0, 120.0, 360.0), frames=frames, dark_frames=frames
    )
    realised = 100.0 * np.random.default_rng(7).standard_normal(camera.shape).std() * 0.02
    spread = np.random.default_rng(11).standard_normal(camera.shape).std()
    for method in METHODS:
        result = noise.measure(session, method=method, context=QUICK)
        (prnu,) = result.find("prnu")
        assert prnu.status == "ok" or (share and frames != 32), method
        for found, truth in [
            (prnu, realised),
            *((m, spread) for m in result.find("dsnu") if m.unit == "DN"),
        ]:
            low, high = found.interval68 or (0.0, 0.0)
            assert found.status != "ok" or abs(found.value - truth) < max(
                4.5 * 0.5 * (high - low), 0.02 * truth
            )
