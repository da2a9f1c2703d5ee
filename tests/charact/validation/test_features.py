"""The numbers compared are those of the noise that was put in, and each defect moves the number
that names it.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from charact.observables import Numbers, Stacks, observables
from charact.observables.frame_view import FrameView
from charact.observables.thresholds import FRAMES
from charact.validation import target_features

SHAPE = (8, 96, 128)
REACH = FRAMES.reach


def numbers_of(
    name: str, dark: NDArray[np.float64], flat: NDArray[np.float64], *, interlaced: bool = False
) -> Numbers:
    """Return the numbers of a statistic of a dark and a flat."""
    views = (FrameView(*each, interlaced=interlaced) for each in (("dark", dark), ("flat", flat)))
    statistics = {statistic.name: statistic for statistic in observables()}
    seen = next(views)
    return statistics[name].numbers(Stacks(darks=(seen,), flats=tuple(views)))


def _white(rng: np.random.Generator, mean: float = 100.0, sd: float = 8.0) -> NDArray[np.float64]:
    return mean + sd * rng.standard_normal(SHAPE)


def _dark_and_flat(seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    return _white(rng, 20.0, 2.0), _white(rng)


def test_white_noise_has_its_variance_and_no_correlation(seed: int) -> None:
    view = FrameView("flat", _white(np.random.default_rng(seed)))
    pixels = np.prod(SHAPE) * 7 / 8
    assert view.variance_dn2 == pytest.approx(64.0, abs=4.5 * 64.0 * np.sqrt(2.0 / pixels))
    for row, col in FRAMES.lags:
        assert abs(view.covariance[REACH + row, REACH + col]) < 4.5 * 64.0 / np.sqrt(pixels)
    # The same power at all frequencies: that of the variance of frames less their mean.
    assert view.power[1:, 1:].mean() == pytest.approx(64.0, rel=4.5 / np.sqrt(pixels / 2.0))


def test_a_moving_mean_of_two_columns_correlates_neighbours_by_half_and_keeps_the_covariance_sum(
    seed: int,
) -> None:
    frames = _white(np.random.default_rng(seed))
    view = FrameView("flat", (frames + np.roll(frames, 1, axis=2)) / 2.0)
    assert view.covariance[REACH, REACH + 1] / view.variance_dn2 == pytest.approx(0.5, abs=0.02)
    assert view.covariance[REACH + 1, REACH] / view.variance_dn2 == pytest.approx(0.0, abs=0.02)
    assert view.covariance.sum() == pytest.approx(64.0, rel=0.25)


def test_gaussian_noise_has_the_tails_of_its_closed_form(seed: int) -> None:
    """The mean of the highest share a of a normal deviate is its density at the quantile over a."""
    from scipy.special import ndtri

    dark, flat = _dark_and_flat(seed)
    found = numbers_of("histogram", dark, flat)
    for share in FRAMES.tails:
        expected = np.exp(-0.5 * ndtri(share) ** 2) / np.sqrt(2.0 * np.pi) / share
        # The scatter of the mean of the highest values is below that of one of them over the root
        # of their number.
        error = 4.5 / np.sqrt(share * flat.size * 7 / 8)
        assert found[f"mean of the highest {100.0 * share:g} % of flat"] == pytest.approx(
            expected, abs=error
        )
        assert found[f"mean of the lowest {100.0 * share:g} % of flat"] == pytest.approx(
            -expected, abs=error
        )


def test_a_bit_left_out_has_no_ones(seed: int) -> None:
    dark, flat = _dark_and_flat(seed)
    found = numbers_of("histogram", dark, 2.0 * (flat // 2.0))
    assert found["share of ones of bit 0 of flat"] == 0.0
    assert found["share of ones of bit 1 of flat"] == pytest.approx(
        0.5, abs=4.5 * 0.5 / np.sqrt(96 * 128)
    )


def test_fields_of_unequal_gain_differ_and_their_lag_is_their_correlation(seed: int) -> None:
    dark, flat = _dark_and_flat(seed)
    flat[:, 1::2] *= 1.02
    # Each odd row holds a tenth of the even row above it, of the field before.
    flat[:, 1::2] += 0.1 * (flat[:, ::2] - 100.0)
    pixels = np.prod(SHAPE)
    difference = numbers_of("fixed-pattern", dark, flat)["odd less even rows of flat"]
    assert difference == pytest.approx(0.02 * 100.0 / 101.0, abs=4.5 * 2.0 * 0.08 / np.sqrt(pixels))
    found = numbers_of("time", dark, flat, interlaced=True)
    # Half of the pairs of successive fields are of one frame.
    lag = 0.1 * 8.0 / 15.0 / np.mean([1.0, 1.02**2 + 0.01])
    assert found["correlation of fields of flat, 1 apart"] == pytest.approx(
        lag, abs=4.5 / np.sqrt(pixels / 2.0)
    )


def test_a_repeated_frame_and_a_repeated_field_are_the_same_twice(seed: int) -> None:
    dark, flat = _dark_and_flat(seed)
    plain = numbers_of("time", dark, flat)
    assert plain["largest correlation of two frames of flat"] < 0.0
    flat[3, ::2] = flat[2, ::2]
    found = numbers_of("time", dark, flat, interlaced=True)
    # Variances less the mean of 8 fields: of two equal ones 42/64, of the 6 with them 58/64, of the
    # others 56/64.
    mean = (2 * 42 + 6 * 58 + 8 * 56) / 16.0
    pixels = np.prod(SHAPE[1:]) / 2.0
    assert found["largest correlation of two fields of flat"] == pytest.approx(
        42.0 / mean, abs=4.5 / np.sqrt(pixels)
    )


def test_six_hot_pixels_are_the_height_of_the_highest(seed: int) -> None:
    dark, flat = _dark_and_flat(seed)
    plain = numbers_of("defects", dark, flat)
    dark[:, 10:70:10, 33] += 24.0
    found = numbers_of("defects", dark, flat)
    name = "ln height of the 8 most bright pixels of dark, DN"
    assert np.exp(found[name]) > 0.75 * 24.0 > 5.0 * np.exp(plain[name])
    # Only the pixels of the dark, and no spot, are another.
    others = {key for key in plain if found[key] != plain[key]} - {name}
    assert all(abs(found[key] - plain[key]) < 0.3 for key in others)
    assert not any("flat" in key for key in others)


def test_jitter_of_rows_is_variance_on_the_edge_alone(seed: int) -> None:
    """An edge of a slope s, moved by a standard deviation d, varies by s d more."""
    rng = np.random.default_rng(seed)
    columns = np.arange(64.0)
    at = 32.0 + 0.05 * np.arange(192.0)[:, None]
    moved = at + 0.3 * rng.standard_normal((16, 192, 1))
    still = np.broadcast_to(at, moved.shape)
    still_edge, moved_edge = (
        target_features.edge_features(
            10.0 * np.clip(columns - x, -4.0, 4.0) + 60.0 + rng.standard_normal((16, 192, 64)), 0.0
        )
        for x in (still, moved)
    )
    assert np.exp(still_edge["ln variance of the edge itself"]) == pytest.approx(1.0, rel=0.1)
    assert np.exp(moved_edge["ln variance of the edge itself"]) == pytest.approx(
        1.0 + 9.0, rel=0.15
    )
    for side in ("dark side", "bright side"):
        assert np.exp(moved_edge[f"ln variance of the {side}"]) == pytest.approx(1.0, rel=0.2)


def test_a_ghost_of_a_point_is_the_highest_spot_beside_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y, x = np.indices((128, 128))
    point = 200.0 * np.exp(-((y - 64) ** 2 + (x - 64) ** 2) / 8.0)
    frames = point + rng.standard_normal((8, 128, 128))
    ghost = frames + 0.05 * np.roll(point, 30, axis=1)
    name = "highest spot beyond 12 px of the point"
    found = [
        np.sinh(target_features.point_features(one, 0.0, None)[name]) for one in (frames, ghost)
    ]
    # A Gaussian of variance 4 px², smoothed by one of variance 2.25 px², keeps 4 / 6.25 of its
    # height.
    assert found[0] < 0.5
    assert found[1] == pytest.approx(10.0 * 4.0 / 6.25, abs=0.5)


def test_a_ring_that_clips_has_no_level() -> None:
    y, x = np.indices((120, 120)) - 60.0
    frames = np.tile(np.minimum(4000.0 * np.exp(-np.hypot(y, x) / 6.0), 255.0), (2, 1, 1))
    free, clipped = (target_features.point_features(frames, 0.0, full) for full in (None, 255.0))
    # exp(-r/6) falls to 255/4000 at 16.5 px.
    assert {name for name in free if np.isnan(clipped[name])} == {
        f"level at {low:g} to {high:g} px of the point"
        for low, high in ((0.0, 1.5), (1.5, 3.0), (3.0, 5.0), (5.0, 8.0), (8.0, 12.0), (12.0, 18.0))
    }
    assert clipped["level at 18 to 26 px of the point"] == free["level at 18 to 26 px of the point"]
