"""Edges, bars and points of a frame are found, each once, and nothing else."""

import time

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators import mtf
from charact.estimators.mtf import (
    DetectedEdge,
    LocatedTarget,
    find_bar_groups,
    find_edges,
    find_pinholes,
    spread_over_frame,
)
from charact.estimators.mtf.point import source
from charact.method import Context
from labdata import BadInput, FrameStack
from tests.truth import (
    BarChart,
    Bars,
    EdgeScene,
    PointScene,
    TiltedSquares,
    TrueBlur,
    edge_spread,
    noisy,
)

# Edges of a frame: those that are there are found, each alone in its region; noise, bars and discs
# are none.


CHART = TiltedSquares()
STEP_DN = CHART.bright_dn - CHART.dark_dn


def angle_between_deg(one: float, other: float) -> float:
    apart = abs(one - other) % 180.0
    return min(apart, 180.0 - apart)


def holds(edge: DetectedEdge, row: float, col: float, margin_px: float = 0.0) -> bool:
    top, left, height, width = edge.region
    return (
        top - margin_px <= row < top + height + margin_px
        and left - margin_px <= col < left + width + margin_px
    )


@pytest.mark.parametrize(
    ("snr", "noise_blur_px"), [(np.inf, 0.0), (50.0, 0.0), (20.0, 1.0), (5.0, 0.0), (5.0, 0.7)]
)
def test_every_edge_of_a_chart_is_found_and_nothing_else(snr: float, noise_blur_px: float) -> None:
    sd_dn = STEP_DN / snr if np.isfinite(snr) else 0.0
    picture = noisy(
        CHART.mean(), np.random.default_rng(4), sd_dn=sd_dn, shot_share=0.8, blur_px=noise_blur_px
    )
    found = find_edges(picture)
    at = [
        [
            k
            for k, edge in enumerate(found)
            if holds(edge, row, col, 12.0) and angle_between_deg(edge.orientation_deg, a) < 3
        ]
        for row, col, a in CHART.edges()
    ]
    assert all(at)
    assert len(found) == len(CHART.edges()) == 20


@pytest.mark.parametrize("tilt_deg", [6.0, 17.0, 28.0])
def test_a_region_shows_one_edge_only(tilt_deg: float) -> None:
    """Within it the light rises across the edge alone: moved along the edge the noiseless picture
    stays the same.
    """
    chart = TiltedSquares(tilt_deg=tilt_deg)
    mean = chart.mean()
    found = find_edges(noisy(mean, np.random.default_rng(1), sd_dn=20.0))
    assert len(found) == 20
    for edge in found:
        top, left, height, width = edge.region
        part = mean[top : top + height, left : left + width]
        angle = np.deg2rad(edge.orientation_deg)
        down, right = np.gradient(part)
        along = np.abs(down * np.cos(angle) - right * np.sin(angle))
        across = np.abs(right * np.cos(angle) + down * np.sin(angle))
        # Differences of neighbouring pixels are not quite the derivative on a sharp edge; another
        # edge gives 1.
        assert along.max() < 0.12 * across.max()


@pytest.mark.parametrize("angle_deg", [3.0, 45.0, 95.0])
@pytest.mark.parametrize(("snr", "gradient"), [(100.0, 0.3), (5.0, 0.0)])
def test_one_long_edge_is_one_edge(angle_deg: float, snr: float, gradient: float) -> None:
    scene = EdgeScene(rows=300, cols=400, angle_deg=angle_deg, snr=snr, gradient=gradient)
    found = find_edges(scene.frames_drawn(np.random.default_rng(2)))
    assert len(found) == 1
    assert angle_between_deg(found[0].orientation_deg, angle_deg) < 0.3


def test_noise_has_no_edges() -> None:
    """White and correlated noise, and pulses of light: at most 1 frame in 100 may have one, and 24
    have none.
    """
    for seed in range(6):
        rng = np.random.default_rng(seed)
        frame = rng.standard_normal((493, 768))
        if seed % 4 == 3:
            frame = rng.poisson(0.05, frame.shape) * rng.exponential(1.0, frame.shape)
        assert find_edges(gaussian_filter(frame, (0.0, 0.8, 1.5, 0.8)[seed % 4])) == ()


@pytest.mark.parametrize("frequency", [0.03, 0.06, 0.12])
def test_bars_are_no_edges(frequency: float) -> None:
    groups = (Bars(row=150, col=200, frequency=frequency, angle_deg=4.0),)
    frame = noisy(
        BarChart(groups=groups, rows=300, cols=400).mean(), np.random.default_rng(0), sd_dn=40.0
    )
    length_px = 3.5 / frequency
    assert all(
        edge.region[2] < length_px / 2 for edge in find_edges(frame) if edge.orientation_deg < 45
    )
    assert len(find_edges(frame)) <= 2


@pytest.mark.parametrize("radius_px", [40.0, 110.0])
def test_the_rim_of_a_disc_is_no_straight_edge(radius_px: float) -> None:
    row, col = np.mgrid[:300, :400]
    disc = 100 + 1000 / (1 + np.exp((np.hypot(row - 150, col - 200) - radius_px) / 0.6))
    assert find_edges(np.random.default_rng(0).normal(disc, 20.0)) == ()


def test_every_mtf50_lies_in_its_interval_as_often_as_promised() -> None:
    """Of eight 95 % intervals more than two miss in 6 of 1000 frames."""
    picture = noisy(CHART.mean(), np.random.default_rng(11), sd_dn=STEP_DN / 40.0, shot_share=0.8)
    stack = FrameStack(data=picture[None], full_scale_dn=4095.0)
    began = time.perf_counter()
    result = mtf.measure_all("edge", stack, max_targets=8, context=Context(quick=True))
    print(f"\n8 edges of a 768 x 493 frame, quick: {time.perf_counter() - began:.2f} s")
    found = result.find("mtf50")
    assert len({m.region for m in found}) == 8
    assert all(m.status == "ok" for m in found)
    misses = 0
    for m in found:
        assert m.interval95 is not None and m.orientation_deg is not None
        truth = CHART.blur.mtf50(m.orientation_deg)
        misses += not m.interval95[0] <= truth <= m.interval95[1]
    assert misses <= 2
    named = {name for name in result.curves if name.startswith("mtf:")}
    assert len(named) == 8
    best = [m for m in found if any("the most precise of" in note for note in m.notes)]
    assert len(best) == 1
    own = result.curves["mtf:" + ",".join(str(number) for number in best[0].region or ())]
    assert np.array_equal(own.value, result.curves["mtf"].value)


def test_what_is_left_out_is_said() -> None:
    picture = noisy(CHART.mean(), np.random.default_rng(11), sd_dn=40.0)
    result = mtf.measure_all(
        "edge",
        FrameStack(data=picture[None]),
        method="edge-slanted",
        max_targets=2,
        context=Context(quick=True),
    )
    assert len({m.region for m in result.measurements}) == 2
    assert any(
        "18 further edges were not measured" in note
        for m in result.measurements
        for note in m.notes
    )


def test_a_frame_with_one_edge_is_measured_as_before() -> None:
    stack = EdgeScene(blur=TrueBlur(), snr=50.0).frames_drawn(np.random.default_rng(5))
    alone = mtf.measure("edge", stack, context=Context(quick=True)).find("mtf50")[0]
    found = mtf.measure_all("edge", stack, context=Context(quick=True)).find("mtf50")
    assert [(m.value, m.interval95, m.region) for m in found] == [
        (alone.value, alone.interval95, alone.region)
    ]


# Groups of bars and point sources of a frame: found with their frequency and place, others told
# from them.


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
    assert not flashed.neighbours and steady.neighbours


# Which targets of a frame are measured where there are more than may be.


SHAPE = (400, 600)


def at(row: int, col: int) -> LocatedTarget:
    return LocatedTarget(region=(row - 10, col - 10, 20, 20))


def quarter(target: LocatedTarget) -> tuple[bool, bool]:
    row, col, height, width = target.region
    return row + height / 2 >= SHAPE[0] / 2, col + width / 2 >= SHAPE[1] / 2


CORNER = [at(20 + 20 * i, 20 + 30 * j) for i in range(4) for j in range(5)]
ELSEWHERE = [at(50, 500), at(350, 80), at(350, 500)]


def test_every_part_of_the_frame_has_its_say_before_any_has_two() -> None:
    chosen = spread_over_frame([*CORNER, *ELSEWHERE], SHAPE, 4)[:4]
    assert {quarter(one) for one in chosen} == {
        (down, right) for down in (False, True) for right in (False, True)
    }


@pytest.mark.parametrize("max_targets", [1, 2, 3, 7, 24, 100])
def test_nothing_is_lost_and_the_best_comes_first(max_targets: int) -> None:
    found = [*CORNER, *ELSEWHERE]
    ordered = spread_over_frame(found, SHAPE, max_targets)
    assert ordered[0] == found[0]
    assert sorted(one.region for one in ordered) == sorted(one.region for one in found)
