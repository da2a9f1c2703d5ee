"""What a stack of frames holds, whatever its number of frames."""

import numpy as np
import pytest

from charact.frames import Stack
from labdata import FrameStack

TOP_DN = 4095


def star(frames: int, rng: np.random.Generator, *, peak_dn: float) -> Stack:
    """Frames of a Gaussian source of 1.2 px with photon noise, cut off at 12 bits."""
    row, col = np.mgrid[:48, :48]
    light = 100.0 + peak_dn * np.exp(-((row - 23.6) ** 2 + (col - 24.2) ** 2) / 2.88)
    drawn = rng.poisson(light, (frames, 48, 48))
    return Stack(frames=FrameStack(data=np.minimum(drawn, TOP_DN).astype(np.uint16)))


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_the_ceiling_of_a_clipped_star_does_not_depend_on_the_number_of_frames(frames, seed):
    rng = np.random.default_rng(seed)
    assert star(frames, rng, peak_dn=5500.0).ceiling_dn == TOP_DN
    assert star(frames, rng, peak_dn=3000.0).ceiling_dn is None


def test_single_pixels_at_the_highest_code_are_no_plateau(seed):
    data = np.random.default_rng(seed).integers(90, 110, (3, 48, 48)).astype(np.uint16)
    data[0, 10, 10] = data[1, 30, 20] = data[2, 10, 12] = TOP_DN
    assert Stack(frames=FrameStack(data=data)).ceiling_dn is None
    data[2, 10, 11] = TOP_DN
    assert Stack(frames=FrameStack(data=data)).ceiling_dn == TOP_DN


def test_a_stated_full_scale_precedes_what_the_file_says_and_that_what_the_frames_show():
    data = np.full((1, 8, 8), TOP_DN, np.uint16)
    of_file = FrameStack(data=data, full_scale_dn=16383.0)
    assert Stack(frames=FrameStack(data=data)).ceiling_dn == TOP_DN
    assert Stack(frames=of_file).ceiling_dn == 16383.0
    assert Stack(frames=of_file, stated_full_scale_dn=65535.0).ceiling_dn == 65535.0


def test_the_top_of_unclipped_frames_is_their_highest_value(seed):
    stack = star(2, np.random.default_rng(seed), peak_dn=3000.0)
    assert stack.top_dn == stack.data.max()
    assert stack.often_full().sum() == 1
    assert not stack.is_clipped()
