"""Lost frames have numbers and reasons."""

import pytest

from labdata import BadInput, LostFrames, losses_before


def test_a_gap_in_the_numbers_is_told_with_its_reasons():
    lost = losses_before(
        15, expected=10, faults={11: "missing packets", 12: "missing packets", 30: "late"}
    )
    assert [(one.first, one.last, one.reason) for one in lost] == [
        (10, 10, "never arrived"),
        (11, 12, "missing packets"),
        (13, 14, "never arrived"),
    ]
    assert sum(map(len, lost)) == 5


def test_no_gap_loses_nothing():
    assert losses_before(10, expected=10, faults={}) == ()


def test_a_loss_needs_frames_and_a_reason():
    with pytest.raises(BadInput, match="must not come before the first, got 5 to 4"):
        LostFrames(first=5, last=4, reason="late")
    with pytest.raises(BadInput, match="must have a reason"):
        LostFrames(first=5, last=5, reason="")
