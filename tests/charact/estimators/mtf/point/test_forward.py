"""Laws of a point source: what its picture tells of the MTF, and what it must not be taken for."""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import point_forward, point_spread
from charact.method import Context
from labdata import FrameStack, load_sensor
from tests.truth.blur import TrueBlur
from tests.truth.counted_pulses import errors
from tests.truth.photon_spots import Spot
from tests.truth.point import PointScene

BACKGROUND_DN, READ_DN, GAIN_DN = 20.0, 2.0, 0.3


def taken(mean, rng, frames=6):
    """Draw frames of light (row, col), DN, in noise that grows with it."""
    noise = rng.standard_normal((frames, *mean.shape)) * np.sqrt(
        READ_DN**2 + GAIN_DN * np.maximum(mean, 0.0)
    )
    return FrameStack(data=BACKGROUND_DN + mean + noise)


def lit(light_dn, **spot):
    """Pixels of a Gaussian spot of so much light, DN."""
    return light_dn * Spot(**spot).picture(64, 64)


QUICK = Context(quick=True)


def level(result, angle=0.0):
    (found,) = result.find("mtf50", orientation_deg=angle)
    return found


@pytest.mark.parametrize(("width", "stretch"), [(0.65, -0.15), (1.3, 0.15)])
def test_mtf_of_a_gaussian_spot_is_that_of_its_width_in_each_direction(seed, width, stretch):
    rng = np.random.default_rng(seed)
    place = {"row_px": rng.uniform(-0.5, 0.5), "col_px": rng.uniform(-0.5, 0.5)}
    spot = Spot(width=width, stretch=stretch, **place)
    result = point_forward(taken(4000.0 * spot.picture(64, 64), rng), context=QUICK)
    for angle in (0.0, 90.0):
        found, truth = level(result, angle), spot.level(0.5, vertical=angle > 0)
        assert found.status == "ok"
        assert abs(errors(found, truth)) < 4.5
        assert found.value == pytest.approx(truth, rel=0.04)


def test_transfer_of_a_known_pinhole_is_divided_out(seed):
    stack = taken(lit(8000.0, width=0.8, pinhole_px=2.5), np.random.default_rng(seed))
    known = level(point_forward(stack, pinhole_px=2.5, context=QUICK))
    unknown = level(point_forward(stack, context=QUICK))
    assert abs(errors(known, TrueBlur(sigma_px=0.8).mtf50(0.0))) < 4.5
    both = TrueBlur(sigma_px=0.8, halo_share=1.0, halo_px=2.5)
    assert unknown.value == pytest.approx(both.mtf50(0.0), rel=0.05)
    assert unknown.value < known.value


@pytest.mark.parametrize("separation_px", [(0.0, 4.0), (24.0, 22.0)])
def test_a_second_source_makes_the_fit_suspect_or_is_masked(seed, separation_px):
    rng = np.random.default_rng(seed)
    down, along = separation_px
    first = {"row_px": -11.5, "col_px": -11.5, "width": 0.9}
    second = {"row_px": down - 11.5, "col_px": along - 11.5, "width": 0.9}
    two = lit(4000.0, **first) + lit(3000.0, **second)
    found = level(point_forward(taken(two, rng), context=QUICK))
    if down == 0.0:
        assert found.status != "ok"
    else:
        assert any("neighbours of the source are masked" in note for note in found.notes)
        assert abs(errors(found, TrueBlur(sigma_px=0.9).mtf50(0.0))) < 4.5


@pytest.mark.parametrize(
    ("frames", "grain"), [(1, "white"), (8, "correlated"), (1, "flashes"), (8, "flashes")]
)
@pytest.mark.parametrize("method", [point_forward, point_spread])
def test_frames_of_noise_hold_no_point(seed, frames, grain, method):
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng([seed, frames])
    white = rng.normal(60.0, 8.0, (frames, 96, 96))
    data = {
        "white": white,
        "correlated": gaussian_filter(white, (0, 1.2, 1.2)),
        "flashes": 12 + 9 * rng.poisson(0.05, white.shape).astype(np.uint8),
    }[grain]
    for context in (
        QUICK,
        Context(quick=True, camera=load_sensor("pulnix-ag5745ef3"), interlaced=True),
    ):
        result = method(FrameStack(data=data), context=context)
        assert result.measurements
        # A single frame's flash cannot be told from a source by its coming and going; it is never
        # trusted.
        assert {m.status for m in result.measurements} <= (
            {"refused"} if frames > 2 else {"refused", "suspect"}
        )


def test_a_core_beyond_full_scale_has_lower_limits_and_no_transform(seed):
    rng = np.random.default_rng(seed)
    bright = lit(20000.0, width=1.2, row_px=0.5, col_px=0.5)
    clipped = np.minimum(taken(bright, rng).data, 255.0)
    stack = FrameStack(data=clipped, full_scale_dn=255.0)
    found = level(point_forward(stack, context=QUICK), 0.0)
    assert (
        any("at full scale are treated as lower limits" in note for note in found.notes)
        or found.status != "ok"
    )
    assert found.status != "ok" or abs(errors(found, TrueBlur(sigma_px=1.2).mtf50(0.0))) < 4.5
    assert {m.status for m in point_spread(stack, context=QUICK).measurements} == {"refused"}


def test_plain_transform_agrees_with_the_forward_fit_where_nothing_deceives_it(seed):
    rng = np.random.default_rng(seed)
    stack = taken(lit(8000.0, width=1.2, row_px=0.7, col_px=0.4), rng, frames=12)
    plain, forward = (level(m(stack, context=QUICK), 0.0) for m in (point_spread, point_forward))
    assert plain.status == "ok"
    # errors of 12 frames are themselves uncertain
    assert abs(errors(plain, TrueBlur(sigma_px=1.2).mtf50(0.0))) < 6.0
    assert plain.value == pytest.approx(forward.value, rel=0.05)


@pytest.mark.parametrize("method", [point_forward, point_spread])
@pytest.mark.parametrize("knob", [{"motion_px": 1.0}, {"drift_px": 2.0}])
def test_what_moved_is_told(method, knob, seed):
    rng = np.random.default_rng(seed)
    told = {"motion_px": "interlace-motion", "drift_px": "drift"}
    still, moved = (
        method(PointScene(**k).frames_drawn(rng), context=QUICK).measurements[0] for k in ({}, knob)
    )
    name = f"{told[next(iter(knob))]}: "
    assert any(note.startswith(name) for note in moved.notes)
    assert not any(note.startswith(name) for note in still.notes)
    # What is ok says how much the motion may cost.
    assert moved.status != "ok" or moved.interval95[0] < PointScene().truth_mtf50
    assert moved.status != "ok" or PointScene().truth_mtf50 < moved.interval95[1]


def test_a_tube_with_a_narrow_pulse_is_fitted_with_both(seed):
    """One form alone is 4 % off for exp(-(f/fc)^1.184) and a Gaussian behind the gain, six of its
    standard errors.
    """
    away = []
    for trial in range(2):
        rng = np.random.default_rng([seed, trial])
        blur = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.35)))
        scene = PointScene(blur=blur, pulse_px=0.6, col_px=rng.uniform(-0.5, 0.5))
        found = level(point_forward(scene.frames_drawn(rng), context=QUICK))
        away.append(errors(found, scene.truth_mtf50))
    assert np.abs(away).max() < 4.5
    assert abs(np.mean(away)) < 4.5 / np.sqrt(2)


def test_the_plain_transform_counts_tails_that_its_disc_cuts_off(seed):
    blur = TrueBlur(form="exponential", frequency_cy_per_px=0.1)
    scene = PointScene(blur=blur)
    found = level(point_spread(scene.frames_drawn(np.random.default_rng(seed)), context=QUICK))
    low, high = found.interval95
    assert found.status == "ok" and low < scene.truth_mtf50 < high
    assert high - low < 0.2 * scene.truth_mtf50


def test_a_pinhole_that_passes_nothing_at_the_crossing_is_refused(seed):
    scene = PointScene(blur=TrueBlur(sigma_px=0.5), pulse_px=0.3, pinhole_px=5.0)
    found = point_spread(
        scene.frames_drawn(np.random.default_rng(seed)), pinhole_px=5.0, context=QUICK
    )
    assert found.measurements[0].status != "ok"


def test_light_missing_about_a_spot_is_told_as_light_too_much_is(seed):
    """A camera that sharpens takes off what a halo adds: of 21 such spots 9 were silently wrong."""
    scene = PointScene(blur=TrueBlur(sigma_px=0.8), photoelectrons=10000.0, black_dn=40.0)
    plain, sharp = (
        point_forward(
            replace(scene, sharpening=amount).frames_drawn(np.random.default_rng(seed)),
            context=QUICK,
        )
        for amount in (0.0, 0.4)
    )
    assert "model-misfit" in sharp.measurements[0].flags
    assert "model-misfit" not in plain.measurements[0].flags


def test_a_spot_of_many_codes_in_two_frames_is_measured(seed):
    # Its model rings below no light, which is no variance.
    scene = PointScene(
        blur=TrueBlur(sigma_px=0.68),
        photoelectrons=1300.0,
        peak_dn=2200.0,
        frames=2,
        read_dn=2.2,
        black_dn=190.0,
        full_scale_dn=4095.0,
    )
    for one in range(2):
        stack = scene.frames_drawn(np.random.default_rng([seed, one]))
        found = level(point_forward(stack, context=QUICK), 0.0)
        low, high = found.interval95
        assert found.value == pytest.approx(scene.truth_mtf50, rel=0.25)
        assert found.status == "suspect" or abs(found.value - scene.truth_mtf50) < high - low
