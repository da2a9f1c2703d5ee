"""Two ways to one extent, the frame's contour and the fitted light, brought together."""

import pytest

from charact.bloom.series.extent_comparison import _combine_diameters, _differ
from labdata.measurement import Provenance, measurement_from_sd

READ_PX, FITTED_PX = 40.0, 40.6


def extent(sd_px):
    provenance = Provenance(version="0")
    return measurement_from_sd("bloom_diameter", "px", READ_PX, sd_px, method="any", provenance=provenance)


@pytest.mark.parametrize("sd_px", [1e-6, 0.1, 1.0])
def test_whichever_of_two_readings_is_right_the_interval_of_their_mean_holds_it(sd_px):
    met = _combine_diameters(extent(sd_px), FITTED_PX, alone=False, frames=8)
    assert met.value == pytest.approx((READ_PX + FITTED_PX) / 2)
    low, high = met.interval95
    assert low < READ_PX < FITTED_PX < high


def test_readings_that_agree_are_surer_together_than_one_alone():
    low, high = _combine_diameters(extent(0.03), READ_PX + 0.01, alone=False, frames=8).interval95
    alone_low, alone_high = extent(0.03).interval95
    assert high - low < 0.8 * (alone_high - alone_low)


def test_where_light_falls_slowly_both_err_alike_and_their_mean_is_hardly_surer():
    shares = [
        _combine_diameters(extent(sd_px), READ_PX, alone=False, frames=8).interval95[1] - READ_PX
        for sd_px in (0.03, 0.3)
    ]
    assert shares[1] > 12.0 * shares[0]


def test_few_frames_tell_their_own_noise_badly():
    few, many = (
        _combine_diameters(extent(0.03), READ_PX, alone=False, frames=frames).interval95[1] for frames in (4, 16)
    )
    assert 1.3 < (few - READ_PX) / (many - READ_PX) < 1.6


def test_differences_over_the_levels_are_judged_together():
    assert not _differ([1.5, -2.0, 2.2, 0.3, -1.0])
    assert _differ([3.0, -2.5, 2.8, 0.3, -2.0])
    assert not _differ([])


def test_an_extent_that_stays_alone_keeps_its_value_and_owns_to_the_difference():
    met = _combine_diameters(extent(0.1), FITTED_PX, alone=True, frames=8)
    assert met.value == READ_PX
    assert met.interval95[1] - READ_PX == pytest.approx(1.96 * (0.1**2 + 0.24**2) ** 0.5, rel=1e-3)
