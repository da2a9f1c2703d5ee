"""Uncertainty of a fused picture follows from the noise of both bands."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from charact.fusion import (
    MARKS,
    Band,
    collapse,
    decompose,
    display_planes,
    estimate_noise,
    fuse,
    fuse_levels,
    fuse_noise_aware,
    level_count,
    level_uncertainty,
    noise_gains,
    resized,
)
from tests.truth.fusion import Pair, bands_of, gaussian

# The stated standard deviation is that of repeated frames; shares are those of injected signals.


FRAMES = 30


def through(weights, images) -> np.ndarray:
    """Return the picture of noise-free images by the weights of a fusion."""
    levels = len(weights[0]) - 1
    pyramids = [decompose(np.asarray(image, np.float32), levels) for image in images]
    return collapse(
        [
            sum(
                resized(own[level], pyramid[level].shape) * pyramid[level]
                for own, pyramid in zip(weights, pyramids, strict=True)
            )
            for level in range(levels + 1)
        ]
    )


@pytest.fixture(scope="module")
def cases():
    """Error over stated deviation of single frames with their own bloom maps, by zone and seed."""
    found = []
    for seed in range(1, 11):
        pair = Pair(seed=seed)
        planes = display_planes(
            bands_of(pair, pair.frames(np.random.default_rng(50 + seed))), bloom=True
        )
        picture, weights, _ = fuse_levels(planes)
        sd, _ = level_uncertainty(planes, weights)
        scenes = (pair.scene[0] * pair.gain_dn, pair.scene[1])
        clean = [
            (scene - p.span[0]) / (p.span[1] - p.span[0])
            for scene, p in zip(scenes, planes, strict=True)
        ]
        found.append(
            {
                zone: ((picture - through(weights, clean)) / sd)[mask]
                for zone, mask in pair.zones.items()
            }
        )
    return {zone: np.concatenate([one[zone] for one in found]) for zone in found[0]}


@pytest.mark.parametrize("zone", ["dark", "halo"])
def test_intervals_hold_the_noise_free_picture(cases, zone: str) -> None:
    z = cases[zone]
    inside68, inside95 = (np.abs(z) < 0.994458).mean(), (np.abs(z) < 1.959964).mean()
    assert 0.9 <= np.sqrt(np.mean(z**2)) <= 1.1
    assert 0.64 <= inside68 <= 0.72
    assert 0.92 <= inside95 <= 0.98


def test_filled_pixels_state_their_error(cases) -> None:
    z = cases["core"]
    found, inside95 = np.sqrt(np.mean(z**2)), (np.abs(z) < 1.959964).mean()
    # A filled hole is one error: 10 of them know its deviation within 0.22.
    assert 0.7 <= found <= 1.3
    assert inside95 >= 0.85


def test_filled_and_clipped_pixels_are_marked(pair, bands) -> None:
    found = fuse(bands, method="noise-aware", registered=True)
    core = pair.zones["core"]
    assert (found.marks[core] & MARKS["filled"] > 0).all() and (
        found.marks[core] & MARKS["clipped"] > 0
    ).all()
    assert not (found.marks[pair.zones["dark"]] & MARKS["filled"]).any()


def test_the_deviation_is_that_of_repeated_frames_without_lamps(redraw) -> None:
    dark = Pair(seed=4, lamp_pe=0.0, flood_pe=0.0)
    rng = np.random.default_rng(3)
    found = [
        fuse(
            [replace(b, bloom=None) for b in redraw(dark, rng)],
            method="noise-aware",
            registered=True,
        )
        for _ in range(FRAMES)
    ]
    pictures, sd = (np.stack([getattr(one, name) for one in found]) for name in ("picture", "sd"))
    ratio = pictures.std(axis=0, ddof=1).mean() / sd.mean()
    # Weights are slightly correlated with the noise that they weigh.
    assert ratio == pytest.approx(1.0, abs=0.06)


def test_shares_are_the_responses_to_injected_signals(pair, bands) -> None:
    plain = fuse(bands, method="noise-aware", registered=True)
    rows, cols = np.indices(plain.picture.shape)
    for place in ((110, 160), (62, 52), (150, 40), (70, 268)):
        mark = np.exp(-0.5 * ((rows - place[0]) ** 2 + (cols - place[1]) ** 2) / 3.0**2)
        answers = []
        for number, band in enumerate(bands):
            low, high = plain.spans[band.name]
            changed = list(bands)
            changed[number] = replace(
                band, image=band.image + np.float32(0.02 * (high - low)) * mark
            )
            answers.append(
                (
                    fuse(changed, method="noise-aware", spans=plain.spans, registered=True).picture
                    - plain.picture
                )[place]
            )
        shares = np.array(answers) / np.sum(answers)
        assert shares == pytest.approx(plain.share[:, place[0], place[1]], abs=0.02)


def test_the_shares_of_known_pixels_sum_to_one(bands) -> None:
    for method in (
        "weighted",
        "pca",
        "laplacian",
        "guided-filter",
        "inverse-noise",
        "noise-aware",
        "opponent",
    ):
        assert fuse(bands, method=method, registered=True).share.sum(axis=0) == pytest.approx(
            1.0, abs=1e-4
        )


@pytest.mark.parametrize("blur_px", [0.0, 0.6, 1.5])
def test_noise_passes_the_pyramid_as_computed(blur_px: float) -> None:
    rng = np.random.default_rng(1)
    gains = noise_gains(blur_px, 5)
    measured = np.zeros(6)
    pixel = 0.0
    for _ in range(4):
        noise = rng.normal(size=(512, 512))
        noise = (gaussian(noise, blur_px) if blur_px else noise).astype(np.float32)
        pixel += noise.var() / 4.0
        measured += [level.var() / 4.0 for level in decompose(noise, 5)]
    samples = 4.0 * 512.0**2 / 4.0 ** np.arange(6)
    assert gains.pixel == pytest.approx(pixel, rel=0.02)
    # Neighbouring coefficients are correlated, so that a few of them count as one.
    assert (np.abs(measured / gains.detail - 1.0) < 4.0 * np.sqrt(2.0 * 4.0 / samples)).all()


@pytest.mark.parametrize("shape", [(493, 768), (61, 87), (240, 320)])
def test_a_collapsed_pyramid_is_the_image(shape: tuple[int, int]) -> None:
    image = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    assert np.abs(collapse(decompose(image, level_count(shape))) - image).max() < 1e-5
    flat = decompose(np.full(shape, 3.0, np.float32), level_count(shape))
    assert np.abs(flat[-1] - 3.0).max() < 1e-5 and np.abs(flat[0]).max() < 1e-5


def test_a_wrong_halo_radius_leaves_a_rim_that_is_flagged(pair) -> None:
    frames = pair.frames(np.random.default_rng(100))
    right = fuse(bands_of(pair, frames), method="noise-aware", registered=True)
    assert right.measurements[0].flags == (), right.measurements[0].notes
    for radius in (26.0, 34.0):
        wrong = fuse(bands_of(pair, frames, halo_px=radius), method="noise-aware", registered=True)
        assert wrong.measurements[0].status == "suspect", radius


def test_without_a_lamp_the_bloom_step_changes_nothing() -> None:
    dark = Pair(seed=4, lamp_pe=0.0, flood_pe=0.0)
    frames = dark.frames(np.random.default_rng(0))
    found = fuse(bands_of(dark, frames, with_map=False), method="noise-aware", registered=True)
    assert any("no lamp in view" in note for note in found.measurements[0].notes)
    plain = fuse(
        [replace(b, clip=None) for b in bands_of(dark, frames, with_map=False)],
        method="noise-aware",
        registered=True,
    )
    assert np.abs(found.picture - plain.picture).max() <= 1e-6


# Noise that is estimated from the frame to be fused is that of the camera, where blocks without
# structure exist.


def draw_street(rng, shape=(480, 640)):
    """Return a scene of sky, ground, houses with windows, and a textured tree, in 20..200."""
    rows, cols = np.indices(shape)
    scene = np.where(rows < 0.5 * shape[0], 150.0, 60.0) + 20.0 * cols / shape[1]
    for col in range(40, shape[1] - 120, 150):
        scene[150:300, col : col + 110] = rng.uniform(30.0, 190.0)
        for row in range(165, 285, 30):
            for window in range(col + 10, col + 100, 24):
                scene[row : row + 16, window : window + 12] = rng.uniform(20.0, 200.0)
    scene[200:330, 560:630] = rng.uniform(20.0, 200.0, (130, 70))
    return cv2.GaussianBlur(scene.astype(np.float32), (0, 0), 0.8)


def photographed(scene, rng, gain_dn, read_dn, blur_px):
    """Return a frame with shot noise of the power gain times mean, blurred, and white read
    noise.
    """
    shot = rng.standard_normal(scene.shape) * np.sqrt(gain_dn * scene)
    blurred = cv2.GaussianBlur(shot, (0, 0), blur_px) if blur_px else shot
    return (scene + blurred + read_dn * rng.standard_normal(scene.shape)).astype(np.float32)


@pytest.mark.parametrize(
    ("gain_dn", "read_dn", "blur_px"), [(0.0, 2.0, 0.0), (0.3, 1.0, 0.0), (2.0, 0.5, 0.8)]
)
def test_the_noise_power_of_a_camera_is_found_in_a_street(gain_dn, read_dn, blur_px):
    """Within a factor of 1.5 of the power of frames drawn with a known law, at three levels of
    light.
    """
    for seed in range(3):
        rng = np.random.default_rng(seed)
        frame = photographed(draw_street(rng), rng, gain_dn, read_dn, blur_px)
        found = estimate_noise(frame)
        for light in (40.0, 100.0, 160.0):
            true = gain_dn * light + read_dn**2
            assert 1 / 1.5 < (found.gain_dn * light + found.read_dn**2) / true < 1.5, (
                seed,
                light,
                found,
            )
        assert not found.is_known


def test_edges_stay_sharp_where_the_noise_law_is_unknown():
    """A noise of 1 % of the contrast costs a hundredth of the slope of a wall, not half of it."""
    rng = np.random.default_rng(1)
    scene = draw_street(rng)
    frames = [photographed(scene, rng, 0.0, 1.0, 0.0) for _ in range(2)]
    out = fuse_noise_aware(
        [Band(name=name, image=frame) for name, frame in zip("ab", frames, strict=True)]
    )
    slopes = [
        np.abs(np.diff(one[220:240].mean(axis=0))).max() / np.ptp(one[220:240].mean(axis=0))
        for one in (scene, out.picture)
    ]
    assert slopes[1] > 0.97 * slopes[0]
