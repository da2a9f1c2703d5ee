"""Twenty rows across bars at a signal of ten times the noise: no bias, intervals that cover, in
every pose.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.harness import CaseTimer
from charact.estimators.mtf import measure
from charact.method import Context
from labdata import FrameStack
from tests.truth import StripScene, TrueBlur
from tests.truth.counted_pulses import errors

CORES = {
    "gaussian 0.8 px": TrueBlur(sigma_px=0.8),
    "gaussian 1.5 px": TrueBlur(sigma_px=1.5),
    "tube n 1.1": TrueBlur(form="exponential", frequency_cy_per_px=0.25, exponent=1.1),
}
PLAIN = StripScene(blur=CORES["gaussian 0.8 px"], angle_deg=3.0)


def read(
    scene: StripScene, rng: np.random.Generator, *, method: str = "bars-forward", **asked: float
):
    """Measure the bars of a scene; `asked`: their number, frequency or full effort if not as
    drawn.
    """
    context = Context(seed=1, quick=asked.pop("quick", True), full_scale_dn=scene.full_scale_dn)
    target = {"bars": 4, "frequency_cy_per_px": scene.frequency_cy_per_px, **asked}
    found = measure("bars", scene.frames_drawn(rng), context=context, method=method, **target)
    return found.measurements[0]


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
@pytest.mark.parametrize("phase_px", [0.0, 0.37])
def test_without_noise_the_mtf_is_exact_at_any_phase(
    name: str, angle_deg: float, frequency: float, phase_px: float
) -> None:
    pose = {"frequency_cy_per_px": frequency, "angle_deg": angle_deg, "phase_px": phase_px}
    scene = StripScene(blur=CORES[name], snr=1e4, **pose)
    found = read(scene, np.random.default_rng(0))
    assert found.value == pytest.approx(scene.truth_mtf, rel=0.01, abs=3e-4), found.flags


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
    relative, scaled = [], []
    for _ in range(8):
        scene = StripScene(
            blur=CORES[name],
            frequency_cy_per_px=float(
                rng.uniform(0.05, 0.4 if name != "gaussian 1.5 px" else 0.18)
            ),
            angle_deg=float(rng.choice([0.0, 1.0, 3.0, 8.0])),
            phase_px=float(rng.uniform(-0.5, 0.5)),
            noise_blur_px=blur_px,
            turned=turned,
        )
        found = read(scene, rng)
        assert found.value is not None, (scene, found.reason)
        scaled.append(errors(found, scene.truth_mtf))
        relative.append(found.value / scene.truth_mtf - 1.0)
    weight = np.array(scaled) ** 2 / np.array(relative) ** 2
    error = np.sqrt(1.0 / weight.sum())
    assert abs(np.average(relative, weights=weight)) < 0.01 + 3.3 * error
    # Chi squared of 8 is above 31.8 once in ten thousand runs; intervals may be a little wide.
    assert np.sum(np.square(scaled)) < 31.8
    assert np.std(scaled) > 0.35


@pytest.mark.parametrize("asked", [3, 5])
@pytest.mark.parametrize(("frequency", "sigma_px"), [(0.05, 0.6), (0.1, 1.2), (0.2, 1.2)])
def test_another_number_than_asked_for_is_told(
    asked: int, frequency: float, sigma_px: float, seed
) -> None:
    """Four bars: what is asked for is never ok, and the note on three of them says how many there
    are.
    """
    blur = TrueBlur(sigma_px=sigma_px)
    scene = replace(PLAIN, blur=blur, frequency_cy_per_px=frequency, phase_px=0.3, snr=20.0)
    found = read(scene, np.random.default_rng(seed), bars=asked)
    assert found.status != "ok", found.value
    assert (
        asked != 3
        or found.status == "refused"
        or any("favour 4 bars over 3" in note for note in found.notes)
    )


@pytest.mark.parametrize("turned", [False, True])
def test_untilted_bars_near_the_sampling_limit_are_not_identifiable(turned: bool, seed) -> None:
    rng = np.random.default_rng(seed)
    fine = StripScene(
        blur=TrueBlur(sigma_px=0.4), angle_deg=0.0, phase_px=0.2, snr=50.0, turned=turned
    )
    for frequency in (0.46, 0.48):
        found = read(replace(fine, frequency_cy_per_px=frequency), rng)
        assert found.status == "refused" and "not identifiable" in found.reason
    tilted = replace(fine, frequency_cy_per_px=0.46, angle_deg=8.0)
    assert abs(errors(read(tilted, rng), tilted.truth_mtf)) < 4.5


def test_the_chain_on_compressed_data_agrees_with_the_curvature(seed) -> None:
    scene = replace(
        PLAIN,
        blur=CORES["tube n 1.1"],
        frequency_cy_per_px=0.2,
        phase_px=0.2,
        snr=20.0,
        noise_blur_px=0.6,
    )
    watch = CaseTimer()
    chain = read(scene, np.random.default_rng(seed), quick=False)
    seconds, quick = watch.seconds(), read(scene, np.random.default_rng(seed))
    assert chain.posterior.sampler == "emcee"
    width = np.diff(quick.interval68)[0]
    assert abs(chain.value - quick.value) < 0.4 * width
    assert np.diff(chain.interval68)[0] == pytest.approx(width, rel=0.25)
    # Of an idle machine.
    assert seconds < 4.0


def test_a_fundamental_under_the_noise_is_an_upper_limit(seed) -> None:
    """A blur of 1.5 px leaves 0.06 % at 0.4 cy/px: nothing to measure at ten times the noise."""
    scene = replace(PLAIN, blur=CORES["gaussian 1.5 px"], frequency_cy_per_px=0.4, phase_px=0.1)
    found = read(scene, np.random.default_rng(seed))
    assert "low-signal" in found.flags
    assert found.interval95[0] < scene.truth_mtf < found.interval95[1]


@pytest.mark.parametrize("frequency", [0.1, 0.2])
def test_one_wide_bar_is_never_four_narrow_ones(frequency: float, seed) -> None:
    pose = {"bars": 1, "frequency_cy_per_px": 0.125 * frequency, "phase_px": 0.2, "reach_px": 24}
    scene = replace(PLAIN, snr=30.0, **pose)
    found = read(scene, np.random.default_rng(seed), frequency_cy_per_px=frequency)
    assert found.status != "ok"


def test_motion_between_fields_of_a_strip_is_told(seed) -> None:
    still = replace(PLAIN, blur=TrueBlur(sigma_px=0.9), frequency_cy_per_px=0.1, snr=30.0)
    asked = {"bars": 4, "frequency_cy_per_px": 0.1, "method": "bars-forward"}
    frames, moved = (
        scene.frames_drawn(np.random.default_rng(seed)).data
        for scene in (still, replace(still, phase_px=0.6))
    )
    woven = np.where(np.arange(20)[:, None] % 2 == 0, frames, moved)
    flags = [
        measure("bars", FrameStack(data=data), context=Context(seed=1, quick=True), **asked)
        .measurements[0]
        .flags
        for data in (woven, frames)
    ]
    assert "interlace-motion" in flags[0] and "interlace-motion" not in flags[1]
