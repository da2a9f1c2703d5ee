"""Frames of a bolometer array and of a cooled array against closed forms and the numbers of their
class.
"""

from dataclasses import replace

import numpy as np
import pytest

from simulate.camera import ThermalImager
from tests.simulate.infrared.measures import (
    contrast,
    imager,
    measured_netd_k,
    noise_terms,
    planck_integral,
    slope,
    still,
)


def vox(rows=96, columns=128, **values) -> ThermalImager:
    return imager("vox-lwir-640", bolometer__rows=rows, bolometer__columns=columns, **values)


def insb(rows=96, columns=128, **values) -> ThermalImager:
    return imager("insb-mwir-640", cooled_array__rows=rows, cooled_array__columns=columns, **values)


def electrons(kelvin, transmission=0.80, quantum_efficiency=0.80, exposure_s=5.8e-3):
    """Electrons of a pixel of 15 um behind f/2.5, 3.4 to 4.9 um."""
    solid_angle = np.pi / (4.0 * 2.5**2 + 1.0)
    photons = planck_integral(3.4, 4.9, kelvin, power=0) * 15e-6**2 * solid_angle * transmission
    return photons * quantum_efficiency * exposure_s


def test_the_noise_of_black_bodies_is_that_of_the_bolometer(seed):
    """40 mK before 300 K, and more before 295 K, as radiance rises less with temperature there."""
    kelvin = 0.040 * slope(7.5, 13.5, 300.0) / slope(7.5, 13.5, 295.0)
    camera = vox()
    assert measured_netd_k(camera, seed) == pytest.approx(kelvin, rel=0.03)
    assert measured_netd_k(camera, seed, 300.0) == pytest.approx(0.040, rel=0.03)
    assert measured_netd_k(camera.without("white noise"), seed) < 0.5 * kelvin


def test_the_photon_limit_is_that_of_the_well():
    """14.8 mK at 3.5 million electrons, 12.3 mK at 5 million; 6.1e8 electrons a second; 3.63 % a
    kelvin.
    """
    camera = insb(cooled_array__read_noise_e=0.0)
    assert electrons(300.0) == pytest.approx(3.5e6, rel=0.02)
    assert float(camera.signal_of(300.0)) == pytest.approx(electrons(300.0), rel=1e-6)
    assert float(camera.signal_of(300.0)) / 5.8e-3 == pytest.approx(6.1e8, rel=0.01)
    assert camera.signal_slope(300.0) / float(camera.signal_of(300.0)) == pytest.approx(
        0.0363, rel=0.01
    )
    for well_e, milli in ((3.5e6, 14.8), (5e6, 12.3)):
        exposure_ms = 5.8 * well_e / electrons(300.0)
        limited = insb(cooled_array__read_noise_e=0.0, cooled_array__integration_ms=exposure_ms)
        assert 1e3 * limited.netd_k(300.0) == pytest.approx(milli, abs=0.15)


def test_the_noise_of_black_bodies_is_that_of_photons_and_reading(seed):
    """18 mK before 300 K."""
    camera = insb()
    for kelvin in (295.0, 300.0):
        per_k = (electrons(kelvin + 0.05) - electrons(kelvin - 0.05)) / 0.1
        closed = np.hypot(np.sqrt(electrons(kelvin)), 1300.0) / per_k
        assert measured_netd_k(camera, seed, kelvin) == pytest.approx(closed, rel=0.03)
        only = measured_netd_k(camera.without("read noise"), seed, kelvin)
        assert only == pytest.approx(np.sqrt(electrons(kelvin)) / per_k, rel=0.03)
        assert measured_netd_k(camera.without("photon noise"), seed, kelvin) == pytest.approx(
            1300.0 / per_k, rel=0.03
        )
    assert closed == pytest.approx(0.018, rel=0.03)


@pytest.mark.parametrize(
    ("make", "half", "whole", "wave"),
    [(vox, 0.732, 0.402, "10 um, f/1"), (insb, 0.710, 0.372, "4 um, f/2.5")],
)
def test_the_transfer_is_diffraction_times_pixel(make, half, whole, wave):
    """At half of the sampling's Nyquist frequency and at it; the lens' own blur is taken away."""
    camera = make(rows=16, optics__blur_mrad=0.0)
    nyquist = 0.5 / camera.pitch_mrad[1]
    for frequency, reference in ((0.5 * nyquist, half), (nyquist, whole)):
        assert contrast(camera, frequency) == pytest.approx(reference, abs=1e-3), wave
        assert contrast(camera.without("optics blur"), frequency) > reference + 0.02
        assert contrast(camera.without("detector footprint"), frequency) > reference + 0.02
    with_lens = replace(
        camera, description=camera.description.with_values({"optics.blur_mrad": 0.1})
    )
    expected = half * np.exp(-2.0 * (np.pi * 0.1 * 0.5 * nyquist) ** 2)
    assert contrast(with_lens, 0.5 * nyquist) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("make", [vox, insb])
def test_frames_do_not_depend_on_the_cells_of_a_picture(make):
    """A scene that cells of every size resolve: the average over a cell is undone."""
    camera = still(make(rows=32, columns=48))
    seen = []
    for oversample in (1, 2, 3, 4):
        down, right = ((np.arange(side * oversample) + 0.5) / oversample for side in camera.shape)
        row_share = np.cos(2.0 * np.pi * down / 16.0) * np.sinc(1.0 / 16.0 / oversample)
        column_share = np.cos(2.0 * np.pi * right / 12.0) * np.sinc(1.0 / 12.0 / oversample)
        signal = float(camera.signal_of(300.0)) * (1.0 + 0.05 * row_share[:, None] * column_share)
        seen.append(next(camera.frames_of_signal(signal, seed=0)).astype(float))
    inner = [frame[8:-8, 12:-12] for frame in seen]
    assert all(np.abs(frame - inner[-1]).max() < 2e-3 * np.ptp(inner[-1]) for frame in inner)


@pytest.mark.parametrize(("rate_hz", "reference"), [(30.0, 0.036), (60.0, 0.189)])
def test_a_bolometer_carries_the_frame_before_over(rate_hz, reference):
    """exp(-T / 10 ms) of a step is missing in the first frame, its square in the second."""
    camera = still(vox(rows=8, columns=8, video__field_rate_hz=rate_hz))
    low, high = float(camera.signal_of(295.0)), float(camera.signal_of(305.0))
    steps = np.ones((5, 8, 8)) * np.array([low, low, high, high, high])[:, None, None]
    found = np.array([frame.mean() for frame in camera.frames_of_signal(steps, seed=0)])
    whole = next(camera.frames_of_signal(steps[2], seed=0)).mean() - found[0]
    missing = 1.0 - (found[2:] - found[0]) / whole
    assert missing[:2] == pytest.approx([reference, reference**2], abs=6e-4)
    prompt = [
        frame.mean() for frame in camera.without("thermal lag").frames_of_signal(steps, seed=0)
    ]
    assert prompt[2] == pytest.approx(prompt[4], rel=1e-6)


def test_the_noise_of_a_bolometer_has_seven_terms(seed):
    """Over the temporal noise of a pixel; the pattern of pixels grows from 0.3 to 0.5 between two
    shutters.
    """
    camera = vox().without("housing drift")
    young = camera.view_target(22.0, seed=seed, count=48)
    old = camera.view_target(22.0, seed=seed, count=48, first_frame=180 * 30 - 49)
    first, last = noise_terms(young), noise_terms(old)
    share = {name: value / first["tvh"] for name, value in first.items()}
    # Four standard errors of each standard deviation, by the number of its values.
    for name, expected, values in (
        ("vh", 0.3, 96 * 128),
        ("h", 0.25, 128),
        ("v", 0.1, 96),
        ("tv", 0.1, 48 * 96),
        ("th", 0.1, 48 * 128),
        ("t", 0.1, 48),
    ):
        assert share[name] == pytest.approx(expected, rel=4.0 / np.sqrt(2.0 * values) + 0.03), name
    assert last["vh"] / last["tvh"] == pytest.approx(0.5, rel=0.05)
    bare = noise_terms(
        camera.without("fixed pattern", "row, column and frame noise").view_target(
            22.0, seed=1, count=16
        )
    )
    assert max(bare[name] for name in ("vh", "h", "v", "tv", "th", "t")) < 0.05 * bare["tvh"]


def test_the_housing_drifts_until_the_next_shutter(seed):
    """30 mK a minute: 60 mK in two minutes, none just after the shutter."""
    camera = vox(rows=32, columns=32).without("row, column and frame noise", "fixed pattern")
    minutes = [0.0, 2.0, 3.0]
    means = [
        camera.view_target(26.85, seed=seed, count=8, first_frame=round(60 * 30 * m)).mean(
            dtype=float
        )
        for m in minutes
    ]
    per_k = camera.view_target(27.85, seed=seed, count=8).mean(dtype=float) - means[0]
    error = 0.04 / np.sqrt(8 * 32 * 32)
    assert (means[1] - means[0]) / per_k == pytest.approx(0.060, abs=6.0 * error + 6e-4)
    assert (means[2] - means[0]) / per_k == pytest.approx(0.0, abs=6.0 * error)
    off = (
        camera.without("housing drift")
        .view_target(26.85, seed=seed, count=8, first_frame=3600)
        .mean(dtype=float)
    )
    assert (off - means[0]) / per_k == pytest.approx(0.0, abs=6.0 * error)


def test_a_two_point_correction_leaves_a_w(seed):
    """Fixed pattern over the temporal noise midway: least at the two black bodies of 15 and 35 C,
    0.4 midway.
    """
    camera = insb()
    pattern = {}
    for celsius in (5.0, 15.0, 25.0, 35.0, 45.0):
        terms = noise_terms(camera.view_target(celsius, seed=seed, count=24))
        pattern[celsius] = terms["vh"]
        if celsius == 25.0:
            temporal = terms["tvh"]
    assert pattern[15.0] / temporal == pytest.approx(0.1, rel=0.15)
    assert pattern[35.0] / temporal == pytest.approx(0.1, rel=0.15)
    # Midway in kelvin is not quite midway in electrons.
    assert pattern[25.0] / temporal == pytest.approx(np.hypot(0.4, 0.1), rel=0.06)
    assert pattern[5.0] > pattern[25.0] > 3.0 * pattern[15.0] and pattern[45.0] > pattern[25.0]
    flat = camera.without("correction residual").view_target(25.0, seed=seed, count=24)
    assert noise_terms(flat)["vh"] / temporal == pytest.approx(0.1, rel=0.15)
    bare = camera.without("correction residual", "pixel pattern").view_target(
        25.0, seed=seed, count=24
    )
    assert noise_terms(bare)["vh"] < 0.06 * temporal
