"""Sequences: frames are paired by time, one span holds for all of them, and the recursive filter
lowers noise as computed and keeps objects that move.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.frames.noise_law import NoiseLaw
from charact.fusion import (
    Source,
    detectability2,
    filtered_law,
    fuse_sequence,
    object_channels,
    pair_frames,
    reduce_noise,
    variance_ratio,
)
from labdata import BadInput, FrameStack
from tests.truth.fusion import gaussian


def stack_of(name: str, times, rng: np.random.Generator, **light: float) -> Source:
    """Frames of a still scene of squares; `light`: in the frame of this number, `frame_3=200`, a
    bright corner.
    """
    scene = np.kron(np.random.default_rng(8).uniform(10.0, 60.0, (8, 8)), np.ones((12, 12)))
    frames = scene + rng.normal(0.0, 1.0, (len(times), *scene.shape))
    for number, amount in light.items():
        frames[int(number.removeprefix("frame_")), :24, :24] += amount
    return Source(name=name, stack=FrameStack(data=frames, time_s=np.asarray(times, float)))


def test_frames_go_with_those_nearest_in_time():
    rng = np.random.default_rng(0)
    visible = stack_of("visible", np.arange(12) / 60.0, rng)
    thermal = stack_of("thermal", 0.004 + np.arange(4) / 30.0, rng)
    pairs, notes = pair_frames([visible, thermal])
    assert pairs[:6] == [(0, 0), (1, 0), (2, 1), (3, 1), (4, 2), (5, 2)]
    # The thermal camera ends at 0.104 s; half of its interval later, frame 7 at 0.117 s is the last
    # with a partner.
    assert len(pairs) == 8 and "4 of 12 frames" in notes[1]
    with pytest.raises(BadInput, match="same time"):
        pair_frames(
            [
                visible,
                replace(thermal, stack=replace(thermal.stack, time_s=thermal.stack.time_s + 60.0)),
            ]
        )
    silent = [
        replace(one, stack=replace(one.stack, time_s=np.empty(0))) for one in (visible, thermal)
    ]
    with pytest.raises(BadInput, match="equally many frames"):
        pair_frames(silent)


def test_a_flash_changes_nothing_elsewhere():
    """With a span of each frame, a flash over 6 % of a band would darken the rest of the
    picture.
    """
    rng = np.random.default_rng(1)
    times = np.arange(5) / 30.0
    sources = [stack_of("visible", times, rng, frame_3=200.0), stack_of("thermal", times, rng)]
    pairs, _ = pair_frames(sources)
    for method in ("weighted", "noise-aware"):
        pictures = [
            one.picture for one in fuse_sequence(sources, pairs, method=method, places=[None, None])
        ]
        quiet = np.array([picture[48:, 48:].mean() for picture in pictures])
        assert len(pictures) == 5 and np.ptp(quiet) < 0.01, method
        assert pictures[3][:20, :20].mean() > pictures[2][:20, :20].mean() + 0.5


def test_a_filtered_sequence_has_the_noise_that_it_states():
    rng = np.random.default_rng(2)
    sources = [stack_of(name, np.arange(24) / 30.0, rng) for name in ("visible", "thermal")]
    pairs, _ = pair_frames(sources)
    frames = list(
        fuse_sequence(sources, pairs, method="weighted", places=[None, None], recursive=0.2)
    )[12:]
    found = np.std(np.stack([one.picture for one in frames[::6]]), axis=0, ddof=1)
    plain = next(fuse_sequence(sources, pairs[:1], method="weighted", places=[None, None]))
    # A gain of 0.2 leaves a ninth of the variance.
    assert np.median(frames[0].sd) == pytest.approx(np.median(plain.sd) / 3.0, rel=0.02)
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.median(frames[0].sd), rel=0.15)


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
    assert np.sqrt(d2["filtered"]) >= 0.9 * np.sqrt(d2["raw"])


def test_a_gain_out_of_range_is_refused() -> None:
    with pytest.raises(BadInput, match="at most 1"):
        list(reduce_noise(np.zeros((2, *SHAPE)), LAW, gain=1.5))
    with pytest.raises(BadInput, match="one size"):
        list(reduce_noise([np.zeros(SHAPE), np.zeros((20, 20))], LAW))
