"""Noise-equivalent quanta and detectability where photons are counted: NEQ = N MTF^2."""

import numpy as np
import pytest
from scipy.special import j1

from charact import measure as measure_with_settings
from charact.reporting.figure_registry import figure_of
from charact.session_measurement import measure
from labdata import BadInput, Conditions, FrameStack
from tests.truth import EdgeScene, TrueBlur, session_in_memory, stack_in_memory

BLUR, GAIN, READ_DN = TrueBlur(sigma_px=0.8), 0.5, 1.0
# Rounding adds a twelfth.
DARK_DN2 = READ_DN**2 + 1.0 / 12.0


def session(photons, exposure_s=0.01, size=128):
    rng = np.random.default_rng(2)

    def frames(signal):
        read = rng.normal(100.0, READ_DN, (12, size, size))
        return FrameStack(data=np.round(GAIN * rng.poisson(signal, read.shape) + read))

    levels = {"dark_dn": 400.0, "bright_dn": 1900.0, "black_dn": 100.0, "full_scale_dn": 4095.0}
    scene = EdgeScene(blur=BLUR, rows=90, cols=90, snr=100.0, frames=4, **levels)
    at = Conditions(exposure_s=0.01)
    return session_in_memory(
        [
            stack_in_memory("dark", frames(0.0), at),
            stack_in_memory("flat", frames(photons), at),
            stack_in_memory("edge", scene.frames_drawn(rng), Conditions(exposure_s=exposure_s)),
        ]
    )


@pytest.mark.parametrize(("photons", "disc"), [(2000.0, (10.0, 0.1)), (300.0, (4.0, 0.3))])
def test_counted_photons_have_as_many_quanta_times_the_squared_mtf(photons, disc):
    result = measure(session(photons), quick=True, disc=disc)
    noise_dn2, signal_dn = GAIN**2 * photons + DARK_DN2, GAIN * photons
    for found in result.find("neq"):
        mtf = float(BLUR.mtf(found.frequency_cy_per_px, 5.0))
        low, high = found.interval95
        assert low < signal_dn**2 * mtf**2 / noise_dn2 < high
        assert high - low < 0.3 * found.value
    frequency = np.fft.fftfreq(600)
    fx, fy = np.meshgrid(frequency, frequency)
    argument = np.pi * disc[0] * np.maximum(np.hypot(fx, fy), 1e-9)
    contrast_dn = disc[1] * signal_dn * 0.25 * np.pi * disc[0] ** 2 * 2.0 * j1(argument) / argument
    square = np.mean((contrast_dn * BLUR.transfer(fx, fy)) ** 2) / noise_dn2
    (detectability,) = result.find("detectability")
    low, high = detectability.interval95
    assert low < np.sqrt(square) < high and high - low < 0.25 * detectability.value
    name = "noise-equivalent quanta:edge"
    assert figure_of(name, result.evidence[name]).svg is not None


def test_an_edge_of_another_exposure_has_no_quanta():
    assert not measure(session(2000.0, exposure_s=0.02, size=96), quick=True).find("neq")


@pytest.mark.parametrize("disc", ["10", "0,0.1", "10,2", "a,b", "nan,0.1"])
def test_an_impossible_disc_is_one_sentence(disc):
    with pytest.raises(BadInput, match="`disc` must be PX,CONTRAST"):
        measure_with_settings(session(100.0, size=16), disc=disc)
