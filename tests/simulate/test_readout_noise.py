"""Read-out of a digital camera: noise of rows, of neighbours along a row, interference, bent
response, late shutter.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Camera, Conditions, Target, load_camera
from labdata.camera import Readout, gain_at_no_signal
from simulate import LabBench
from simulate.camera import StageImage, Video, readout_noise


def small(**values: float) -> Camera:
    """Return the machine-vision camera, 64 x 80, with a plain pattern and other values of its
    read-out.
    """
    camera = load_camera("machine-vision")
    plain = {
        "ccd.prnu": 0.0,
        "ccd.dsnu_e": 0.0,
        "optics.veiling_glare_fraction": 0.0,
        "ccd.smear_fraction": 0.0,
    }
    camera = camera.with_values(
        plain | {f"readout.{name}": value for name, value in values.items()}
    )
    return replace(camera, ccd=replace(camera.ccd, rows=64, columns=80))


@pytest.mark.parametrize("exponent", [0.0, 0.3, 1.0])
def test_offsets_of_rows_have_their_spectral_density(exponent, seed):
    """The periodogram of 600 frames at four frequencies far from 0, where leakage of a frame is
    small.
    """
    rng, rows, count = np.random.default_rng(seed), 256, 600
    frames = np.stack(
        [readout_noise.draw_row_offsets(rng, rows, 2.0, exponent)[:, 0] for _ in range(count)]
    )
    window = np.hanning(rows)
    power = np.mean(np.abs(np.fft.rfft(frames * window)) ** 2, axis=0) / np.sum(window**2)
    for place in (16, 40, 64, 110):
        expected = 2.0 * (4.0 * place / rows) ** -exponent
        # Three bins of a Hann window are correlated: counted as one and a half.
        found = power[place - 1 : place + 2].mean()
        assert found == pytest.approx(expected, rel=4.5 / np.sqrt(1.5 * count))


@pytest.mark.parametrize("ratio", [0.5, 1.0, 2.5])
def test_read_noise_has_unit_variance_and_the_ratio_of_densities(ratio, seed):
    noise = readout_noise.draw_read_noise(np.random.default_rng(seed), (4000, 200), ratio).astype(
        float
    )
    power = np.mean(np.abs(np.fft.rfft(noise)) ** 2, axis=0) / 200
    assert noise.var() == pytest.approx(1.0, rel=4.5 * np.sqrt(3.0 / noise.size))
    assert power[-1] / power[0] == pytest.approx(ratio, rel=4.5 * np.sqrt(4.0 / 4000) + 0.01)


@pytest.mark.parametrize("frequency", [(0.5, 0.5), (0.25, 0.75), (0.1, 0.3)])
def test_interference_has_its_variance_in_every_frame_and_changes_its_phase(frequency, seed):
    rng = np.random.default_rng(seed)
    frames = [readout_noise.draw_interference(rng, (80, 120), 0.7, *frequency) for _ in range(20)]
    assert [float(frame.var()) for frame in frames] == pytest.approx([0.7] * 20, rel=1e-4)
    assert max(np.abs(frames[0] - frame).max() for frame in frames[1:]) > 0.5
    # One sinusoid: a frame moved by one pixel and back adds to 2 cos(2 pi f) times itself.
    across = 2.0 * np.cos(2.0 * np.pi * frequency[0])
    assert frames[0][:, :-2] + frames[0][:, 2:] == pytest.approx(
        across * frames[0][:, 1:-1], abs=1e-4
    )


def test_a_plain_read_out_draws_the_frames_that_it_drew_without_a_description_of_it():
    bench = LabBench(small())
    without = LabBench(replace(small(), readout=Readout()))
    known = Conditions(exposure_s=0.02, illuminance_lux=0.01)
    frames, same = (
        one.expose("flat", Target(), known, frames=2, seed=4).data for one in (bench, without)
    )
    assert np.array_equal(frames, same)


def test_terms_of_the_read_out_are_in_the_frames_of_the_camera(seed):
    camera = small(row_noise_dn2=4.0, interference_dn2=9.0, fine_noise_ratio=1.5)
    camera = camera.with_values({"video.black_level_dn": 200.0, "ccd.dark_current_e_per_s": 0.1})
    dark = (
        LabBench(camera)
        .expose("dark", Target(), Conditions(exposure_s=0.02), frames=60, seed=seed)
        .data
    )
    change = dark - dark.mean(axis=0)
    read_dn2 = (float(camera.ccd.read_noise_e) * float(camera.video.conversion_gain_dn_per_e)) ** 2
    assert change.var() == pytest.approx(read_dn2 + 13.0 + 1 / 12, rel=0.05)
    assert change.mean(axis=2).var() == pytest.approx(
        4.0 + (read_dn2 * 0.8 + 1 / 12) / 80, rel=0.15
    )


def test_a_bent_response_loses_its_fraction_at_full_scale():
    bent = Video(
        conversion_gain_dn_per_e=1.0, black_level_dn=0.0, bit_depth=12, compression_fraction=0.02
    )
    level = bent.mean(StageImage(values=np.array([[10.0, 1000.0, 3000.0]], np.float32))).values[0]
    straight = np.array([10.0, 1000.0, 3000.0]) * gain_at_no_signal(1.0, 0.02)
    assert level == pytest.approx(straight * (1.0 - 0.02 * straight / 4095.0), rel=1e-5)


def test_the_conversion_gain_is_the_slope_of_variance_over_signal_to_70_percent_of_full_scale():
    """Shot noise K0 s (1 - 2 c s)^2 behind y = s - c s^2, by a straight line through evenly spaced
    levels.
    """
    c = 0.005
    s = np.linspace(0.0, 0.7, 2000)
    y, variance = s - c * s**2, gain_at_no_signal(1.0, c) * s * (1.0 - 2.0 * c * s) ** 2
    assert np.polyfit(y, variance, 1)[0] == pytest.approx(1.0, abs=2e-4)


def test_an_open_shutter_counts_longer_than_stated():
    stated = Conditions(exposure_s=1e-3, photons_per_px=2000.0, wavelength_nm=530.0)
    late, plain = (
        LabBench(small(exposure_offset_us=us)).mean("flat", Target(), stated) - 30.0
        for us in (50.0, 0.0)
    )
    assert late.mean() / plain.mean() == pytest.approx(1.05, rel=1e-5)
    with pytest.raises(BadInput, match="exposure_s must be positive"):
        LabBench(small(exposure_offset_us=-2000.0)).mean("flat", Target(), stated)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("row_noise_dn2", -1.0),
        ("fine_noise_ratio", 0.0),
        ("row_noise_exponent", 3.0),
        ("interference_dn2", -0.1),
        ("interference_x_cy_per_px", 1.5),
        ("compression_fraction", 0.5),
    ],
)
def test_an_impossible_read_out_is_refused(name, value):
    with pytest.raises(BadInput, match=name):
        small(**{name: value})
