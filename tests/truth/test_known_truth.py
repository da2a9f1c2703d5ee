"""True scenes are true: edges, bars, points, flats and blooms against independent closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf
from scipy.stats import norm

from charact.method import Context, choose
from charact.method.registry import chart_table, methods_of_kind
from tests.truth import BarScene, EdgeScene, TrueBlur, edge_spread
from tests.truth.bloom import apply_column_blooming, noiseless_frame, stack
from tests.truth.bloom_extents import truth
from tests.truth.bloom_light import BloomScene, halo_rings, radial_light
from tests.truth.cases.bloom import BloomSeries, halo_overload, series_in_scope
from tests.truth.flats import FlatScene
from tests.truth.point import PointScene, landing_places

# True scenes are true: edges, bars, points and flats against independent closed forms.


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


# True blooms, and the cases made of them.


# The generator of blooming keeps the laws of physics: volumes, rims, the step and plateau, charge,
# noise, seeds.


# Densities of electrons that land at r/d = 0.1, 0.3 .. 1.9, in units of 1/d^2, by Monte Carlo of
# the cosine law.
ELASTIC = (0.040, 0.040, 0.041, 0.042, 0.045, 0.048, 0.053, 0.061, 0.077, 0.182)
UNIFORM = (1.21, 0.38, 0.21, 0.14, 0.10, 0.07, 0.05, 0.04, 0.03, 0.01)


@pytest.mark.parametrize(("elastic", "density"), [(1.0, ELASTIC), (0.0, UNIFORM)])
def test_electrons_land_as_the_cosine_law_says(elastic, density):
    """Half a digit of the table, and 3 % where the Monte Carlo has scatter."""
    gap = 1.0
    radius, weight = halo_rings(4.0 * gap, elastic)
    held, edges = np.histogram(radius, bins=np.arange(0.0, 2.01, 0.2), weights=weight)
    found = held / (np.pi * np.diff(edges**2))
    assert found == pytest.approx(density, rel=0.06, abs=0.006)


def test_truth_by_pixels_agrees_with_truth_in_closed_form():
    source = BloomScene(rows=121, cols=121, row_pitch=1.18)
    for overload in (2.0, 30.0, 3e3):
        exact, counted = (
            truth(source, overload),
            truth(replace(source, plate_saturation_dn=1e12), overload),
        )
        for name in ("bloom_diameter", "bloom_diameter_background", "bloom_diameter_clip"):
            assert counted[name] == pytest.approx(exact[name], abs=0.15), (overload, name)


@pytest.mark.parametrize(("wing", "after_px"), [(0.0, 0.8), (0.3, 0.8), (0.0, 0.5)])
def test_the_law_along_the_radius_is_that_of_the_picture(wing, after_px):
    """The blur after the gain widens the wing as well: a tenth of its light 5 px out; narrow ones
    are blurs no less.
    """
    source = BloomScene(
        core_sigma_px=1.15, post_gain_sigma_px=after_px, wing_share=wing, wing_radius_px=2.0
    )
    row, col = source.centre
    radius = np.hypot(
        (np.arange(source.rows) - row)[:, None], (np.arange(source.cols) - col)[None, :]
    )
    near, table = radius < 40, np.arange(0.0, 41.0, 0.01)
    law = np.interp(radius[near], table, radial_light(source, table))
    picture = noiseless_frame(source, 1.0)[near] - source.dark_dn - source.background_dn
    assert picture == pytest.approx(
        source.source_dn(1.0) * law, rel=1e-3, abs=1e-6 * source.span_dn
    )


def test_overflow_settles_as_charge_handed_on_step_by_step():
    charge = np.full((61, 1), 10.0)
    charge[30:32, 0] = 320.0, 150.0
    slow = charge.copy()
    for _ in range(4000):
        spill = np.maximum(slow - 50.0, 0.0)
        slow = slow - spill
        slow[1:] += 0.5 * spill[:-1]
        slow[:-1] += 0.5 * spill[1:]
    assert apply_column_blooming(charge, 50.0) == pytest.approx(slow, abs=1e-6)


@pytest.mark.parametrize("background_dn", [6.0, 240.0])
def test_noise_is_that_of_pulses_blurred_after_the_gain(background_dn):
    source = BloomScene(frames=24, background_dn=background_dn, full_scale_dn=4095.0, bits=12)
    frames = stack(source, 1e-9, np.random.default_rng(1)).data.astype(float)
    noise = (frames - frames.mean(axis=0)) * np.sqrt(24 / 23)
    kernel = np.exp(-0.5 * (np.arange(-4, 5) / 0.7) ** 2)
    kernel /= kernel.sum()
    pulses = background_dn * source.photoelectron_dn * source.excess
    shared = np.array([(kernel[lag:] * kernel[: len(kernel) - lag]).sum() for lag in (0, 1)])
    sd = np.sqrt(2.0 / noise.size / shared[0] ** 2) * shared[0] * 2
    variance = pulses * shared[0] ** 2 + source.read_noise_dn**2 + 1 / 12
    assert frames.mean() == pytest.approx(
        source.dark_dn + background_dn, abs=5 * np.sqrt(pulses / noise.size) + 0.01
    )
    assert (noise**2).mean() == pytest.approx(variance, rel=6 * sd)
    covariance = (noise[:, :, 1:] * noise[:, :, :-1]).mean()
    assert covariance == pytest.approx(
        pulses * shared[0] * shared[1], rel=6 * sd / shared[1] * shared[0]
    )


def test_lag_motion_and_a_second_source_are_where_they_should_be():
    source = BloomScene(
        frames=5,
        read_noise_dn=0.0,
        halo_fraction=0.0,
        background_dn=1.0,
        full_scale_dn=65535.0,
        bits=16,
    )
    moving = stack(replace(source, motion_px=4.0), 0.8, np.random.default_rng(3)).data
    peaks = [int(np.argmax(frame.max(axis=0))) for frame in moving]
    assert np.diff(peaks) == pytest.approx(4.0, abs=1.5)
    lagging = stack(
        replace(source, motion_px=12.0, lag=0.3), 0.8, np.random.default_rng(3)
    ).data.astype(float)
    row, col = (round(one) for one in source.centre)
    now, before = (
        lagging[2, row - 6 : row + 7, at - 5 : at + 6].sum() - 13 * 143 for at in (col, col - 12)
    )
    assert before / now == pytest.approx(0.3 / 0.7, rel=0.05)
    pair = noiseless_frame(
        replace(source, second_distance_px=20.0, second_ratio=0.5, second_angle_deg=90.0), 1.0
    )
    assert pair[row + 20, col] - 13 == pytest.approx(0.5 * (pair[row, col] - 13), rel=1e-3)


def test_the_plate_tires_where_it_is_bright():
    source = BloomScene(background_dn=0.0)
    tired = replace(source, plate_saturation_dn=1e3)
    assert truth(tired, 1e-3)["core_compression"] == pytest.approx(1.0, abs=1e-2)
    assert truth(tired, 100.0)["core_compression"] < 0.3
    row, col = (round(one) for one in source.centre)
    assert noiseless_frame(tired, 1e6)[row, col] - source.dark_dn == pytest.approx(1e3, rel=0.01)
    far = np.s_[row, col + 21]
    assert noiseless_frame(tired, 100.0)[far] == pytest.approx(
        noiseless_frame(source, 100.0)[far], rel=0.02
    )


# The studies of blooming: series are what they are said to be, and the chart is what the method
# still does.


def test_series_in_scope_show_the_halo_over_two_decades_and_saturate_beyond():
    for seed in range(20):
        series = series_in_scope(np.random.default_rng(seed))
        scene = series.scene
        plateau = np.array(series.overloads) / halo_overload(scene)
        assert 25 <= scene.halo_diameter_px <= 70
        assert 0.02 <= scene.halo_fraction <= 0.3
        assert ((plateau > 0.006) & (plateau < 1.0)).sum() >= 5
        assert plateau[0] < 0.008 < 1.0 < plateau[-1]
        assert series.overloads == tuple(sorted(series.overloads))


def test_streak_and_halo_are_told_apart_where_columns_overflow_and_smear():
    """Streak within 2 px, halo within 2 % or 1 px, or flagged or refused."""
    scene = BloomScene(
        rows=200,
        cols=120,
        halo_diameter_px=40.0,
        halo_fraction=0.1,
        halo_elastic_share=0.5,
        frames=4,
    )
    for well, smear in ((12.0, 1e-4), (4.0, 1e-3)):
        spoilt = replace(scene, full_well_dn=well * scene.span_dn, smear_fraction=smear)
        overloads = tuple(
            float(one) for one in halo_overload(spoilt) * np.array([0.003, 0.03, 0.3, 1.5])
        )
        series = BloomSeries(scene=spoilt, overloads=overloads)
        drawn = series.session_drawn(np.random.default_rng(7))
        context = Context(quick=True, seed=7, full_scale_dn=scene.full_scale_dn)
        found = (
            methods_of_kind("bloom")["series-forward"].function(drawn, context=context).measurements
        )
        sure = {(one.quantity, one.stack): one for one in found if one.status == "ok"}
        assert sure["halo_diameter", None].value == pytest.approx(40.0, abs=1.0)
        streaks = [
            (one.value, series.truth(*key))
            for key, one in sure.items()
            if key[0] == "streak_length"
        ]
        assert len(streaks) >= 2
        assert all(abs((value or 0.0) - (right or 0.0)) <= 2.0 for value, right in streaks), streaks
        assert max(right or 0.0 for _, right in streaks) > 30


def test_auto_takes_the_only_method_and_the_chart_says_how_well_it_measures():
    (row,) = chart_table("halo_diameter")
    assert [row["method"]] == list(methods_of_kind("bloom"))
    assert choose("bloom").name == "series-forward"
    assert row["error_percent"] < 2.0 and row["silent"] == 0
