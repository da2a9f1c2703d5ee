"""Moments of simulated flats are those of theory and of photoelectrons followed one by one, at
every light level.

Tolerances are the physical ones asked of the simulator: mean 0.1 %, variance 0.5 %, skewness 2 %,
the value that one pixel in a thousand exceeds 0.5 %, covariances to four pixels 1 % of the
variance; beside them stand four standard errors of the samples drawn. CHARACT_TEST_SAMPLES
multiplies the samples.
"""

import os
from collections.abc import Iterator
from functools import cache
from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from labdata import Camera, Conditions
from simulate.camera import CameraModel, StageImage
from tests.simulate import event_by_event as slow
from tests.simulate.samplers import Sampler, drawn_by

LEVELS = (0.05, 0.5, 5.0, 50.0, 500.0)
SHAPES = {"exponential": 1.0, "Polya 2": 2.0}
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
    pytest.param(tier, level, shape, id=f"{tier}-{name}-{level:g}")
    for tier, levels in AFFORDED.items()
    for level in levels
    for name, shape in SHAPES.items()
    if shape == 1.0 or (tier == "fast" and level in (LEVELS[0], LEVELS[-1]))
]


def drawn(
    sensor: Camera, at_mcp: StageImage, frames: int, seed: int, tier: Sampler
) -> Iterator[NDArray[Any]]:
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
) -> Iterator[NDArray[Any]]:
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
    camera = slow.of_sensor(sensor)
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
) -> tuple[slow.Moments, slow.Moments, float]:
    """Moments of a flat in `BLOCKS` of so many frames, their errors, e- above black, and the
    digitiser's step, e-.
    """
    fine = in_fine_steps(sensor, level)
    step_e = 1.0 / float(fine.video.conversion_gain_dn_per_e)
    blocks = islice(flat_frames(fine, level, frames, seed, tier), BLOCKS)
    charge = ((block[:, :, LINE_START_PX:] - BLACK_DN) * step_e for block in blocks)
    return *slow.measured(charge, slow.of_sensor(sensor).charge_e * level), step_e


@pytest.fixture(scope="module")
def flats(plain, seed):
    """Moments of flats by tier, level and shape, each drawn once."""

    @cache
    def make(tier: Sampler, level: float, shape: float):
        sensor = plain(240, 320, microchannel_plate__pulse_height_shape=shape)
        frames = round(AFFORDED[tier][level] * SAMPLES)
        found, error, step_e = measured_flat(sensor, level, frames, seed, tier)
        return slow.of_sensor(sensor), found, error, step_e

    return make


def departures(found: slow.Moments, expected: slow.Moments, *errors: slow.Moments) -> list[str]:
    """Return the statistics that depart by more than the tolerance and the errors, in words."""
    wrong = []
    for name, share in TOLERANCE.items():
        error = np.sqrt(sum(getattr(e, name) ** 2 for e in errors))
        allowed = share * abs(getattr(expected, name)) + ERRORS * error
        if abs(getattr(found, name) - getattr(expected, name)) > allowed:
            wrong.append(
                f"{name}: {getattr(found, name):.6g}, not {getattr(expected, name):.6g} +- "
                f"{allowed:.2g}"
            )
    for name in ("horizontal", "vertical"):
        error = np.sqrt(sum(getattr(e, name) ** 2 for e in errors))
        off = np.abs(getattr(found, name) - getattr(expected, name))
        wrong += [
            f"{name} lag {lag + 1}: off by {off[lag] / expected.variance:.4f} of the variance"
            for lag in np.flatnonzero(off > 0.01 * expected.variance + ERRORS * error)
        ]
    return wrong


@pytest.mark.parametrize(("tier", "level", "shape"), CASES)
def test_flats_have_the_moments_of_campbells_theorem(tier, level, shape, flats):
    camera, found, error, step_e = flats(tier, level, shape)
    expected = slow.campbell(camera, level / camera.rows_summed, step_e=step_e)
    assert not departures(found, expected, error)


# Variance from column to column under stripes eight pixels wide, a tenth of the light in their dark
# half: where the streamed tier, which lays its noise a little wider than pulses do, is set right
# but for the finest detail.
STRIPES: dict[Sampler, float] = {"fast": 0.015, "chain": 5e-3}


PERIOD_PX, STRIPES_PE = 8, 6.0


def stripes(x_px: NDArray[Any]) -> NDArray[Any]:
    return STRIPES_PE * (1.0 + 0.9 * np.sin(2.0 * np.pi * x_px / PERIOD_PX))


@pytest.fixture(scope="module")
def striped_events(plain, seed) -> NDArray[Any]:
    """Frames of stripes, photoelectron by photoelectron."""
    side, sensor = 96, in_fine_steps(plain(240, 320), 2.0 * STRIPES_PE)
    expected = np.repeat(
        stripes((np.arange(side * slow.PHASES) + 0.5) / slow.PHASES)[None] / 2.0, side, axis=0
    )
    stream = slow.frames(slow.of_sensor(sensor), expected, shape=(side, side), seed=seed)
    return np.stack(list(islice(stream, 120)))


@pytest.mark.parametrize("tier", AFFORDED)
def test_stripes_have_the_mean_and_variance_of_single_events(tier, plain, striped_events, seed):
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
    for power, tolerance in ((1, 1e-3), (2, STRIPES[tier])):
        ours, our_error = _by_phase(charge, PERIOD_PX, power)
        theirs, their_error = _by_phase(striped_events, PERIOD_PX, power)
        off = (ours - theirs) / theirs
        error = np.hypot(our_error, their_error) / theirs
        assert np.all(np.abs(off) < tolerance + ERRORS * error), (
            f"off by {off.round(4)}, errors {error.round(4)}"
        )
        assert np.all(error < 0.015)


def _by_phase(frames: NDArray[Any], period: int, power: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Mean or variance of each column of the stripes' period, and its error by blocks of frames."""
    columns = frames.reshape(*frames.shape[:2], -1, period)
    if power == 2:
        columns = (columns - columns.mean(axis=(0, 1, 2))) ** 2
    blocks = np.stack([block.mean(axis=(0, 1, 2)) for block in np.array_split(columns, 12)])
    return blocks.mean(axis=0), blocks.std(axis=0, ddof=1) / np.sqrt(12.0)
