"""Strips across bars, pulsed bars, and the bias of their amplitudes."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import measure
from charact.estimators.mtf.bars import bar_image_model, detection, fit, noise
from charact.method import Context
from labdata import FrameStack
from tests.truth import BarScene, PulsedBars, StripScene, TrueBlur, correlate_noise
from tests.truth.counted_pulses import errors

# Twenty rows across bars at a signal of ten times the noise: no bias, intervals that cover, in
# every pose.


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
    # Fine bars are fitted alike by several forms, of which the interval holds all.
    tolerance = max(0.01 * scene.truth_mtf, 3e-4, 0.5 * float(np.ptp(found.interval95)))
    assert tolerance < 0.04 * scene.truth_mtf + 3e-4
    assert found.value == pytest.approx(scene.truth_mtf, abs=tolerance), found.flags


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


# Bars of intensified cameras: the scene against the other generator's, dim targets, transfers of
# several stages.


BRIGHT = {
    "photoelectrons": 1e5,
    "gain_spread": 0.0,
    "bright_dn": 30000.0,
    "black_dn": 1000.0,
    "full_scale_dn": 65535.0,
}
DIM = PulsedBars(
    blur=TrueBlur(form="exponential", frequency_cy_per_px=0.32, exponent=1.3),
    pulse_px=0.6,
    photoelectrons=4.0,
    bright_dn=60.0,
    dark_share=0.3,
    gain_spread=0.7,
    frames=4,
    frequency_cy_per_px=0.22,
    rows=90,
    cols=100,
)


def found(scene, rng):
    context = Context(quick=True, full_scale_dn=scene.full_scale_dn)
    told = {"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px}
    return measure(
        "bars", scene.frames_drawn(rng), method="bars-forward", context=context, **told
    ).measurements[0]


def test_the_mean_is_that_of_bars_in_closed_form(seed):
    """Gaussians of 0.8 and 0.6 px make one of 1.0: pixels within 5 of their own scatter and two
    thousandths.
    """
    place = {"row_px": 0.3, "col_px": -0.7, "rows": 120, "cols": 130, "angle_deg": 5.0}
    pulsed = PulsedBars(
        blur=TrueBlur(sigma_px=0.8), pulse_px=0.6, dark_share=0.2, frames=40, **place, **BRIGHT
    )
    drawn = pulsed.frames_drawn(np.random.default_rng(seed)).data.astype(float)
    closed = BarScene(
        blur=TrueBlur(sigma_px=1.0),
        black_dn=1000.0,
        pedestal_dn=7000.0,
        level_dn=24000.0,
        full_scale_dn=65535.0,
        **place,
    )
    error = drawn.std(axis=0, ddof=1) / np.sqrt(len(drawn))
    assert np.all(np.abs(drawn.mean(axis=0) - closed.mean()) < 5.0 * error + 0.002 * 24000.0)
    assert pulsed.truth_mtf == pytest.approx(closed.truth_mtf, rel=1e-12)


@pytest.mark.parametrize("frequency", [0.07, 0.2])
def test_a_tube_behind_a_gaussian_is_no_tube_and_told_rightly(frequency, seed):
    """The product of both forms is of neither: 0.3 to 1.2 % high, and `processed`, where one
    exponent must hold it.
    """
    scene = PulsedBars(
        blur=TrueBlur(form="exponential", frequency_cy_per_px=0.3, exponent=1.15),
        pulse_px=0.8,
        dark_share=0.1,
        frames=4,
        frequency_cy_per_px=frequency,
        rows=160,
        cols=170,
        **BRIGHT,
    )
    one = found(scene, np.random.default_rng(seed))
    assert one.status == "ok", one.flags
    assert one.value == pytest.approx(scene.truth_mtf, rel=1e-3)


def test_bars_that_wide_sums_hide_in_noise_are_measured(seed):
    """Bars of nine standard errors, refused at four or so while the blur's whole window was asked
    for them.
    """
    rng = np.random.default_rng(seed)
    told = [found(DIM, rng) for _ in range(3)]
    assert sum(one.status == "ok" for one in told) >= 2
    errors = [
        (one.value - DIM.truth_mtf) / (0.5 * np.ptp(one.interval68))
        for one in told
        if one.status == "ok"
    ]
    assert np.abs(errors).max() < 4.5


def test_one_frame_of_much_light_is_told_in_full_as_quickly(seed):
    """Noise looked for in what a rough first fit left over was no noise: 3 to 56 % off in full, or
    a traceback.
    """
    scene = BarScene(
        blur=TrueBlur(sigma_px=1.0),
        frequency_cy_per_px=0.0625,
        frames=1,
        snr=300.0,
        level_dn=3000.0,
        pedestal_dn=300.0,
        black_dn=100.0,
        full_scale_dn=4095.0,
        rows=160,
        cols=180,
        angle_deg=4.0,
    )
    stack = scene.frames_drawn(np.random.default_rng(seed))
    told = {"bars": 4, "frequency_cy_per_px": 0.0625, "method": "bars-forward"}
    quick, full = (
        measure("bars", stack, context=Context(quick=quick), **told).measurements[0]
        for quick in (True, False)
    )
    assert full.status == quick.status == "ok"
    assert abs(full.value - scene.truth_mtf) < 4.5 * 0.5 * np.ptp(full.interval68)
    assert np.ptp(full.interval95) == pytest.approx(np.ptp(quick.interval95), rel=0.25)


def test_bars_without_noise_are_no_surer_than_their_table(seed):
    """Off by 0.02 % at a told 0.004, five standard errors, at 50,000 DN in four frames."""
    rng = np.random.default_rng(seed)
    for frequency in (0.0625, 0.18):
        scene = BarScene(
            blur=TrueBlur(sigma_px=1.0),
            frequency_cy_per_px=frequency,
            frames=4,
            snr=3000.0,
            level_dn=50000.0,
            pedestal_dn=3000.0,
            black_dn=1000.0,
            full_scale_dn=65535.0,
            rows=160,
            cols=180,
            shot_share=0.0,
        )
        one = found(scene, rng)
        assert abs(one.value - scene.truth_mtf) < 4.5 * 0.5 * np.ptp(one.interval68)


# What noise adds to a fitted MTF on the average is what the second order of the fit says it adds.


STEP_DN, SNR, PAIRS = 1000.0, 10.0, 80


def fits_of(image, blur_px):
    """Return what fits pictures like this one with its noise known, and its parts."""
    target = detection.strip_of(image, bars=4, frequency=0.4, pitch_ratio=1.0)
    assert target is not None
    variance = np.full(image.size, (STEP_DN / SNR) ** 2)
    # White noise blurred by a Gaussian of s px, by distance: exp(-d^2 / (4 s^2)).
    along = np.exp(-((np.arange(-6, 7) / (2.0 * max(blur_px, 1e-3))) ** 2))
    known = noise.WindowCovariance(variance=variance, correlation=np.outer(along, along))

    def fit_of(picture, start=None):
        problem = bar_image_model.BarLikelihood(
            image=picture,
            window=np.ones(picture.shape, bool),
            variance=variance,
            asked=0.4,
            length_px=picture.shape[0],
            strip=True,
        )
        begun = start or bar_image_model.initial_parameters(problem, target)
        tolerance = 1e-4 if start else 1e-8
        return fit.fit_bars(problem, target, begun, known, tolerance=tolerance), problem

    return fit_of


@pytest.mark.parametrize(("rows", "blur_px", "sign"), [(10, 0.0, 1), (20, 0.7, -1)])
def test_the_bias_of_fits_is_what_their_second_order_says(rows, blur_px, sign, seed) -> None:
    """Pairs of noise and its opposite, fitted: what is linear in it cancels, what is left is the
    bias.
    """
    pose = {"frequency_cy_per_px": 0.4, "angle_deg": 3.0, "phase_px": 0.2}
    image = STEP_DN * StripScene(blur=TrueBlur(sigma_px=0.8), rows=rows, **pose).light()
    fit_of, rng, means = fits_of(image, blur_px), np.random.default_rng(seed), []
    clean, problem = fit_of(image)
    for _ in range(PAIRS):
        drawn = correlate_noise(rng.standard_normal((1, *image.shape)), blur_px)[0] * STEP_DN / SNR
        both = (fit_of(image + way * drawn, clean.values)[0] for way in (1, -1))
        means.append(np.mean([one.shape.mtf for one in both]))
    found, error = np.mean(means) - clean.shape.mtf, np.std(means, ddof=1) / np.sqrt(PAIRS)
    predicted = fit.mtf_bias(clean, problem)
    assert sign * predicted > 0
    assert abs(found - predicted) < 3.3 * error + 0.1 * abs(predicted)
    assert abs(predicted) > error


# Offsets that rows of a target share are told, and counted in the noise of their mean.


@pytest.mark.parametrize("offset_dn", [0.0, 1.5])
def test_offsets_of_rows_are_told_and_counted(offset_dn, seed):
    """The mean over a window of R rows varies by (v/C + w)/R, v of white noise, w of offsets."""
    rng, frames, shape = np.random.default_rng(seed), 8, (60, 70)
    drawn = 3.0 * rng.standard_normal((frames, *shape)) + offset_dn * rng.standard_normal(
        (frames, shape[0], 1)
    )
    window = np.ones(shape, bool)
    told = noise.noise_of(
        100.0 + drawn, np.full(window.size, 100.0), window, ground_dn=100.0, inflation=1.0
    )
    free = (frames - 1) * shape[0]
    assert told.row_variance * frames == pytest.approx(offset_dn**2, rel=5.0 * np.sqrt(2.0 / free))
    variance = (3.0**2 / shape[1] + offset_dn**2) / shape[0] / frames
    found = float(told.spread(np.full((1, window.size), 1.0 / window.size), window)[0, 0])
    assert offset_dn == 0.0 or found == pytest.approx(variance, rel=0.25)
