"""Focus: MTF50 of a known blur, and a best that only a sharper picture replaces."""

import numpy as np
import pytest

from charact.live import AVERAGED_FRAMES, BestFocus, Focus, FocusReader, read_focus
from charact.method import Context
from tests.charact.live.sources import AtOnce, edge
from tests.truth.blur import TrueBlur

CONTEXT = Context(quick=True, full_scale_dn=255.0)


def reading(value: float, half: float = 0.01, flags: tuple[str, ...] = ()) -> Focus:
    return Focus(mtf50_cy_per_px=value, interval95=(value - half, value + half), flags=flags)


def test_focus_is_the_mtf50_of_the_blur(seed) -> None:
    rng = np.random.default_rng(seed)
    frames = np.stack([edge(rng, blur_px=1.5) for _ in range(4)])
    truth = TrueBlur(sigma_px=1.5).mtf50(5.0)
    focus = read_focus(frames, None, CONTEXT)
    assert focus.mtf50_cy_per_px is not None and focus.interval95 is not None
    assert focus.interval95[0] < truth < focus.interval95[1]
    assert focus.interval95[1] - focus.interval95[0] < 0.1 * truth


def test_a_picture_without_an_edge_has_a_reason_and_no_number(seed) -> None:
    flat = np.random.default_rng(seed).normal(100.0, 3.0, (2, 120, 120)).astype(np.uint8)
    focus = read_focus(flat, None, CONTEXT)
    assert focus.mtf50_cy_per_px is None and focus.reason


def test_the_best_is_held_while_the_lens_is_turned_through_focus(seed) -> None:
    rng = np.random.default_rng(seed)
    seen = 0
    with FocusReader(CONTEXT, None, AtOnce()) as reader:
        for blur_px in (2.0, 1.2, 3.0):
            for _ in range(3 * AVERAGED_FRAMES + 1):
                reader.look_at(edge(rng, blur_px=blur_px, shape=(100, 100)))
                seen += reader.newest is not None
        assert seen > 0 and reader.newest is not None and reader.best.best is not None
        sharpest, blurred = (TrueBlur(sigma_px=sigma).mtf50(5.0) for sigma in (1.2, 3.0))
        assert reader.best.best.mtf50_cy_per_px == pytest.approx(sharpest, rel=0.06)
        assert reader.newest.mtf50_cy_per_px == pytest.approx(blurred, rel=0.1)
        assert reader.best.is_reached_by(reader.newest) is False
        reader.forget_best()
        assert reader.best.best is None


def test_noise_alone_does_not_push_the_best_upwards(seed) -> None:
    """Of 50 lenses that nobody turns, 1,500 readings each: intervals of two standard errors on
    either side.
    """
    error, bests = 0.005, []
    for readings in np.random.default_rng(seed).normal(0.2, error, (50, 1500)):
        held = BestFocus()
        for value in readings:
            held = held.after(reading(float(value), half=2 * error))
        assert held.best is not None and held.best.mtf50_cy_per_px is not None
        bests.append((held.best.mtf50_cy_per_px - 0.2) / error)
        # An ordinary reading finds it again, and one four standard errors lower does not.
        assert held.is_reached_by(reading(0.2, half=2 * error))
    assert 1.0 < np.median(bests) < 2.0
    assert np.sum(np.array(bests) > 3.0) <= 2
    assert not held.is_reached_by(reading(0.18 - error, half=2 * error))


def test_only_clearly_sharper_trusted_readings_take_the_place_of_the_best() -> None:
    held = BestFocus().after(reading(0.2))
    assert held.after(reading(0.205)) == held
    assert held.after(reading(0.19)) == held
    assert held.after(reading(0.4, flags=("saturated",))) == held
    assert held.after(Focus(reason="no target")) == held
    once = held.after(reading(0.22))
    assert once.best == reading(0.2)
    assert once.after(reading(0.2)).after(reading(0.22)).best == reading(0.2)
    assert once.after(reading(0.23)).best == reading(0.22) == once.after(reading(0.22)).best
    assert once.after(reading(0.215)).best == reading(0.215)


def test_readings_that_share_frames_are_held_against_the_best_once(seed) -> None:
    """One sharp moment, in all readings that its frames enter: no two of them confirm each
    other.
    """
    rng = np.random.default_rng(seed)
    with FocusReader(CONTEXT, None, AtOnce()) as reader:
        for blur_px in (
            *[2.0] * 2 * AVERAGED_FRAMES,
            *[1.2] * AVERAGED_FRAMES,
            *[2.0] * 2 * AVERAGED_FRAMES,
        ):
            reader.look_at(edge(rng, blur_px=blur_px, shape=(100, 100)))
        assert reader.best.best is not None and reader.best.best.mtf50_cy_per_px is not None
        blurred = TrueBlur(sigma_px=2.0).mtf50(5.0)
        assert reader.best.best.mtf50_cy_per_px == pytest.approx(blurred, rel=0.1)
