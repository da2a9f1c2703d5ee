"""Lag, line noise and the noise between pulses are found in frames of a known law, and absent where
nothing shows.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.fitting import (
    predicted_quantities,
    tube_dark_observations,
    tube_ions,
    tube_pattern_observations,
    tube_time_observations,
)
from charact.fitting.prior import values_of_description
from charact.fitting.tube_darks import quiet_noise
from charact.fitting.tube_pattern_observations import white_pattern
from charact.fitting.tube_time_observations import Fields
from charact.observables import Values
from charact.observables.stack_level import StackLevel
from labdata import Camera, FrameStack, Result, load_camera
from tests.truth.sessions import stack_in_memory

FRAMES, ROWS, COLUMNS = 12, 96, 128
GATE_S = 0.016
# Standard errors of a test that holds for any seed.
WITHIN = 4.5


def tube(name: str = "pulnix-ag5745ef3") -> Camera:
    return load_camera(name)


def level_of(
    data: np.ndarray, *, lux: float = 1e-4, numbers: np.ndarray | None = None
) -> StackLevel:
    """Return a stack of frames as the fit sees it."""
    numbers = np.arange(len(data)) if numbers is None else numbers
    stack = FrameStack(data=data, frame_number=numbers)
    entry = stack_in_memory("flat" if lux else "dark", stack, label="a")
    return StackLevel(
        label="a",
        mean_dn=float(data.mean()),
        mean_sd_dn=0.1,
        noise_dn=float(data.std()),
        illuminance_lux=lux,
        gate_s=GATE_S,
        exposure_s=GATE_S,
        mcp_v=800.0,
        entry=entry,
    )


def fields_from(data: np.ndarray) -> Fields:
    found = tube_time_observations.fields_of(level_of(data), tube(), 0.0)
    assert found is not None
    return found


def glowing_fields(rng: np.random.Generator, shares: np.ndarray) -> np.ndarray:
    """Return interlaced frames of pulses that show these fractions of their light in successive
    fields.
    """
    pulses = rng.standard_gamma(2.0, size=(2 * FRAMES + len(shares), ROWS, COLUMNS))
    # A field row is seen by two frame rows: pulses lie on pairs of rows.
    pulses = np.repeat(pulses[:, ::2], 2, axis=1)
    shown = np.sum(
        [share * pulses[len(shares) - j : len(pulses) - j] for j, share in enumerate(shares)],
        axis=0,
    )
    frames = np.array(shown[0::2])
    frames[:, 1::2] = shown[1::2, 1::2]
    return 20.0 * frames


@pytest.mark.parametrize("odd_first", [False, True])
def test_correlations_are_those_of_the_light_of_successive_fields(
    seed: int, odd_first: bool
) -> None:
    rng = np.random.default_rng([seed, 1])
    shares = np.array([0.6, 0.2, 0.12, 0.08])
    frames = glowing_fields(rng, shares)
    if odd_first:
        frames = np.roll(frames, 1, axis=1)
    found, covariance = tube_time_observations.measure_correlations(fields_from(frames))
    full = np.correlate(shares, shares, mode="full")[len(shares) - 1 :]
    apart = np.abs(np.subtract.outer(np.arange(2 * FRAMES), np.arange(2 * FRAMES)))
    whole = np.where(apart < len(full), full[np.minimum(apart, len(full) - 1)], 0.0)
    project = np.eye(FRAMES) - 1.0 / FRAMES
    same = project @ whole[::2, ::2] @ project
    # Of a row's two neighbours in the other field one shares its pulses.
    between = 0.5 * project @ whole[::2, 1::2] @ project
    expected = [np.diagonal(same, lag).mean() for lag in range(1, 5)]
    expected.append(0.5 * (np.diagonal(between).mean() + np.diagonal(between, -1).mean()))
    away = found - np.array(expected) / np.diagonal(same).mean()
    assert np.all(np.abs(away) < WITHIN * np.sqrt(np.diag(covariance)))
    assert np.sqrt(np.diag(covariance)).max() < 0.02


def test_frames_without_lag_have_the_correlation_of_a_removed_mean(seed: int) -> None:
    data = np.random.default_rng([seed, 2]).normal(50.0, 4.0, (FRAMES, ROWS, COLUMNS))
    found, covariance = tube_time_observations.measure_correlations(fields_from(data))
    assert np.all(
        np.abs(found[:4] + 1.0 / (FRAMES - 1.0)) < WITHIN * np.sqrt(np.diag(covariance)[:4])
    )


def test_line_noise_is_told_from_pulses_flicker_and_fixed_lines(seed: int) -> None:
    rng = np.random.default_rng([seed, 3])
    data = rng.normal(50.0, 2.0, (FRAMES, ROWS, COLUMNS + 2))
    data = (data[:, :, :-2] + data[:, :, 1:-1] + data[:, :, 2:]) + rng.normal(
        0.0, 5.0, (FRAMES, 1, 1)
    )
    data += rng.normal(0.0, 3.0, (1, ROWS, 1)) + 0.8 * rng.standard_normal((FRAMES, ROWS, 1))
    value, variance = tube_time_observations.measure_line_variance(fields_from(data))
    assert abs(value - 0.64) < WITHIN * np.sqrt(variance)
    assert np.sqrt(variance) < 0.1


def test_frames_that_were_lost_or_too_few_show_no_lag() -> None:
    data = np.full((FRAMES, 16, 16), 50.0)
    assert (
        tube_time_observations.fields_of(level_of(data, numbers=2 * np.arange(FRAMES)), tube(), 0.0)
        is None
    )
    assert tube_time_observations.fields_of(level_of(data[:3]), tube(), 0.0) is None


def test_a_screen_that_fades_within_its_field_has_no_lag_to_observe(seed: int) -> None:
    data = np.random.default_rng([seed, 4]).normal(900.0, 40.0, (FRAMES, ROWS, COLUMNS))
    camera = tube("gen3-digital-iccd")
    assert not tube_time_observations.time_observations(camera, (level_of(data),))
    assert tube_time_observations.time_observations(tube(), (level_of(data / 10.0),))


def test_the_light_of_a_pulse_comes_out_once() -> None:
    values = values_of_description(tube())
    light = tube_time_observations.field_light(values, GATE_S, 60)
    assert light.sum() == pytest.approx(1.0, abs=1e-6)
    # The products of all fields are the square of the whole light: c_0 + 2 sum c_j = 1.
    products = tube_time_observations.field_products(values, GATE_S, 60)[0]
    assert products[0] + 2.0 * products[1:].sum() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(("level", "noise"), [(10.3, 0.25), (10.6, 0.33), (600.0, 12.0)])
def test_the_noise_of_rounded_darks_is_located_below_their_pulses(
    seed: int, level: float, noise: float
) -> None:
    rng = np.random.default_rng([seed, 5])
    values = rng.normal(level, noise, 400_000)
    pulses = rng.exponential(20.0 * noise, 4000)
    values[: pulses.size] += pulses
    found = quiet_noise(np.rint(values))
    assert found is not None
    # A hundredth of the values are pulses: they move the level by a hundredth of a normal
    # quantile's slope.
    assert found[0] == pytest.approx(level, abs=0.04 * noise)
    assert found[1] == pytest.approx(noise, rel=0.03)


def test_a_dark_of_one_grey_value_has_no_noise_to_locate() -> None:
    assert quiet_noise(np.full(1000, 12.0)) is None
    data = np.full((FRAMES, ROWS, COLUMNS), 12.0)
    assert tube_ions.ions_of(tube(), Result(), (level_of(data, lux=0.0),)) is None


@pytest.mark.parametrize(("level", "noise"), [(10.0, 0.2), (10.2, 0.3), (10.5, 0.25)])
def test_the_slope_of_rounding_is_that_of_the_rounded_mean(level: float, noise: float) -> None:
    from scipy.special import ndtr

    codes = np.arange(0.0, 21.0)

    def mean(at: float) -> float:
        return float(codes @ (ndtr((codes + 0.5 - at) / noise) - ndtr((codes - 0.5 - at) / noise)))

    step = 1e-4
    expected = (mean(level + step) - mean(level - step)) / (2.0 * step)
    assert tube_dark_observations.rounding_slope(level, noise) == pytest.approx(expected, rel=1e-5)


def test_moments_below_a_limit_are_those_of_the_exponential_law() -> None:
    x = np.array([0.5, 2.0, 8.0])
    first, second = (
        tube_dark_observations.moment_below(np.ones(1), 1.0, x, order) for order in (1, 2)
    )
    assert first == pytest.approx(1.0 - np.exp(-x) * (1.0 + x))
    assert second == pytest.approx(2.0 * (1.0 - np.exp(-x) * (1.0 + x + x**2 / 2.0)))


def test_the_spectrum_of_a_pulse_is_computed_anew_for_other_values() -> None:
    values = dict(values_of_description(tube()))
    before = tube_time_observations.pulse_covariance(values, ((0.0, 0.0),))[0, 0]
    values["tube.post_gain_share"] = np.array([0.4])
    after = tube_time_observations.pulse_covariance(values, ((0.0, 0.0),))[0, 0]
    assert after > 1.2 * before


def test_the_white_pattern_is_parted_from_coarse_ones_and_from_noise(seed: int) -> None:

    rng = np.random.default_rng([seed, 8])
    coarse = gaussian_filter(rng.standard_normal((2 * ROWS, 2 * COLUMNS)), 3.0, mode="wrap")
    pattern = 1.0 + 0.03 * coarse / coarse.std() + 0.01 * rng.standard_normal(coarse.shape)
    data = (400.0 * pattern + rng.normal(0.0, 8.0, (FRAMES, *coarse.shape))).astype(np.float32)
    value, variance = white_pattern(data, 400.0, 2)
    assert abs(value - 1e-4) < WITHIN * np.sqrt(variance)
    assert np.sqrt(variance) < 1e-5


def test_noise_that_hides_the_pattern_leaves_no_observation(seed: int) -> None:
    rng = np.random.default_rng([seed, 9])
    noisy, clean = (level_of(rng.normal(100.0, sd, (FRAMES, ROWS, COLUMNS))) for sd in (60.0, 2.0))
    assert not tube_pattern_observations.pattern_observations(tube(), (noisy,))
    assert len(tube_pattern_observations.pattern_observations(tube(), (clean,))) == 1


PULSE_DN = 400.0


def frames_with_ions(
    rng: np.random.Generator, values: Values, shape: tuple[int, int, int]
) -> np.ndarray:
    """Return frames of single pulses of a mean charge of 400 DN and of ion events of Poisson
    numbers of them.
    """
    frames = rng.normal(600.0, 5.0, shape)
    charges = np.zeros(shape)
    ions, pulses = (
        rng.poisson(float(rate[0]) * GATE_S * frames.size)
        for rate in (
            predicted_quantities.ion_rate(values),
            predicted_quantities.background_rate(values) * values[tube_ions.DETECTED],
        )
    )
    for heights in (np.ones(pulses), rng.poisson(values[tube_ions.SIZE], ions)):
        place = tuple(rng.integers(0, n, heights.size) for n in shape)
        np.add.at(charges, place, PULSE_DN * rng.standard_gamma(np.maximum(heights, 1e-9)))
    return frames + gaussian_filter(charges, (0.0, 0.6, 0.6))


def values_of_ions(camera: Camera, rate: float, pulses: float) -> Values:
    """Return parameters of pulses of exponential heights and a mean charge of 400 DN, so many a
    pixel and frame.
    """
    values = {
        **values_of_description(camera),
        tube_ions.RATE: np.array([rate]),
        tube_ions.SHAPE: np.ones(1),
    }
    gain = predicted_quantities.photoelectron_gain(
        values, 800.0, float(camera.microchannel_plate.reference_v)
    )
    conversion, background = "video.conversion_gain_dn_per_e", "photocathode.ebi_lm_per_cm2"
    values[conversion] = values[conversion] * PULSE_DN * values[tube_ions.DETECTED] / gain
    usual = predicted_quantities.background_rate(values) * values[tube_ions.DETECTED] * GATE_S
    values[background] = values[background] * pulses / usual
    return values


@pytest.mark.parametrize(
    ("rate", "pulses", "wrong"),
    [(0.0, 0.005, 2000.0), (400.0, 0.005, 3000.0), (9000.0, 0.005, 3000.0), (400.0, 0.08, 9000.0)],
)
def test_number_and_charge_of_ion_events_are_those_put_into_the_frames(
    seed: int, rate: float, pulses: float, wrong: float
) -> None:
    """Also where so many pulses share a window that groups of them pass for ions."""
    camera, rng = tube("gen3-digital-iccd"), np.random.default_rng([seed, 11, round(rate)])
    values = values_of_ions(camera, rate, pulses)
    data = frames_with_ions(rng, values, (FRAMES, 200, 300)).astype(np.float32)
    observed = tube_ions.ion_observation(
        tube_ions.find_ions(data, level_of(data, lux=0.0), camera, 2.0 * PULSE_DN)
    )
    away = (observed.predict(values)[0] - observed.value) / np.sqrt(np.diag(observed.covariance))
    assert np.abs(away).max() < WITHIN
    other = {**values, tube_ions.RATE: np.array([wrong])}
    assert observed.chi_squared(other)[0] > observed.chi_squared(values)[0] + 4.0
