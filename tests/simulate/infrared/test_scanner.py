"""A scanner's frames against closed forms of its scan, its electronics and its noise."""

import numpy as np
import pytest

from labdata import BadInput, load_camera
from simulate.camera import ThermalImager
from tests.simulate.infrared.measures import (
    AMPLITUDE_MRAD,
    FIELD_MRAD,
    MIRROR_HZ,
    comb_ifov,
    contrast,
    droop,
    imager,
    lines_by_direction,
    measured_netd_k,
    row_streaks,
    slope,
    still,
)

NAME = "scanning-lwir"


def scanner(**values) -> ThermalImager:
    return imager(NAME, **{f"scanner__{key}": value for key, value in values.items()})


def narrow(**values) -> ThermalImager:
    """The scanner with few lines, for what happens along a line."""
    return scanner(lines_per_field=8, **values)


def speed(at_mrad):
    """Speed of the mirror, rad/s: amplitude 10.82 degrees, 7867 Hz."""
    return 2.0 * np.pi * MIRROR_HZ * 1e-3 * np.sqrt(AMPLITUDE_MRAD**2 - at_mrad**2)


def test_the_noise_of_black_bodies_is_the_formula_of_the_detector(seed):
    """E1543: 295 K background. The noise bandwidth of one pole is pi/2 of its 1.5 MHz."""
    noise_hz = 0.5 * np.pi * 1.5e6
    formula = (
        4.0
        * 1.2**2
        * np.sqrt(noise_hz)
        / (60e-4 * 0.6 * 4e10 * 1e-4 * np.pi * slope(8.0, 12.0, 295.0))
    )
    camera = scanner(lines_per_field=120)
    assert camera.netd_k(295.0) == pytest.approx(formula, rel=1e-3)
    assert measured_netd_k(camera, seed) == pytest.approx(formula, rel=0.03)
    assert measured_netd_k(camera.without("white noise"), seed) < 0.5 * formula


def test_lines_of_both_directions_part_by_twice_speed_times_clock_error():
    """50 ns: 0.52 IFOV at the centre; less towards the turn, where the mirror is slower."""
    late = narrow(clock_error_ns=50.0)
    assert comb_ifov(late, 0.3) == pytest.approx(0.52, abs=0.05)
    for at_mrad in (-120.0, 0.3, 160.0):
        closed = 2.0 * speed(at_mrad) * 50e-9 * 1e3 / 1.8
        assert comb_ifov(late, at_mrad) == pytest.approx(closed, abs=0.02)
        assert comb_ifov(narrow(clock_error_ns=-50.0), at_mrad) == pytest.approx(-closed, abs=0.02)
        assert abs(comb_ifov(late.without("clock error"), at_mrad)) < 0.02
    # At the edge of the field the mirror has 0.383 of its speed.
    assert speed(0.5 * FIELD_MRAD) * 2.0 * 50e-9 * 1e3 / 1.8 == pytest.approx(0.20, abs=0.005)
    assert speed(0.0) == pytest.approx(9338.0, rel=1e-3)


@pytest.mark.parametrize(
    ("coupling_hz", "percent"), [(10.0, 0.33), (100.0, 3.2), (500.0, 15.0), (1000.0, 28.0)]
)
def test_ac_coupling_droops_along_the_active_line(coupling_hz, percent):
    """An active line of 52.7 us, 0.829 of a half period."""
    camera = narrow(coupling_hz=coupling_hz, active_fraction=0.829)
    assert 100.0 * droop(camera) == pytest.approx(percent, rel=0.1)
    assert abs(droop(camera.without("AC coupling"))) < 1e-5


def test_the_undershoot_lies_behind_a_hot_body_on_both_kinds_of_line():
    """Right of it on lines to the right, left of it on the return lines."""
    camera = still(narrow(coupling_hz=1000.0)).with_span(25.0, 60.0)
    share = np.zeros((camera.shape[0], camera.shape[1]))
    share[:, 100:156] = 1.0
    frame = camera.view_target(50.0, 25.0, share, seed=0, count=1)[0].astype(float)
    base = still(camera).view_target(25.0, seed=0, count=1)[0].astype(float)
    right, left = frame[0] - base[0], frame[2] - base[2]
    assert right[170:].max() < -1.0
    assert abs(right[:90]).max() < 0.1
    assert left[:86].max() < -1.0
    assert abs(left[166:]).max() < 0.1


def test_the_electronics_blur_less_towards_the_turn():
    """A pole of 1.5 MHz at 0.2 cy/mrad: 0.626 at the centre, 0.902 at the edge."""
    camera = narrow().without("optics blur", "detector footprint")
    cells = np.sinc(0.2 * FIELD_MRAD / 256 / 4)
    assert contrast(camera, 0.2, width_px=8) / cells == pytest.approx(0.626, rel=0.01)
    found = {}
    for at_mrad in (-160.0, 100.0, 150.0, 168.0):
        found[at_mrad] = contrast(camera, 0.2, at_mrad, width_px=6) / cells
        assert found[at_mrad] == pytest.approx(
            1.0 / np.hypot(1.0, 0.2e3 * speed(at_mrad) / 1.5e6), rel=0.01
        )
    assert 1.0 / np.hypot(1.0, 0.2e3 * speed(0.5 * FIELD_MRAD) / 1.5e6) == pytest.approx(
        0.902, abs=2e-3
    )
    assert found[168.0] == pytest.approx(0.902, rel=0.04)
    assert contrast(camera.without("electronics bandwidth"), 0.2) / cells == pytest.approx(
        1.0, abs=0.005
    )


def test_return_lines_are_the_mirror_image_of_lines_to_the_right(seed):
    """Blur by the electronics lies on opposite sides, so that a line of one direction is not
    symmetric.
    """
    camera = still(narrow())
    point = np.zeros((camera.shape[0], camera.shape[1] * 4))
    point[:, 510:514] = 1.0
    point = np.repeat(point, 4, axis=0)
    frame, mirrored = (
        camera.view_target(30.0, 25.0, share, seed=seed, count=1)[0].astype(float)
        for share in (point, point[:, ::-1])
    )
    assert np.allclose(frame[0], mirrored[2, ::-1], atol=1e-2)
    assert np.abs(frame[0] - frame[2]).max() > 0.05 * np.ptp(frame[0])


@pytest.mark.parametrize(
    ("frequency", "reference"), [(0.05, 0.938), (0.1, 0.790), (0.2, 0.467), (0.25, 0.338)]
)
def test_the_transfer_of_the_whole_scanner_is_the_product_of_its_parts(frequency, reference):
    """Footprint of 1.8 mrad, blur of 0.3 mrad, pole of 1.5 MHz, at the centre."""
    camera = narrow()
    assert contrast(camera, frequency, width_px=12) == pytest.approx(reference, abs=0.004)
    for effect in ("optics blur", "detector footprint", "electronics bandwidth"):
        assert contrast(camera.without(effect), frequency, width_px=12) > reference + 0.004


# Temporal noise of rows over that of pixels: no clamp, clamps of 10 and of 40 samples. The table's
# 0.54 at 100 kHz without a clamp is left out: no noise of the density n0 (1 + f_k / f) gives it
# beside 0.15 at 10 kHz.
ROWS = [
    (0, 1e3, 0.05),
    (0, 1e4, 0.15),
    (0, 3e4, 0.28),
    (10, 0.0, 0.32),
    (10, 1e3, 0.32),
    (10, 1e4, 0.34),
    (10, 3e4, 0.38),
    (10, 1e5, 0.47),
    (40, 0.0, 0.16),
    (40, 1e3, 0.16),
    (40, 1e4, 0.19),
    (40, 3e4, 0.25),
    (40, 1e5, 0.35),
]


@pytest.mark.parametrize(("clamp_samples", "knee_hz", "reference"), ROWS)
def test_rows_streak_by_flicker_and_clamp(clamp_samples, knee_hz, reference, seed):
    """Samples so few that they are independent, as those of the table."""
    camera = scanner(clamp_samples=clamp_samples, knee_hz=knee_hz, coupling_hz=0.0, samples=64)
    camera = camera.without("quantisation")
    assert row_streaks(camera, seed, 20 if clamp_samples else 100) == pytest.approx(
        reference, rel=0.1
    )


def test_rows_do_not_streak_without_flicker_or_clamp(seed):
    camera = scanner(clamp_samples=10, knee_hz=3e4, coupling_hz=0.0, samples=64).without(
        "quantisation"
    )
    assert row_streaks(camera.without("1/f noise"), seed, 10) == pytest.approx(0.32, rel=0.05)
    assert row_streaks(camera.without("line clamp"), seed, 10) < 0.33
    assert row_streaks(camera.without("1/f noise", "line clamp"), seed, 10) < 0.03


def test_flicker_grows_along_the_sweep_from_the_clamp_before_it(seed):
    """To the right on lines scanned to the right, to the left on return lines."""
    camera = scanner(knee_hz=1e5, coupling_hz=0.0).without("quantisation", "white noise")
    frames = camera.view_target(22.0, seed=seed, count=4).astype(float)
    spread = [frames[:, lines].std(axis=(0, 1)) for lines in lines_by_direction(camera)]
    for right, left in ((spread[0], spread[2]), (spread[1], spread[3])):
        assert right[-40:].mean() > 1.1 * right[:40].mean()
        assert left[:40].mean() > 1.1 * left[-40:].mean()


def test_noise_correlates_over_a_smaller_angle_towards_the_turn(seed):
    """White noise behind a pole: exp(-2 pi f_c t), t the time between samples of equal angle."""
    camera = scanner(knee_hz=0.0, clamp_samples=0).without("quantisation")
    frames = camera.view_target(22.0, seed=seed, count=3)[:, ::4].astype(float)
    noise = frames - frames.mean((0, 1))
    alike = (noise[..., 1:] * noise[..., :-1]).mean((0, 1)) / (noise**2).mean()
    pitch_mrad = FIELD_MRAD / 256
    for part, at_mrad in ((slice(108, 148), 0.0), (slice(245, 255), 168.0)):
        closed = np.exp(-2.0 * np.pi * 1.5e6 * pitch_mrad * 1e-3 / speed(at_mrad))
        error = 1.0 / np.sqrt(360 * (part.stop - part.start))
        assert alike[part].mean() == pytest.approx(closed, abs=4.0 * error + 0.01)
    assert alike[108:148].mean() > 3.0 * alike[245:].mean()


def test_a_scan_that_is_not_linearised_errs_by_up_to_ten_footprints():
    """Equal steps of time over a sine: 1.03 degrees at worst."""
    camera = still(narrow(linearised=False, clock_error_ns=0.0))
    right = ((np.arange(256 * 4) + 0.5) / 1024 - 0.5) * FIELD_MRAD
    level = float(camera.signal_of(295.0))
    ramp = level * (1.0 + 1e-3 * right)
    (frame,) = camera.with_span(22.0, 60.0).frames_of_signal(
        np.broadcast_to(ramp, (64, 1024)), seed=0, count=1
    )
    flat, one = (
        camera.with_span(22.0, 60.0).frames_of_signal(np.full(camera.shape, value), seed=0, count=1)
        for value in (level, 1.1 * level)
    )
    per_mrad = (float(next(one).mean()) - float(next(flat).mean())) / 100.0
    seen = (frame[0] - frame[0, 127:129].mean()) / per_mrad
    nominal = ((np.arange(256) + 0.5) / 256 - 0.5) * FIELD_MRAD
    assert np.rad2deg(np.abs(seen - nominal)[5:-5].max() * 1e-3) == pytest.approx(1.03, rel=0.03)


def test_narcissus_makes_the_axis_colder_than_the_corners_along_a_parabola():
    """0.4 K at the axis, half of it at 0.707 of the way to a corner, none in the corners; off as
    shipped.
    """
    camera = still(scanner(lines_per_field=64, coupling_hz=0.0)).with_span(22.0, 20.0)
    with_it = still(
        ThermalImager(camera.description.with_values({"scanner.narcissus_k": 0.4}))
    ).with_span(22.0, 20.0)
    plain, seen = (
        one.view_target(26.85, seed=0, count=1)[0].astype(float) for one in (camera, with_it)
    )
    per_k = (
        camera.signal_slope(300.0)
        / np.diff([float(camera.signal_of(273.15 + c)) for c in (12.0, 32.0)])[0]
        * 256.0
    )
    kelvin = (seen - plain) / per_k
    rows, columns = np.array(kelvin.shape) / 2.0
    assert kelvin[int(rows), int(columns)] == pytest.approx(-0.4, abs=2e-3)
    assert kelvin[[0, 0, -1, -1], [0, -1, 0, -1]] == pytest.approx(np.zeros(4), abs=0.015)
    half = int(rows * (1.0 + np.sqrt(0.5))), int(columns * (1.0 + np.sqrt(0.5)))
    assert kelvin[half] == pytest.approx(-0.2, abs=0.01)
    assert np.array_equal(
        with_it.without("narcissus").view_target(26.85, seed=0, count=1)[0], plain
    )
    assert float(load_camera(NAME).scanner.narcissus_k) == 0.0


def test_frames_averaged_in_the_imager_have_the_noise_of_a_mean_and_come_more_slowly(seed):
    """Of 16 frames a quarter of the noise, rows included; a step within a block is a part of it."""
    single, mean = scanner(lines_per_field=24), scanner(lines_per_field=24, averaged_frames=16)
    wide = mean.without("quantisation")
    assert wide.netd_k() == pytest.approx(0.25 * single.netd_k())
    netd_k, of_mean_k, of_single_k = (
        measured_netd_k(one, seed) for one in (single, wide, wide.without("frame averaging"))
    )
    # Six frames of 48 lines of 256 samples, of which neighbours correlate: 1 % of each.
    assert of_mean_k == pytest.approx(0.25 * netd_k, rel=0.05)
    assert of_single_k == pytest.approx(netd_k, rel=0.05)
    assert (
        mean.frame_s == pytest.approx(16.0 * single.frame_s) == 1.0 / mean.description.frame_rate_hz
    )
    assert mean.without("frame averaging").frame_s == pytest.approx(single.frame_s)
    step = np.full((8, *narrow().shape), float(single.signal_of(295.0)))
    step[3:] = float(single.signal_of(299.0))
    camera = still(narrow(averaged_frames=4, coupling_hz=0.0)).with_span(22.0, 20.0)
    first, second = (frame.mean() for frame in camera.frames_of_signal(step, seed=0))
    low, high = (frame.mean() for frame in camera.frames_of_signal(step[[0] * 4 + [3] * 4], seed=0))
    assert (first, second) == pytest.approx((low + 0.25 * (high - low), high))
    with pytest.raises(BadInput, match="a multiple of the 4 frames averaged, got 7"):
        next(camera.frames_of_signal(step[:7], seed=0))
