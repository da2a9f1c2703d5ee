"""Noise of simulated flats, stripes and scintillations is that of the theory of pulses, at every
light level.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import pytest

from labdata import Array, Camera, Conditions, Target
from simulate import LabBench
from simulate.camera import CameraModel, PixelAperture, StageImage, TubeShare, true_quantities
from tests.simulate import pulse_theory
from tests.simulate.samplers import Sampler, drawn_by

# Moments of simulated flats and stripes are those of the theory of pulses, at every light level.
#
# Tolerances are the physical ones asked of the simulator: mean 0.1 %, variance 0.5 %, skewness 2
# %, the value that one pixel in a thousand exceeds 0.5 %, covariances to four pixels 1 % of the
# variance; beside them stand four standard errors of the samples drawn. CHARACT_TEST_SAMPLES
# multiplies the samples.


LEVELS = (0.05, 0.5, 5.0, 50.0, 500.0)
# Pulse heights of another shape than the exponential, and a screen that does not glow on.
CAMERAS: dict[str, dict[str, float]] = {
    "exponential": {},
    "Polya 2": {"microchannel_plate__pulse_height_shape": 2.0},
    "without decay": {"phosphor__fast_decay_ms": 1e-6, "phosphor__slow_decay_ms": 1e-6},
}
BLACK_DN, TOP_DN = 2000.0, 60000.0
# What the filter along the line makes of a line's beginning is no flat.
LINE_START_PX = 16
ERRORS = 4.0
BLOCKS = 20
SAMPLES = float(os.environ.get("CHARACT_TEST_SAMPLES", "1"))
TOLERANCE = {"mean": 1e-3, "variance": 5e-3, "skewness": 2e-2, "quantile": 5e-3}


# Frames of 240 x 320 pixels in one block of flats that a tier can afford, by level; and what is
# tried of each tier.
AFFORDED: dict[Sampler, dict[float, int]] = {
    "fast": dict.fromkeys(LEVELS, 10),
    "chain": {0.5: 2, 50.0: 1},
}
CASES = [
    pytest.param(tier, level, name, id=f"{tier}-{name}-{level:g}")
    for tier, levels in AFFORDED.items()
    for level in levels
    for name in CAMERAS
    if name == "exponential" or (tier == "fast" and level in (LEVELS[0], LEVELS[-1]))
]


def drawn(
    sensor: Camera, at_mcp: StageImage, frames: int, seed: int, tier: Sampler
) -> Iterator[Array]:
    """Yield blocks of so many frames of a steady scene by one of the simulator's tiers, DN, shape
    (frame, row, col).
    """
    stream = drawn_by(tier, CameraModel(sensor), at_mcp, Conditions(), seed=seed)
    while True:
        codes = np.stack([frame.copy() for frame in islice(stream, frames)])
        assert codes.min() > 0 and codes.max() < 2**sensor.video.bit_depth - 1
        yield codes.astype(np.float32)


def flat_frames(
    sensor: Camera, photoelectrons_per_pixel: float, frames: int, seed: int, tier: Sampler
) -> Iterator[Array]:
    """Yield blocks of so many frames of a flat by one of the simulator's tiers, DN, shape (frame,
    row, col).
    """
    camera = CameraModel(sensor)
    cells = (
        camera.cells.per_column * camera.cells.per_row * (2 if camera.description.interlaced else 1)
    )
    flat = np.full(camera.cells.shape, photoelectrons_per_pixel / cells, np.float32)
    return drawn(sensor, StageImage(values=flat, grid=camera.cells), frames, seed, tier)


def in_fine_steps(sensor: Camera, photoelectrons: float) -> Camera:
    """The sensor with sixteen bits that span its flat, wells without end."""
    camera = pulse_theory.of_sensor(sensor)
    factor = camera.height_moment(2) / camera.height_moment(1) / camera.charge_e
    reach = camera.charge_e * (photoelectrons + 12.0 * np.sqrt(factor * photoelectrons) + 40.0)
    return sensor.with_values(
        {
            "video.conversion_gain_dn_per_e": (TOP_DN - BLACK_DN) / reach,
            "video.black_level_dn": BLACK_DN,
            "ccd.full_well_e": 1e12,
        }
    )


def measured_flat(
    sensor: Camera, level: float, frames: int, seed: int, tier: Sampler
) -> tuple[pulse_theory.Moments, pulse_theory.Moments, float]:
    """Moments of a flat in `BLOCKS` of so many frames, their errors, e- above black, and the
    digitiser's step, e-.
    """
    fine = in_fine_steps(sensor, level)
    step_e = 1.0 / float(fine.video.conversion_gain_dn_per_e)
    blocks = islice(flat_frames(fine, level, frames, seed, tier), BLOCKS)
    charge = ((block[:, :, LINE_START_PX:] - BLACK_DN) * step_e for block in blocks)
    return *pulse_theory.measured(charge, pulse_theory.of_sensor(sensor).charge_e * level), step_e


def departures(
    found: pulse_theory.Moments, expected: pulse_theory.Moments, error: pulse_theory.Moments
) -> list[str]:
    """Return the statistics that depart by more than the tolerance and the error, in words."""
    wrong = []
    for name, share in TOLERANCE.items():
        allowed = share * abs(getattr(expected, name)) + ERRORS * getattr(error, name)
        if abs(getattr(found, name) - getattr(expected, name)) > allowed:
            wrong.append(
                f"{name}: {getattr(found, name):.6g}, not {getattr(expected, name):.6g} +- "
                f"{allowed:.2g}"
            )
    for name in ("horizontal", "vertical"):
        off = np.abs(getattr(found, name) - getattr(expected, name))
        wrong += [
            f"{name} lag {lag + 1}: off by {off[lag] / expected.variance:.4f} of the variance"
            for lag in np.flatnonzero(
                off > 0.01 * expected.variance + ERRORS * getattr(error, name)
            )
        ]
    return wrong


@pytest.mark.parametrize(("tier", "level", "name"), CASES)
def test_flats_have_the_moments_of_campbells_theorem(tier, level, name, plain, seed):
    sensor = plain(240, 320, **CAMERAS[name])
    frames = round(AFFORDED[tier][level] * SAMPLES)
    found, error, step_e = measured_flat(sensor, level, frames, seed, tier)
    camera = pulse_theory.of_sensor(sensor)
    expected = pulse_theory.campbell(camera, level / camera.rows_summed, step_e=step_e)
    assert not departures(found, expected, error)


# Variance from column to column under stripes eight pixels wide, a tenth of the light in their dark
# half: where the streamed tier, which lays its noise a little wider than pulses do, is set right
# but for the finest detail.
STRIPES: dict[Sampler, float] = {"fast": 0.015, "chain": 5e-3}


PERIOD_PX, STRIPES_PE = 8, 6.0


def stripes(x_px: Array) -> Array:
    return STRIPES_PE * (1.0 + 0.9 * np.sin(2.0 * np.pi * x_px / PERIOD_PX))


@pytest.mark.parametrize("tier", AFFORDED)
def test_stripes_have_the_mean_and_variance_of_single_events(tier, plain, seed):
    """Light that changes from column to column: blur of means and blur of pulses act on it each in
    its own way.
    """
    sensor = in_fine_steps(plain(240, 320), 2.0 * STRIPES_PE)
    cells = CameraModel(sensor).cells
    x_px = (np.arange(cells.shape[1]) + 0.5) / cells.per_column - cells.margin_columns
    per_cell = stripes(x_px) / (2 * cells.per_row * cells.per_column)
    light = np.repeat(per_cell[None].astype(np.float32), cells.shape[0], axis=0)
    codes = next(drawn(sensor, StageImage(values=light, grid=cells), 60, seed, tier))[
        :, :, LINE_START_PX:
    ]
    charge = (codes - BLACK_DN) / float(sensor.video.conversion_gain_dn_per_e)
    theory = pulse_theory.campbell_of_columns(
        pulse_theory.of_sensor(sensor), lambda x_px: stripes(x_px) / 2.0, PERIOD_PX
    )
    for power, expected, tolerance in zip((1, 2), theory, (1e-3, STRIPES[tier]), strict=True):
        found, error = (part / expected for part in _by_phase(charge, PERIOD_PX, power))
        assert np.all(np.abs(found - 1.0) < tolerance + ERRORS * error), (found.round(4), error)
        assert np.all(error < 0.015)


def _by_phase(frames: Array, period: int, power: int) -> tuple[Array, Array]:
    """Mean or variance of each column of the stripes' period, and its error by blocks of frames."""
    columns = frames.reshape(*frames.shape[:2], -1, period)
    if power == 2:
        columns = (columns - columns.mean(axis=(0, 1, 2))) ** 2
    blocks = np.stack([block.mean(axis=(0, 1, 2)) for block in np.array_split(columns, 12)])
    return blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / np.sqrt(12.0)


# True quantities of noise agree with cascade theory (physics reference, 5.2, 6.4 and 10).


@dataclass(frozen=True)
class GaussianFibres:
    """The fibres of table 5.2, a Gaussian of 80 lp/mm at the photocathode."""

    def transfer(self, fx_per_mm, fy_per_mm):
        return np.exp(-(fx_per_mm**2 + fy_per_mm**2) / 80.0**2)


# Post-gain share; blur factor and correlation in the row for single rows (21.3 um), then for row
# pairs (42.5 um).
TABLE = [
    (1.0, 0.204, 0.45, 0.38, 0.282, 0.47, 0.18),
    (0.8, 0.250, 0.39, 0.33, 0.331, 0.41, 0.15),
    (0.5, 0.349, 0.29, 0.24, 0.434, 0.31, 0.11),
    (0.25, 0.482, 0.20, 0.17, 0.562, 0.21, 0.08),
    (0.0, 0.701, 0.11, 0.09, 0.762, 0.11, 0.04),
]


@pytest.mark.parametrize("row", TABLE)
def test_blur_factor_and_correlations_are_those_of_table_5_2(row):
    share, *published = row
    for height_mm, expected in ((0.0213, published[:3]), (0.0425, published[3:])):
        blurs = (
            TubeShare(share=share, frequency_lp_per_mm=26.25, exponent=1.184),
            GaussianFibres(),
            PixelAperture(width_mm=0.018, height_mm=height_mm),
        )
        found = true_quantities.pulse_correlation(blurs, None, 0.018, height_mm)
        assert found[0] == pytest.approx(expected[0], abs=1.5e-3)
        assert found[1:] == pytest.approx(expected[1:], abs=6e-3)


@pytest.mark.parametrize("name", CAMERAS)
def test_truths_of_the_noise_of_flats_are_campbells(name, plain):
    """The moments of frames are held against the same theory in test_moments.py."""
    sensor, level = plain(120, 160, **CAMERAS[name]), 3.0
    truths, camera = true_quantities.true_quantities(sensor), pulse_theory.of_sensor(sensor)
    theory = pulse_theory.campbell(camera, level)
    shares, weight = pulse_theory.field_shares(camera)
    dn_per_e = float(sensor.video.conversion_gain_dn_per_e)
    signal = truths["photoelectron_gain"] * 2.0 * level
    assert dn_per_e * theory.mean == pytest.approx(signal, rel=1e-3)
    # All the light of a pulse lies on the pixels of a field, whatever its blur.
    pulses = float(weight @ np.sum(shares**2, axis=1)) * camera.height_moment(2)
    covariance_gain = dn_per_e * (1.0 + pulses / camera.height_moment(1))
    assert truths["field_covariance_gain"] == pytest.approx(covariance_gain, rel=1e-3)
    variance = dn_per_e**2 * theory.variance - truths["read_noise"] ** 2
    assert truths["blur_factor"] * covariance_gain * signal == pytest.approx(variance, rel=3e-3)
    # The next line of a field is the line after next of the frame.
    shared = dn_per_e**2 * np.array([theory.horizontal[0], theory.vertical[1]]) / variance
    correlations = [truths["correlation_horizontal"], truths["correlation_vertical"]]
    assert correlations == pytest.approx(shared, abs=2e-3)


def test_without_decay_field_and_pulse_have_one_covariance_gain(plain):
    q = true_quantities.true_quantities(plain(120, 160, **CAMERAS["without decay"]))
    assert q["covariance_gain"] == pytest.approx(
        q["system_gain"] + q["photoelectron_gain"] * q["excess_noise_factor"]
    )
    assert q["field_covariance_gain"] == pytest.approx(q["covariance_gain"], rel=1e-3)
    assert q["field_correlation"] == pytest.approx(0.0, abs=1e-6)


# The interlaced default camera: what lines share, and scintillations in the dark.


NO_DECAY = {"phosphor.fast_decay_ms": 1e-6, "phosphor.slow_decay_ms": 1e-6}


def test_p20_correlates_pixels_of_a_line_so_many_times_as_lines(sheet):
    """What field residuals and the overlap of row pairs predict, by the independent theory."""
    camera = pulse_theory.of_sensor(sheet)
    shares, weight = pulse_theory.field_shares(camera)
    decay = float(weight @ np.sum(shares**2, axis=1))
    following = float(weight @ np.sum(shares[:, 1:] * shares[:, :-1], axis=1))
    field_correlation = true_quantities.true_quantities(sheet)["field_correlation"]
    assert [following / decay, field_correlation] == pytest.approx([0.36, 0.36], abs=0.005)
    theory = pulse_theory.campbell(
        camera, 3.0, step_e=1.0 / float(sheet.video.conversion_gain_dn_per_e)
    )
    assert theory.vertical[0] / theory.variance == pytest.approx(0.23, abs=0.02)
    # The reference's 2.1 is of a video filter without the staircase of the pixel clock.
    assert 2.1 * 0.9 < theory.horizontal[0] / theory.vertical[0] < 2.75


# Scintillations in the dark.

GATE_SHARE = 0.01
WINDOW_ROWS, WINDOW_COLUMNS = 7, 13


def _events(field: Array, candidate: float) -> Array:
    """Sums of windows round the peaks of a field that stand alone and away from its borders, e-."""
    from scipy.ndimage import maximum_filter, uniform_filter

    size: Any = (WINDOW_ROWS, WINDOW_COLUMNS)
    highest: Any = maximum_filter(field, size)
    around: Any = uniform_filter(field, size=size, mode="constant") * (WINDOW_ROWS * WINDOW_COLUMNS)
    peak = (field == highest) & (field > candidate)
    border = np.zeros_like(peak)
    border[WINDOW_ROWS:-WINDOW_ROWS, WINDOW_COLUMNS + LINE_START_PX : -WINDOW_COLUMNS] = True
    return around[peak & border]


@pytest.mark.parametrize("shape", [1.0, 2.0])
def test_dark_frames_show_scintillations_at_the_ebi_rate_with_the_pulse_height_law(
    shape, plain, seed
):
    """Gate so short that events stand alone. Above a threshold, rate and heights are those of the
    gamma law.
    """
    from scipy import stats

    rows, columns, frames = 240, 320, 240
    sensor = plain(
        rows,
        columns,
        ccd__read_noise_e=4.0,
        ccd__dark_current_e_per_s=0.0,
        microchannel_plate__pulse_height_shape=shape,
    ).with_values(NO_DECAY)
    assert float(sensor.tube.luminous_gain) == 15000.0
    bench = LabBench(sensor)
    conditions = Conditions(gate_ns=GATE_SHARE * bench.camera.field_s * 1e9)
    stack = bench.expose("dark", Target(), conditions, frames=frames, seed=seed).data.astype(float)
    charge = (stack - 400.0) / float(sensor.video.conversion_gain_dn_per_e)
    camera = replace(pulse_theory.of_sensor(sensor), gate_s=GATE_SHARE / 59.94)
    height_e = camera.charge_e / camera.detection_probability
    seen = height_e * _window_share(camera)
    threshold = 0.8 * seen
    found = np.concatenate(
        [_events(f[parity::2], 0.08 * height_e) for f in charge for parity in (0, 1)]
    )
    found = found[found > threshold]
    # 1.129 photoelectrons per s and chip pixel; a field's pixels have two rows each.
    searched = (
        (rows / 2 - 2 * WINDOW_ROWS) * (columns - 2 * WINDOW_COLUMNS - LINE_START_PX) * 2 * frames
    )
    expected = 2.0 * 1.129 * GATE_SHARE / 59.94 * camera.detection_probability * searched
    law = stats.gamma(shape, scale=seen / shape)
    expected_above = expected * float(law.sf(threshold))
    assert len(found) > 1000
    # Two in a window count as one, which a share of a few per cent of them does.
    crowding = expected / searched * WINDOW_ROWS * WINDOW_COLUMNS
    assert crowding < 0.03
    assert (
        abs(len(found) - expected_above) < 3.0 * np.sqrt(expected_above) + crowding * expected_above
    )
    above = (law.cdf(found) - law.cdf(threshold)) / law.sf(threshold)
    assert stats.kstest(above, "uniform").pvalue > 1e-3
    # The wrong law is told: an exponential's events are no Polya's.
    other = stats.gamma(3.0 - shape, scale=seen / (3.0 - shape))
    wrong = (other.cdf(found) - other.cdf(threshold)) / other.sf(threshold)
    assert stats.kstest(wrong, "uniform").pvalue < 1e-3


def _window_share(camera: pulse_theory.EventCamera) -> float:
    """Share of a pulse's light in the window round its pixel, over all places within the pixel."""
    rows, columns = 2 * WINDOW_ROWS, WINDOW_COLUMNS
    table = pulse_theory.pixel_response(camera, 4 * rows, 4 * columns, pulse_theory.PHASES)
    pair = table + np.roll(table, pulse_theory.PHASES, axis=0)
    pair = sum(
        (
            tap * np.roll(pair, -n * pulse_theory.PHASES, axis=1)
            for n, tap in enumerate(camera.video_taps)
        ),
        start=0.0,
    )
    total = np.asarray(pair).shape
    row, col = total[0] // 2 - pulse_theory.PHASES, total[1] // 2
    # Places of an event that pixels of the window see: the peak's pixel is where most of the light
    # is.
    reach_rows, reach_columns = rows * pulse_theory.PHASES // 2, columns * pulse_theory.PHASES // 2
    inside = np.asarray(pair)[row - reach_rows : row + reach_rows, :]
    centre = int(np.argmax(np.asarray(pair).sum(axis=0)))
    inside = inside[:, centre - reach_columns : centre + reach_columns]
    assert abs(centre - col) < 2 * pulse_theory.PHASES
    return float(inside.sum()) / pulse_theory.PHASES**2 / 2.0
