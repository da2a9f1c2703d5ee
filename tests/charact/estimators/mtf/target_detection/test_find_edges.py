"""Edges of a frame: those that are there are found, each alone in its region; noise, bars and discs
are none.
"""

import time

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators import mtf
from charact.estimators.mtf import DetectedEdge, find_edges
from charact.method import Context
from labdata import FrameStack
from tests.truth import BarChart, Bars, EdgeScene, TiltedSquares, TrueBlur, noisy

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
