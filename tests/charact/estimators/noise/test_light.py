"""The signal-to-noise ratio follows the light with slopes 1, 1/2 and 0, and its least light holds
the light's doubt.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import uniform_filter
from scipy.special import ndtr

from charact.estimators import noise
from charact.estimators.noise import (
    read_levels,
    snr_against_light,
)
from charact.frames import rounding_sd, stack_statistics
from labdata import Conditions, Measurement
from tests.truth.counted_pulses import QUICK, Pulses, errors, gaussian, session_of

LUX_PER_PE = 1e-6


def kernel(sigma_px: float, size: int = 64):
    """The blur of one pulse as the camera of the tests lays it on its pixels."""
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None, :])
    return np.fft.fftshift(np.real(np.fft.ifft2(gaussian(sigma_px)(f))))


def pixel_variance(camera, level: float, sigma_px: float) -> float:
    """Read noise, rounding, counted electrons and blurred pulses, DN2."""
    pulses = camera.covariance_gain_dn - camera.electron_gain_dn
    signal = level * camera.gain_dn
    fixed = camera.read_noise_dn**2 + 1.0 / 12.0
    return fixed + signal * (
        camera.electron_gain_dn + pulses * float(np.sum(kernel(sigma_px) ** 2))
    )


def area_variance(camera, level: float, sigma_px: float) -> float:
    """The same of the mean of a square: pulses by the blur smoothed over the square, the rest as
    white noise.
    """
    pulses = camera.covariance_gain_dn - camera.electron_gain_dn
    smoothed = uniform_filter(kernel(sigma_px), stack_statistics.SIDE_PX, mode="constant")
    signal, white = level * camera.gain_dn, 1.0 / stack_statistics.SIDE_PX**2
    fixed = camera.read_noise_dn**2 + 1.0 / 12.0
    return white * (fixed + signal * camera.electron_gain_dn) + signal * pulses * float(
        np.sum(smoothed**2)
    )


def light_series(
    camera, rng, in_memory, levels, *, frames=8, dark_frames=16, meter=1.0, **conditions
):
    """Darks and flats whose recorded illuminance is off the true one by a factor `meter`."""
    told = Conditions(**{"illuminance_relative_sd": 0.05, "exposure_s": 0.02, **conditions})
    stacks = [("dark", "dark", camera.frames(rng, 0.0, dark_frames), told)] if dark_frames else []
    for index, level in enumerate(levels):
        recorded = replace(told, illuminance_lux=level * LUX_PER_PE / meter)
        stacks.append((f"flat-{index}", "flat", camera.frames(rng, level, frames), recorded))
    return in_memory(stacks)


def measured(session):
    """Ratios and minima alone, without the gains and the 3-D noise."""
    darks, flats, _ = read_levels(session, context=QUICK, spectra=True)
    return snr_against_light.snr_against_light(darks, flats, context=QUICK)


def of(result, quantity) -> list[Measurement]:
    return [one for one in result.measurements if one.quantity == quantity]


def least_level(camera, variance) -> float:
    """The level, photoelectrons, at which signal equals noise, by bisection."""
    low, high = 1e-4, 1e3
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (
            (middle, high) if (middle * camera.gain_dn) ** 2 < variance(middle) else (low, middle)
        )
    return float(low)


@pytest.mark.parametrize("sigma_px", [0.0, 1.5])
def test_ratios_of_pixel_and_area_are_those_of_counted_pulses_behind_a_blur(seed, sigma_px):
    """Blur smooths a pixel's noise and leaves most of an area's: the area is not as good as its
    pixels over n.
    """
    camera = Pulses(
        gain_dn=4.0, transfer=gaussian(sigma_px) if sigma_px else None, read_noise_dn=3.0
    )
    levels = (0.02, 0.1, 0.5, 3.0, 20.0)
    session = light_series(camera, np.random.default_rng(seed), session_of, levels)
    result = measured(session)
    for quantity, variance in (("snr", pixel_variance), ("snr_area", area_variance)):
        found = of(result, quantity)
        assert [one.stack for one in found] == [f"flat-{n}" for n in range(len(levels))]
        for one, level in zip(found, levels, strict=True):
            truth = level * camera.gain_dn / np.sqrt(variance(camera, level, sigma_px))
            assert abs(errors(one, truth)) < 4.5, (quantity, one, truth)
            assert one.status == "ok"
    for quantity, variance in (
        ("minimum_illumination", pixel_variance),
        ("minimum_illumination_area", area_variance),
    ):
        (found,) = of(result, quantity)
        truth = LUX_PER_PE * least_level(
            camera, lambda level, of=variance: of(camera, level, sigma_px)
        )
        assert found.unit == "lux" and abs(errors(found, truth)) < 4.5, (found, truth)


@pytest.mark.parametrize("sd_dn", [0.2, 0.5])
def test_steps_of_the_digitiser_shift_mean_and_variance_by_as_much_as_is_allowed_for(sd_dn):
    """Noise rounded by summing its normal law over the codes, at every place between two codes."""
    codes, places = np.arange(-8, 9), np.linspace(0.0, 1.0, 41)[:-1]
    share = np.diff(ndtr((np.append(codes, 9) - 0.5 - places[:, None]) / sd_dn), axis=1)
    mean = share @ codes
    variance = share @ codes**2 - mean**2
    allowed = rounding_sd(sd_dn**2 + 1.0 / 12.0)
    assert np.std(mean - places) == pytest.approx(allowed[0], rel=0.1)
    assert np.std(variance) < 1.4 * allowed[1]


def test_noise_finer_than_the_steps_leaves_the_truth_in_the_interval(seed):
    """Read noise of 0.2 DN under pulses of 4 DN: dim signals are rounded away by some tenths of a
    DN.
    """
    camera = Pulses(
        gain_dn=4.0, transfer=gaussian(0.8), read_noise_dn=0.2, black_dn=12.3, shape=(96, 128)
    )
    levels = (0.02, 0.1, 1.0, 10.0)
    result = measured(light_series(camera, np.random.default_rng(seed), session_of, levels))
    for one in of(result, "snr"):
        level = levels[int(one.stack[-1])]
        if one.value is not None:
            assert (
                abs(
                    errors(
                        one, level * camera.gain_dn / np.sqrt(pixel_variance(camera, level, 0.8))
                    )
                )
                < 4.5
            )
    (found,) = of(result, "minimum_illumination")
    truth = LUX_PER_PE * least_level(camera, lambda level: pixel_variance(camera, level, 0.8))
    assert abs(errors(found, truth)) < 4.5 and found.status == "ok"


@pytest.mark.parametrize("off", [-2.0, 1.0])
def test_a_meter_wrong_by_its_stated_error_is_in_the_interval(seed, off):
    camera = Pulses(gain_dn=4.0, transfer=gaussian(0.6), read_noise_dn=3.0, shape=(96, 128))
    session = light_series(
        camera,
        np.random.default_rng(seed),
        session_of,
        (0.1, 1.0, 10.0),
        meter=float(np.exp(0.1 * off)),
        illuminance_relative_sd=0.1,
    )
    (found,) = of(measured(session), "minimum_illumination")
    truth = LUX_PER_PE * least_level(camera, lambda level: pixel_variance(camera, level, 0.6))
    # The meter's share of the error is all but the whole.
    assert errors(found, truth) == pytest.approx(-off, abs=0.4)


def test_light_without_a_stated_error_is_not_taken_for_exact(seed):
    camera = Pulses(gain_dn=4.0, transfer=gaussian(0.6), read_noise_dn=3.0, shape=(96, 128))
    session = light_series(
        camera,
        np.random.default_rng(seed),
        session_of,
        (0.1, 1.0, 10.0),
        illuminance_relative_sd=None,
    )
    (found,) = of(measured(session), "minimum_illumination")
    low, high = found.interval68
    assert 0.5 * (high - low) / found.value == pytest.approx(0.1, rel=0.15)
    assert any("states no uncertainty of its light" in note for note in found.notes)


@pytest.mark.parametrize(
    ("levels", "changes", "status", "says"),
    [
        ((30.0, 60.0, 90.0), {}, "suspect", "extrapolated"),
        ((5.0,), {}, "ok", "only 1 level"),
        ((0.05, 0.1, 0.2), {}, "refused", "up to the brightest flat"),
        ((0.1, 1.0, 10.0), {"illuminance": False}, "refused", "illuminance_lux or photons_per_px"),
        ((0.1, 1.0, 10.0), {"dark_frames": 0}, "refused", "no darks of two frames"),
        ((500.0, 900.0, 1500.0), {}, "refused", "too far below the dimmest flat"),
    ],
)
def test_a_light_that_cannot_be_told_is_refused_or_flagged(seed, levels, changes, status, says):
    camera = Pulses(gain_dn=4.0, transfer=gaussian(0.6), read_noise_dn=3.0, shape=(96, 128))
    lit = changes.pop("illuminance", True)
    session = light_series(camera, np.random.default_rng(seed), session_of, levels, **changes)
    if not lit:
        dark = tuple(
            replace(one, conditions=replace(one.conditions, illuminance_lux=None))
            for one in session.stacks
        )
        session = replace(session, stacks=dark)
    (found,) = of(measured(session), "minimum_illumination")
    assert found.status == status, found
    assert any(says in text for text in (*found.flags, *found.notes, found.reason or "")), found


def test_a_mean_that_an_automatic_gain_holds_has_no_minimum_illumination(seed):
    camera, rng = (
        Pulses(gain_dn=4.0, read_noise_dn=3.0, shape=(96, 128)),
        np.random.default_rng(seed),
    )
    told = Conditions(exposure_s=0.02)
    stacks = [("dark", "dark", camera.frames(rng, 0.0, 16), told)]
    stacks += [
        (f"flat-{lux:g}", "flat", camera.frames(rng, 20.0, 8), replace(told, illuminance_lux=lux))
        for lux in (1e-6, 1e-5, 1e-4)
    ]
    (found,) = of(measured(session_of(stacks)), "minimum_illumination")
    assert found.status == "refused" and "automatic gain" in found.reason


@pytest.mark.parametrize("full_scale_dn", [255.0, 400.0])
def test_a_saturated_flat_has_no_ratio_and_leaves_the_others_theirs(seed, full_scale_dn):
    """Also where only its brightest pixels are cut off, and the variance still rises."""
    camera = Pulses(
        gain_dn=4.0,
        transfer=gaussian(0.6),
        read_noise_dn=3.0,
        shape=(96, 128),
        full_scale_dn=full_scale_dn,
    )
    session = light_series(camera, np.random.default_rng(seed), session_of, (0.2, 2.0, 15.0, 60.0))
    result = measured(session)
    *dim, top = of(result, "snr")
    assert top.status == "refused" and "saturated" in top.reason
    for one, level in zip(dim, (0.2, 2.0, 15.0), strict=True):
        truth = level * camera.gain_dn / np.sqrt(pixel_variance(camera, level, 0.6))
        assert abs(errors(one, truth)) < 4.5


def test_every_gain_has_its_own_ratios_and_minimum(seed):
    rng, stacks = np.random.default_rng(seed), []
    for voltage, gain in ((700.0, 2.0), (800.0, 16.0)):
        camera = Pulses(gain_dn=gain, transfer=gaussian(0.6), read_noise_dn=3.0, shape=(96, 128))
        told = Conditions(mcp_v=voltage, exposure_s=0.02, illuminance_relative_sd=0.05)
        stacks.append((f"dark-{voltage:g}", "dark", camera.frames(rng, 0.0, 8), told))
        stacks += [
            (
                f"{voltage:g}-{level:g}",
                "flat",
                camera.frames(rng, level, 6),
                replace(told, illuminance_lux=LUX_PER_PE * level),
            )
            for level in (0.1, 1.0, 10.0)
        ]
    result = measured(session_of(stacks))
    low, high = of(result, "minimum_illumination")
    assert low.value > 2.0 * high.value
    assert "MCP at 700 V" in low.notes and "MCP at 800 V" in high.notes
    # One light for both: its error is one and the same draw.
    assert np.array_equal(low.posterior["light_scale"], high.posterior["light_scale"])
    assert len(result.evidence["snr-light"]["gains"]) == 2


@pytest.mark.parametrize("relative_sd", [None, 0.04])
def test_quantum_efficiency_holds_the_stated_doubt_of_its_photons(seed, relative_sd):
    """Efficiency 50 %, photons recorded 4 % too many: one standard error where it is stated."""
    camera = Pulses(gain_dn=0.0, electron_gain_dn=0.5, shape=(96, 128))
    rng = np.random.default_rng(seed)
    stacks = [("dark", "dark", camera.frames(rng, 0.0, 16), Conditions())]
    stacks += [
        (
            f"flat-{electrons:g}",
            "flat",
            camera.frames(rng, electrons, 8),
            Conditions(photons_per_px=2.08 * electrons, illuminance_relative_sd=relative_sd),
        )
        for electrons in (400.0, 1500.0, 4000.0, 9000.0)
    ]
    (found,) = of(
        noise.measure(session_of(stacks), method="variance", context=QUICK), "quantum_efficiency"
    )
    if relative_sd is None:
        assert any("assumed exact" in note for note in found.notes)
        assert found.interval95[1] < 50.0
    else:
        assert errors(found, 50.0) == pytest.approx(-1.0, abs=0.3)
