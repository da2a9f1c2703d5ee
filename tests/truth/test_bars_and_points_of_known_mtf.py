"""Bars and points of the study have the MTF they state: closed forms and transforms of the pixels
say the same.
"""

import numpy as np
import pytest
from scipy.special import erf

from tests.truth import BarScene, TrueBlur
from tests.truth.point import PointScene, landing_places


def _supersampled(scene: BarScene, fine: int = 6) -> np.ndarray:
    """Bars under a Gaussian by products of error functions, averaged over square pixels; 1 on a
    wide bar.
    """
    row, col = (
        (np.arange(size * fine) + 0.5) / fine - 0.5 - (size - 1) / 2 - off
        for size, off in ((scene.rows, scene.row_px), (scene.cols, scene.col_px))
    )
    angle, width, step = (
        np.deg2rad(scene.angle_deg),
        0.5 / scene.frequency_cy_per_px,
        scene.blur.sigma_px * np.sqrt(2),
    )
    across = col[None, :] * np.cos(angle) + row[:, None] * np.sin(angle)
    along = row[:, None] * np.cos(angle) - col[None, :] * np.sin(angle)
    box = lambda x, half: 0.5 * (erf((x + half) / step) - erf((x - half) / step))  # noqa: E731
    centres = (np.arange(scene.bars) - (scene.bars - 1) / 2) / scene.frequency_cy_per_px
    image = sum(box(across - centre, width / 2) for centre in centres) * box(along, 3.5 * width)
    return image.reshape(scene.rows, fine, scene.cols, fine).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("bars", "angle_deg", "rows"), [(4, 7.0, 100), (3, 0.0, 101), (5, 92.0, 100)]
)
def test_bars_from_their_spectrum_are_the_blurred_bars_in_the_pixels(bars, angle_deg, rows):
    scene = BarScene(
        blur=TrueBlur(sigma_px=0.8),
        bars=bars,
        frequency_cy_per_px=0.15,
        angle_deg=angle_deg,
        rows=rows,
        cols=110,
        row_px=0.3,
        col_px=-0.4,
    )
    light = (scene.light() - (scene.pedestal_dn - scene.black_dn)) / scene.level_dn
    assert np.abs(light - _supersampled(scene)).max() < 2e-3


@pytest.mark.parametrize(
    "blur",
    [
        TrueBlur(sigma_px=0.9),
        TrueBlur(form="exponential", frequency_cy_per_px=0.25),
        TrueBlur(sigma_px=0.5, halo_share=1 / 3, halo_px=40.0),
    ],
)
def test_places_of_photoelectrons_have_the_mtf_as_their_characteristic_function(blur, seed):
    count = 200_000
    landings = landing_places(blur, count, np.random.default_rng(seed))
    for frequency in (0.05, 0.15, 0.3):
        pixel = np.sinc(frequency)
        for axis in (0, 1):
            mean_phase = np.mean(np.cos(2 * np.pi * frequency * landings[:, axis]))
            expected = float(blur.mtf(frequency, 0.0)) / pixel
            assert abs(mean_phase - expected) < 4.5 * np.sqrt(0.5 / count)


@pytest.mark.parametrize("pulse_px", [0.0, 0.7])
def test_the_transform_of_many_photoelectrons_is_the_stated_mtf(pulse_px, seed):
    scene = PointScene(
        blur=TrueBlur(sigma_px=0.8),
        pulse_px=pulse_px,
        photoelectrons=2e5,
        background=0.0,
        read_dn=0.3,
        frames=1,
        full_scale_dn=4095.0,
        peak_dn=3000.0,
    )
    frame = scene.frames_drawn(np.random.default_rng(seed)).data[0] - scene.black_dn
    spot = frame[28:68, 28:68].sum(axis=0)
    position = np.arange(spot.size)
    for frequency in (0.1, 0.2):
        transform = abs(np.sum(spot * np.exp(-2j * np.pi * frequency * position))) / spot.sum()
        # Pulses of unequal height weigh as 1.6 of their number; rounding adds little.
        assert transform == pytest.approx(
            float(scene.mtf(frequency)), abs=4.5 * np.sqrt(0.8 / 2e5) + 2e-3
        )
