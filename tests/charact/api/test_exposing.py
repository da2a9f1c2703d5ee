"""Exposures by description: the stated signal-to-noise ratio is that of simulated frames, light on
the detector that of the simulator's lens, and what cannot be reached is a sentence.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact import BadInput, expose
from labdata import Conditions, Target, load_camera
from labdata.camera.parameters import Draws
from simulate import LabBench
from simulate.camera.camera import CameraModel
from simulate.camera.scene_to_photoelectrons import photoelectrons_from_radiance
from simulate.camera.tube_photometry import photoelectrons_per_lumen_s
from simulate.radiance.cube import RadianceCube
from simulate.radiance.spectrum import luminous_efficiency, planck
from tests.charact.cli.runner import assert_one_sentence, charact, json_of


def small(name):
    camera = load_camera(name)
    return replace(camera, ccd=replace(camera.ccd, rows=120, columns=120))


@pytest.mark.parametrize(
    ("name", "lux"), [("gen3-digital-iccd", 1e-2), ("emccd-512", 1e-2), ("machine-vision", 0.05)]
)
def test_frames_at_the_answer_have_the_ratio(name, lux):
    camera = small(name)
    exposure = expose(camera, snr=10.0, lux=lux)
    bench, inside = LabBench(camera), (slice(None), slice(8, -8), slice(16, -8))
    lit = exposure.conditions
    unlit = replace(lit, illuminance_lux=None)
    means = 12
    flats, darks = (
        bench.expose(kind, Target(), at, frames=frames, seed=3).data[inside].astype(float)
        for kind, at, frames in (("flat", lit, means * exposure.frames), ("dark", unlit, 40))
    )
    signal = flats.mean() - darks.mean()
    of_means = flats.reshape(means, exposure.frames, *flats.shape[1:]).mean(axis=1)
    variance = of_means.var(axis=0, ddof=1)
    # Pixels correlate over a few neighbours: independent are blocks of 8 x 8.
    blocks = variance[:104, :96].reshape(13, 8, 12, 8).mean(axis=(1, 3))
    relative_sd = 0.5 * blocks.std() / np.sqrt(blocks.size) / blocks.mean()
    assert exposure.frames > 1 and exposure.snr >= 10.0 - 1e-6
    assert signal / np.sqrt(variance.mean()) == pytest.approx(
        exposure.snr, rel=4.0 * relative_sd + 0.005
    )
    assert relative_sd < 0.02


@pytest.mark.parametrize("kelvin", [2000.0, 4000.0])
def test_light_on_the_detector_is_that_of_the_simulated_lens(kelvin):
    """A diffuse scene of reflectance 0.3 under 0.002 lux of the lamp, as spectral radiance."""
    camera = small("gen3-digital-iccd")
    exposure = expose(camera, snr=5.0, lux=2e-3, reflectance=0.3, colour_temperature_k=kelvin)
    wavelength_nm = np.arange(380.0, 1081.0, 5.0)
    light = planck(wavelength_nm, kelvin)
    lux = 683.002 * 5.0 * np.sum(light * luminous_efficiency(wavelength_nm))
    radiance = light * (2e-3 / lux) * 0.3 / np.pi
    cube = RadianceCube(
        radiance=np.broadcast_to(radiance[:, None, None], (radiance.size, 60, 60)),
        wavelength_nm=wavelength_nm,
    )
    model = CameraModel(camera)
    freed = model.photoelectrons_per_pixel(
        photoelectrons_from_radiance(model, cube, Conditions(gate_ns=1e6))
    )
    middle = freed[freed.shape[0] // 2, freed.shape[1] // 2]
    per_lux = photoelectrons_per_lumen_s(camera) * 1e-4 * model.field_pixel_area_cm2 * 1e-3
    assert middle == pytest.approx(per_lux * exposure.conditions.illuminance_lux, rel=0.02)


def test_the_interval_is_that_of_the_posterior():
    """Shot noise: the ratio goes as the root of the efficiency, frames as its inverse."""
    camera = small("machine-vision")
    path, efficiency = "ccd.quantum_efficiency", float(camera.ccd.quantum_efficiency)
    factors = 1.0 + 0.1 * np.random.default_rng(1).standard_normal(400)
    draws = Draws(names=(path,), values=tuple((efficiency * f,) for f in factors.tolist()))
    asked = {"snr": 300.0, "lux": 5.0}
    exposure = expose(replace(camera, draws=draws), **asked)
    low, high = np.quantile(factors, (0.025, 0.975))
    assert exposure.snr_interval95 == pytest.approx(
        (exposure.snr * low**0.5, exposure.snr * high**0.5), rel=0.01
    )
    assert exposure.frames95 == pytest.approx(
        (exposure.frames / high, exposure.frames / low), rel=0.05, abs=1
    )
    assert expose(camera, **asked).snr_interval95 is None


def test_less_light_needs_more_frames_and_limits_hold():
    exposures = [expose("gen3-digital-iccd", lux=lux) for lux in (1e-2, 1e-3, 1e-4)]
    assert exposures[0].frames < exposures[1].frames < exposures[2].frames
    for exposure in exposures:
        assert exposure.conditions.gate_ns <= 2e7
        assert all(load <= most for load, most in exposure.loads.values())
    assert expose("gen3-digital-iccd", lux=1e-3, contrast=0.5).frames == pytest.approx(
        4 * exposures[1].frames, rel=0.1
    )


def test_an_exposure_that_is_out_of_reach_is_one_sentence():
    for arguments, words in (
        (("gen3-digital-iccd", "--lux", "1e-7"), ("--snr", "--max-frames", "as the fewest")),
        (("gen3-digital-iccd", "--lux", "1"), ("photocathode, lux must be at most 0.01",)),
        (
            ("machine-vision", "--lux", "9e5", "--f-number", "1"),
            ("charge of a pixel, e- must be at most", "--f-number"),
        ),
        (("machine-vision", "--lux", "1e9"), ("--lux must lie in (0, ",)),
        (("machine-vision", "--lux", "0"), ("--lux must lie in (0, ",)),
        (("vox-lwir-640", "--lux", "1"), ("visible light",)),
    ):
        assert_one_sentence(charact("expose", *arguments), *words)
    document = json_of("expose", "machine-vision", "--lux", "0.05", "--f-number", "1.4")
    assert document["exposure"]["frames"] == 1
    with pytest.raises(BadInput, match="gamma 1"):
        expose(load_camera("pulnix-ag5745ef3").with_values({"video.gamma": 0.45}), lux=1e-3)
    with pytest.raises(BadInput, match="`reflectance` must lie in"):
        expose("machine-vision", lux=1.0, reflectance=2.0)
