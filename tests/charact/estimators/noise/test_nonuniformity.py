"""DSNU, PRNU and saturation of EMVA 1288 of drawn frames whose parts are known."""

import numpy as np
import pytest
from scipy.ndimage import convolve
from scipy.stats import norm

import charact
from charact.estimators.noise.nonuniformity import MeanFrame, highpass
from charact.reporting import emva_summary
from labdata.data_sheet import BY_VARIANCE


@pytest.mark.parametrize("shape", [(60, 90), (240, 40)])
def test_rows_columns_and_pixels_are_separated(shape, seed):
    """The variances of columns, rows and pixels behind noise in time are those drawn (eq. 42)."""
    rng, frames, pixel_sd = np.random.default_rng(seed), 20, 0.7
    column, row = rng.normal(0.0, 1.0, (1, shape[1])), rng.normal(0.0, 2.0, (shape[0], 1))
    pixel = rng.normal(0.0, pixel_sd, shape)
    mean = 100.0 + row + column + pixel + rng.normal(0.0, 3.0, shape) / np.sqrt(frames)
    of_columns, of_rows = 9.0 / np.array(shape)
    frame = MeanFrame(dn=mean, frames=frames, pixel_dn2=9.0, column_dn2=of_columns, row_dn2=of_rows)
    square, sd, raised = frame.variances(filtered=False)
    assert np.all(raised < 1e-12)
    truth = np.array([column.var(), row.var(), pixel.var()])
    # Means of pixels over a column or row are a pattern of these too, by chance.
    shared = pixel_sd**2 / np.array([*shape, np.sqrt(pixel.size)])
    number = np.array([shape[1], shape[0], pixel.size])
    chance = np.sqrt((2.0 * shared**2 + 4.0 * truth * shared) / number)
    assert np.all(np.abs(square[1:] - truth) < 4.5 * np.hypot(sd[1:], chance))
    assert square[0] == pytest.approx(square[1:].sum())


def test_the_filter_removes_shading_and_keeps_pixels(seed):
    pixels = np.random.default_rng(seed).normal(0.0, 1.0, (120, 160))
    across, down = np.meshgrid(np.linspace(-1, 1, 160), np.linspace(-1, 1, 120))
    left = highpass(pixels + 40.0 * (across**2 + down**2) + 25.0 * across)[12:-12, 12:-12]
    # 1 - 2 h(0) + sum h^2 of the smooth part h, which is 1/121 in its middle.
    assert left.var() == pytest.approx(0.989 * pixels.var(), rel=0.03)


def test_saturation_is_where_one_pixel_of_a_thousand_is_full(seed):
    """Pixels of shot noise s are full at 4095 DN: 0.1 % of them at the level 4094.5 DN - 3.09 s."""
    rng, photons = np.random.default_rng(seed), np.linspace(400.0, 4400.0, 21)
    flats = [
        np.minimum(rng.poisson(light, (4, 80, 120)) + 50, 4095).astype(np.uint16)
        for light in photons
    ]
    dark = np.rint(50.0 + rng.normal(0.0, 2.0, (4, 80, 120))).astype(np.uint16)
    settings = {"photons_per_px": photons, "exposure_s": 0.01, "bit_depth": 12, "quick": True}
    result = charact.noise(flats=flats, darks=[dark], seed=seed, **settings)
    light = np.linspace(3500.0, 4400.0, 9001)
    full = norm.sf((4094.5 - 50.0 - light) / np.sqrt(light))
    truth = float(np.interp(0.001, full, light))
    (exposure,) = result.find("saturation_exposure_full_scale")
    assert exposure.interval95[0] < truth < exposure.interval95[1]
    assert exposure.value == pytest.approx(truth, abs=0.25 * float(np.diff(photons)[0]))
    (capacity,) = result.find("saturation_capacity_full_scale")
    assert capacity.value == pytest.approx(truth, rel=0.03)


def test_the_gain_of_the_standard_stands_beside_that_of_diffusing_charge(seed):
    """Of charge that leaves its pixel the slope of the variance is K times the kernel's energy."""
    rng, photons = np.random.default_rng(seed), np.linspace(500.0, 6000.0, 6)
    kernel = np.array([[0.0, 0.04, 0.0], [0.04, 0.84, 0.04], [0.0, 0.04, 0.0]])

    def frames(light):
        electrons = rng.poisson(0.6 * light, (8, 128, 160)).astype(float)
        blurred = convolve(electrons, kernel[None], mode="wrap")
        return np.rint(100.0 + 0.5 * blurred + rng.normal(0.0, 2.0, blurred.shape)).astype("u2")

    settings = {"photons_per_px": photons, "exposure_s": 0.01, "bit_depth": 12, "quick": True}
    result = charact.noise(
        flats=[frames(light) for light in photons], darks=[frames(0.0)], seed=seed, **settings
    )
    energy = float((kernel**2).sum())
    rows = {row.entry.element[1]: row for row in emva_summary(result)["rows"]}
    gain, efficiency = rows["K"], rows["QE"]
    assert gain.flags == ("correlated-noise",)
    assert gain.m.value == pytest.approx(0.5 * energy, rel=0.01)
    low, high = efficiency.m.interval95
    assert low < 60.0 < high
    beside = float(efficiency.entry.remark.removeprefix(BY_VARIANCE).split()[0])
    assert beside == pytest.approx(60.0 / energy, rel=0.02)
