"""The numbers compared are those of the noise that was put in, and their errors are honest."""

import numpy as np
import pytest

from charact.validation import frame_features

SHAPE = (8, 96, 128)


def _white(rng: np.random.Generator, mean: float = 100.0, sd: float = 8.0) -> np.ndarray:
    return mean + sd * rng.standard_normal(SHAPE)


def test_white_noise_has_its_variance_and_no_correlation(seed: int) -> None:
    tiles = frame_features.tiles_of(_white(np.random.default_rng(seed)))
    pixels = np.prod(SHAPE)
    assert tiles.variance == pytest.approx(64.0, abs=4.5 * 64.0 * np.sqrt(2.0 / pixels))
    for lag in frame_features.LAGS:
        assert abs(tiles.correlation(lag)) < 4.5 / np.sqrt(pixels * 7 / 8)


def test_a_moving_mean_of_two_columns_correlates_neighbours_by_half(seed: int) -> None:
    frames = _white(np.random.default_rng(seed))
    tiles = frame_features.tiles_of((frames + np.roll(frames, 1, axis=2)) / 2.0)
    assert tiles.correlation((0, 1)) == pytest.approx(0.5, abs=0.02)
    assert tiles.correlation((1, 0)) == pytest.approx(0.0, abs=0.02)
    # Summed over the lags the covariance is what it was before the blur.
    assert tiles.covariance_sum == pytest.approx(64.0, rel=0.25)


def test_errors_told_are_the_scatter_over_repetitions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found = [frame_features.correlation_features(frame_features.tiles_of(_white(rng))) for _ in range(40)]
    scatter = np.std([one.value for one in found], axis=0, ddof=1)
    told = np.sqrt(np.mean([np.diag(one.covariance) for one in found], axis=0))
    # A scatter of 40 is known to 11 %, a mean of 40 jackknives to a few.
    assert told == pytest.approx(scatter, rel=0.5)
    assert np.mean(told / scatter) == pytest.approx(1.0, abs=0.25)


def test_equal_noise_has_equal_grey_levels_and_other_noise_has_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (8, 192, 256)
    measured = frame_features.sample_of(rng.normal(100.0, 8.0, shape).round(), rng)
    same = np.concatenate([frame_features.sample_of(rng.normal(103.0, 8.0, shape).round(), rng) for _ in range(8)])
    skewed = np.concatenate([frame_features.sample_of(rng.gamma(4.0, 4.0, shape).round(), rng) for _ in range(8)])
    assert frame_features.distance(measured, same).p_value > 1e-5
    other = frame_features.distance(measured, skewed)
    assert other.p_value < 1e-6
    assert other.wasserstein_sd > 0.05


def test_pixels_drawn_for_the_histogram_share_no_frame_and_no_neighbourhood(seed: int) -> None:
    """Numbering every pixel shows which were drawn."""
    frames, rows, cols = 8, 64, 64
    numbers = np.arange(frames * rows * cols, dtype=float).reshape(frames, rows, cols)
    drawn = frame_features.sample_of(numbers, np.random.default_rng(seed))
    places = np.round(drawn - drawn.min()).astype(int)
    assert len(np.unique(places)) >= len(places) * 0.9
    assert len(places) == frames // 2 * rows * cols // frame_features.STRIDE**2
