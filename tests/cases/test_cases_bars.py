"""Bars of other tools' users in whole pictures, and siblings drawn in plain NumPy."""

from pathlib import Path

import numpy as np
import pytest

import charact

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"
FINE = 5


def frames_of(
    rng, bars, frequency, tilt_deg, *, aspect=5.0, dark=False, place=(0.0, 0.0), blur=1.0
):
    """Four frames of parallel bars with an even ground about them, Gaussian blur and pixels."""
    width = 0.5 / frequency
    extent = max((2 * bars - 1) * width, aspect * width)
    side = int(extent + 44.0 + 2.0 * max(np.abs(place)))
    at = (np.arange(side * FINE) + 0.5) / FINE - 0.5 * side
    tilt = np.deg2rad(tilt_deg)
    y, x = at[:, None] - place[0], at[None, :] - place[1]
    across, along = x * np.cos(tilt) + y * np.sin(tilt), y * np.cos(tilt) - x * np.sin(tilt)
    phase = across * frequency + 0.5 * bars - 0.25
    lit = (
        (np.mod(phase, 1.0) < 0.5)
        & (phase > 0.0)
        & (phase < bars)
        & (2.0 * np.abs(along) < aspect * width)
    )
    f = np.fft.fftfreq(side * FINE, 1.0 / FINE)
    gaussian = np.exp(-2.0 * (np.pi * blur * f) ** 2)
    light = np.fft.ifft2(np.fft.fft2(lit) * gaussian[:, None] * gaussian).real
    light = light.reshape(side, FINE, side, FINE).mean(axis=(1, 3))
    mean = 400.0 + 1600.0 * (1.0 - light if dark else light)
    noisy = rng.poisson(np.broadcast_to(mean * 8.0, (4, side, side))) / 8.0
    return np.rint(noisy + 2.0 * rng.standard_normal(noisy.shape)).astype(np.uint16)


def mtf_of(frequency, tilt_deg, blur):
    """A Gaussian times a square pixel, in closed form."""
    tilt = np.deg2rad(tilt_deg)
    pixel = np.sinc(frequency * np.cos(tilt)) * np.sinc(frequency * np.sin(tilt))
    return np.exp(-2.0 * (np.pi * blur * frequency) ** 2) * pixel


def test_the_five_tilted_bars_of_the_case_are_found_and_no_other():
    folder = CASES / "ii1-five-tilted-bars"
    if not folder.is_dir():
        pytest.skip("the shared case ii1-five-tilted-bars is not here")
    (mtf,) = charact.mtf(folder / "b.tif", "bars", quick=True).find("mtf")
    assert mtf.status == "ok"
    assert mtf.frequency_cy_per_px == pytest.approx(0.0565, rel=0.01)
    assert mtf.value == pytest.approx(0.957, abs=0.004)


@pytest.mark.parametrize(
    "bars, frequency, tilt_deg, options",
    [
        (3, 0.09, 86.0, {"aspect": 7.0}),
        (4, 0.06, -5.0, {"aspect": 9.0, "dark": True, "place": (4.0, -6.0)}),
        (5, 0.12, 2.5, {"aspect": 12.0, "place": (-8.0, 5.0)}),
        (5, 0.045, 94.0, {"aspect": 9.0, "blur": 1.6}),
    ],
)
def test_one_group_of_a_whole_picture_has_the_mtf_of_its_blur(
    bars, frequency, tilt_deg, options, seed
):
    frames = frames_of(np.random.default_rng(seed), bars, frequency, tilt_deg, **options)
    (mtf,) = charact.mtf(frames, "bars", quick=True).find("mtf")
    assert mtf.value is not None and "processed" not in mtf.flags
    assert mtf.frequency_cy_per_px == pytest.approx(frequency, rel=0.02)
    truth = mtf_of(mtf.frequency_cy_per_px, tilt_deg, options.get("blur", 1.0))
    # 4 standard errors and half a percent of the table.
    assert abs(mtf.value - truth) < np.ptp(mtf.interval95) + 0.005


def test_an_mtf_above_any_lens_is_refused_with_its_value(seed):
    """Frames whose bars overshoot by a half at their fundamental: no number, but a sentence."""
    frames = frames_of(np.random.default_rng(seed), 4, 0.08, 0.0, blur=0.7).astype(float)

    f = np.fft.fftfreq(frames.shape[2])
    lifted = 1.0 + 0.8 * np.exp(-0.5 * ((np.abs(f) - 0.08) / 0.02) ** 2)
    sharpened = np.fft.ifft2(np.fft.fft2(frames) * lifted).real
    result = charact.mtf(
        np.rint(sharpened + 500.0).astype(np.uint16),
        "bars",
        quick=True,
        bars=4,
        frequency_cy_per_px=0.08,
    )
    for mtf in result.find("mtf"):
        assert mtf.value is None or mtf.value <= 1.1
    assert any("at most 1, got" in (mtf.reason or "") for mtf in result.find("mtf"))
