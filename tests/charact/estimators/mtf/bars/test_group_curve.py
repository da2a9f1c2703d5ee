"""Groups of bars have one curve, and a bent response is told by their harmonics."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import sici

from charact.estimators import mtf
from charact.estimators.mtf import fit_group_curve, frame_curves, measure, session_curves
from charact.estimators.mtf.bars import bar_measurement, nonlinearity
from charact.method import Context
from labdata import BadInput, FrameStack, Measurement, Result, load_sensor, measurement_from_sd
from tests.truth import BarChart, Bars, BarScene, PulsedBars, TrueBlur, noisy

# Groups of bars of a frame or a session give one MTF50 and one curve for each direction, and only
# where they can.


QUICK = Context(seed=1, quick=True)
CAMERA = load_sensor("pulnix-ag5745ef3")
FREQUENCIES = (0.06, 0.1, 0.16, 0.24)
FITTED = (0.05, 0.1, 0.2, 0.3)
# Of the camera: 11 um columns, 13 um rows of which a frame's row sums two, seen through a taper of
# 18/11.
PIXEL_HEIGHT, COLUMN_AT_CATHODE_MM = 26.0 / 11.0, 0.018


def reading(
    frequency: float, value: float, sd: float = 0.01, angle_deg: float = 3.0, **fields
) -> Measurement:
    own = {
        "method": "bars-forward",
        "frequency_cy_per_px": frequency,
        "orientation_deg": angle_deg,
        **fields,
    }
    return measurement_from_sd("mtf", "1", value, sd, **own)


def tube(frequency, half: float = 0.22, exponent: float = 1.3):
    """exp(-ln 2 (f/f2)^n) times a square pixel."""
    return np.exp(-np.log(2.0) * (np.asarray(frequency) / half) ** exponent) * np.sinc(frequency)


def crossing(of) -> float:
    """Frequency where a falling function is one half."""
    fine = np.linspace(0.01, 0.6, 2000)
    value = of(fine)
    at = int(np.argmax(value < 0.5))
    return float(np.interp(0.5, value[at : at - 2 : -1], fine[at : at - 2 : -1]))


def test_groups_of_a_frame_give_the_mtf50_of_its_blur_along_rows_and_columns(seed: int) -> None:
    """MTF50 of the Gaussian and the pixel in closed form, within 4.5 standard errors."""
    groups = tuple(
        Bars(row=75.0 + 95.0 * turn, col=col, frequency=frequency, angle_deg=3.0 + 90.0 * turn)
        for turn in (0, 1)
        for frequency, col in zip((0.1, 0.17, 0.27), (50.0, 120.0, 170.0), strict=True)
    )
    chart = BarChart(groups=groups, rows=240, cols=210)
    frame = noisy(chart.mean(), np.random.default_rng(seed), sd_dn=60.0)
    stack = FrameStack(data=frame[None], full_scale_dn=4095.0)
    found = mtf.measure_all("bars", stack, bars=4, frequency_cy_per_px=None, context=QUICK)
    truth = crossing(lambda f: chart.blur.mtf(f, 3.0))
    told = found.find("mtf50", method="bars-joint")
    assert [round(m.orientation_deg / 90.0) for m in told] == [0, 1]
    for m in told:
        assert m.region is None and m.status == "ok"
        assert abs(m.value - truth) < 4.5 * np.ptp(m.interval95) / 3.92
    assert set(found.curves) == {"mtf", "mtf_vertical"}


@pytest.mark.parametrize(
    ("angle_deg", "height", "filtered"), [(0.0, 1.0, True), (90.0, PIXEL_HEIGHT, False)]
)
def test_of_a_described_camera_the_halo_the_row_pair_and_the_video_are_in_the_curve(
    angle_deg: float, height: float, filtered: bool, seed: int
) -> None:
    """Over 12 cameras whose halo is drawn from the description the 95 % intervals hold within 4.5
    standard errors.
    """
    rng, cathode_px = np.random.default_rng(seed), 4.0 * 0.21 / COLUMN_AT_CATHODE_MM

    def whole(frequency, share: float):
        x = np.pi * cathode_px * np.maximum(frequency, 1e-9)
        halo = 0.3 * np.sin(x) / x + 0.7 * sici(x)[0] / x
        core = np.exp(-np.log(2.0) * (frequency / 0.26) ** 1.3) * np.abs(
            np.sinc(frequency * height)
        )
        return core * (1.0 - share + share * halo) * (video(frequency) if filtered else 1.0)

    held = np.zeros(2)
    for _ in range(12):
        share = float(np.clip(rng.normal(0.1, 0.28 / 3.92), 0.0, 0.5))
        own = [
            reading(
                f,
                float(whole(np.array([f]), share)[0]) + 0.006 * rng.standard_normal(),
                0.006,
                angle_deg,
            )
            for f in FREQUENCIES
        ]
        context = Context(seed=1, quick=True, camera=CAMERA, interlaced=True)
        found = session_curves(
            Result(measurements=tuple(m.with_(stack="b") for m in own)),
            {"b": "bars"},
            context=context,
        )
        (curve,) = found.curves.values()
        low, high = found.find("mtf50")[0].interval95
        held[0] += low <= crossing(lambda f, share=share: whole(f, share)) <= high
        at = int(np.argmin(np.abs(curve.frequency_cy_per_px - 0.03)))
        truth = float(whole(curve.frequency_cy_per_px[at : at + 1], share)[0])
        held[1] += curve.interval95[0][at] <= truth <= curve.interval95[1][at]
    assert np.all(held >= 12 * 0.95 - 4.5 * np.sqrt(12 * 0.95 * 0.05)), held


def video(frequency):
    """Stairs one clock wide through a Butterworth filter of 6.5 MHz, read at 14.318 MHz: the
    aliases added up.
    """
    shifts = np.arange(-40, 41)
    at = np.asarray(frequency)[..., None] + shifts
    s = 1j * at * 14.318 / 6.5
    filtered = np.sinc(at) * np.exp(-1j * np.pi * at) / ((s + 1.0) * (s**2 + s + 1.0))
    return np.abs(filtered.sum(axis=-1))


@pytest.mark.parametrize(
    "readings",
    [
        [reading(0.1, 0.8)],
        [reading(0.1, 0.8), reading(0.1, 0.81)],
        [reading(0.1, 0.8), reading(0.103, 0.79)],
        [reading(0.1, 0.8), reading(0.2, 0.5, flags=("low-signal",))],
        [reading(0.1, 0.8), reading(0.2, 0.5, angle_deg=93.0)],
        [reading(0.1, 0.8, method="edge-free"), reading(0.2, 0.5, method="edge-free")],
        [reading(0.1, 0.8, angle_deg=45.0), reading(0.2, 0.5, angle_deg=45.0)],
    ],
)
def test_too_few_sound_groups_of_one_direction_add_nothing(readings: list[Measurement]) -> None:
    assert frame_curves(Result(measurements=tuple(readings)), context=QUICK) == Result()


@pytest.mark.parametrize("frequencies", [(0.02, 0.04), (0.5, 0.6)])
def test_an_mtf50_far_from_all_groups_is_refused_with_the_rule(
    frequencies: tuple[float, ...],
) -> None:
    found = frame_curves(
        Result(measurements=tuple(reading(f, float(tube(f)), 0.002) for f in frequencies)),
        context=QUICK,
    )
    refused = found.find("mtf50")[0]
    assert refused.status == "refused"
    assert "within a factor of 1.5 of the groups' frequencies" in refused.reason
    assert "mtf" in found.curves


@pytest.mark.parametrize(
    ("frequencies", "beyond"), [((0.08, 0.12, 0.16), True), (FREQUENCIES, False)]
)
def test_an_mtf50_a_little_beyond_its_groups_says_so(
    frequencies: tuple[float, ...], beyond: bool
) -> None:
    found = frame_curves(
        Result(measurements=tuple(reading(f, float(tube(f))) for f in frequencies)), context=QUICK
    )
    assert any("beyond the groups" in note for note in found.find("mtf50")[0].notes) == beyond


def test_groups_that_do_not_belong_together_say_so() -> None:
    blur = TrueBlur(sigma_px=0.8)
    groups = [reading(f, float(blur.mtf(f, 0.0)), 0.01, 0.0) for f in FITTED]
    context = Context(seed=1, quick=True)
    assert fit_group_curve(groups, context=context).measurements[0].status == "ok"
    groups[1] = reading(0.1, float(blur.mtf(0.1, 0.0)) - 0.2, 0.01, 0.0)
    assert "model-misfit" in fit_group_curve(groups, context=context).measurements[0].flags


def test_one_group_is_no_curve_and_directions_do_not_mix() -> None:
    context = Context(seed=1, quick=True)
    one = reading(0.1, 0.8, 0.01, 0.0)
    assert fit_group_curve([one], context=context).measurements[0].status == "refused"
    with pytest.raises(BadInput, match="degrees"):
        fit_group_curve([one, reading(0.2, 0.5, 0.01, angle_deg=90.0)], context=context)


# What the noise of bars says of a response, level by level: pulses of light, one frame of it,
# read-out besides.


FINE = PulsedBars(
    blur=TrueBlur(form="exponential", frequency_cy_per_px=0.32, exponent=1.3),
    pulse_px=0.6,
    photoelectrons=12.0,
    bright_dn=120.0,
    dark_share=0.1,
    gain_spread=0.7,
    frames=4,
    frequency_cy_per_px=0.25,
    rows=90,
    cols=100,
)


def told(stack, scene, monkeypatch):
    """Return the measured MTF of bars, and what they tell of the response."""
    seen = []
    response_of = nonlinearity.response_of
    monkeypatch.setattr(
        bar_measurement, "response_of", lambda *args: seen.append(response_of(*args)) or seen[-1]
    )
    asked = {"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px}
    context = Context(quick=True, full_scale_dn=scene.full_scale_dn)
    return measure("bars", stack, method="bars-forward", context=context, **asked).measurements[
        0
    ], seen[-1]


def powers(scene, rng, monkeypatch):
    """Return the flags of bars, and the powers of the light with which their noise grows."""
    one, of_response = told(scene.frames_drawn(rng), scene, monkeypatch)
    return one.flags, of_response.shared, of_response.per_pixel


def bent_frames(scene, curvature, rng):
    """Return frames of white noise behind a response y = u + c u (1 - u), u the light of a wide bar
    being one.
    """
    light = (scene.mean() - scene.pedestal_dn) / scene.level_dn
    mean = scene.pedestal_dn + scene.level_dn * (light + curvature * light * (1.0 - light))
    noise = rng.normal(0.0, scene.level_dn / scene.snr, (scene.frames, *mean.shape))
    return FrameStack(data=mean + noise, full_scale_dn=scene.full_scale_dn)


@pytest.mark.parametrize("exponent", [0.48, 1.0, 1.9])
def test_bars_too_fine_to_be_bright_tell_a_response_by_their_noise(exponent, seed, monkeypatch):
    """Few pixels are as bright as a wide bar would be, and exponents of 0.5 and 1.9 made the MTF 25
    to 75 % wrong, ok.

    The covariance of neighbours grows with the power 2 - 1/g of the level: within 4 errors and
    0.05.
    """
    flags, shared, own = powers(
        replace(FINE, gamma=exponent), np.random.default_rng(seed), monkeypatch
    )
    assert ("gamma" in flags) == (exponent != 1.0)
    assert shared.exponent == pytest.approx(2.0 - 1.0 / exponent, abs=4.0 * shared.sd + 0.05)
    assert exponent != 1.0 or -0.05 < own.exponent < 1.0 + 4.0 * own.sd


def test_one_frame_tells_a_response_that_steepens(seed, monkeypatch):
    """Ground that the response has made dark shows hardly more than read noise: told in one of two
    drawings or both.
    """
    scene = replace(FINE, frames=1)
    rng = np.random.default_rng(seed)
    assert any("gamma" in powers(replace(scene, gamma=1.9), rng, monkeypatch)[0] for _ in range(2))
    assert "gamma" not in powers(scene, rng, monkeypatch)[0]


@pytest.mark.parametrize(
    "more", [{"flicker": 0.1}, {"row_noise_dn": 6.0}, {"read_dn": 8.0}, {"lag": 0.3}]
)
def test_what_else_is_in_the_noise_is_no_response(more, seed, monkeypatch):
    """Light that flickers, rows with an offset of their own, read noise and lag of a straight
    camera.
    """
    flags, shared, _ = powers(replace(FINE, **more), np.random.default_rng(seed), monkeypatch)
    assert "gamma" not in flags and abs(shared.exponent - 1.0) < 3.0 * shared.sd + 0.05


def test_errors_of_the_power_are_those_it_scatters_by(seed, monkeypatch):
    """Five targets: the scatter over the stated errors lies within 0.2 and 1.9, chi squared at
    0.002 of chance.
    """
    rng = np.random.default_rng(seed)
    shared = [
        powers(replace(FINE, col_px=float(rng.uniform(-1, 1))), rng, monkeypatch)[1]
        for _ in range(5)
    ]
    away = np.array([(one.exponent - 1.0) / one.sd for one in shared])
    assert 0.2 < np.sqrt(np.mean(away**2)) < 1.9 and abs(away.mean()) < 3.1 / np.sqrt(5)


PLAIN = BarScene(
    blur=TrueBlur(sigma_px=1.0),
    frequency_cy_per_px=0.15,
    frames=8,
    snr=30.0,
    pedestal_dn=500.0,
    level_dn=1000.0,
    full_scale_dn=4095.0,
    rows=130,
    cols=140,
)


@pytest.mark.parametrize("curvature", [-0.3, 0.0, 0.25])
def test_the_picture_tells_its_curvature_and_what_it_does(curvature, seed, monkeypatch):
    """No black is known and noise tells nothing. Within 4 errors, and a seventh of itself: a series
    of first order.
    """
    rng = np.random.default_rng(seed)
    one, of = told(bent_frames(PLAIN, curvature, rng), PLAIN, monkeypatch)
    assert of.shared is None and of.per_pixel is None
    assert of.curvature == pytest.approx(curvature, abs=4.0 * of.sd + 0.15 * abs(curvature))
    assert any(note.startswith("gamma: the image") for note in one.notes) == (curvature != 0.0)
    # What is told has its lift taken off, most of it by the width of the bars, which a response of
    # 0.3 changes by a tenth: what is left of it is of second order.
    assert one.value == pytest.approx(PLAIN.truth_mtf, rel=0.25 * abs(of.lifts * curvature) + 0.01)


@pytest.mark.parametrize("gamma", [0.6, 1.6])
def test_a_curved_response_of_fine_bars_is_told_without_any_harmonic(gamma, seed, monkeypatch):
    """Cells of the map whose MTF was 5 to 13 % off, ok: white noise, few pixels, hardly a second
    harmonic.
    """
    scene = replace(
        PLAIN,
        frequency_cy_per_px=0.22,
        gamma=gamma,
        shot_share=0.0,
        black_dn=300.0,
        full_scale_dn=1700.0,
    )
    stack = replace(scene.frames_drawn(np.random.default_rng(seed)), black_level_dn=None)
    found = told(stack, scene, monkeypatch)[0]
    assert any(note.startswith("gamma: the image") for note in found.notes)
    assert found.interval95[0] < scene.truth_mtf < found.interval95[1] or "gamma" in found.flags


def test_a_black_above_the_ground_is_not_believed(seed, monkeypatch):
    """Light below none grows with no power; the picture's own curvature is told as before."""
    stack = FINE.frames_drawn(np.random.default_rng(seed))
    _, right = told(stack, FINE, monkeypatch)
    _, wrong = told(replace(stack, black_level_dn=80.0), FINE, monkeypatch)
    assert right.shared is not None
    assert wrong.shared is None and wrong.curvature == pytest.approx(right.curvature)
