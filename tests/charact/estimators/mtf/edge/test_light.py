"""Edges in pulses of light, with grain, roughness and light that changes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from charact.estimators import mtf
from charact.estimators.mtf import prepare_edge
from charact.estimators.mtf.edge.pixels import bow as bows
from charact.estimators.mtf.edge.pixels import noise_model
from charact.estimators.mtf.edge.pixels import profile as edge_profile
from charact.method import Context
from labdata import FrameStack
from tests.truth import BlurOf, EdgeScene, PulseEdge, TrueBlur

# Uneven light and correlated noise on an edge: what they may do to its MTF, and what must be said
# of them.


QUICK = Context(quick=True)


LENS = TrueBlur(sigma_px=1.2)


def frame_of(angle_deg, rows=110, cols=110, blur=LENS):
    levels = {"dark_dn": 1000.0, "bright_dn": 2500.0, "black_dn": 0.0, "full_scale_dn": 4095.0}
    pose = {"angle_deg": angle_deg, "offset_px": 0.3}
    return EdgeScene(blur=blur, rows=rows, cols=cols, **pose, **levels).mean()


def measured(frame, **options):
    return mtf.measure(
        "edge", FrameStack(data=frame[None]), method="edge-parametric", context=QUICK
    ).find("mtf50")[0]


@pytest.mark.parametrize(
    ("angle_deg", "along"),
    [(4.0, False), (14.0, True), (35.0, False), (94.0, True), (124.0, False)],
)
def test_light_that_changes_over_the_frame_leaves_the_mtf_alone(angle_deg, along, seed):
    """Light changing by a fifth over the frame, along columns or rows, at a step of 40 standard
    deviations.
    """
    frame = frame_of(angle_deg)
    ramp = 1.0 + 0.2 * (np.arange(110) / 110 - 0.5)
    frame = frame * (ramp[:, None] if along else ramp[None])
    found = measured(frame + 40.0 * np.random.default_rng(seed).standard_normal(frame.shape))
    half = (found.interval95[1] - found.interval95[0]) / 2
    assert abs(found.value - LENS.mtf50(angle_deg)) < 2.0 * half


def test_a_ramp_along_a_tilted_edge_does_not_turn_its_line():
    """The line found is the edge's, whatever its light: a ramp by half turns it by less than a
    hundredth of a pixel.
    """
    frame = frame_of(96.0)
    ramp = 1.0 + 0.5 * (np.arange(110) / 110 - 0.5)
    plain, sloped = (
        prepare_edge(FrameStack(data=each[None]), None, QUICK).profile.angle_rad
        for each in (frame, frame * ramp)
    )
    assert abs(plain - sloped) * 110 < 0.02


@pytest.mark.parametrize("share", [0.15, 0.3])
def test_light_wider_than_the_window_is_told_or_within_the_interval(share, seed):
    """A Gaussian veil of 80 px in a window of 55 px on both sides: its light belongs to the
    normalisation.
    """
    veil = TrueBlur(sigma_px=80.0).before_pixel
    blur = BlurOf(of=lambda f: LENS.before_pixel(f) * (1 - share + share * veil(f)))
    frame, truth = frame_of(5.0, blur=blur), blur.mtf50(5.0)
    for one in range(6):
        found = measured(
            frame + 40.0 * np.random.default_rng([seed, one]).standard_normal(frame.shape)
        )
        assert found.status != "ok" or found.interval95[0] < truth < found.interval95[1], (
            found.provenance
        )


def test_a_line_that_leaves_the_region_is_no_edge(seed):
    """Noise in a region of a few pixels: whatever line is found there, one sentence comes back."""
    rng = np.random.default_rng(seed)
    for size in (8, 9, 11, 14):
        found = measured(1000.0 + 50.0 * rng.standard_normal((size, size)))
        assert found.status in ("refused", "suspect")
        assert found.value is not None or found.reason


def blurred_noise(rng, size, sigma_px):
    """White noise through a Gaussian, by transform, of unit variance."""
    f = np.fft.fftfreq(size)
    gain = np.exp(-2 * (np.pi * sigma_px) ** 2 * (f[:, None] ** 2 + f[None] ** 2))
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * gain).real
    return field / np.sqrt(np.mean(gain**2))


@pytest.mark.parametrize(("sigma_px", "share"), [(0.0, 0.0), (0.6, 0.8), (1.0, 0.8)])
def test_the_sum_of_the_noise_correlation_is_unbiased(sigma_px, share, seed):
    """Sum of the correlation: the share of the blurred noise over the mean of its squared gain,
    plus the white rest.

    Twenty frames; 4 standard errors of their mean, at least 4 percent.
    """
    rng = np.random.default_rng(seed)
    frame = frame_of(12.0)
    sums = []
    for _ in range(20):
        noise = np.sqrt(share) * blurred_noise(rng, 110, sigma_px) + np.sqrt(
            1 - share
        ) * rng.standard_normal((110, 110))
        stack = FrameStack(data=(frame + 60.0 * noise)[None])
        sums.append(prepare_edge(stack, None, QUICK).profile.correlated_noise.correlation_factor)
    f = np.fft.fftfreq(110)
    power = np.mean(np.exp(-4 * (np.pi * sigma_px) ** 2 * (f[:, None] ** 2 + f[None] ** 2)))
    truth = share / power + 1 - share
    assert abs(np.mean(sums) - truth) < max(4 * np.std(sums) / np.sqrt(20), 0.04 * truth)


@pytest.mark.parametrize("cols", [48, 150])
def test_ripples_are_no_undulations_many_times_their_size(cols, seed):
    """What a bend leaves over of a plateau of 13 px is a fiftieth of an undulation, and not to be
    blown up to one.
    """
    frame = frame_of(4.0, rows=110, cols=cols) + 10.0 * np.random.default_rng(seed).standard_normal(
        (110, cols)
    )
    profile = prepare_edge(FrameStack(data=frame[None]), None, QUICK).profile
    ripples, waves = (
        height * np.sin(2 * np.pi * profile.distance / px)
        for height, px in ((6.0, 5.0), (45.0, 40.0))
    )
    assert edge_profile.with_shading(profile, ripples).shading_sd < 3 * 6.0
    # Waves of 45 DN are undulations of their own size, as a plateau of 62 px lets them be told.
    assert cols < 100 or 45.0 < edge_profile.with_shading(profile, waves).shading_sd < 90.0


# Edges of intensified cameras: the scene against plain statistics of its own, and what methods
# make of it.


@pytest.mark.parametrize("seed_of_scene", range(3))
def test_noise_of_two_fields_is_not_taken_for_that_of_one(seed_of_scene, seed):
    """Wide pulses before an interlaced camera: chi squared per bin was 2 to 3.4, its noise told too
    small.
    """
    scene = PulseEdge(
        blur=TrueBlur(sigma_px=1.2),
        pulse_px=0.87,
        photoelectrons=10.0,
        bright_dn=150.0,
        dark_share=0.2,
        frames=8,
        rows=80,
        cols=80,
        angle_deg=20.0 + 3.0 * seed_of_scene,
        interlaced=True,
    )
    found = mtf.measure(
        "edge",
        scene.frames_drawn(np.random.default_rng([seed, seed_of_scene])),
        method="edge-parametric",
        context=Context(quick=True, interlaced=True),
    )
    shown = found.evidence["edge-spread"]
    free = shown["degrees_of_freedom"]
    assert shown["chi_squared"] / free == pytest.approx(1.0, abs=0.1 + 4.0 * np.sqrt(2.0 / free))


@pytest.mark.parametrize("tied", [False, True], ids=["white", "tied"])
def test_rows_that_share_noise_make_no_bow(tied, seed):
    """Of 2,000 straight courses at most 0.6 % are bowed (1.5 % of tied ones before); a bow of 8
    errors is.
    """
    rng = np.random.default_rng(seed)
    course = rng.standard_normal((2000, 96))
    if tied:
        course = course + np.roll(course, 1, axis=1) + np.roll(course, 2, axis=1)
    place = np.linspace(-1.0, 1.0, 96)
    design = np.polynomial.legendre.legvander(place, 1)
    course -= (course @ np.linalg.pinv(design).T) @ design.T
    assert np.mean([bows.bow_of(one).any() for one in course]) <= 0.006
    error = course.std() * np.sqrt((3.0 if tied else 1.0) / 96 * 5.0)
    bow = 8.0 * error * np.polynomial.legendre.legval(place, [0.0, 0.0, 1.0])
    assert np.mean([bows.bow_of(one + bow).any() for one in course[:200]]) > 0.95


@pytest.mark.parametrize(
    "scene",
    [
        PulseEdge(
            blur=TrueBlur(form="moffat", moffat_px=2.11, moffat_exponent=1.73),
            pulse_px=0.55,
            photoelectrons=7.86,
            bright_dn=34.5,
            dark_share=0.396,
            gain_spread=0.53,
            read_dn=0.74,
            row_noise_dn=10.7,
            rows=119,
            cols=95,
            frames=16,
            angle_deg=271.75,
            interlaced=True,
        ),
        PulseEdge(
            blur=TrueBlur(form="exponential", frequency_cy_per_px=0.304, exponent=1.95),
            pulse_px=0.55,
            photoelectrons=226.0,
            bright_dn=1226.0,
            dark_share=0.233,
            gain_spread=0.68,
            read_dn=1.9,
            rows=107,
            cols=111,
            frames=8,
            angle_deg=22.4,
        ),
    ],
    ids=["noise of rows", "full scale"],
)
def test_rows_of_noise_and_a_side_of_nothing_but_full_scale_end_in_a_verdict(scene, seed):
    """A profile too short for a slope, and a bright side without noise: a verdict, no traceback."""
    frames = scene.frames_drawn(np.random.default_rng(seed))
    context = Context(quick=True, interlaced=scene.interlaced, full_scale_dn=scene.full_scale_dn)
    found = mtf.measure("edge", frames, method="edge-parametric", context=context).find("mtf50")
    assert all(one.status != "ok" for one in found)


# The noise along an edge: its correlation against sums done plainly, its variances, and the codes
# that pile up.


@pytest.fixture
def rng(seed) -> np.random.Generator:
    return np.random.default_rng([seed, 23])


@pytest.mark.parametrize(("sigma", "share"), [(0.5, 0.8), (0.9, 0.8)])
def test_no_picture_s_noise_is_far_from_that_of_its_fellows(rng, sigma, share):
    """Sums of the correlation of 250 pictures of one noise, the bins' means taken off as profiles
    take them off.

    None is 8 deviations, told by the quartiles, from the middle: a lag that stood out by chance
    moves a sum by 6 in one picture of 1,500, a fit that ends beside its peak by 10 and more in one
    of 50.
    """
    place = np.add.outer(0.03 * np.arange(120), np.arange(110))
    bins = np.rint(4.0 * place).astype(int)
    count = np.maximum(np.bincount(bins.ravel()), 1)
    used, sums = np.ones(place.shape, bool), []
    for _ in range(250):
        noise = gaussian_filter(rng.standard_normal(place.shape), sigma, mode="wrap")
        noise = np.sqrt(share) * noise / noise.std() + np.sqrt(1.0 - share) * rng.standard_normal(
            place.shape
        )
        noise -= (np.bincount(bins.ravel(), noise.ravel()) / count)[bins]
        sums.append(noise_model.correlation_of(noise / noise.std(), used, (1.0, 0.03)).sum())
    low, middle, high = np.quantile(np.log(sums), [0.25, 0.5, 0.75])
    away = (np.log(sums) - middle) / ((high - low) / 1.349)
    assert np.abs(away).max() < 8.0


def test_no_chance_takes_noise_away_at_any_frequency(rng):
    """The power of noise blurred by 0.9 px and a tenth white, estimated in 300 pictures: 0.1 at
    least.

    A lag of 0.1 that stands out by chance would leave less than nothing at some frequency, as in
    one picture of ten.
    """
    used, least = np.ones((79, 85), bool), []
    for _ in range(300):
        noise = gaussian_filter(rng.standard_normal(used.shape), 0.9, mode="wrap")
        noise = np.sqrt(0.9) * noise / noise.std() + np.sqrt(0.1) * rng.standard_normal(used.shape)
        found = noise_model.correlation_of(noise / noise.std(), used, (1.0, 0.1))
        beyond = (64 - found.shape[0]) // 2
        whole = np.pad(found, (beyond + 1, beyond))
        least.append(np.fft.fft2(np.fft.ifftshift(whole)).real.min())
    assert min(least) > 0.0


# An edge that wanders along its length: told by its rows' places, beside what noise makes of them.


ROUGH = EdgeScene(blur=TrueBlur(sigma_px=1.3), frames=4, snr=25.0, roughness_px=0.7)
PULSES = PulseEdge(
    blur=TrueBlur(sigma_px=1.0), photoelectrons=2.0, frames=12, rows=80, cols=80, angle_deg=6.0
)


@pytest.mark.parametrize("method", ["edge-parametric", "edge-free", "edge-forward", "edge-slanted"])
@pytest.mark.parametrize("roughness_px", [0.0, 0.7])
def test_every_method_says_that_the_edge_is_rough(method, roughness_px, seed):
    """0.7 px rms lower MTF50 by a seventh and more: the interval reaches to the straight edge's."""
    scene = replace(ROUGH, roughness_px=roughness_px)
    found = mtf.measure(
        "edge", scene.frames_drawn(np.random.default_rng(seed)), method=method, context=QUICK
    )
    told = found.measurements[0]
    assert any(note.startswith("curved-edge: ") for note in told.notes) == (roughness_px > 0)
    assert told.interval95[0] < scene.truth_mtf50 < told.interval95[1] or told.status != "ok"


@pytest.mark.parametrize("angle_deg", [5.0, 96.0, 205.0])
def test_how_rough_is_the_scatter_of_its_course(angle_deg, seed):
    """0.3 px rms along the normal, within a fifth: rows average what they see of it."""
    scene = replace(ROUGH, roughness_px=0.3, roughness_length_px=4.0, angle_deg=angle_deg)
    found = prepare_edge(scene.frames_drawn(np.random.default_rng(seed)), None, QUICK)
    assert found.roughness.moves
    # Some of a course by chance is a bend of its whole length, which the line follows.
    bend = 0.0 if found.rows.line.bend is None else found.rows.line.bend.std()
    assert np.hypot(found.roughness.rms_px, bend) == pytest.approx(0.3, rel=0.2)


@pytest.mark.parametrize(
    "scene",
    [
        replace(ROUGH, roughness_px=0.0),
        replace(ROUGH, roughness_px=0.0, frames=1, noise_blur_px=0.9, snr=10.0),
        replace(ROUGH, roughness_px=0.0, frames=16, snr=400.0),
        replace(ROUGH, roughness_px=0.0, blur=TrueBlur(sigma_px=0.4), snr=100.0),
        PULSES,
        replace(PULSES, row_noise_dn=6.0),
        replace(PULSES, lag=0.3),
    ],
    ids=["noise", "tied noise", "rounding", "sharp", "pulses", "row noise", "lag"],
)
def test_straight_edges_are_straight(scene, seed):
    found = [
        prepare_edge(scene.frames_drawn(np.random.default_rng([seed, n])), None, QUICK).roughness
        for n in range(3)
    ]
    assert not any(one.moves and one.mtf_loss(scene.truth_mtf50) > 1e-4 for one in found), found
