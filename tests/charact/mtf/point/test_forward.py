"""Laws of a point source: what its picture tells of the MTF, and what it must not be taken for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.optimize import brentq
from scipy.special import erf, j1

from charact.method import Context
from charact.mtf.point import forward
from charact.mtf.point.forward import point_forward
from charact.mtf.point.forward_model import KnownPointOptics, PointModel, priors_of
from charact.mtf.point.source_window import window_of
from charact.mtf.point.spot_transform import point_spread
from charact.posterior import sampling
from charact.study.edge.scene import TrueBlur
from charact.study.point.cases import chart_cases
from charact.study.point.scene import PointScene
from charact.video_filter import VideoFilter
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.sensors import load_sensor

SHAPE = (64, 64)
BACKGROUND_DN, READ_DN, GAIN_DN = 20.0, 2.0, 0.3


def _along(places, centre, sigma):
    return np.diff(0.5 * (1.0 + erf((np.arange(places + 1) - 0.5 - centre) / (sigma * np.sqrt(2.0)))))


def gaussian_spot(row, col, light_dn, sigma_row, sigma_col):
    """Pixels that integrate a Gaussian spot: MTF exp(-2 (pi s f)^2) sinc(f) in closed form."""
    return light_dn * np.outer(_along(SHAPE[0], row, sigma_row), _along(SHAPE[1], col, sigma_col))


def taken(mean, rng, frames=6):
    noise = rng.standard_normal((frames, *mean.shape)) * np.sqrt(READ_DN**2 + GAIN_DN * mean)
    return FrameStack(data=BACKGROUND_DN + mean + noise)


def half_frequency(sigma, diameter_px=0.0):
    def mtf(f):
        u = np.pi * diameter_px * f
        return np.exp(-2 * (np.pi * sigma * f) ** 2) * np.sinc(f) * (2 * j1(u) / u if diameter_px else 1.0)

    return brentq(lambda f: mtf(f) - 0.5, 0.01, 0.9)


def standard_errors(measurement, truth):
    return (measurement.value - truth) / ((measurement.interval95[1] - measurement.interval95[0]) / 3.92)


def level(result, quantity, angle):
    (found,) = result.find(quantity, orientation_deg=angle)
    return found


QUICK = Context(quick=True)


@pytest.mark.parametrize("sigmas", [(0.6, 0.7), (1.4, 1.2)])
def test_mtf_of_a_gaussian_spot_is_that_of_its_width_in_each_direction(seed, sigmas):
    rng = np.random.default_rng(seed)
    spot = gaussian_spot(31.8 + rng.uniform(), 31.2 + rng.uniform(), 4000.0, *sigmas)
    result = point_forward(taken(spot, rng), context=QUICK)
    for angle, sigma in ((0.0, sigmas[1]), (90.0, sigmas[0])):
        found = level(result, "mtf50", angle)
        assert found.status == "ok"
        assert abs(standard_errors(found, half_frequency(sigma))) < 4.5
        assert found.value == pytest.approx(half_frequency(sigma), rel=0.04)


def test_intervals_of_a_gaussian_spot_hold_the_truth_as_often_as_they_say(seed):
    rng = np.random.default_rng(seed)
    inside = 0
    for _ in range(12):
        sigma = rng.uniform(0.6, 1.8)
        spot = gaussian_spot(32 + rng.uniform(-0.5, 0.5), 32 + rng.uniform(-0.5, 0.5), 3000.0, sigma, sigma)
        found = level(point_forward(taken(spot, rng), context=QUICK), "mtf50", 0.0)
        inside += found.interval95[0] <= half_frequency(sigma) <= found.interval95[1]
    assert inside >= 8  # 12 at 95 %: fewer than 8 once in a million


def test_transfer_of_a_known_pinhole_is_divided_out(seed):
    rng = np.random.default_rng(seed)
    diameter, sigma = 2.5, 0.8
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    rings = diameter / 2 * np.sqrt((np.arange(12) + 0.5) / 12)
    places = [(r * np.sin(a), r * np.cos(a)) for r in rings for a in angles]
    spot = np.mean([gaussian_spot(32 + y, 32 + x, 8000.0, sigma, sigma) for y, x in places], axis=0)
    stack = taken(spot, rng)
    known = level(point_forward(stack, pinhole_px=diameter, context=QUICK), "mtf50", 0.0)
    unknown = level(point_forward(stack, context=QUICK), "mtf50", 0.0)
    assert abs(standard_errors(known, half_frequency(sigma))) < 4.5
    assert unknown.value == pytest.approx(half_frequency(sigma, diameter), rel=0.05)
    assert unknown.value < known.value


@pytest.mark.parametrize("frames", [1, 2, 8])
@pytest.mark.parametrize("grain", ["white", "correlated", "flashes"])
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
    for context in (QUICK, Context(quick=True, sensor=load_sensor("pulnix-ag5745ef3"), interlaced=True)):
        result = method(FrameStack(data=data), context=context)
        assert result.measurements
        # A single frame's flash cannot be told from a source by its coming and going; it is never trusted.
        assert {m.status for m in result.measurements} <= ({"refused"} if frames > 2 else {"refused", "suspect"})


def test_a_flash_in_one_frame_is_no_point_source(seed):
    rng = np.random.default_rng(seed)
    stack = taken(np.zeros(SHAPE), rng, frames=8)
    data = stack.data.copy()
    data[3] += gaussian_spot(30, 30, 3000.0, 0.8, 0.8)
    result = point_forward(FrameStack(data=data), context=QUICK)
    assert {m.status for m in result.measurements} == {"refused"}


def test_two_sources_are_told_from_one(seed):
    rng = np.random.default_rng(seed)
    two = gaussian_spot(20, 20, 4000.0, 0.9, 0.9) + gaussian_spot(44, 42, 3000.0, 0.9, 0.9)
    result = point_forward(taken(two, rng), context=QUICK)
    assert all("several-targets" in m.flags for m in result.measurements)


def test_two_sources_too_near_to_be_told_apart_do_not_fit_one(seed):
    rng = np.random.default_rng(seed)
    two = gaussian_spot(32, 30, 4000.0, 0.8, 0.8) + gaussian_spot(32, 34, 3000.0, 0.8, 0.8)
    result = point_forward(taken(two, rng), context=QUICK)
    assert all(m.status != "ok" for m in result.measurements)


def test_a_core_beyond_full_scale_is_suspect_or_refused(seed):
    rng = np.random.default_rng(seed)
    spot = gaussian_spot(32, 32, 20000.0, 1.2, 1.2)
    clipped = np.minimum(taken(spot, rng).data, 255.0)
    stack = FrameStack(data=clipped, full_scale_dn=255.0)
    assert all(m.status != "ok" and "saturated" in m.flags for m in point_forward(stack, context=QUICK).measurements)
    assert {m.status for m in point_spread(stack, context=QUICK).measurements} == {"refused"}


@pytest.mark.parametrize("number", [3, 6])
def test_draws_by_importance_say_the_same_as_a_markov_chain(number, monkeypatch):
    """Medians of 2,000 effective draws lie within 0.02 widths of each other, a chain's and those of 500 within 0.1.

    One case is a Gaussian, the other a tube with a pulse, whose three blurs can be traded for each other.
    """
    case = chart_cases(5, 7)[number]
    stack, context = case.drawn(), replace(Context(seed=3), **case.context)

    def measured(**asked):
        return level(point_forward(stack, context=replace(context, **asked)), "mtf50", 0.0)

    picked, quick = measured(), measured(quick=True)
    assert picked.posterior.sampler == quick.posterior.sampler == "importance"
    assert picked.posterior.effective_sample_size.min() >= 2000
    monkeypatch.setattr(sampling, "ENOUGH", np.inf)
    monkeypatch.setattr(forward, "ACCURACY", replace(forward.ACCURACY, forward_chain_steps=16000))
    chained = measured()
    assert chained.posterior.sampler == "emcee"
    width = np.diff(chained.interval68)
    for found in (picked, quick):
        assert abs(found.value - chained.value) < 0.3 * width
        assert np.diff(found.interval68) == pytest.approx(width, rel=0.25)


@pytest.mark.parametrize("blur_px", [0.6, 1.0])
def test_frequencies_that_reach_no_pixel_are_left_out_within_a_hundred_thousandth_of_the_peak(blur_px, seed):
    """At the peak and at draws about it; a picture sharper than its pixels keeps every frequency."""
    _, prior = priors_of(Context(), halo_seen=False)
    optics = KnownPointOptics(width_px=1.0, height_px=1.0, video=None, pinhole_px=0.0, top=2.0)
    x, y = np.arange(-7.0, 8.0), np.arange(-6.0, 7.0)
    model = PointModel(optics=optics, prior=prior, x=x, y=y, ring_px=np.empty((0, 1)))
    point = np.array([0.2, -0.3, np.log(0.3), 1.2, blur_px, 0.02])
    covariance = np.diag([0.01, 0.01, 0.1, 0.1, 0.05, 0.02]) ** 2
    narrow = model.restrict_frequencies(point, covariance)
    draws = np.concatenate([point[None], np.random.default_rng(seed).multivariate_normal(point, covariance, 50)])
    full = model.core(draws)
    assert np.abs(narrow.core(draws) - full).max() < 1e-5 * full.max()
    assert narrow.optics.top < 1.9
    sharp = np.array([0.0, 0.0, np.log(2.5), 1.2, 0.0, 0.0])
    assert model.restrict_frequencies(sharp, covariance).optics.top == model.optics.top


def test_the_same_seed_gives_the_same_numbers(seed):
    stack = taken(gaussian_spot(32.3, 31.7, 4000.0, 1.0, 1.0), np.random.default_rng(seed))
    first, second = (point_forward(stack, context=Context(quick=True, seed=5)) for _ in range(2))
    assert [m.interval95 for m in first.measurements] == [m.interval95 for m in second.measurements]


def test_light_of_the_model_is_one_however_it_is_blurred():
    context = Context(sensor=load_sensor("pulnix-ag5745ef3"), interlaced=True)
    (prior,) = priors_of(context, halo_seen=True)
    optics = KnownPointOptics(
        width_px=1.0,
        height_px=2 * context.pitch_ratio,
        video=VideoFilter(bandwidth_mhz=6.5, clock_mhz=14.318, order=3),
        pinhole_px=1.0,
        top=1.2,
    )
    x, y = np.arange(-19.0, 20.0), context.pitch_ratio * np.arange(-16.0, 17.0)
    model = PointModel(optics=optics, prior=prior, x=x, y=y, ring_px=np.empty((0, 1)))
    start = prior.centre[prior.free_index].copy()
    start[prior.free.index("halo_deviate")] = -3.0  # nearly no halo, which would reach beyond these pixels
    light = model.core(start[None])[0].sum() * context.pitch_ratio
    share = float(prior.halo_fraction(np.array([-3.0]))[0])
    assert light == pytest.approx(1.0, abs=0.01 + share)


def test_halo_is_as_wide_as_the_description_allows():
    sensor = load_sensor("pulnix-ag5745ef3")
    (prior,) = priors_of(Context(sensor=sensor, interlaced=True), halo_seen=True)
    gap, at = sensor.photocathode.gap_mm, prior.free.index("halo_diameter_px")
    peak = prior.centre[prior.free_index]
    for end in (gap.low, gap.high):
        assert end is not None
        there = peak.copy()
        there[at] *= end / float(gap)
        fall = prior.log_density(peak[None]) - prior.log_density(there[None])
        # The ends of a range that holds 95 % lie 1.96 standard deviations off.
        assert fall[0] == pytest.approx(0.5 * 1.96**2, rel=1e-3)


def test_rings_of_light_that_neighbours_share_scatter_as_told(seed):
    rng = np.random.default_rng(seed)
    chi2 = []
    for _ in range(120):
        grain = ndimage.gaussian_filter(rng.standard_normal((2, 80, 80)), (0.0, 1.0, 1.0))
        window = window_of(grain, 40, 40, pitch_ratio=1.0, full_scale_dn=None, halo_radius_px=None, filtered=False)
        # A halo lifts all rings at once.
        told = window.ring_covariance(window.ring_variance)
        weight = 1.0 / window.ring_variance
        chi2.append((weight @ window.ring_dn) ** 2 / (weight @ told @ weight))
    # The mean of 120 squares is known to 0.13 of itself. Rings as if on their own scatter by 2.0 of what is told, those
    # of curved borders counted as straight ones by 1.3.
    assert 0.6 < np.mean(chi2) < 1.7


def test_plain_transform_agrees_with_the_forward_fit_where_nothing_deceives_it(seed):
    rng = np.random.default_rng(seed)
    stack = taken(gaussian_spot(32.2, 31.9, 8000.0, 1.2, 1.2), rng, frames=12)
    plain, forward = (level(m(stack, context=QUICK), "mtf50", 0.0) for m in (point_spread, point_forward))
    assert plain.status == "ok"
    assert abs(standard_errors(plain, half_frequency(1.2))) < 6.0  # errors of 12 frames are themselves uncertain
    assert plain.value == pytest.approx(forward.value, rel=0.05)


def test_a_negative_pinhole_is_bad_input():
    with pytest.raises(BadInput, match="pinhole_px"):
        point_forward(FrameStack(data=np.zeros((2, 32, 32))), pinhole_px=-1.0, context=QUICK)


@pytest.mark.parametrize("method", [point_forward, point_spread])
@pytest.mark.parametrize("knob", [{"motion_px": 1.0}, {"drift_px": 2.0}])
def test_what_moved_is_told(method, knob, seed):
    rng = np.random.default_rng(seed)
    told = {"motion_px": "interlace-motion", "drift_px": "drift"}
    still, moved = (method(PointScene(**k).frames_drawn(rng), context=QUICK).measurements[0] for k in ({}, knob))
    assert told[next(iter(knob))] in moved.flags
    assert told[next(iter(knob))] not in still.flags


def test_a_tube_with_a_narrow_pulse_is_fitted_with_both(seed):
    """One form alone is 4 % off for exp(-(f/fc)^1.184) and a Gaussian behind the gain, six of its standard errors."""
    errors = []
    for trial in range(8):
        rng = np.random.default_rng([seed, trial])
        blur = TrueBlur(form="exponential", frequency_cy_per_px=float(rng.uniform(0.2, 0.35)))
        scene = PointScene(blur=blur, pulse_px=0.6, col_px=rng.uniform(-0.5, 0.5))
        found = level(point_forward(scene.frames_drawn(rng), context=QUICK), "mtf50", 0.0)
        errors.append(standard_errors(found, scene.truth_mtf50))
    assert np.abs(errors).max() < 4.5
    assert abs(np.mean(errors)) < 4.5 / np.sqrt(8)


def test_the_plain_transform_tells_tails_that_its_disc_cuts_off(seed):
    blur = TrueBlur(form="exponential", frequency_cy_per_px=0.1)
    stack = PointScene(blur=blur).frames_drawn(np.random.default_rng(seed))
    assert "window-too-small" in point_spread(stack, context=QUICK).measurements[0].flags


def test_the_plain_transform_tells_two_sources_from_one(seed):
    stack = PointScene(neighbour_px=4.0).frames_drawn(np.random.default_rng(seed))
    assert "model-misfit" in point_spread(stack, context=QUICK).measurements[0].flags


def test_a_pinhole_that_passes_nothing_at_the_crossing_is_refused(seed):
    scene = PointScene(blur=TrueBlur(sigma_px=0.5), pulse_px=0.3, pinhole_px=5.0)
    found = point_spread(scene.frames_drawn(np.random.default_rng(seed)), pinhole_px=5.0, context=QUICK)
    assert found.measurements[0].status != "ok"


def test_light_missing_about_a_spot_is_told_as_light_too_much_is(seed):
    """A camera that sharpens takes off what a halo adds: of 21 such spots 9 were silently wrong."""
    scene = PointScene(blur=TrueBlur(sigma_px=0.8), photoelectrons=10000.0, black_dn=40.0)
    plain, sharp = (
        point_forward(replace(scene, sharpening=amount).frames_drawn(np.random.default_rng(seed)), context=QUICK)
        for amount in (0.0, 0.4)
    )
    assert "model-misfit" in sharp.measurements[0].flags
    assert "model-misfit" not in plain.measurements[0].flags


def test_a_spot_of_many_codes_in_two_frames_is_measured(seed):
    # Its model rings below no light, which is no variance.
    scene = PointScene(
        blur=TrueBlur(sigma_px=0.68), photoelectrons=1300.0, peak_dn=2200.0, frames=2, read_dn=2.2, black_dn=190.0,
        full_scale_dn=4095.0,
    )  # fmt: skip
    for one in range(3):
        stack = scene.frames_drawn(np.random.default_rng([seed, one]))
        found = point_forward(stack, context=QUICK).find("mtf50", orientation_deg=0.0)[0]
        low, high = found.interval95
        assert found.value == pytest.approx(scene.truth_mtf50, rel=0.25)
        assert found.status == "suspect" or abs(found.value - scene.truth_mtf50) < high - low
