"""Fused sequences, and where the pictures of both bands lie on each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import fourier_shift, gaussian_filter

from charact.frames.noise_law import NoiseLaw
from charact.fusion import (
    Band,
    CameraGeometry,
    Source,
    align_bands,
    blur_px_of,
    common_field,
    crop_band,
    detectability2,
    filtered_law,
    fuse_sequence,
    measure_noise,
    object_channels,
    pair_frames,
    place_pixels,
    reduce_noise,
    residual_shift,
    variance_ratio,
)
from labdata import BadInput, FrameStack
from tests.truth.fusion import gaussian

# Sequences: frames are paired by time, one span holds for all of them, and the recursive filter
# lowers noise as computed and keeps objects that move.


def stack_of(name: str, times, rng: np.random.Generator, **light: float) -> Source:
    """Frames of a still scene of squares; `light`: in the frame of this number, `frame_3=200`, a
    bright corner.
    """
    scene = np.kron(np.random.default_rng(8).uniform(10.0, 60.0, (8, 8)), np.ones((12, 12)))
    frames = scene + rng.normal(0.0, 1.0, (len(times), *scene.shape))
    for number, amount in light.items():
        frames[int(number.removeprefix("frame_")), :24, :24] += amount
    return Source(name=name, stack=FrameStack(data=frames, time_s=np.asarray(times, float)))


def test_frames_go_with_those_nearest_in_time():
    rng = np.random.default_rng(0)
    visible = stack_of("visible", np.arange(12) / 60.0, rng)
    thermal = stack_of("thermal", 0.004 + np.arange(4) / 30.0, rng)
    pairs, notes = pair_frames([visible, thermal])
    assert pairs[:6] == [(0, 0), (1, 0), (2, 1), (3, 1), (4, 2), (5, 2)]
    # The thermal camera ends at 0.104 s; half of its interval later, frame 7 at 0.117 s is the last
    # with a partner.
    assert len(pairs) == 8 and "4 of 12 frames" in notes[1]
    with pytest.raises(BadInput, match="same time"):
        pair_frames(
            [
                visible,
                replace(thermal, stack=replace(thermal.stack, time_s=thermal.stack.time_s + 60.0)),
            ]
        )
    silent = [
        replace(one, stack=replace(one.stack, time_s=np.empty(0))) for one in (visible, thermal)
    ]
    with pytest.raises(BadInput, match="equally many frames"):
        pair_frames(silent)


def test_a_flash_changes_nothing_elsewhere():
    """With a span of each frame, a flash over 6 % of a band would darken the rest of the
    picture.
    """
    rng = np.random.default_rng(1)
    times = np.arange(5) / 30.0
    sources = [stack_of("visible", times, rng, frame_3=200.0), stack_of("thermal", times, rng)]
    pairs, _ = pair_frames(sources)
    for method in ("weighted", "noise-aware"):
        pictures = [
            one.picture for one in fuse_sequence(sources, pairs, method=method, places=[None, None])
        ]
        quiet = np.array([picture[48:, 48:].mean() for picture in pictures])
        assert len(pictures) == 5 and np.ptp(quiet) < 0.01, method
        assert pictures[3][:20, :20].mean() > pictures[2][:20, :20].mean() + 0.5


def test_a_filtered_sequence_has_the_noise_that_it_states():
    rng = np.random.default_rng(2)
    sources = [stack_of(name, np.arange(24) / 30.0, rng) for name in ("visible", "thermal")]
    pairs, _ = pair_frames(sources)
    frames = list(
        fuse_sequence(sources, pairs, method="weighted", places=[None, None], recursive=0.2)
    )[12:]
    found = np.std(np.stack([one.picture for one in frames[::6]]), axis=0, ddof=1)
    plain = next(fuse_sequence(sources, pairs[:1], method="weighted", places=[None, None]))
    # A gain of 0.2 leaves a ninth of the variance.
    assert np.median(frames[0].sd) == pytest.approx(np.median(plain.sd) / 3.0, rel=0.02)
    assert np.sqrt(np.mean(found**2)) == pytest.approx(np.median(frames[0].sd), rel=0.15)


SHAPE = (64, 96)
GAIN_DN, READ_DN, BLUR_PX = 8.0, 1.0, 0.6


def camera_frames(mean_pe: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Frames of 4 DN per photoelectron of exponential pulse height, blurred after the gain."""
    electrons = rng.poisson(np.broadcast_to(mean_pe, (count, *SHAPE)))
    pulses = np.where(electrons > 0, rng.gamma(np.maximum(electrons, 1)), 0.0) * 4.0
    return np.stack([gaussian(one, BLUR_PX) for one in pulses]) + READ_DN * rng.normal(
        size=(count, *SHAPE)
    )


LAW = NoiseLaw(gain_dn=GAIN_DN, read_dn=READ_DN, blur_px=BLUR_PX)


@pytest.mark.parametrize("gain", [0.2, 0.4])
def test_noise_of_a_static_scene_falls_by_g_over_2_minus_g(gain: float) -> None:
    rng = np.random.default_rng(1)
    ground = gaussian(rng.normal(size=SHAPE), 6.0)
    scene = 8.0 + 2.0 * ground / ground.std()
    found = {False: [], True: []}
    for _ in range(3):
        frames = camera_frames(np.maximum(scene, 1.0), 36, rng)
        for motion, values in found.items():
            *_, last = reduce_noise(frames, LAW, gain=gain, motion=motion)
            left = last - 4.0 * gaussian(np.maximum(scene, 1.0), BLUR_PX)
            values.append((left.var(), left.mean(), (frames - frames.mean(axis=0)).var() * 36 / 35))
    ratios = {
        motion: np.mean([one[0] for one in values]) / np.mean([one[2] for one in values])
        for motion, values in found.items()
    }
    # 18,000 pixels of which a third are independent: 2 %.
    assert ratios[False] == pytest.approx(variance_ratio(gain), rel=0.06)
    assert ratios[True] <= variance_ratio(gain) / 0.9**2
    assert abs(np.mean([one[1] for one in found[True]])) < 0.1


def test_image_lag_raises_the_noise_of_the_filter() -> None:
    rng = np.random.default_rng(2)
    correlation, frames = 0.4, np.empty((30, *SHAPE))
    frames[0] = rng.normal(size=SHAPE)
    for number in range(1, len(frames)):
        frames[number] = correlation * frames[number - 1] + (
            1.0 - correlation**2
        ) ** 0.5 * rng.normal(size=SHAPE)
    law = NoiseLaw(gain_dn=0.0, read_dn=1.0)
    *_, last = reduce_noise(frames, law, gain=0.3, motion=False)
    # Of 6,144 pixels the variance is known within 1.8 %.
    assert last.var() == pytest.approx(variance_ratio(0.3, correlation), rel=0.06)
    assert filtered_law(law, 0.3, correlation).read_dn ** 2 == pytest.approx(
        variance_ratio(0.3, correlation)
    )


@pytest.mark.parametrize("contrast_pe", [2.0, 4.0])
def test_an_object_that_moves_by_2_px_a_frame_is_seen_as_well(contrast_pe: float) -> None:
    rng = np.random.default_rng(3)
    rows, cols = np.indices(SHAPE)
    places = [14 + 2 * step for step in range(14)]
    discs = np.stack([np.clip(5.0 - np.hypot(rows - 32, cols - col), 0.0, 1.0) for col in places])
    templates = object_channels(discs[-1] > 0.5)
    outputs = {"raw": ([], []), "filtered": ([], [])}
    for _ in range(40):
        for side, contrast in enumerate((contrast_pe, 0.0)):
            frames = camera_frames(8.0 + contrast * discs, 14, rng)
            *_, last = reduce_noise(frames, LAW, gain=0.2)
            for name, picture in (("raw", frames[-1]), ("filtered", last)):
                outputs[name][side].append(np.tensordot(templates, picture, axes=2))
    d2 = {
        name: detectability2(*(np.array(one) for one in sides)) for name, sides in outputs.items()
    }
    assert np.sqrt(d2["filtered"]) >= 0.9 * np.sqrt(d2["raw"])


def test_a_gain_out_of_range_is_refused() -> None:
    with pytest.raises(BadInput, match="at most 1"):
        list(reduce_noise(np.zeros((2, *SHAPE)), LAW, gain=1.5))
    with pytest.raises(BadInput, match="one size"):
        list(reduce_noise([np.zeros(SHAPE), np.zeros((20, 20))], LAW))


# Bands of two cameras on one grid: parallax by range, occlusion, lenses, what a warp does to
# noise, and a shift that is recovered with an honest interval.


FIXED = CameraGeometry(
    shape=(96, 128), focal_px=(200.0, 200.0), position_m=np.zeros(3), rotation=np.eye(3)
)
# Beside, 0.5 m to the right.
BESIDE = replace(FIXED, position_m=np.array([0.5, 0.0, 0.0]))


def ranges(camera: CameraGeometry, near_m: float, far_m: float) -> np.ndarray:
    """Range of a wall far_m ahead with a board near_m ahead, |x| < 0.8 m and |y| < 0.6 m, by closed
    form.
    """
    x, y = camera.tangents
    length = np.sqrt(x**2 + y**2 + 1.0)
    board = (np.abs(camera.position_m[0] + near_m * x) < 0.8) & (np.abs(near_m * y) < 0.6)
    return np.where(board, near_m, far_m) * length


def test_parallax_is_focal_length_times_baseline_over_depth():
    for distance in (5.0, 20.0, np.inf):
        placed = place_pixels(
            replace(FIXED, range_m=np.full(FIXED.shape, np.inf)),
            BESIDE,
            distance_m=None if np.isinf(distance) else distance,
        )
        rows, cols = np.indices(FIXED.shape)
        np.testing.assert_allclose(cols - placed.col, 200.0 * 0.5 / distance, atol=1e-9)
        np.testing.assert_allclose(placed.row, rows, atol=1e-9)


def test_a_step_of_range_hides_a_strip_of_the_difference_of_parallaxes():
    fixed, beside = (replace(one, range_m=ranges(one, 5.0, 10.0)) for one in (FIXED, BESIDE))
    placed = place_pixels(fixed, beside)
    strip = placed.occluded[48].sum()
    # f B (1/Z1 - 1/Z2) = 200 x 0.5 x (0.2 - 0.1) = 10 px, left of the board; an edge within a pixel
    # hides nothing.
    assert 8 <= strip <= 10
    rows, cols = np.nonzero(placed.occluded)
    board = 200.0 * 0.6 / 5.0
    assert np.abs(rows - 47.5).max() <= board + 1.0 and cols.max() < 63.5 - 0.8 / 5.0 * 200.0 + 1.0


def test_a_warp_and_its_inverse_meet():
    turn = np.radians(1.5)
    turned = np.array(
        [[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    other = replace(FIXED, focal_px=(230.0, 260.0), rotation=turned, frame_distortion=(-0.02, 0.03))
    there = place_pixels(FIXED, other)
    back = place_pixels(other, FIXED)
    col, row = there.warp(back.col), there.warp(back.row)
    rows, cols = np.indices(FIXED.shape)
    inside = np.s_[20:-20, 24:-24]
    # Places are rounded to 1/32 px, twice.
    assert np.hypot(col - cols, row - rows)[inside].max() < 2.0**0.5 / 32.0


def test_a_lens_displaces_its_corner_by_its_distortion():
    lens = replace(FIXED, frame_distortion=(0.02,))
    col, row = lens.pixels_of(np.array([63.5 / 200.0]), np.array([47.5 / 200.0]))
    share = np.hypot(63.5, 47.5) / np.hypot(64.0, 48.0)
    assert np.hypot(col - 63.5, row - 47.5)[0] == pytest.approx(
        np.hypot(63.5, 47.5) * (1.0 + 0.02 * share**2)
    )


def test_a_warp_states_the_noise_that_it_leaves():
    rng = np.random.default_rng(5)
    coarse = replace(FIXED, shape=(64, 84), focal_px=(130.0, 130.0))
    placed = place_pixels(FIXED, coarse)
    power, factor = placed.noise_change
    # A pixel of the fixed frame has (130/200)^2 of the area of a coarse one: noise per area is
    # kept.
    assert power == pytest.approx((200.0 / 130.0) ** 2, rel=0.1)
    warped = placed.warp(rng.standard_normal(coarse.shape))
    assert warped[8:-8, 8:-8].var() == pytest.approx(power * factor, rel=0.1)


def pair(rng, moving: CameraGeometry | None, fixed: CameraGeometry | None = FIXED):
    """Sources and bands of a random scene at infinity; `moving` sees it through its own lens."""
    scene = np.kron(rng.uniform(0.0, 50.0, (12, 16)), np.ones((8, 8)))
    images = [
        scene,
        scene if moving is None or fixed is None else place_pixels(moving, fixed).warp(scene),
    ]
    bands = [
        Band(
            name=name,
            image=image + rng.normal(0.0, 0.5, image.shape),
            noise=NoiseLaw(gain_dn=0.0, read_dn=0.5),
        )
        for name, image in zip(("visible", "thermal"), images, strict=True)
    ]
    sources = [
        Source(name=band.name, stack=FrameStack(data=band.image[None]), geometry=geometry)
        for band, geometry in zip(bands, (fixed, moving), strict=True)
    ]
    return bands, sources


def test_bands_of_two_sizes_are_placed_by_their_lenses_and_cut_to_the_field_in_common():
    rng = np.random.default_rng(1)
    narrow = CameraGeometry(shape=(80, 100), focal_px=(240.0, 240.0))
    bands, sources = pair(rng, narrow)
    aligned, places = align_bands(bands, sources)
    region = common_field(places)
    # 100 px of 240 against 128 px of 200: 83 columns; 80 against 96 rows: 66.
    assert region is not None and abs(region[3] - 83) <= 1 and abs(region[2] - 66) <= 1
    cut = [crop_band(band, region).image for band in aligned]
    assert np.corrcoef(cut[0].ravel(), cut[1].ravel())[0, 1] > 0.9
    assert any("parallax was left out" in note for note in aligned[1].notes)


def test_what_cannot_be_placed_is_refused():
    rng = np.random.default_rng(2)
    bands, sources = pair(rng, None, fixed=None)
    small = [bands[0], replace(bands[1], image=bands[1].image[:-8])]
    sizes = [sources[0], replace(sources[1], stack=FrameStack(data=small[1].image[None]))]
    with pytest.raises(BadInput, match="same rows and columns"):
        align_bands(small, sizes)
    with pytest.raises(BadInput, match="poses of both cameras"):
        align_bands(bands, sources, distance_m=100.0)
    with pytest.raises(BadInput, match="must be positive"):
        place_pixels(FIXED, BESIDE, distance_m=0.0)


def test_frames_state_their_own_noise():
    rng = np.random.default_rng(3)
    light = np.linspace(5.0, 60.0, 256)[None, :] * np.ones((192, 1))
    frames = 10.0 + 3.0 * rng.poisson(light, (12, 192, 256)) + rng.normal(0.0, 2.0, (12, 192, 256))
    found = measure_noise(FrameStack(data=frames), 10.0)
    # Gain 3 DN/pe: variance 9 pe = 3 DN x mean. 12 frames of 3,000 places know it within 2 %.
    assert found is not None
    assert found.gain_dn == pytest.approx(3.0, rel=0.06) and found.read_dn == pytest.approx(
        2.0, abs=0.8
    )
    assert found.blur_px < 0.25
    assert measure_noise(FrameStack(data=frames[:3]), 10.0) is None


def test_the_blur_of_a_factor_lowers_white_noise_by_it():
    away = np.arange(-20, 21)
    kernel = np.exp(-0.5 * (away / blur_px_of(0.2)) ** 2)
    assert np.sum((kernel / kernel.sum()) ** 2) ** 2 == pytest.approx(0.2, rel=0.01)


def test_a_shift_that_no_geometry_explains_is_measured_and_corrected():
    rng = np.random.default_rng(6)
    scene = np.kron(rng.uniform(0.0, 60.0, (24, 32)), np.ones((10, 10)))
    images = scene, np.roll(60.0 - scene, (2, 5), axis=(0, 1))
    bands = [
        Band(
            name=name,
            image=image + rng.normal(0.0, 1.0, scene.shape),
            noise=NoiseLaw(gain_dn=0.0, read_dn=1.0),
        )
        for name, image in zip(("visible", "thermal"), images, strict=True)
    ]
    sources = [Source(name=band.name, stack=FrameStack(data=band.image[None])) for band in bands]
    (_, moved), _ = align_bands(bands, sources)
    assert any("moved by its measured shift" in note for note in moved.notes)
    seen = ~moved.no_data
    assert seen.mean() > 0.95 and np.corrcoef(moved.image[seen], scene[seen])[0, 1] < -0.97
    (_, kept), _ = align_bands(bands, sources, registered=True)
    assert np.array_equal(kept.image, bands[1].image)


def bands(rng: np.random.Generator, shift: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Two bands of rectangles, some of opposed contrast, the second one shifted by (x, y) px, with
    noise.
    """
    visible, thermal = np.zeros((2, 240, 320))
    for _ in range(60):
        row, col = rng.integers(0, 220), rng.integers(0, 300)
        place = np.s_[row : row + rng.integers(8, 30), col : col + rng.integers(8, 30)]
        visible[place] += rng.uniform(20.0, 60.0)
        thermal[place] += rng.uniform(20.0, 60.0) * rng.choice([-1.0, 1.0])
    visible, thermal = (gaussian_filter(band, 1.2, mode="wrap") for band in (visible, thermal))
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(thermal), shift[::-1])).real
    return tuple(
        (band + rng.normal(0.0, 3.0, band.shape)).astype(np.float32) for band in (visible, moved)
    )


@pytest.mark.parametrize("shift", [(0.4, -0.3), (1.3, 0.8), (0.0, 0.0)])
def test_a_shift_lies_in_its_interval(shift):
    found = residual_shift(*bands(np.random.default_rng([7, round(10 * shift[0])]), shift))
    assert found.reason is None
    for true, got, (low, high) in zip(shift, found.shift_px, found.interval_px(0.95), strict=True):
        assert low - 0.1 < true < high + 0.1
        assert got == pytest.approx(true, abs=0.4)


def test_a_shift_beyond_the_limit_is_refused_by_its_reason():
    found = residual_shift(*bands(np.random.default_rng(3), (5.2, -2.0)))
    assert found.reason == "beyond-limit" and found.status == "refused"
    assert found.shift_px == pytest.approx((5.2, -2.0), abs=0.4)


def test_what_cannot_be_registered_is_a_reason_and_no_exception():
    rng = np.random.default_rng(4)
    flat = np.full((240, 320), 7.0, np.float32)
    noise = rng.normal(0.0, 1.0, (2, 240, 320)).astype(np.float32)
    nothing = np.full((240, 320), np.nan, np.float32)
    assert residual_shift(flat, noise[0]).reason == "no-structure"
    assert residual_shift(noise[0], noise[1]).reason == "not-found"
    assert residual_shift(nothing, noise[1]).reason == "too-few-pixels"
