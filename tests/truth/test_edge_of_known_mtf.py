"""The closed-form edge is the transform of its MTF, and its noise has the variance and covariance
it states.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from tests.truth import EdgeScene, TrueBlur, edge_spread


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
