"""Twenty rows across bars at a signal of ten times the noise: no bias, intervals that cover, in
every pose.
"""

import numpy as np
import pytest

from benchmarks.studies.harness import CaseTimer
from charact.estimators.mtf import measure
from charact.method import Context
from tests.truth.long_bars import frames_of, gaussian, mtf_of, strip, tube

CORES = {
    "gaussian 0.8 px": gaussian(0.8),
    "gaussian 1.5 px": gaussian(1.5),
    "tube n 1.1": tube(0.25, 1.1),
}


def read(
    stack, frequency: float, *, bars: int = 4, quick: bool = True, method: str = "bars-forward"
):
    context = Context(seed=1, quick=quick, full_scale_dn=4095.0)
    found = measure(
        "bars", stack, bars=bars, frequency_cy_per_px=frequency, context=context, method=method
    )
    return found.measurements[0]


def deviation(found, truth: float) -> float:
    """Distance from the truth in the standard deviations that the 68 % interval states."""
    low, high = found.interval68
    return (found.value - truth) / ((high - low) / 2)


@pytest.mark.parametrize(
    ("name", "angle_deg", "frequency"),
    [
        ("gaussian 0.8 px", 8.0, 0.12),
        ("gaussian 1.5 px", 2.0, 0.25),
        ("gaussian 1.5 px", 0.0, 0.05),
        ("tube n 1.1", 2.0, 0.4),
        ("tube n 1.1", 8.0, 0.25),
    ],
)
def test_without_noise_the_mtf_is_exact_at_any_phase(
    name: str, angle_deg: float, frequency: float
) -> None:
    truth = mtf_of(CORES[name], frequency, angle_deg)
    for phase_px in (0.0, 0.37):
        image = strip(CORES[name], frequency, angle_deg, phase_px)
        stack = frames_of(image, np.random.default_rng(0), snr=1e4)
        found = read(stack, frequency)
        assert found.value == pytest.approx(truth, rel=0.01, abs=3e-4), (phase_px, found.flags)


@pytest.mark.parametrize(
    ("name", "blur_px", "turned"),
    [("gaussian 0.8 px", 0.0, False), ("gaussian 1.5 px", 0.7, True), ("tube n 1.1", 0.7, False)],
)
def test_no_bias_and_honest_intervals_at_ten_times_the_noise(
    name: str, blur_px: float, turned: bool, seed
) -> None:
    """Mean error under 1 % of the truth within 3.3 standard errors, and each scatters as its
    interval says.
    """
    rng = np.random.default_rng(seed)
    errors, scaled = [], []
    for _ in range(8):
        frequency = float(rng.uniform(0.05, 0.4 if name != "gaussian 1.5 px" else 0.18))
        angle, phase = float(rng.choice([0.0, 1.0, 3.0, 8.0])), float(rng.uniform(-0.5, 0.5))
        image = strip(CORES[name], frequency, angle, phase)
        stack = frames_of(image.T if turned else image, rng, blur_px=blur_px)
        found = read(stack, frequency)
        assert found.value is not None, (frequency, angle, found.reason)
        truth = mtf_of(CORES[name], frequency, angle)
        scaled.append(deviation(found, truth))
        errors.append(found.value / truth - 1.0)
    weight = np.array(scaled) ** 2 / np.array(errors) ** 2
    error = np.sqrt(1.0 / weight.sum())
    assert abs(np.average(errors, weights=weight)) < 0.01 + 3.3 * error
    # Chi squared of 8 is above 31.8 once in ten thousand runs; intervals may be a little wide.
    assert np.sum(np.square(scaled)) < 31.8
    assert np.std(scaled) > 0.35


@pytest.mark.parametrize("asked", [3, 5])
def test_another_number_than_asked_for_is_told(asked: int, seed) -> None:
    """Four bars: what is asked for is never ok, and the note on three of them says how many there
    are.
    """
    for frequency, sigma_px in ((0.05, 0.6), (0.1, 1.2), (0.2, 1.2)):
        stack = frames_of(
            strip(gaussian(sigma_px), frequency, 3.0, 0.3), np.random.default_rng(seed), snr=20.0
        )
        found = read(stack, frequency, bars=asked)
        assert found.status != "ok", (frequency, found.value)
        assert (
            asked != 3
            or found.status == "refused"
            or any("favour 4 bars over 3" in note for note in found.notes)
        )


@pytest.mark.parametrize("turned", [False, True])
def test_untilted_bars_near_the_sampling_limit_are_not_identifiable(turned: bool, seed) -> None:
    rng = np.random.default_rng(seed)
    for frequency, angle in ((0.46, 0.0), (0.48, 0.0)):
        image = strip(gaussian(0.4), frequency, angle, 0.2)
        found = read(frames_of(image.T if turned else image, rng, snr=50.0), frequency)
        assert found.status == "refused"
        assert "not identifiable" in found.reason
    image = strip(gaussian(0.4), 0.46, 8.0, 0.2)
    found = read(frames_of(image.T if turned else image, rng, snr=50.0), 0.46)
    assert abs(deviation(found, mtf_of(gaussian(0.4), 0.46, 8.0))) < 4.5


def test_the_chain_on_compressed_data_agrees_with_the_curvature(seed) -> None:
    rng = np.random.default_rng(seed)
    stack = frames_of(strip(CORES["tube n 1.1"], 0.2, 3.0, 0.2), rng, snr=20.0, blur_px=0.6)
    watch = CaseTimer()
    chain = read(stack, 0.2, quick=False)
    seconds, quick = watch.seconds(), read(stack, 0.2)
    assert chain.posterior.sampler == "emcee"
    width = np.diff(quick.interval68)[0]
    assert abs(chain.value - quick.value) < 0.4 * width
    assert np.diff(chain.interval68)[0] == pytest.approx(width, rel=0.25)
    # Of an idle machine.
    assert seconds < 4.0


def test_a_fundamental_under_the_noise_is_an_upper_limit(seed) -> None:
    """A blur of 1.5 px leaves 0.06 % at 0.4 cy/px: nothing to measure at ten times the noise."""
    found = read(frames_of(strip(gaussian(1.5), 0.4, 3.0, 0.1), np.random.default_rng(seed)), 0.4)
    assert "low-signal" in found.flags
    assert found.interval95[0] < mtf_of(gaussian(1.5), 0.4, 3.0) < found.interval95[1]


def test_one_wide_bar_is_never_four_narrow_ones(seed) -> None:
    rng = np.random.default_rng(seed)
    for frequency in (0.1, 0.2):
        wide = strip(gaussian(0.8), 0.5 * frequency / 4.0, 3.0, 0.2, bars=1, ground_px=24)
        assert read(frames_of(wide, rng, snr=30.0), frequency).status != "ok"


def test_motion_between_fields_of_a_strip_is_told(seed) -> None:
    still, moved = strip(gaussian(0.9), 0.1, 3.0, 0.0), strip(gaussian(0.9), 0.1, 3.0, 0.6)
    woven = np.where(np.arange(20)[:, None] % 2 == 0, still, moved)
    rng = np.random.default_rng(seed)
    assert "interlace-motion" in read(frames_of(woven, rng, snr=30.0), 0.1).flags
    assert "interlace-motion" not in read(frames_of(still, rng, snr=30.0), 0.1).flags
