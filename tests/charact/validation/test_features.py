"""The numbers compared are those of the noise that was put in, and each defect moves the number
that names it.
"""

import numpy as np
import pytest
from scipy.special import ndtri

from charact.observables import FRAMES, FrameView, Numbers, Stacks, observables
from charact.observables.frame_view import highest
from charact.validation import target_features


def numbers_of(name: str, *frames: np.ndarray, interlaced: bool = False) -> Numbers:
    """Return the numbers of a statistic of a dark and flats, the brightest last."""
    labels = ("dark", "low", "flat") if len(frames) > 2 else ("dark", "flat")
    dark, *flats = (
        FrameView(*stack, interlaced=interlaced) for stack in zip(labels, frames, strict=True)
    )
    (statistic,) = (known for known in observables() if known.name == name)
    return statistic.numbers(Stacks(darks=(dark,), flats=tuple(flats)))


def test_gaussian_noise_has_the_tails_of_its_closed_form(seed: int) -> None:
    """The mean of the highest share a of a normal deviate is its density at the quantile over a."""
    dark, flat = 8.0 * np.random.default_rng(seed).standard_normal((2, 8, 96, 128))
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


def test_ones_of_the_bits_show_one_left_out_and_no_level(seed: int) -> None:
    """The raw share of ones of a bit as large as the noise follows the level."""
    rng = np.random.default_rng(seed)
    frames = [np.rint(level + 6.0 * rng.standard_normal((8, 96, 128))) for level in (1000, 1011)]
    raw = [np.mean(flat[0].astype(int) >> 4 & 1) for flat in frames]
    assert abs(raw[1] - raw[0]) > 0.3
    # Two shares of all pixels of a frame.
    error = 4.5 * np.sqrt(2.0 * 0.25 / frames[0][0].size)
    for flat in frames:
        numbers = numbers_of("histogram", frames[0], flat)
        for bit in range(FRAMES.bits):
            assert numbers[f"excess ones of bit {bit} of flat"] == pytest.approx(0.0, abs=error)
        even = numbers_of("histogram", frames[0], 2.0 * (flat // 2.0))
        assert even["excess ones of bit 0 of flat"] == pytest.approx(-0.5, abs=error)


def test_fields_of_unequal_gain_differ_and_their_lag_is_their_correlation(seed: int) -> None:
    rng, shape = np.random.default_rng(seed), (8, 96, 128)
    dark, flat = 20.0 + 2.0 * rng.standard_normal(shape), 100.0 + 8.0 * rng.standard_normal(shape)
    flat[:, 1::2] *= 1.02
    # Each odd row holds a tenth of the even row above it, of the field before.
    flat[:, 1::2] += 0.1 * (flat[:, ::2] - 100.0)
    pixels = np.prod(shape)
    difference = numbers_of("fixed-pattern", dark, flat)["odd less even rows of flat"]
    assert difference == pytest.approx(0.02 * 100.0 / 101.0, abs=4.5 * 2.0 * 0.08 / np.sqrt(pixels))
    found = numbers_of("time", dark, flat, interlaced=True)
    # Half of the pairs of successive fields are of one frame.
    lag = 0.1 * 8.0 / 15.0 / np.mean([1.0, 1.02**2 + 0.01])
    assert found["correlation of fields of flat, 1 apart"] == pytest.approx(
        lag, abs=4.5 / np.sqrt(pixels / 2.0)
    )


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


def test_a_bend_moves_signal_and_variance_of_a_dim_flat_over_a_bright_one_by_its_closed_form(
    seed: int,
) -> None:
    """The slope of s (1 - a s) is 1 - 2 a s: the variance of photons follows its square."""
    rng, bend = np.random.default_rng(seed), 1e-4
    photons = [rng.poisson(mean, (8, 96, 128)).astype(float) for mean in (200.0, 1000.0)]
    dark = 10.0 + rng.standard_normal((8, 96, 128))
    found = numbers_of("linearity", dark, *(10.0 + s * (1.0 - bend * s) for s in photons))
    # Of s^2 its mean is s^2 + s.
    low, high = (s - bend * (s**2 + s) for s in (200.0, 1000.0))
    assert found["signal of low over flat"] == pytest.approx(low / high, rel=2e-3)
    noise_low, noise_high = (
        s * (1.0 - 2.0 * bend * s) ** 2 / signal for s, signal in ((200.0, low), (1000.0, high))
    )
    # Variances of 86,016 values above their mean have a relative standard error of 0.5 %, the
    # dark's is 0.5 % of them.
    assert found["variance/signal of low over flat"] == pytest.approx(
        noise_low / noise_high, rel=4.5 * 0.008
    )


def test_columns_averaged_near_the_corners_are_correlated_there_by_half(seed: int) -> None:
    rng = np.random.default_rng(seed)
    dark, flat = (
        10.0 + rng.standard_normal((8, 128, 160)),
        100.0 + 8.0 * rng.standard_normal((8, 128, 160)),
    )
    y, x = (np.linspace(-1.0, 1.0, size) for size in flat.shape[1:])
    outside = y[:, None] ** 2 + x[None, :] ** 2 > 1.0
    mixed = np.where(outside, (flat + np.roll(flat, 1, axis=2)) / 2.0, flat)
    plain, found = (numbers_of("field", dark, each) for each in (flat, mixed))
    of = "px near the corners less the centre of flat"
    # A seventh of the picture is near its corners, and its correlation is that of 20,000 pairs.
    error = 4.5 / np.sqrt(0.1 * flat.size)
    assert found[f"correlation at 0,1 {of}"] == pytest.approx(0.5, abs=2.0 * error)
    assert found[f"correlation at 1,0 {of}"] == pytest.approx(0.0, abs=2.0 * error)
    name = "ln variance/signal near the corners over the centre of flat"
    assert found[name] == pytest.approx(-np.log(2.0), abs=2.0 * np.sqrt(2.0) * error)
    assert all(abs(value) < 2.0 * np.sqrt(2.0) * error for value in plain.values())


@pytest.mark.parametrize("size", [40, 1000])
def test_the_mean_of_the_highest_values_is_that_of_the_end_of_the_sorted_ones(
    size: int, seed: int
) -> None:
    # Whole numbers tie, also at the limit.
    values = np.random.default_rng(seed).poisson(3.0, (size, 7)).astype(np.float32)
    assert highest(values, 30) == pytest.approx(np.sort(values, axis=None)[-30:].mean())
