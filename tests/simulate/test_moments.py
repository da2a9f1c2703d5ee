"""Moments of simulated flats and stripes are those of the theory of pulses, at every light level.

Tolerances are the physical ones asked of the simulator: mean 0.1 %, variance 0.5 %, skewness 2 %,
the value that one pixel in a thousand exceeds 0.5 %, covariances to four pixels 1 % of the
variance; beside them stand four standard errors of the samples drawn. CHARACT_TEST_SAMPLES
multiplies the samples.
"""

import os
from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest

from labdata import Array, Camera, Conditions
from simulate.camera import CameraModel, StageImage
from tests.simulate import pulse_theory
from tests.simulate.samplers import Sampler, drawn_by

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
