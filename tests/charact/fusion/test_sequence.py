"""Sequences: frames are paired by time, and one span holds for all of them."""

from dataclasses import replace

import numpy as np
import pytest

from charact.fusion import Source, fuse_sequence, pair_frames
from labdata import BadInput, FrameStack


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
