"""The recursive filter lowers noise as computed and keeps objects that move."""

import numpy as np
import pytest

from charact.frames.noise_law import NoiseLaw
from charact.fusion import (
    detectability2,
    filtered_law,
    object_channels,
    reduce_noise,
    variance_ratio,
)
from labdata import BadInput
from tests.truth.fusion import gaussian

SHAPE = (64, 96)
GAIN_DN, READ_DN, BLUR_PX = 8.0, 1.0, 0.6


def camera_frames(mean_pe: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Frames of 4 DN per photoelectron of exponential pulse height, blurred after the gain."""
    electrons = rng.poisson(np.broadcast_to(mean_pe, (count, *SHAPE)))
    pulses = np.where(electrons > 0, rng.gamma(np.maximum(electrons, 1)), 0.0) * 4.0
    return np.stack([gaussian(one, BLUR_PX) for one in pulses]) + READ_DN * rng.normal(
        size=(count, *SHAPE)
    )


LAW = NoiseLaw(gain_dn=GAIN_DN, read_dn=READ_DN, blur_px=BLUR_PX)


@pytest.mark.parametrize("gain", [0.2, 0.4])
def test_noise_of_a_static_scene_falls_by_g_over_2_minus_g(gain: float) -> None:
    rng = np.random.default_rng(1)
    ground = gaussian(rng.normal(size=SHAPE), 6.0)
    scene = 8.0 + 2.0 * ground / ground.std()
    found = {False: [], True: []}
    for _ in range(3):
        frames = camera_frames(np.maximum(scene, 1.0), 36, rng)
        for motion, values in found.items():
            *_, last = reduce_noise(frames, LAW, gain=gain, motion=motion)
            left = last - 4.0 * gaussian(np.maximum(scene, 1.0), BLUR_PX)
            values.append((left.var(), left.mean(), (frames - frames.mean(axis=0)).var() * 36 / 35))
    ratios = {
        motion: np.mean([one[0] for one in values]) / np.mean([one[2] for one in values])
        for motion, values in found.items()
    }
    print(gain, variance_ratio(gain), ratios)
    # 18,000 pixels of which a third are independent: 2 %.
    assert ratios[False] == pytest.approx(variance_ratio(gain), rel=0.06)
    assert ratios[True] <= variance_ratio(gain) / 0.9**2
    assert abs(np.mean([one[1] for one in found[True]])) < 0.1


def test_image_lag_raises_the_noise_of_the_filter() -> None:
    rng = np.random.default_rng(2)
    correlation, frames = 0.4, np.empty((30, *SHAPE))
    frames[0] = rng.normal(size=SHAPE)
    for number in range(1, len(frames)):
        frames[number] = correlation * frames[number - 1] + (
            1.0 - correlation**2
        ) ** 0.5 * rng.normal(size=SHAPE)
    law = NoiseLaw(gain_dn=0.0, read_dn=1.0)
    *_, last = reduce_noise(frames, law, gain=0.3, motion=False)
    # Of 6,144 pixels the variance is known within 1.8 %.
    assert last.var() == pytest.approx(variance_ratio(0.3, correlation), rel=0.06)
    assert filtered_law(law, 0.3, correlation).read_dn ** 2 == pytest.approx(
        variance_ratio(0.3, correlation)
    )


@pytest.mark.parametrize("contrast_pe", [2.0, 4.0])
def test_an_object_that_moves_by_2_px_a_frame_is_seen_as_well(contrast_pe: float) -> None:
    rng = np.random.default_rng(3)
    rows, cols = np.indices(SHAPE)
    places = [14 + 2 * step for step in range(14)]
    discs = np.stack([np.clip(5.0 - np.hypot(rows - 32, cols - col), 0.0, 1.0) for col in places])
    templates = object_channels(discs[-1] > 0.5)
    outputs = {"raw": ([], []), "filtered": ([], [])}
    for _ in range(40):
        for side, contrast in enumerate((contrast_pe, 0.0)):
            frames = camera_frames(8.0 + contrast * discs, 14, rng)
            *_, last = reduce_noise(frames, LAW, gain=0.2)
            for name, picture in (("raw", frames[-1]), ("filtered", last)):
                outputs[name][side].append(np.tensordot(templates, picture, axes=2))
    d2 = {
        name: detectability2(*(np.array(one) for one in sides)) for name, sides in outputs.items()
    }
    print(contrast_pe, d2)
    assert np.sqrt(d2["filtered"]) >= 0.9 * np.sqrt(d2["raw"])


def test_a_gain_out_of_range_is_refused() -> None:
    with pytest.raises(BadInput, match="at most 1"):
        list(reduce_noise(np.zeros((2, *SHAPE)), LAW, gain=1.5))
    with pytest.raises(BadInput, match="one size"):
        list(reduce_noise([np.zeros(SHAPE), np.zeros((20, 20))], LAW))
