"""True scenes are true: edges, bars, points and flats against independent closed forms."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf
from scipy.stats import norm

from tests.truth import BarScene, EdgeScene, TrueBlur, edge_spread
from tests.truth.flats import FlatScene
from tests.truth.point import PointScene, landing_places

# The closed-form edge is the transform of its MTF, and its noise has the variance and covariance
# it states.


def test_mtf50_of_a_pixel_behind_a_unit_gaussian_is_the_published_one():
    # physics reference, section 5.1: sigma 1 px and the pixel give 0.1800 cy/px.
    assert TrueBlur(sigma_px=1.0).mtf50(0.0) == pytest.approx(0.1800, abs=5e-5)


def test_edge_spread_of_a_gaussian_behind_a_pixel_is_the_integral_of_the_error_function():
    x = np.linspace(-6, 6, 241)
    integral = lambda u: u * norm.cdf(u) + norm.pdf(u)  # noqa: E731
    exact = integral(x + 0.5) - integral(x - 0.5)
    assert np.abs(edge_spread(TrueBlur(sigma_px=1.0), x, 0.0) - exact).max() < 5e-6


@pytest.mark.parametrize("angle_deg", [0.0, 7.0, 45.0])
def test_edge_spread_is_the_fourier_integral_of_the_mtf(angle_deg):
    blur = TrueBlur(form="exponential", frequency_cy_per_px=0.25)
    for x in (0.3, 2.0, 9.0):
        exact, _ = quad(
            lambda f: blur.mtf(f, angle_deg) / (np.pi * f),
            1e-9,
            6,
            weight="sin",
            wvar=2 * np.pi * x,
            limit=400,
        )
        assert float(edge_spread(blur, np.array(x), angle_deg)) == pytest.approx(
            0.5 + exact, abs=3e-5
        )


def test_a_vertical_edge_brightens_along_the_row_and_a_tilted_one_moves_against_the_row_number():
    frame = EdgeScene(angle_deg=5.0, snr=np.inf).mean()
    assert (np.diff(frame, axis=1) > -1e-9).all()
    crossing = np.argmax(frame > 115, axis=1)
    assert crossing[0] - crossing[-1] == pytest.approx(99 * np.tan(np.deg2rad(5)), abs=1.01)


@pytest.mark.parametrize("noise_blur_px", [0.0, 1.0])
def test_noise_half_way_up_has_the_stated_spread_whether_or_not_it_is_shared(noise_blur_px, seed):
    scene = EdgeScene(
        dark_dn=115, bright_dn=115.0001, snr=1e-4 / 8.0, noise_blur_px=noise_blur_px, frames=8
    )
    data = scene.frames_drawn(np.random.default_rng(seed)).data.astype(float)
    independent = data.size / (1 + 4 * np.pi * noise_blur_px**2)
    assert data.var() - 1 / 12 == pytest.approx(64, abs=4.5 * 64 * np.sqrt(2 / independent))
    neighbour = np.mean((data[..., 1:] - data.mean()) * (data[..., :-1] - data.mean())) / data.var()
    expected = 0.8 * np.exp(-1 / (4 * noise_blur_px**2)) if noise_blur_px else 0.0
    assert neighbour == pytest.approx(expected, abs=0.04)


# Bars and points of the study have the MTF they state: closed forms and transforms of the pixels
# say the same.


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


# The closed-form flats obey the cascade: mean, and a covariance sum that no blur after the gain
# can change.


def _summed_covariance_over_mean(scene: FlatScene, seed: int) -> tuple[float, float]:
    """Slope of block variance against the mean, and the standard error; a block sum takes in all
    its covariances.
    """
    rng = np.random.default_rng(seed)
    light = scene._light(scene.photoelectrons[0], rng)
    return float(np.var(light.sum(axis=(1, 2))) / light.mean() / light[0].size), float(
        np.sqrt(2 / len(light))
    )


@pytest.mark.parametrize("blur_px", [0.0, 1.0])
def test_covariance_sum_over_mean_is_k_f2_plus_electron_gain_whatever_the_blur(blur_px, seed):
    scene = FlatScene(rows=24, cols=24, frames=3000, blur_px=blur_px, photoelectrons=(6.0,))
    ratio, relative_error = _summed_covariance_over_mean(scene, seed)
    assert ratio == pytest.approx(scene.truth_covariance_gain, rel=4.5 * relative_error)
