"""Frames that are delivered again: they count once, whatever the target."""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import drop_duplicate_frames
from charact.method import Context
from labdata import FrameStack
from tests.truth import BarScene, EdgeScene, PointScene, TrueBlur

QUICK = Context(quick=True)
TARGETS = {
    "edge": (EdgeScene(snr=30.0), {}),
    "bars": (
        BarScene(frames=1, frequency_cy_per_px=0.15),
        {"bars": 4, "frequency_cy_per_px": 0.15},
    ),
    "point": (
        PointScene(
            blur=TrueBlur(sigma_px=0.8),
            pulse_px=0.5,
            photoelectrons=3000.0,
            rows=64,
            cols=64,
            frames=1,
        ),
        {},
    ),
}
EDGES = ("edge-parametric", "edge-free", "edge-forward", "edge-slanted", "edge-gradient")


def repeated(stack, times):
    return FrameStack(
        data=np.repeat(stack.data, times, axis=0),
        full_scale_dn=stack.full_scale_dn,
        black_level_dn=stack.black_level_dn,
    )


@pytest.mark.parametrize(
    ("kind", "method"),
    [*(("edge", one) for one in EDGES), ("bars", "auto"), ("point", "point-forward")],
)
def test_one_frame_delivered_six_times_is_one_frame(kind, method, seed):
    """The number, its interval and its flags are those of the frame; edges ended in a division by
    zero.
    """
    scene, told = TARGETS[kind]
    one = scene.frames_drawn(np.random.default_rng(seed))
    alone, again = (
        mtf.measure(kind, stack, method=method, context=QUICK, **told)
        for stack in (one, repeated(one, 6))
    )
    for single, same in zip(alone.measurements, again.measurements, strict=True):
        assert (same.value, same.interval95, same.flags) == (
            single.value,
            single.interval95,
            single.flags,
        )
        assert "All 6 frames are identical and count as one." in same.notes


@pytest.mark.parametrize("method", EDGES)
def test_no_method_ends_in_an_error_on_frames_without_differences(method, seed):
    """Asked past the door that counts frames."""
    from charact.method.registry import methods_of_kind

    stack = repeated(TARGETS["edge"][0].frames_drawn(np.random.default_rng(seed)), 4)
    assert (
        methods_of_kind("edge")[method]
        .function(stack, region=None, context=QUICK)
        .measurements[0]
        .value
        is not None
    )


def test_frames_that_repeat_are_left_out_and_counted(seed):
    drawn = np.random.default_rng(seed).poisson(50.0, (3, 16, 16)).astype(np.uint16)
    order = [0, 1, 1, 0, 2]
    stack = FrameStack(
        data=drawn[order], time_s=np.arange(5.0), frame_number=np.arange(10, 15), notes=("a note",)
    )
    found = drop_duplicate_frames(stack)
    assert np.array_equal(found.data, drawn)
    assert found.time_s.tolist() == [0.0, 1.0, 4.0]
    assert found.frame_number.tolist() == [10, 11, 14]
    assert found.notes == (
        "a note",
        "2 of 5 frames are identical to an earlier one and do not count.",
    )


def test_frames_that_differ_in_one_pixel_are_two(seed):
    """A pixel that is not among those by which frames are looked up."""
    frame = np.random.default_rng(seed).poisson(50.0, (64, 64)).astype(np.uint16)
    other = frame.copy()
    other[1, 1] += 1
    stack = FrameStack(data=np.stack([frame, other]))
    assert drop_duplicate_frames(stack) is stack
