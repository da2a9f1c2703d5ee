"""Pixels that pile up at a code: told at any code where noise is cut off, not where a plateau is
still.
"""

import numpy as np
import pytest

from charact.frames import is_clipped
from tests.truth import EdgeScene, TrueBlur

EDGE = EdgeScene(dark_dn=60.3, bright_dn=210.3, frames=4, shot_share=0.5)


def edge(noise_dn, **knobs):
    scene = {**vars(EDGE), "snr": 150.0 / noise_dn, **knobs}
    return EdgeScene(**scene)


@pytest.mark.parametrize("frames", [1, 4])
@pytest.mark.parametrize("over_sd", [-0.7, 0.0, 1.0])
@pytest.mark.parametrize("noise_dn", [3.0, 8.0])
def test_noise_cut_off_at_any_code_is_clipped(frames, over_sd, noise_dn, seed):
    """The lowest code from 0.7 deviations below the dark side to one above it; only 0 and 16 were
    looked at.
    """
    scene = edge(noise_dn, frames=frames, floor_dn=float(round(60.3 + over_sd * noise_dn)))
    assert is_clipped(scene.frames_drawn(np.random.default_rng(seed)).data, 255.0)


@pytest.mark.parametrize("frames", [1, 4])
def test_a_bright_side_cut_off_is_clipped_too(frames, seed):
    data = edge(6.0, frames=frames).frames_drawn(np.random.default_rng(seed)).data
    assert is_clipped(np.minimum(data, 210), 255.0)


@pytest.mark.parametrize("frames", [1, 8])
@pytest.mark.parametrize("noise_dn", [0.1, 0.3, 0.6, 1.0, 3.0])
@pytest.mark.parametrize("size", [16, 70])
def test_quiet_plateaus_are_not(frames, noise_dn, size, seed):
    """Sharp, with a halo and with a tube's tail; noise from a tenth of a code to three."""
    blurs = (
        TrueBlur(sigma_px=0.3),
        TrueBlur(halo_share=0.2, halo_px=30.0),
        TrueBlur(form="exponential", frequency_cy_per_px=0.2),
    )
    for blur in blurs:
        scene = edge(noise_dn, frames=frames, rows=size, cols=size, blur=blur)
        assert not is_clipped(scene.frames_drawn(np.random.default_rng(seed)).data, 255.0)
