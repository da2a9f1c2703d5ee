"""From the wells to codes: overflow and smear, read-out noise, video and digitiser."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdata import BadInput, Camera, Conditions, Target, load_camera
from labdata.camera import Readout, gain_at_no_signal
from simulate import LabBench
from simulate.camera import (
    Ccd,
    NoFilter,
    StageImage,
    Video,
    VideoFilter,
    apply_column_blooming,
    filter_lines,
    readout_noise,
    shift_lines,
    spread_excess_charge,
    video,
)

# Charge in the CCD: conserved in overflow, held at the full well, smeared along columns only.


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.floats(0.0, 40.0), min_size=3, max_size=60),
    st.floats(1.0, 5.0),
)
def test_charge_and_drained_charge_are_all_that_came_in(column, ratio):
    charge = np.array(column)[:, None]
    held, drained = apply_column_blooming(charge, 1.0, ratio)
    assert held.sum() + drained == pytest.approx(charge.sum(), rel=1e-9)
    assert held.max() <= 1.0 + 1e-9
    assert held.min() >= 0.0 and drained >= -1e-9


def test_spill_without_drain_fills_a_column_symmetrically_and_keeps_its_charge():
    column = np.zeros(101)
    column[50] = 21.0
    settled = spread_excess_charge(column, 1.0)
    assert settled.sum() == pytest.approx(21.0, rel=1e-9)
    assert np.allclose(settled, settled[::-1], atol=1e-6)
    assert np.allclose(settled[40:61], 1.0, atol=1e-6)
    assert np.allclose(settled[:39], 0.0, atol=1e-6)


def test_spill_keeps_the_centre_of_charge_until_it_meets_an_end():
    column = np.full(200, 0.2)
    column[90:95] = [3.0, 8.0, 1.0, 12.0, 5.0]
    settled = spread_excess_charge(column, 1.0)
    place = np.arange(200)
    assert settled.sum() == pytest.approx(column.sum(), rel=1e-9)
    assert (settled * place).sum() == pytest.approx((column * place).sum(), rel=1e-6)
    assert settled.max() <= 1.0 + 1e-6


def test_streak_grows_with_overload_beyond_the_drain():
    def rows(overload: float) -> int:
        field = np.zeros((101, 3))
        field[50, 1] = overload
        held, _ = apply_column_blooming(field, 1.0, 10.0)
        assert not held[:, [0, 2]].any()
        return int((held[:, 1] > 0.5).sum())

    assert rows(5.0) == 1
    assert rows(10.0) == 1
    assert 1 < rows(100.0) < rows(300.0)


def test_fields_overflow_each_on_their_own():
    ccd = Ccd(quantum_efficiency=1.0, full_well_e=1.0, antibloom_ratio=1.0, interlaced=True)
    frame = np.zeros((21, 3), np.float32)
    frame[10, 1] = 5.0
    held = ccd.mean(StageImage(values=frame[None])).values[0]
    assert np.flatnonzero(held[:, 1] > 0.5).tolist() == [6, 8, 10, 12, 14]
    assert held.sum() == pytest.approx(5.0, rel=1e-6)


def test_smear_of_a_spot_a_tenth_of_the_picture_high_is_its_fraction():
    ccd = Ccd(quantum_efficiency=1.0, full_well_e=1e9, smear_fraction=1e-3)
    frame = np.zeros((100, 5), np.float32)
    frame[40:50, 2] = 1000.0
    seen = ccd.mean(StageImage(values=frame)).values
    assert seen[0, 2] == pytest.approx(1.0, rel=1e-5)
    assert seen[99, 2] == pytest.approx(1.0, rel=1e-5)
    assert not seen[:, [0, 1, 3, 4]].any()


# Read-out of a digital camera: noise of rows, of neighbours along a row, interference, bent
# response, late shutter.


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


# Video and back end: aperture correction boosts at 4.5 MHz, lines jitter and jump, digital pixels
# stay apart.


CLOCK_MHZ = 14.318


def _filter(boost_db: float = 0.0, bandwidth_mhz: float = 6.5) -> VideoFilter:
    return VideoFilter(
        bandwidth_mhz=bandwidth_mhz,
        pixel_clock_mhz=CLOCK_MHZ,
        order=3,
        aperture_correction_db=boost_db,
    )


def _video(**changes) -> Video:
    given = {
        "low_pass": _filter(),
        "conversion_gain_dn_per_e": 1.0,
        "black_level_dn": 1000.0,
        "gamma": 1.0,
    }
    return Video(**given | {"bit_depth": 16} | changes)


@pytest.mark.parametrize("boost_db", [2.0, 6.0])
def test_aperture_correction_boosts_by_its_decibels_at_4_5_megahertz(boost_db):
    at = np.array([0.0, video.CORRECTED_MHZ / CLOCK_MHZ])
    ratio = np.abs(_filter(boost_db).transfer(at) / _filter().transfer(at))
    assert ratio == pytest.approx([1.0, 10 ** (boost_db / 20)], rel=1e-9)


def test_corrected_mtf_may_exceed_one_and_the_line_keeps_its_level():
    corrected = _filter(6.0, bandwidth_mhz=10.0)
    assert np.abs(corrected.transfer(np.linspace(0.0, 0.5, 100))).max() > 1.3
    assert corrected.impulse_response().sum() == pytest.approx(1.0)
    assert filter_lines(np.full((2, 60), 7.0), corrected.impulse_response()) == pytest.approx(
        7.0, rel=1e-6
    )


def test_a_shifted_line_is_late_by_its_part_of_a_pixel():
    col = np.arange(200)
    line = np.sin(2.0 * np.pi * 0.08 * col)[None, :].astype(np.float32)
    for late in (-0.2, 0.05, 0.3):
        exact = np.sin(2.0 * np.pi * 0.08 * (col - late))
        found = shift_lines(line, np.array([[late]], np.float32))[0]
        assert found[5:-5] == pytest.approx(exact[5:-5], abs=0.012)


def test_jitter_moves_whole_lines_by_its_standard_deviation(seed):
    ramp = np.tile(100.0 * np.arange(300, dtype=np.float32), (2000, 1))
    frame = (
        _video(sync_jitter_px=0.05, bit_depth=16)
        .draw(StageImage(values=ramp), np.random.default_rng(seed))
        .values
    )
    steady = _video().mean(StageImage(values=ramp)).values
    late = -(frame - steady)[:, 50:250].mean(axis=1) / 100.0
    assert late.std(ddof=1) == pytest.approx(0.05, rel=4.5 / np.sqrt(2 * 2000))
    within = ((frame - steady)[:, 50:250] + 100.0 * late[:, None]).std()
    assert within < 0.5


def test_line_noise_is_common_to_a_line_and_new_on_the_next(seed):
    flat = StageImage(values=np.full((3000, 40), 500.0, np.float32))
    frame = _video(line_noise_dn=3.0).draw(flat, np.random.default_rng(seed)).values.astype(float)
    assert np.ptp(frame, axis=1).max() == 0.0
    offset = frame[:, 0] - 1500.0
    assert offset.std(ddof=1) == pytest.approx(3.0, rel=4.5 / np.sqrt(2 * 3000))
    assert abs(np.corrcoef(offset[1:], offset[:-1])[0, 1]) < 4.5 / np.sqrt(3000)


def test_gain_of_the_video_multiplies_signal_and_noise_alike(seed):
    rng = np.random.default_rng(seed)
    light = StageImage(values=(500.0 + 20.0 * rng.standard_normal((100, 200))).astype(np.float32))
    once, twice = (_video(gain=g).mean(light).values - 1000.0 for g in (1.0, 2.0))
    assert twice == pytest.approx(2.0 * once, rel=1e-5)


def test_digital_back_end_leaves_neighbours_alone():
    spot = np.zeros((5, 9), np.float32)
    spot[2, 4] = 100.0
    digital = Video(conversion_gain_dn_per_e=0.5, black_level_dn=200.0, bit_depth=12)
    expected = np.full((5, 9), 200)
    expected[2, 4] = 250
    drawn = digital.draw(StageImage(values=spot), np.random.default_rng(0)).values
    assert np.array_equal(drawn, expected)
    assert drawn.dtype == np.uint16
    assert NoFilter().impulse_response() == pytest.approx([1.0])
    assert np.abs(NoFilter().transfer(np.array([0.0, 0.3]))) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("bits", [1, 8, 10, 16])
def test_codes_end_at_full_scale(bits):
    digital = Video(conversion_gain_dn_per_e=1.0, black_level_dn=0.0, bit_depth=bits)
    ends = StageImage(values=np.array([[-50.0, 1e9]], np.float32))
    assert digital.draw(ends, np.random.default_rng(0)).values.tolist() == [[0, 2**bits - 1]]


def test_gamma_bends_the_signal_above_black_alone():
    digital = Video(conversion_gain_dn_per_e=1.0, black_level_dn=55.0, bit_depth=8, gamma=0.5)
    level = digital.mean(StageImage(values=np.array([[0.0, 50.0, 200.0]], np.float32))).values
    assert level[0] == pytest.approx([55.0, 155.0, 255.0])


DIGITAL = {"conversion_gain_dn_per_e": 1.0, "black_level_dn": 0.0, "bit_depth": 8}


@pytest.mark.parametrize(
    ("make", "change"),
    [
        (_video, {"sync_jitter_px": 0.6}),
        (_video, {"sync_jitter_px": -0.1}),
        (_video, {"line_noise_dn": -1.0}),
        (Video, DIGITAL | {"bit_depth": 0}),
        (Video, DIGITAL | {"bit_depth": 17}),
        (Video, DIGITAL | {"gamma": 0.0}),
    ],
)
def test_impossible_video_is_refused(make, change):
    with pytest.raises(BadInput):
        make(**change)
