"""Groups of bars and point sources of a frame: found with their frequency and place, others told
from them.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import find_bar_groups, find_pinholes
from charact.estimators.mtf.point import source
from charact.method import Context
from labdata import BadInput
from tests.truth import BarChart, Bars, PointScene, TrueBlur, edge_spread, noisy

FREQUENCIES, FEW = (0.06, 0.09, 0.14, 0.2, 0.27), (0.06, 0.14, 0.27)


def chart(
    bars: int, tilt_deg: float, aspect: float = 7.0, frequencies: tuple[float, ...] = FREQUENCIES
) -> BarChart:
    """Rows of groups of several frequencies, upright in the upper row and lying in the lower."""
    groups, col = [], 10.0
    for frequency in frequencies:
        half = max(bars / 2, aspect / 4) / frequency + 14
        col += half
        groups += [
            Bars(
                row=70 + 90 * turn,
                col=col,
                frequency=frequency,
                bars=bars,
                angle_deg=tilt_deg + 90 * turn,
                aspect=aspect,
            )
            for turn in (0, 1)
        ]
        col += half
    return BarChart(groups=tuple(groups), rows=240, cols=int(col + 10))


@pytest.mark.parametrize(
    ("bars", "tilt_deg", "aspect", "snr"), [(4, 8.0, 7.0, 8.0), (3, 0.5, 5.0, 50.0)]
)
def test_every_group_is_found_with_its_frequency(
    bars: int, tilt_deg: float, aspect: float, snr: float
) -> None:
    whole = chart(bars, tilt_deg, aspect)
    frame = noisy(whole.mean(), np.random.default_rng(3), sd_dn=2000.0 / snr, shot_share=0.5)
    found = find_bar_groups(frame, bars)
    for group in whole.groups:
        at = [
            one
            for one in found
            if one.region[0] < group.row < one.region[0] + one.region[2]
            and one.region[1] < group.col < one.region[1] + one.region[3]
        ]
        assert len(at) == 1, group
        assert at[0].frequency_cy_per_px == pytest.approx(group.frequency, rel=0.04)
        assert at[0].orientation_deg == (90.0 if group.angle_deg > 45 else 0.0)
    assert len(found) == len(whole.groups)


def test_groups_of_fewer_bars_are_not_taken() -> None:
    frame = noisy(chart(3, 1.0, frequencies=FEW).mean(), np.random.default_rng(3), sd_dn=40.0)
    assert find_bar_groups(frame, 4) == ()


def test_noise_has_no_bars_and_no_points() -> None:
    for seed in range(2):
        frame = np.random.default_rng(seed).poisson(20.0, (300, 400))
        assert find_bar_groups(frame) == ()
        assert find_pinholes(frame) == ()


@pytest.mark.parametrize(("bars", "aspect", "dark"), [(3, 5.0, True), (5, 10.0, False)])
def test_groups_of_any_number_are_counted_and_dark_ones_are_found(
    bars: int, aspect: float, dark: bool
) -> None:
    whole = chart(bars, 1.0, aspect, FEW)
    mean = whole.mean()
    frame = noisy(
        whole.bright_dn + whole.dark_dn - mean if dark else mean,
        np.random.default_rng(3),
        sd_dn=60.0,
    )
    found = find_bar_groups(frame)
    assert len(found) == len(whole.groups)
    assert {one.bars for one in found} == {bars}


def test_two_bars_are_not_looked_for() -> None:
    with pytest.raises(BadInput, match="at least 3 bars, got 2"):
        find_bar_groups(np.zeros((64, 64)), 2)


POINTS = (
    (60.3, 80.2, 1.0),
    (60.0, 200.7, 0.5),
    (150.5, 300.5, 1.0),
    (230.0, 100.0, 0.3),
    (240.2, 240.9, 5.0),
)


def points_on(sigma_px: float, light_dn: float = 4000.0) -> np.ndarray:
    """Point sources through a Gaussian and square pixels, differentiated edge spreads both ways."""
    blur, row, col = TrueBlur(sigma_px=sigma_px), np.arange(300), np.arange(400)

    def line(distance: np.ndarray) -> np.ndarray:
        return (
            edge_spread(blur, distance + 0.01, 0.0) - edge_spread(blur, distance - 0.01, 0.0)
        ) / 0.02

    return 100.0 + sum(k * light_dn * line(row - y)[:, None] * line(col - x) for y, x, k in POINTS)


@pytest.mark.parametrize("sigma_px", [0.35, 0.7, 1.5])
def test_points_are_found_and_hot_pixels_are_not(sigma_px: float) -> None:
    rng = np.random.default_rng(6)
    frame = np.clip(rng.normal(points_on(sigma_px), 10.0), 0, 4095)
    hot = (rng.integers(20, 280, 40), rng.integers(20, 380, 40))
    frame[hot] = rng.choice([600.0, 1500.0, 4095.0], 40)
    found = find_pinholes(np.rint(frame), full_scale_dn=4095.0)
    assert len(found) == len(POINTS)
    for y, x, _ in POINTS:
        assert min(np.hypot(one.row - y, one.col - x) for one in found) < 0.5
    clipped = {(one.row > 235 and one.col > 235) for one in found if one.saturated}
    assert clipped == ({True} if sigma_px < 1.0 else set())


def test_every_point_is_alone_in_its_region() -> None:
    found = find_pinholes(np.random.default_rng(0).normal(points_on(0.7), 10.0))
    for one in found:
        top, left, height, width = one.region
        assert sum(top <= y < top + height and left <= x < left + width for y, x, _ in POINTS) == 1


@pytest.mark.parametrize("seed", range(4))
def test_flashes_of_an_intensifier_are_no_points_and_take_no_room_from_one(seed: int) -> None:
    """Single photoelectrons, each a pulse as high as a faint point in its one frame of eight."""
    scene = PointScene(
        photoelectrons=60,
        peak_dn=60,
        background=0.0005,
        rows=240,
        cols=320,
        row_px=3,
        col_px=5,
        read_dn=0.3,
        gain_spread=2.0,
    )
    (found,) = find_pinholes(scene.frames_drawn(np.random.default_rng(seed)))
    assert found.row == pytest.approx(122.5, abs=0.7) and found.col == pytest.approx(164.5, abs=0.7)
    assert found.region[2:] == (97, 97)


def test_flashes_alone_are_one_sentence() -> None:
    scene = PointScene(
        photoelectrons=0,
        peak_dn=1.0,
        background=0.0005,
        rows=240,
        cols=320,
        read_dn=0.3,
        gain_spread=2.0,
    )
    stack = scene.frames_drawn(np.random.default_rng(3))
    result = mtf.measure_all("point", stack, context=Context(quick=True))
    assert {one.region for one in result.measurements} == {(0, 0, 240, 320)}
    assert len({one.reason for one in result.measurements}) == 1


def test_a_spot_just_below_what_is_needed_is_said_to_be_below() -> None:
    rng = np.random.default_rng(5)
    ground, row, col = rng.normal(0.0, 1.0, (64, 64)), *np.mgrid[-32:32, -32:32]
    spot = np.exp(-0.5 * (row**2 + col**2) / 1.5**2)
    found = [
        source.detect_source((ground + height * spot)[None], 1.0)
        for height in np.linspace(2.0, 8.0, 600)
    ]
    below = [one.reason for one in found if isinstance(one, source.PointRefusal)]
    assert "is 8.9 standard deviations; at least 9 are required" in below[-1]
    assert not any("stands 9.0" in sentence for sentence in below)


def test_flashes_beside_a_point_are_no_other_points() -> None:
    """A flash of two frames in four outlasts their median, and not the changes from frame to
    frame.
    """
    row, col = np.mgrid[:200, :200]

    def spot(height: float, at: tuple[int, int]) -> np.ndarray:
        return height * np.exp(-0.5 * ((row - at[0]) ** 2 + (col - at[1]) ** 2) / 1.5**2)

    frames = np.random.default_rng(0).normal(spot(200.0, (100, 100)), 1.0, (4, 200, 200))
    frames[:2] += spot(60.0, (40, 150))
    flashed = source.detect_source(frames, 1.0)
    frames[2:] += spot(60.0, (40, 150))
    steady = source.detect_source(frames, 1.0)
    assert isinstance(flashed, source.DetectedSource) and isinstance(steady, source.DetectedSource)
    assert not flashed.has_others and steady.has_others
