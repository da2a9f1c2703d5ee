"""Video and back end: aperture correction boosts at 4.5 MHz, lines jitter and jump, digital pixels
stay apart.
"""

import numpy as np
import pytest

from labdata import BadInput
from simulate.camera import (
    NoFilter,
    StageImage,
    Video,
    VideoFilter,
    filter_lines,
    shift_lines,
    video,
)

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


@pytest.mark.parametrize(
    "change", [{"sync_jitter_px": 0.6}, {"sync_jitter_px": -0.1}, {"line_noise_dn": -1.0}]
)
def test_impossible_video_is_refused(change):
    with pytest.raises(BadInput):
        _video(**change)


@pytest.mark.parametrize("change", [{"bit_depth": 0}, {"bit_depth": 17}, {"gamma": 0.0}])
def test_impossible_digitisers_are_refused(change):
    with pytest.raises(BadInput):
        Video(**{"conversion_gain_dn_per_e": 1.0, "black_level_dn": 0.0, "bit_depth": 8} | change)
