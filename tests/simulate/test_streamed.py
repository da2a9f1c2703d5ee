"""The fast sampler: its tables are the law they stand for, its kernel the blur, however
narrow, and a frame follows from its number.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from scipy.integrate import quad

from labdata import BadInput, Conditions
from simulate.camera import (
    CameraModel,
    GapSpread,
    PhosphorDecay,
    PixelAperture,
    PulseMoments,
    Slot,
    StageImage,
    fold_transfer,
    mcp_input_from_photoelectrons,
    product,
)
from simulate.camera.fast_sampler import (
    Exposure,
    SparseLight,
    SparseScreen,
    charge_distribution,
    event_samplers,
    frame_generator,
    kernel,
    noise_kernel,
)
from tests.simulate.samplers import SAMPLERS, drawn_by

# The video-rate tier: its tables are the law they stand for, its kernel the blur, a frame follows
# from its number.


def _moments_of(quantiles: np.ndarray) -> list[float]:
    """First four moments of a law drawn by straight lines between the nodes of its quantiles."""
    probability = charge_distribution.node_probabilities()
    points, weights = np.polynomial.legendre.leggauss(6)
    moments = np.zeros(4)
    for half in (quantiles[: charge_distribution.HALF], quantiles[charge_distribution.HALF :]):
        inside = half[:-1, None] + np.diff(half)[:, None] * (points + 1.0) / 2.0
        for power in range(1, 5):
            moments[power - 1] += probability[0] * half[0] ** power
            moments[power - 1] += np.sum(
                np.diff(probability)[:, None] * weights / 2.0 * inside**power
            )
    return list(moments)


@pytest.mark.parametrize("shape", [0.8, 1.0, 2.0, 50.0])
@pytest.mark.parametrize("mean", [1e-3, 0.05, 0.7, 4.0, 30.0, 34.0, 500.0])
def test_a_row_has_the_skewness_and_kurtosis_of_the_compound_law(shape, mean):
    """Cumulants of a Poisson sum are N E[g^n]; given that it is not zero, moments about zero are
    over 1 - exp(-N).
    """
    heights = [1.0, *(np.prod([1.0 + j / shape for j in range(1, n)]) for n in (2, 3, 4))]
    k1, k2, k3, k4 = (mean * height for height in heights)
    raw = np.array(
        [
            k1,
            k2 + k1**2,
            k3 + 3 * k2 * k1 + k1**3,
            k4 + 4 * k3 * k1 + 3 * k2**2 + 6 * k2 * k1**2 + k1**4,
        ]
    ) / -np.expm1(-mean)
    m1, m2, m3, m4 = raw
    variance = m2 - m1**2
    skewness = (m3 - 3 * m1 * m2 + 2 * m1**3) / variance**1.5
    kurtosis = (m4 - 4 * m1 * m3 + 6 * m1**2 * m2 - 3 * m1**4) / variance**2
    found = _moments_of(charge_distribution.unit_variance_quantiles(shape, mean))
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert found[1] == pytest.approx(1.0, abs=1e-9)
    # Narrow pulses make a staircase of the law, whose steps straight lines between nodes round off.
    tolerance = 1e-3 if shape < 10.0 else 5e-3
    assert found[2] == pytest.approx(skewness, rel=tolerance, abs=1e-4)
    assert found[3] == pytest.approx(kurtosis, rel=tolerance)


def _kernels(sensor, divisions):
    camera = CameraModel(sensor)
    blurs = PulseMoments(camera.chain(Conditions())).blurs
    known = kernel.DIVISIONS
    try:
        kernel.DIVISIONS = (divisions,)
        kernel.noise_kernel.cache_clear()
        made = kernel.noise_kernel(blurs, camera.cells, 2, (1.0,), 0.0)
    finally:
        kernel.DIVISIONS = known
        kernel.noise_kernel.cache_clear()
    return camera, blurs, made


def _seen_of_cell(made, plane, row, col, shape):
    """What pixels see of one cell's charge, by the compact part and by the far wing, shape (row,
    col).
    """
    image = _far_of_cell(made, row, col, shape)
    for down, along in zip(made.down[plane], made.along[plane], strict=True):
        image[row - len(down) + 1 : row + 1, col - len(along) + 1 : col + 1] += np.outer(
            down[::-1], along[::-1]
        )
    return image


def _far_of_cell(made, row, col, shape):
    """What the far wing alone brings of it."""
    coarse = np.zeros([-(-(n + 2 * kernel.REACH) // kernel.COARSE) for n in shape], np.float32)
    coarse[row // kernel.COARSE, col // kernel.COARSE] = 1.0
    wide, places = frame_generator.far_wing(made, coarse, shape)
    above = places.astype(int)
    share = (places - above)[:, None].astype(float)
    return wide[above] + share * (wide[above + 1].astype(float) - wide[above])


@pytest.mark.parametrize("divisions", [(1, 1), (1, 2), (2, 2)])
def test_the_kernel_keeps_all_light_and_the_covariance_of_the_continuous_blur(sheet, divisions):
    """The spectrum of what pixels see of cells at every place, beside the samples of the continuous
    noise.
    """
    camera, blurs, made = _kernels(sheet, divisions)
    near = sum(
        np.einsum("ri,rj->", down, along) for down, along in zip(made.down, made.along, strict=True)
    )
    far = made.wing.sum() * kernel.COARSE**2 * len(made.down)
    assert near + far == pytest.approx(made.height * len(made.down), rel=1e-5)
    shape, middle, found = (128, 128), 64, np.zeros((128, 128))
    for place in range(kernel.COARSE**2):
        row, col = divmod(place, kernel.COARSE)
        plane = place % len(made.down)
        seen = _seen_of_cell(made, plane, middle + row, middle + col, shape)
        found += np.abs(np.fft.fft2(seen)) ** 2 / made.height**2 / kernel.COARSE**2
    # Pixels one pitch apart sample it: frequencies a whole number apart add up.
    f = np.fft.fftfreq(128)
    aperture = PixelAperture(
        width_mm=camera.cells.pitch_x_mm, height_mm=2 * camera.cells.pitch_y_mm
    )
    fx, fy = f[None, :] / camera.cells.pitch_x_mm, f[:, None] / camera.cells.pitch_y_mm
    turns = [(m, n) for m in range(-3, 4) for n in range(-3, 4)]
    beside = 1.0 / camera.cells.pitch_x_mm, 1.0 / camera.cells.pitch_y_mm
    replicas = (np.broadcast_arrays(fx + m * beside[0], fy + n * beside[1]) for m, n in turns)
    due = np.sum([product((*blurs, aperture), *place) ** 2 for place in replicas], axis=0)
    low = np.hypot(f[:, None], f[None, :]) < 0.11
    assert np.allclose(found[low], due[low], rtol=4e-3)
    assert np.allclose(found, due, atol=4e-3)


@pytest.fixture(scope="module")
def sparse(plain):
    """A small camera before a dim edge, patterns, ions and all, in which single pulses are seen."""
    sensor = plain(
        48, 64, photocathode__ebi_lm_per_cm2=0.0, microchannel_plate__ion_event_rate_per_s_cm2=300.0
    )
    camera = CameraModel(sensor, geometry=True)
    image = np.where(np.arange(64) < 32, 0.02, 0.4) * np.ones((48, 1))
    return camera, mcp_input_from_photoelectrons(camera, image, Conditions())


def test_sparse_frames_average_to_the_mean_frame(sparse, seed):
    camera, light = sparse
    stream = camera.frames(light, Conditions(), seed=seed)
    frames = np.stack(list(islice(stream, 1000))).astype(float) - camera.mean_frame(
        light, Conditions()
    )
    assert isinstance(_made(camera, light).light, SparseLight)
    blocks = frames.mean(axis=1).reshape(40, 25, -1).mean(axis=1)
    error = blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))
    assert np.all(np.abs(blocks.mean(axis=0)) < 5.0 * error + 5e-3)


def _made(camera, light) -> Exposure:
    chain, fields = camera.chain(Conditions()), camera.fields_per_frame
    return event_samplers.prepare_exposure(chain, light, fields, sparse=camera.is_sparse(light))


def _screen(camera, light, seed) -> SparseScreen:
    return light.screen(camera.stage(Slot.DECAY), camera.fields_per_frame, seed, camera.shape)


def test_single_pulses_fall_evenly_within_a_pixel(plain, seed):
    """The share of its light that a pulse gives to its brightest pixel is as often as low as by all
    places alike.
    """
    sensor = plain(32, 32, phosphor__fast_decay_ms=1e-6, phosphor__slow_decay_ms=1e-6)
    camera = CameraModel(replace(sensor, video=replace(sensor.video, interlaced=False)))
    light = _made(
        camera, StageImage(values=np.full(camera.cells.shape, 1e-3, np.float32), grid=camera.cells)
    ).light
    assert isinstance(light, SparseLight)
    expected = np.zeros_like(light.expected)
    # The cells of one pixel amid the frame, in which there is hardly ever more than one pulse.
    expected[42:44, 42:44] = 0.01
    alone = replace(light, expected=expected, ions_per_field=0.0)
    screen, near_e, found = _screen(camera, alone, seed), alone.compact_charge_e(camera.shape), []
    for frame in range(8000):
        screen.expose(frame, [alone], 1.0, lambda work, rows, block: work(0, rows))
        image = screen.shown[0, 0] + near_e
        if image.max() > 1e-3 * light.gain.mean():
            found.append(image.max() / image.sum())
    places = light.kernel.fractions.reshape(-1, *light.kernel.fractions.shape[2:])
    brightest = places.max(axis=(1, 2)) / places.sum(axis=(1, 2))
    levels = np.quantile(brightest, [0.2, 0.4, 0.6, 0.8]) * 1.0001
    seen = (np.array(found)[:, None] < levels).mean(axis=0)
    due = (brightest[:, None] < levels).mean(axis=0)
    assert len(found) > 200
    assert np.all(np.abs(seen - due) < 4.5 * np.sqrt(due * (1.0 - due) / len(found)) + 0.02)


@pytest.fixture(scope="module")
def scene(sheet):
    """A small camera and an uneven picture through it, patterns, ions and a lamp included."""
    small = replace(sheet, ccd=replace(sheet.ccd, rows=60, columns=84))
    camera = CameraModel(small, geometry=True, local_depletion=True)
    image = 2.0 + 2.0 * np.sin(np.arange(84) / 9.0)[None, :] * np.ones((60, 1))
    image[30, 40] = 5e4
    return camera, mcp_input_from_photoelectrons(camera, image, Conditions())


def _frames(scene, count, tier="fast", seed=9, **more):
    camera, light = scene
    return np.stack(
        list(islice(drawn_by(tier, camera, light, Conditions(), seed=seed, **more), count))
    )


@pytest.mark.parametrize(
    ("light", "tier"), [("scene", "fast"), ("scene", "normal"), ("sparse", "fast")]
)
def test_frames_follow_from_seed_and_number_whoever_draws_them_and_in_whatever_order(
    light, tier, monkeypatch, request
):
    scene = request.getfixturevalue(light)
    monkeypatch.setattr(frame_generator, "SEGMENT_FRAMES", 4)
    run = _frames(scene, 11, tier=tier)
    assert run.tobytes() == _frames(scene, 11, tier=tier, threads=2).tobytes()
    for first in (1, 4, 6, 8):
        assert (
            run[first : first + 2].tobytes()
            == _frames(scene, 2, tier=tier, first_frame=first).tobytes()
        )
    assert run.tobytes() != _frames(scene, 11, tier=tier, seed=10).tobytes()


def test_every_tier_averages_to_the_mean_frame(scene, seed):
    camera, light = scene
    conditions = Conditions(mcp_v=700.0)
    mean = camera.mean_frame(light, conditions)
    dark_side = mean < 60.0
    for tier in SAMPLERS:
        stream = drawn_by(tier, camera, light, conditions, seed=seed)
        frames = np.stack(list(islice(stream, 160))).astype(float)
        profiles = np.where(dark_side, frames - mean, 0.0).sum(axis=1) / np.maximum(
            dark_side.sum(axis=0), 1
        )
        blocks = profiles.reshape(20, 8, -1).mean(axis=1)
        error = blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))
        assert np.all(np.abs(profiles.mean(axis=0)) < 5.5 * error + 0.02), tier


def test_the_screen_glows_into_the_next_frame_as_by_cell(scene, seed):
    """Correlation of a pixel's noise with the next frame's, by both tiers."""
    camera, light = scene
    found = []
    for tier in ("chain", "fast"):
        stream = drawn_by(tier, camera, light, Conditions(mcp_v=730.0), seed=seed)
        frames = np.stack(list(islice(stream, 220)))[:, :20].astype(float)
        noise = frames - frames.mean(axis=0)
        share = (noise[1:] * noise[:-1]).mean(axis=(1, 2)) / (noise**2).mean()
        blocks = share[:216].reshape(18, 12).mean(axis=1)
        found.append((blocks.mean(), blocks.std(ddof=1) / np.sqrt(18.0)))
    (by_cell, first), (streamed, second) = found
    assert by_cell > 10.0 * first
    assert abs(by_cell - streamed) < 4.0 * np.hypot(first, second)


def test_brightness_control_dims_streamed_frames_as_by_cell(sheet):
    small = replace(sheet, ccd=replace(sheet.ccd, rows=40, columns=64)).with_values(
        {"ccd.full_well_e": 1e7, "video.conversion_gain_dn_per_e": 4e-4}
    )
    camera, on = CameraModel(small), Conditions(brightness_control=True)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 800.0), on)
    levels = [
        [float(frame.mean()) for frame in islice(drawn_by(tier, camera, light, on, seed=1), 12)]
        for tier in ("chain", "fast")
    ]
    assert levels[1][0] > levels[1][-1] + 5.0
    assert np.allclose(levels[0], levels[1], rtol=0.02)


def test_light_that_is_no_number_is_refused(scene):
    camera, light = scene
    broken = light.with_values(np.where(light.values > 1.0, np.nan, light.values))
    with pytest.raises(BadInput, match="photoelectrons at the plate must be finite"):
        camera.frames(broken, Conditions(), seed=1)


@pytest.mark.parametrize("tier", SAMPLERS)
def test_six_decibels_of_camera_gain_double_signal_and_noise(sheet, tier, seed):
    small = replace(
        sheet, ccd=replace(sheet.ccd, rows=60, columns=84), video=replace(sheet.video, bit_depth=16)
    )
    camera = CameraModel(small)
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, 5.0), Conditions())
    black, found = float(sheet.video.black_level_dn), []
    for gain_db in (0.0, 20.0 * np.log10(2.0)):
        stream = drawn_by(tier, camera, light, Conditions(camera_gain_db=float(gain_db)), seed=seed)
        frames = np.stack(list(islice(stream, 24))).astype(float)
        found.append((frames.mean() - black, frames.std(axis=0).mean()))
    (level, noise), (doubled_level, doubled_noise) = found
    assert doubled_level == pytest.approx(2.0 * level, rel=0.01)
    assert doubled_noise == pytest.approx(2.0 * noise, rel=0.02)


def test_rows_between_exact_ones_have_the_law_s_skewness_too():
    for row in (3, 152, 298, 451, 603, 748):
        mean = charge_distribution.LOWEST_ROW * float(np.exp(charge_distribution.ROW_STEP * row))
        between, exact = (
            _moments_of(charge_distribution.row_quantiles(1.0, row)),
            _moments_of(charge_distribution.unit_variance_quantiles(1.0, mean)),
        )
        assert row % charge_distribution.EXACT_EVERY
        assert between[1] == pytest.approx(1.0, abs=1e-9)
        assert between[2] == pytest.approx(exact[2], rel=1.5e-3)
        assert between[3] == pytest.approx(exact[3], rel=3e-3)


def test_a_screen_far_faster_than_the_gate_s_end_leaves_nothing():
    glow = PhosphorDecay(components=((0.95, 3.6e-8), (0.05, 1.9e-6)), gate_s=1e-4, field_s=1 / 30)
    later, spread, _ = glow.recursion
    assert later.sum() < 1e-6 > abs(spread.sum())
    assert np.isfinite(glow.lateness)
    assert glow.n_lag_fields == 0


# Noise keeps its variance and covariances however narrow the blur behind the gain is, down to
# none.
#
# The reference is the closed form of events that fall anywhere, spread by a Gaussian and collected
# by square pixels: the autocovariance of a blurred box, int (1 - |u - k|) g(u) du with g a normal
# density of variance 2 s^2, per axis.


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
