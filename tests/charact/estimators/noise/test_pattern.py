"""The fixed pattern of unequal pixels is neither the noise of the frames nor the light they keep
from each other.
"""

import numpy as np
import pytest

from charact.estimators import noise
from tests.truth.counted_pulses import METHODS, QUICK, Pulses, flat_series, gaussian, memory_of


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
