"""Bars of others: a region alone is enough, bright or dark, any number, any direction, however
little noise.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf

from charact.estimators.mtf import measure, measure_all
from charact.method import Context
from labdata import Array, FrameStack, Measurement, read_frames

ROOT = Path(__file__).parents[2]
CASES = ROOT.parent / "shared" / "cases"
SIGMA_PX = 0.9
# Fine samples of a pixel along each side.
FINE = 5


def bars_of(
    number: int,
    frequency: float,
    angle_deg: float,
    length_periods: float,
    *,
    sigma_px: float = SIGMA_PX,
) -> Array:
    """Bars under a Gaussian blur, integrated over square pixels, 1 on a wide bar, with ground all
    around.
    """
    angle, step = np.deg2rad(angle_deg), sigma_px * np.sqrt(2.0)
    margin_px = max(30.0, 1.5 / frequency)
    width, length = number / frequency, length_periods / frequency
    shape = (
        int(width * abs(np.sin(angle)) + length * abs(np.cos(angle)) + 2 * margin_px),
        int(width * abs(np.cos(angle)) + length * abs(np.sin(angle)) + 2 * margin_px),
    )
    row, col = (
        ((np.arange(side * FINE) + 0.5) / FINE - 0.5) - (side - 1) / 2 - 0.3 for side in shape
    )
    across = col[None, :] * np.cos(angle) + row[:, None] * np.sin(angle)
    along = row[:, None] * np.cos(angle) - col[None, :] * np.sin(angle)

    def slab(distance: Array, size: float) -> Array:
        return 0.5 * (erf((distance + size / 2) / step) - erf((distance - size / 2) / step))

    places = (np.arange(number) - (number - 1) / 2) / frequency
    image = sum(slab(across - place, 0.5 / frequency) for place in places) * slab(along, length)
    return image.reshape(shape[0], FINE, shape[1], FINE).mean(axis=(1, 3))


def mtf_of(frequency: float, angle_deg: float) -> float:
    """Gaussian times the mean of a pixel's samples across the bars."""
    angle = np.deg2rad(angle_deg)
    along, across = frequency * np.cos(angle), frequency * np.sin(angle)
    pixel = np.sinc(along) * np.sinc(across) / (np.sinc(along / FINE) * np.sinc(across / FINE))
    return float(np.exp(-2.0 * (np.pi * frequency * SIGMA_PX) ** 2) * pixel)


def measured(frames: Array, **said) -> Measurement:
    """Measure frames of which hardly more than a region is said."""
    context = Context(seed=1, quick=True)
    region = (0, 0, *frames.shape[1:])
    return measure(
        "bars", FrameStack(data=frames), region=region, context=context, **said
    ).measurements[0]


def holds(found: Measurement, truth: float) -> bool:
    """Tell whether a number is ok and its truth within twice the half width of its interval."""
    return found.status == "ok" and abs(found.value - truth) < np.ptp(found.interval95)


def test_a_region_alone_is_enough() -> None:
    file = CASES / "j1-bars-roi-only" / "b.tif"
    if not file.is_file():
        pytest.skip(f"the case's file is not here: {file}")
    stack = read_frames(file)
    for said in ({}, {"bars": 3}):
        found = measure(
            "bars", stack, region=(20, 20, 56, 56), context=Context(quick=True), **said
        ).measurements[0]
        assert found.status == "ok"
        assert found.frequency_cy_per_px == pytest.approx(0.1, rel=0.005)
        assert found.value == pytest.approx(0.641, abs=0.004)
    (whole,) = measure_all("bars", stack, context=Context(quick=True)).find("mtf")
    assert whole.value == pytest.approx(0.641, abs=0.006) and whole.status == "ok"


@pytest.mark.parametrize(
    ("number", "frequency", "angle_deg", "length_periods", "dark"),
    [
        (3, 0.06, 0.0, 2.5, True),
        (3, 0.11, 17.0, 2.5, True),
        (7, 0.2, 4.0, 7.0, True),
        (11, 0.17, 115.0, 6.0, False),
    ],
)
def test_any_number_of_dark_or_bright_bars_of_any_length(
    number, frequency, angle_deg, length_periods, dark, seed
) -> None:
    """USAF-1951-like, STANAG-like, ISO-12233-like: the number counted, the frequency to a percent,
    the MTF in place.
    """
    light = bars_of(number, frequency, angle_deg, length_periods)
    light = 0.1 + 0.7 * (1.0 - light if dark else light)
    rng, full_scale_dn = np.random.default_rng([seed, number]), 4095 if dark else 255
    frames = np.rint(full_scale_dn * (light + 0.01 * rng.standard_normal((2, *light.shape))))
    found = measured(frames.astype(np.uint16))
    assert holds(found, mtf_of(frequency, angle_deg)), (found.value, found.flags, found.reason)
    assert found.frequency_cy_per_px == pytest.approx(frequency, rel=0.01)
    assert found.provenance.settings["bars"] == number


@pytest.mark.parametrize(
    ("dark", "kind"), [(False, np.uint16), (True, float)], ids=["bright codes", "dark"]
)
def test_the_plateau_of_a_picture_without_noise_is_no_clipping(dark: bool, kind: type) -> None:
    light = bars_of(3, 0.05, 5.0, 2.5)
    light = 300.0 + 2000.0 * (1.0 - light if dark else light)
    found = measured((np.rint(light) if kind is np.uint16 else light)[None].astype(kind))
    assert "clipped" not in found.flags
    assert found.value == pytest.approx(mtf_of(0.05, 5.0), rel=0.005)


def test_wings_of_a_second_gaussian_are_no_sharpening(seed: int) -> None:
    """A core and a tenth to a quarter of the light in one three times as wide: 1.7 % low, and
    `processed`, before.
    """
    rng, truth_of = np.random.default_rng(seed), np.array([0.08, 0.13])
    for frequency, share in zip(truth_of, (0.12, 0.25), strict=True):
        core, wing = (bars_of(4, frequency, 0.0, 3.5, sigma_px=sigma_px) for sigma_px in (0.9, 2.7))
        light = (1.0 - share) * core + share * wing
        frames = np.rint(400.0 + 2500.0 * light + 20.0 * rng.standard_normal((4, *light.shape)))
        found = measured(frames.astype(np.uint16))
        weights = np.exp(-2.0 * (np.pi * frequency * np.array([0.9, 2.7])) ** 2)
        pixel = np.sinc(frequency) / np.sinc(frequency / FINE)
        truth = float(pixel * ((1.0 - share) * weights[0] + share * weights[1]))
        assert holds(found, truth), (found.value, truth, found.flags)


def test_a_wave_that_fills_its_region_a_spot_and_noise_are_no_bars(seed: int) -> None:
    rng, (row, col) = np.random.default_rng(seed), np.mgrid[:90, :100]
    pictures = (
        0.5 + 0.5 * np.sin(0.6 * col + 0.1 * row),
        np.exp(-((row - 45) ** 2 + (col - 50) ** 2) / 18.0),
        0.5 * (1.0 + np.tanh(col - 50 - 0.1 * row)),
        np.zeros(row.shape),
    )
    for picture in pictures:
        found = measured(
            (400.0 + 1000.0 * picture + 20.0 * rng.standard_normal((3, 90, 100))).astype(np.uint16)
        )
        assert found.status != "ok", (found.value, found.notes)
