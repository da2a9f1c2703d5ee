"""Noise keeps its variance and covariances however narrow the blur behind the gain is, down to
none.

The reference is the closed form of events that fall anywhere, spread by a Gaussian and collected by
square pixels: the autocovariance of a blurred box, int (1 - |u - k|) g(u) du with g a normal
density of variance 2 s^2, per axis.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from scipy.integrate import quad

from labdata import Conditions
from simulate.camera import CameraModel, GapSpread, PixelAperture, Slot, StageImage, fold_transfer
from simulate.camera.fast_sampler import noise_kernel
from tests.simulate.samplers import drawn_by

PITCH_MM = 0.02


def autocovariance(sigma_px: float, lag: int, height: int = 1) -> float:
    """Covariance at a lag of pixels `height` wide over the variance of events that each fall into
    one, per axis.
    """
    if sigma_px == 0.0:
        return max(height - abs(lag), 0.0) / height

    def density(u: float) -> float:
        return max(height - abs(u - lag), 0.0) / height * np.exp(-(u**2) / (4.0 * sigma_px**2))

    reach = 12.0 * sigma_px
    inside = [p for p in (lag - height, lag, lag + height) if -reach < p < reach]
    return quad(density, -reach, reach, points=inside or None)[0] / (
        2.0 * sigma_px * np.sqrt(np.pi)
    )


def blur(sigma_px: float) -> tuple[GapSpread, ...]:
    return (GapSpread(radius_um=np.sqrt(2.0) * sigma_px * PITCH_MM * 1e3),) if sigma_px else ()


SIGMAS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.7, 1.0, 2.0)


@pytest.mark.parametrize(("across", "down", "height"), [(2, 1, 1), (2, 1, 2), (8, 8, 1), (8, 8, 2)])
@pytest.mark.parametrize("sigma_px", SIGMAS)
def test_events_on_cells_have_the_covariance_of_events_anywhere(sigma_px, across, down, height):
    cells = {"cell_x_mm": PITCH_MM / across, "cell_y_mm": PITCH_MM / down}
    fx, fy = (
        np.fft.fftfreq(32 * n, cell) for n, cell in zip((across, down), cells.values(), strict=True)
    )
    aperture = PixelAperture(width_mm=PITCH_MM, height_mm=height * PITCH_MM)
    power = fold_transfer(blur(sigma_px), aperture, fx, fy, **cells) ** 2
    # Amount per cell averaged over the pixel: variance of the sum over the pixel, one event a pixel
    # area.
    covariance = np.fft.ifft2(power).real * across * down * height
    variance = autocovariance(sigma_px, 0) * autocovariance(sigma_px, 0, height)
    assert covariance[0, 0] == pytest.approx(variance, rel=5e-3)
    beside = autocovariance(sigma_px, 1) * autocovariance(sigma_px, 0, height)
    assert covariance[0, across] == pytest.approx(beside, abs=5e-3 * variance)
    below = autocovariance(sigma_px, 0) * autocovariance(sigma_px, 1, height)
    assert covariance[down, 0] == pytest.approx(below, abs=5e-3 * variance)


@pytest.mark.parametrize(
    ("sigma_px", "height"), [(0.0, 1), (0.02, 2), (0.1, 1), (0.35, 2), (1.0, 1), (1.0, 2)]
)
def test_the_kernel_of_the_fast_tier_keeps_the_variance(sigma_px, height, plain):
    grid = replace(CameraModel(plain(48, 64)).cells, pitch_x_mm=PITCH_MM, pitch_y_mm=PITCH_MM)
    kernel = noise_kernel(blur(sigma_px), grid, height, (1.0,), 1.0)
    variance = autocovariance(sigma_px, 0) * autocovariance(sigma_px, 0, height)
    assert kernel.blur_factor == pytest.approx(variance, rel=5e-3)
    rows, columns = kernel.divisions
    planes = np.einsum("prj,prk->pjk", kernel.down, kernel.along)
    assert np.sum(planes**2) / (rows * columns * height) == pytest.approx(variance, rel=5e-3)


@pytest.mark.parametrize(("level", "tier"), [(8.0, "chain"), (8.0, "fast"), (0.4, "fast")])
def test_flats_of_a_camera_that_does_not_blur_are_white(level, tier, plain, seed):
    """Variance (k F)^2 n / p with nothing shared between neighbours: 1 %, and four standard
    errors.
    """
    sensor = plain(
        96,
        144,
        tube__mtf_frequency_lp_per_mm=1e6,
        taper__fibre_pitch_um=1e-3,
        taper__interface_mtf_lp_per_mm=1e6,
        video__bandwidth_mhz=1e3,
        ccd__read_noise_e=0.0,
        ccd__dark_current_e_per_s=0.0,
        ccd__full_well_e=1e12,
        video__conversion_gain_dn_per_e=0.5 / level,
        video__black_level_dn=2000.0,
        phosphor__slow_decay_ms=1e-3,
        phosphor__fast_decay_ms=1e-3,
    )
    camera = CameraModel(replace(sensor, video=replace(sensor.video, interlaced=False)))
    cells = camera.cells
    flat = StageImage(
        values=np.full(cells.shape, level / cells.per_column / cells.per_row, np.float32),
        grid=cells,
    )
    stream = drawn_by(tier, camera, flat, Conditions(), seed=seed)
    frames = np.stack([frame.copy() for frame in islice(stream, 32)]).astype(float)
    assert frames.min() > 0
    black = float(camera.description.video.black_level_dn)
    step, mean = float(camera.description.video.conversion_gain_dn_per_e), frames.mean() - black
    p, shape = (
        camera.stage(Slot.MCP, Conditions()).detection_probability,
        camera.stage(Slot.MCP, Conditions()).pulse_height_shape,
    )
    variance = mean**2 / level * (1.0 + 1.0 / shape) / p + step * mean + 1.0 / 12.0
    centred = frames - frames.mean(axis=0)
    found = centred.var(axis=0, ddof=1).mean()
    blocks = centred.var(axis=0, ddof=1).reshape(16, 6, -1).mean(axis=(1, 2))
    assert found == pytest.approx(variance, rel=0.01, abs=4.0 * blocks.std() / 4.0)
    pixels = centred.size
    for beside in ((centred[:, :, 1:] * centred[:, :, :-1]), (centred[:, 1:] * centred[:, :-1])):
        assert abs(beside.mean() / found) < 4.0 / np.sqrt(pixels) + 0.002
