"""Noise that is estimated from the frame to be fused is that of the camera, where blocks without
structure exist.
"""

import cv2
import numpy as np
import pytest

from charact.fusion import Band, estimate_noise, fuse_noise_aware


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
