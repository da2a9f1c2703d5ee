"""The regression truths of the physics reference, section 8, that concern the chain, each under its
number.

Reference numbers are the reference's own, not this code's. Other tests hold some of them in more
depth.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from simulate.camera import (
    CameraModel,
    HaloBlur,
    MicrochannelPlate,
    PhosphorDecay,
    PixelAperture,
    Slot,
    TubeShare,
    apply_phosphor_decay,
    product,
    true_quantities,
    tube_photometry,
)
from tests.simulate.test_photometry import drawn_pulses

FIELD_S = 1.0 / 59.94
# Table 5.2 at a post-gain share of 1, single rows: tube, fibres of 80 lp/mm, pixel of 18.0 x 21.3
# um at the cathode.
PIXEL_MM = (0.018, 0.0213)


def test_truth_01_gallium_arsenide_has_1996_ua_per_lumen_and_228_ma_per_watt(
    sheet,
):
    cathode = sheet.photocathode
    table_nm, table = cathode.wavelength_nm, np.asarray(cathode.relative_quantum_efficiency)
    assert tube_photometry.luminous_sensitivity(table_nm, table) == pytest.approx(1996, rel=0.01)
    peak = tube_photometry.quantum_efficiency(sheet, [700.0, 750.0]).max()
    assert peak == pytest.approx(0.27, rel=0.01)
    responsivity = (
        tube_photometry.quantum_efficiency(sheet, [830.0])[0]
        * tube_photometry.ELEMENTARY_CHARGE_C
        * 830e-9
    )
    assert 1e3 * responsivity / tube_photometry.JOULE_METRE == pytest.approx(154, rel=0.01)
    scale = table.max() / peak
    assert 1e3 * scale * responsivity / tube_photometry.JOULE_METRE == pytest.approx(228, rel=0.01)


def test_truth_02_ebi_is_1_129_electrons_per_second_and_chip_pixel(sheet):
    per_row_pair = true_quantities.true_quantities(sheet)["ebi"]
    assert per_row_pair / 2.0 == pytest.approx(1.129, abs=1e-3)
    assert per_row_pair * FIELD_S == pytest.approx(0.038, abs=5e-4)


def test_truth_03_luminous_gain_15000_is_10229_photons_per_photoelectron(sheet):
    assert float(sheet.tube.luminous_gain) == 15000.0
    assert tube_photometry.photons_per_photoelectron(sheet) == pytest.approx(10229, rel=5e-4)


def _plate(probability: float, shape: float) -> MicrochannelPlate:
    return MicrochannelPlate(
        detection_probability=probability,
        pulse_height_shape=shape,
        gain=1.0,
        saturation_e_per_s_cm2=np.inf,
        field_s=FIELD_S,
    )


# Section 1.4: excess noise of fixed gain, Polya of shape 2, exponential pulse heights. A gamma law
# of shape 1e5 is fixed to 1e-5.
NOISE = {
    1.0: (1.00, 1.50, 2.00),
    0.75: (1.33, 2.00, 2.67),
    0.63: (1.59, 2.38, 3.17),
    0.60: (1.67, 2.50, 3.33),
    0.50: (2.00, 3.00, 4.00),
}


@pytest.mark.parametrize("probability", NOISE)
@pytest.mark.parametrize(("column", "shape"), [(0, 1e5), (1, 2.0), (2, 1.0)])
def test_truth_04_excess_noise_is_that_of_the_table(probability, column, shape):
    assert _plate(probability, shape).excess_noise_factor == pytest.approx(
        NOISE[probability][column], abs=5e-3
    )


def test_truth_05_signal_to_noise_of_the_tube_specification_is_21(sheet, seed):
    """108 microlux on a spot of 0.2 mm, 10 Hz: the photoelectrons of 50 ms, with a noise factor of
    1.8.
    """
    area_m2 = np.pi * (0.1e-3) ** 2
    counted = tube_photometry.photoelectrons_per_lumen_s(sheet) * 108e-6 * area_m2 / (2.0 * 10.0)
    assert np.sqrt(counted) == pytest.approx(37.8, abs=0.05)
    assert np.sqrt(counted) / 1.8 == pytest.approx(21.0, abs=0.05)
    plate = _plate(0.62, 1.0)
    spots = drawn_pulses(plate, counted, 400_000, np.random.default_rng(seed))
    assert np.sqrt(plate.excess_noise_factor) == pytest.approx(1.8, abs=0.01)
    assert spots.mean() / spots.std() == pytest.approx(21.0, abs=0.15)


def test_truth_06_johnson_fit_of_the_least_mtf_is_26_25_and_1_184(sheet):
    from scipy.optimize import curve_fit

    frequency, least = np.array([2.5, 7.5, 15.0, 25.0]), np.array([0.92, 0.80, 0.61, 0.38])

    def tube(f, cut_off, exponent):
        return TubeShare(share=1.0, frequency_lp_per_mm=cut_off, exponent=exponent).transfer(
            f, np.zeros_like(f)
        )

    fitted, _ = curve_fit(tube, frequency, least, p0=(30.0, 1.0))
    assert fitted == pytest.approx([26.25, 1.184], rel=1e-3)
    assert [float(sheet.tube.mtf_frequency_lp_per_mm), float(sheet.tube.mtf_exponent)] == [
        26.25,
        1.184,
    ]
    assert 100.0 * (tube(frequency, 26.25, 1.184) - least) == pytest.approx(
        [2.0, -0.3, -1.3, 0.9], abs=0.06
    )
    assert tube(np.array([64.0]), 26.25, 1.184)[0] == pytest.approx(0.057, abs=5e-4)


def test_truth_06_shares_before_and_after_the_gain_make_the_whole_tube(sheet):
    frequency = np.array([2.5, 7.5, 15.0, 25.0])
    shares = [TubeShare(share=s, frequency_lp_per_mm=26.25, exponent=1.184) for s in (0.8, 0.2)]
    whole = product(tuple(shares), frequency, np.zeros(4))
    assert whole == pytest.approx(np.exp(-((frequency / 26.25) ** 1.184)), rel=1e-12)


def test_truth_07_stage_resolutions_add_in_quadrature_to_62_15(sheet):
    stages = [
        sheet.photocathode.gap_resolution_lp_per_mm,
        sheet.microchannel_plate.resolution_lp_per_mm,
        sheet.phosphor.resolution_lp_per_mm,
    ]
    assert [float(stage) for stage in stages] == [140.0, 85.0, 120.0]
    assert sum(float(stage) ** -2 for stage in stages) ** -0.5 == pytest.approx(62.15, abs=5e-3)


def test_truth_08_570_television_lines_are_the_nyquist_frequency_of_the_columns(sheet):
    camera = CameraModel(sheet)
    rows, columns = camera.shape
    assert columns * 3 / 4 == 576
    height_mm = rows * camera.cells.pitch_y_mm
    assert 570.0 / 2.0 / height_mm == pytest.approx(27.2, abs=0.05)
    assert 0.5 / camera.cells.pitch_x_mm == pytest.approx(27.8, abs=0.05)


def _share_of_one() -> tuple:
    tube = TubeShare(share=1.0, frequency_lp_per_mm=26.25, exponent=1.184)
    return tube, _Fibres(), PixelAperture(width_mm=PIXEL_MM[0], height_mm=PIXEL_MM[1])


class _Fibres:
    """Fibres and taper of table 5.2: a Gaussian of 80 lp/mm at the cathode."""

    def transfer(self, fx_per_mm, fy_per_mm):
        return np.exp(-(fx_per_mm**2 + fy_per_mm**2) / 80.0**2)


def test_truth_09_blur_factor_at_share_one_is_204_thousandths():
    blur, beside, below = true_quantities.pulse_correlation(_share_of_one(), None, *PIXEL_MM)
    assert blur == pytest.approx(0.204, abs=1e-3)
    assert (beside, below) == pytest.approx((0.45, 0.38), abs=6e-3)


def test_truth_09_covariances_summed_so_far_hold_their_share():
    """Sum over lags to `reach` pixels both ways, over the whole sum: section 5.2."""
    # Tails of the point spread beyond some forty pixels are folded, as on any lattice of so many
    # frequencies.
    x, y = ((np.arange(n) + 0.5) / n - 0.5 for n in (480, 480))
    power = np.zeros((len(y), len(x)))
    for m in (-2, -1, 0, 1, 2):
        for n in (-2, -1, 0, 1, 2):
            fx, fy = np.broadcast_arrays(
                (x[None, :] + m) / PIXEL_MM[0], (y[:, None] + n) / PIXEL_MM[1]
            )
            power += product(_share_of_one(), fx, fy) ** 2
    for reach, share in ((1, 0.70), (2, 0.84), (4, 0.93), (6, 0.95), (8, 0.95)):
        lags = [np.sin(np.pi * (2 * reach + 1) * f) / np.sin(np.pi * f) for f in (x, y)]
        assert float(np.mean(power * lags[0][None, :] * lags[1][:, None])) == pytest.approx(
            share, abs=0.02
        ), reach


# Section 5.2: variance left by a lag r, and that of differences of consecutive fields.
LAGGING = {
    0.05: (0.90, 0.86),
    0.1: (0.82, 0.74),
    0.2: (0.67, 0.53),
    0.3: (0.54, 0.38),
    0.45: (0.38, 0.21),
}


@pytest.mark.parametrize("lag", LAGGING)
def test_truth_10_a_lag_takes_its_share_of_the_variance(lag, seed):
    """One exponential and pulses at the start of the field alone make fields a first-order
    recursion.
    """
    decay_ms = -1e3 * FIELD_S / np.log(lag)
    glow = PhosphorDecay(
        components=((1.0, decay_ms * 1e-3),), gate_s=1e-9 * FIELD_S, field_s=FIELD_S
    )
    fields = np.random.default_rng(seed).standard_normal((240, 80, 80)).astype(np.float32)
    shown = apply_phosphor_decay(fields, glow.weights).astype(float)
    variance = shown.var()
    difference = np.diff(shown, axis=0).var() / 2.0
    assert variance == pytest.approx(LAGGING[lag][0], abs=0.006)
    assert difference == pytest.approx(LAGGING[lag][1], abs=0.006)


# Section 10: one exponential of so many ms, fields of so many Hz; variance in time and of adjacent
# differences.
@pytest.mark.parametrize(
    ("decay_ms", "rate_hz", "variance", "adjacent"),
    [(1.0, 30.0, 0.968, 0.952), (1.0, 60.0, 0.936, 0.907), (5.0, 30.0, 0.848, 0.775)],
)
def test_truth_10_pulses_at_any_time_of_the_field_lose_the_variance_of_section_10(
    decay_ms, rate_hz, variance, adjacent
):
    field_s = 1.0 / rate_hz
    glow = PhosphorDecay(components=((1.0, decay_ms * 1e-3),), gate_s=field_s, field_s=field_s)
    halves = np.pad(glow.halves, ((0, 0), (0, 1)))
    same = np.mean(np.sum(halves**2, axis=1))
    following = np.mean(np.sum(halves[:, 1:] * halves[:, :-1], axis=1))
    # The reference's own Monte Carlo agrees with its formula within half a per cent.
    assert same == pytest.approx(variance, abs=0.006)
    assert same - following == pytest.approx(adjacent, abs=0.006)


# Section 1.5: density times gap squared at r/d = 0.1, 0.3 ... 1.9.
HALO = {
    1.0: (0.040, 0.040, 0.041, 0.042, 0.045, 0.048, 0.053, 0.061, 0.077, 0.182),
    0.0: (1.21, 0.38, 0.21, 0.14, 0.10, 0.07, 0.05, 0.04, 0.03, 0.01),
    0.3: (0.86, 0.28, 0.16, 0.11, 0.08, 0.06, 0.05, 0.045, 0.041, 0.064),
}


@pytest.mark.parametrize("elastic_share", HALO)
def test_truth_11_halo_ends_at_two_gaps_with_the_tabulated_density(elastic_share):
    """The halo's transfer turned back into a picture, 80 cells a gap, softened by one cell."""
    gap_cells, size = 80.0, 640
    fx, fy = np.broadcast_arrays(np.fft.rfftfreq(size)[None, :], np.fft.fftfreq(size)[:, None])
    halo = HaloBlur(fraction=1.0, gap_mm=gap_cells, elastic_share=elastic_share).transfer(fx, fy)
    soft = np.exp(-2.0 * np.pi**2 * (fx**2 + fy**2))
    picture = np.fft.irfft2(halo * soft, s=(size, size))
    along = np.minimum(np.arange(size), size - np.arange(size))
    distance = np.hypot(along[None, :], along[:, None]) / gap_cells
    # The softened rim belongs to the last ring.
    ring = np.digitize(distance, np.append(np.linspace(0.0, 1.8, 10), 2.06)) - 1
    density = np.array(
        [picture[ring == n].sum() / np.pi / ((n + 1) ** 2 - n**2) / 0.04 for n in range(10)]
    )
    assert density == pytest.approx(HALO[elastic_share], rel=0.05, abs=0.007)
    assert abs(picture[distance > 2.06].sum()) < 2e-3
    if elastic_share > 0.0:
        assert density[9] > density[8]


def test_truth_11_halo_of_the_camera_is_four_gaps_wide(sheet):
    camera = CameraModel(sheet)
    diameter_mm = true_quantities.true_quantities(sheet)["halo_diameter"] * camera.cells.pitch_x_mm
    assert diameter_mm == pytest.approx(0.84)
    assert true_quantities.true_quantities(sheet)["halo_diameter"] == pytest.approx(47.0, abs=0.5)


# Section 2.1: bloom diameter, pixels of 18 um at the cathode, at overloads 10 ... 1e6; core alone
# and with its halo.
CORE = (5.1, 7.3, 8.9, 10.3, 11.5, 12.6)
WITH_HALO = (5.1, 7.3, 9.0, 40.9, 51.8, 57.3)


def _diameters(fraction: float) -> np.ndarray:
    """Diameters above clip of a Gaussian core of 1.2 px with so many times clip at its peak, and a
    halo of 23.6 px.
    """
    size, per_px, sigma_px = 720, 6, 1.2
    fx, fy = np.broadcast_arrays(
        np.fft.rfftfreq(size, 1 / per_px)[None, :], np.fft.fftfreq(size, 1 / per_px)[:, None]
    )
    halo = HaloBlur(fraction=fraction, gap_mm=23.6 / 2.0, elastic_share=1.0).transfer(fx, fy)
    core = np.exp(-2.0 * (np.pi * sigma_px) ** 2 * (fx**2 + fy**2))
    picture = np.fft.irfft2(halo * core, s=(size, size)) * (2.0 * np.pi * sigma_px**2) * per_px**2
    return np.array(
        [
            2.0 * np.sqrt((overload * picture > 1.0).sum() / per_px**2 / np.pi)
            for overload in 10.0 ** np.arange(1, 7)
        ]
    )


def test_truth_12_bloom_steps_to_the_halo_and_stays_while_a_core_grows_on():
    core, with_halo = _diameters(0.0), _diameters(0.02)
    assert core == pytest.approx(CORE, abs=0.06)
    assert with_halo[:3] == pytest.approx(WITH_HALO[:3], abs=0.2)
    # The table's wing is its own, and at 1e4 only the rim is above clip: the step and the plateau
    # are what it says.
    assert with_halo[3] > 2.5 * core[3]
    assert with_halo[4:] == pytest.approx(WITH_HALO[4:], rel=0.16)
    assert with_halo[5] / with_halo[4] < 1.1


# Section 1.4: control word and luminous gain of a published camera.
KNOB = {0: 2512, 51: 5012, 102: 9772, 153: 19055, 204: 36728, 255: 70795}


@pytest.mark.parametrize("word", KNOB)
def test_truth_18_control_word_gives_the_published_gain(word, sheet):
    """Log-linear, a factor 1.95 per 51 counts, through the published gain of word 0."""
    gain = float(sheet.tube.luminous_gain) * tube_photometry.gain_factor(sheet, None, float(word))
    assert gain == pytest.approx(2512.0 * 1.95 ** (word / 51.0), rel=1e-3)
    # The table is not quite log-linear.
    assert gain == pytest.approx(KNOB[word], rel=0.025)


def test_truth_18_control_word_reaches_the_plate(sheet):
    from labdata import Conditions

    camera = CameraModel(sheet)

    def gain(word: float) -> float:
        (plate,) = (
            s
            for s in camera.chain(Conditions(gain_control=word)).stages
            if s.name == "microchannel plate"
        )
        assert isinstance(plate, MicrochannelPlate)
        return plate.gain

    assert gain(255.0) / gain(204.0) == pytest.approx(1.95, rel=1e-6)


def test_truth_19_p20_leaves_48_28_17_11_7_hundredths_to_the_fields_after(sheet):
    from labdata import Conditions

    found = CameraModel(sheet).stage(Slot.DECAY, Conditions()).residuals(5)
    assert found == pytest.approx([0.48, 0.28, 0.17, 0.11, 0.07], abs=0.006)


@dataclass(frozen=True)
class _AnalogVideo:
    """The reference's video filter: a Butterworth low pass of third order, its frequencies not
    folded by sampling.
    """

    bandwidth_cy_per_px: float

    def transfer(self, frequency_cy_per_px):
        return (1.0 + (frequency_cy_per_px / self.bandwidth_cy_per_px) ** 6) ** -0.5


def _row_pairs(sheet, video) -> tuple[float, float]:
    """Correlation of row pairs with the next in the line, and with those that share one of their
    two rows.
    """
    camera = CameraModel(sheet)
    x, y = ((np.arange(n) + 0.5) / n * 4.0 for n in (400, 300))
    pitch_x, pitch_y = camera.cells.pitch_x_mm, 2.0 * camera.cells.pitch_y_mm
    power = (
        product(
            true_quantities._after_gain(camera),
            *np.broadcast_arrays(x[None, :] / pitch_x, y[:, None] / pitch_y),
        )
        ** 2
    )
    power = power * np.abs(video.transfer(x)) ** 2
    beside, shared = np.cos(2.0 * np.pi * x)[None, :], np.cos(np.pi * y)[:, None]
    return float(np.sum(power * beside) / power.sum()), float(np.sum(power * shared) / power.sum())


def test_truth_20_p20_correlates_lines_by_23_hundredths_and_pixels_2_1_times_as_much(sheet):
    """Field correlation 0.36 times row-pair overlap 0.64; the pixels' own correlation under the
    reference's filter.
    """
    field = true_quantities.true_quantities(sheet)["field_correlation"]
    assert field == pytest.approx(0.36, abs=5e-3)
    video = sheet.video
    analog = _AnalogVideo(float(video.bandwidth_mhz) / float(video.pixel_clock_mhz))
    beside, overlap = _row_pairs(sheet, analog)
    assert overlap == pytest.approx(0.64, abs=0.012)
    assert field * overlap == pytest.approx(0.23, abs=5e-3)
    assert beside / (field * overlap) == pytest.approx(2.1, rel=0.05)


def test_truth_20_the_staircase_of_the_pixel_clock_adds_to_the_correlation_along_lines(sheet):
    """Pixels are held for a clock before the filter: along lines the chain's noise is smoother than
    the reference's.
    """
    camera = CameraModel(sheet)
    beside, overlap = _row_pairs(sheet, camera.stage(Slot.VIDEO).low_pass)
    assert beside == pytest.approx(
        true_quantities.true_quantities(sheet)["correlation_horizontal"], abs=2e-3
    )
    ratio = beside / (true_quantities.true_quantities(sheet)["field_correlation"] * overlap)
    assert 2.1 * 1.05 < ratio < 3.0


def test_truth_20_without_decay_fields_share_nothing(sheet):
    lagless = sheet.with_values({"phosphor.fast_decay_ms": 1e-6, "phosphor.slow_decay_ms": 1e-6})
    assert true_quantities.true_quantities(lagless)["field_correlation"] == pytest.approx(
        0.0, abs=1e-6
    )
