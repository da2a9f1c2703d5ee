"""Fixed pattern of a tube is found in frames of a known law, and what does not show is not
observed.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.special import ndtr

from charact.fitting import (
    Observation,
    observations_of,
    predicted_quantities,
    stacks_of,
    tube_dark_observations,
    tube_darks,
    tube_frames,
    tube_ions,
    tube_time_observations,
    values_of_description,
)
from charact.observables import StackLevel, Values
from charact.transfer.stages import image_tube
from labdata import Camera, FrameStack, Result, load_camera, measurement_from_sd
from tests.truth.sessions import session_in_memory, stack_in_memory

FRAMES, ROWS, COLUMNS = 12, 96, 128
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
        gate_s=0.016,
        exposure_s=0.016,
        mcp_v=800.0,
        entry=entry,
    )


def observed_in(
    level: StackLevel, camera: Camera, result: Result | None = None
) -> dict[str, Observation]:
    """Return what a fit observes in one stack, by name."""
    session = session_in_memory((), camera=camera)
    stacks = stacks_of(session, camera, result or Result(), (level,))
    return {observed.name: observed for observed in observations_of(stacks)}


def test_frames_that_were_lost_or_too_few_show_no_lag() -> None:
    data = np.full((FRAMES, 16, 16), 50.0)
    assert tube_frames.frames_of(level_of(data, numbers=2 * np.arange(FRAMES))) is None
    assert tube_frames.frames_of(level_of(data[:3])) is None


def test_a_screen_that_fades_within_its_field_has_no_lag_to_observe(seed: int) -> None:
    data = np.random.default_rng([seed, 4]).normal(900.0, 40.0, (FRAMES, ROWS, COLUMNS))
    assert "image lag" not in observed_in(level_of(data), tube("gen3-digital-iccd"))
    assert "image lag" in observed_in(level_of(data / 10.0), tube())


def test_a_dark_of_one_grey_value_has_no_noise_to_locate() -> None:
    assert tube_darks.quiet_noise(np.full(1000, 12.0)) is None
    data = np.full((FRAMES, ROWS, COLUMNS), 12.0)
    assert tube_ions.ions_of(tube(), Result(), (level_of(data, lux=0.0),)) is None


def test_the_white_pattern_is_parted_from_coarse_ones_and_from_noise(seed: int) -> None:
    rng = np.random.default_rng([seed, 8])
    coarse = gaussian_filter(rng.standard_normal((2 * ROWS, 2 * COLUMNS)), 3.0, mode="wrap")
    pattern = 1.0 + 0.03 * coarse / coarse.std() + 0.01 * rng.standard_normal(coarse.shape)
    data = (400.0 * pattern + rng.normal(0.0, 8.0, (FRAMES, *coarse.shape))).astype(np.float32)
    value, variance = tube_time_observations.white_pattern(data, 400.0, 2)
    assert abs(value - 1e-4) < WITHIN * np.sqrt(variance)
    assert np.sqrt(variance) < 1e-5


def test_noise_that_hides_the_pattern_leaves_no_observation(seed: int) -> None:
    rng = np.random.default_rng([seed, 9])
    noisy, clean = (level_of(rng.normal(100.0, sd, (FRAMES, ROWS, COLUMNS))) for sd in (60.0, 2.0))
    assert "PRNU" not in observed_in(noisy, tube())
    assert "PRNU" in observed_in(clean, tube())


@pytest.mark.parametrize(("level", "noise"), [(10.0, 0.2), (10.2, 0.3), (10.5, 0.25)])
def test_the_slope_of_rounding_is_that_of_the_rounded_mean(level: float, noise: float) -> None:
    codes = np.arange(0.0, 21.0)

    def mean(at: float) -> float:
        return float(codes @ (ndtr((codes + 0.5 - at) / noise) - ndtr((codes - 0.5 - at) / noise)))

    step = 1e-4
    expected = (mean(level + step) - mean(level - step)) / (2.0 * step)
    assert tube_dark_observations.rounding_slope(level, noise) == pytest.approx(expected, rel=1e-5)


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
        rng.poisson(float(rate[0]) * 0.016 * frames.size)
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
    gain = predicted_quantities.photoelectron_gain(values, 800.0)
    conversion, background = "video.conversion_gain_dn_per_e", "photocathode.ebi_lm_per_cm2"
    values[conversion] = values[conversion] * PULSE_DN * values[tube_ions.DETECTED] / gain
    usual = predicted_quantities.background_rate(values) * values[tube_ions.DETECTED] * 0.016
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
    dark = level_of(data, lux=0.0)
    gain = measurement_from_sd("covariance_gain", "DN", 2.0 * PULSE_DN, 1.0, method="told")
    observed = observed_in(dark, camera, Result(measurements=(gain,)))["ion events"]
    away = (observed.predict(values)[0] - observed.value) / np.sqrt(np.diag(observed.covariance))
    assert np.abs(away).max() < WITHIN
    other = {**values, tube_ions.RATE: np.array([wrong])}
    assert observed.chi_squared(other)[0] > observed.chi_squared(values)[0] + 4.0


def test_a_tube_of_any_exponent_passes_all_below_its_cut_off_and_nothing_above() -> None:
    """At the far ends of the parameters, where a climb to the peak looks once."""
    passed = image_tube(np.array([0.0, 1.0, 10.0, 300.0]), np.array([10.0]), np.array([500.0]))
    assert passed == pytest.approx([1.0, 1.0, np.exp(-1.0), 0.0])
    all_before_gain = image_tube(np.array([300.0]), np.array([10.0]), np.array([500.0]), 0.0)
    assert all_before_gain == pytest.approx([1.0])
