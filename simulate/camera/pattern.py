"""Fixed patterns: phosphor granularity, multi-fibre patterns, PRNU and DSNU."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from labdata.frames import read_only
from simulate.camera.grid import Grid, irfft_image, rfft_image

GRANULARITY_MM = 0.06


def _in_whole_rows(
    draw: Callable[..., NDArray[np.float32]], grid: Grid, *values: float
) -> NDArray[np.float32]:
    """The pattern on cells one row high: means of those half as high."""
    halves = draw(replace(grid, per_row=2, shape=(2 * grid.shape[0], grid.shape[1])), *values)
    return read_only(halves.reshape(-1, 2, halves.shape[1]).mean(axis=1, dtype=np.float32))


@lru_cache(maxsize=4)
def phosphor_granularity(grid: Grid, relative_sd: float, pattern_seed: int) -> NDArray[np.float32]:
    """Return the phosphor's gain on cells, mean 1, Gaussian with correlation length
    `GRANULARITY_MM` at the cathode.
    """
    if grid.per_row == 1:
        return _in_whole_rows(phosphor_granularity, grid, relative_sd, pattern_seed)
    rng = np.random.default_rng([pattern_seed, 1])
    fx, fy = grid.frequencies()
    grain = np.exp(-2.0 * (np.pi * GRANULARITY_MM * np.hypot(fx, fy)) ** 2)
    grain[0, 0] = 0.0
    smooth = irfft_image(rfft_image(rng.standard_normal(grid.shape)) * grain, grid.shape)
    return read_only((1.0 + relative_sd * smooth / smooth.std()).astype(np.float32))


@lru_cache(maxsize=4)
def multifibre_transmission(
    grid: Grid, contrast: float, pitch_mm: float, line_mm: float, demagnification: float
) -> NDArray[np.float32]:
    """Return the transmission of the borders between multi-fibres, 1 inside them and 1 - contrast
    on the lines.

    Hexagons of a pitch and a line width at the small end, laid out on cells at the photocathode.
    """
    if grid.per_row == 1:
        return _in_whole_rows(
            multifibre_transmission, grid, contrast, pitch_mm, line_mm, demagnification
        )
    rows, columns = (np.arange(n, dtype=np.float64) for n in grid.shape)
    y = rows[:, None] * (grid.pitch_y_mm / grid.per_row / demagnification / pitch_mm)
    x = columns[None, :] * (grid.pitch_x_mm / grid.per_column / demagnification / pitch_mm)
    border = _border_distance(x, y) * pitch_mm
    return read_only(
        (1.0 - contrast * np.exp(-0.5 * (border / (line_mm / 2.0)) ** 2)).astype(np.float32)
    )


@lru_cache(maxsize=4)
def multifibre_gain(
    grid: Grid, contrast: float, pitch_mm: float, line_mm: float
) -> NDArray[np.float32]:
    """Return the gain of an MCP of multi-fibres, mean 1, lower on the lines where its hexagons
    meet.

    Pitch and width are at the photocathode, where the cells are. Lines narrower than a cell are as
    wide and as shallow as a cell's average makes them.
    """
    cell_mm = np.sqrt(grid.cell_area_cm2) * 10.0
    averaged_mm = np.sqrt(line_mm**2 + cell_mm**2 / 3.0)
    lines = multifibre_transmission(
        grid, contrast * line_mm / averaged_mm, pitch_mm, averaged_mm, 1.0
    )
    return read_only((lines / lines.mean(dtype=np.float64)).astype(np.float32))


def _border_distance(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance to the nearest border of hexagons whose centres are one unit apart."""
    height = np.sqrt(3.0)
    distances = []
    for shift in (0.0, 0.5):
        dx = x - shift - np.round(x - shift)
        dy = y - shift * height - height * np.round((y - shift * height) / height)
        hexagon_distance = np.maximum(np.abs(dx), 0.5 * np.abs(dx) + 0.5 * height * np.abs(dy))
        distances.append(0.5 - hexagon_distance)
    return np.maximum(distances[0], distances[1])


@lru_cache(maxsize=4)
def dark_signal_map(
    shape: tuple[int, int], mean_e: float, sd_e: float, pattern_seed: int
) -> NDArray[np.float32]:
    """Return each pixel's mean dark charge, e-, gamma distributed over pixels: never below zero,
    some pixels hot.
    """
    rng = np.random.default_rng([pattern_seed, 3])
    shape_parameter = (mean_e / sd_e) ** 2
    return read_only(
        (rng.gamma(shape_parameter, size=shape) * (mean_e / shape_parameter)).astype(np.float32)
    )


@lru_cache(maxsize=4)
def offset_map(shape: tuple[int, int], sd_e: float, pattern_seed: int) -> NDArray[np.float32]:
    """Return each pixel's offset, e-, mean 0, independent from pixel to pixel."""
    rng = np.random.default_rng([pattern_seed, 5])
    return read_only((sd_e * rng.standard_normal(shape)).astype(np.float32))


@lru_cache(maxsize=4)
def multifibre_offsets(
    grid: Grid, pitch_mm: float, rms_mm: float, pattern_seed: int
) -> NDArray[np.float32]:
    """Return how far each multi-fibre is shifted, (x, y) on cells, shape (2, row, col), at the
    photocathode, mm.

    All of a hexagon of the multi-fibre pattern is shifted alike; across a border the shifts of two
    hexagons differ by `rms_mm`, root mean square. Pitch at the photocathode.
    """
    rows, columns = (np.arange(n, dtype=np.float64) for n in grid.shape)
    y = rows[:, None] * (grid.pitch_y_mm / grid.per_row / pitch_mm)
    x = columns[None, :] * (grid.pitch_x_mm / grid.per_column / pitch_mm)
    hexagon, row, col = _hexagons(x, y)
    rng = np.random.default_rng([pattern_seed, 4])
    # The lattice is drawn from its corner on, so a larger image has the same first hexagons only if
    # as wide.
    table = 0.5 * rms_mm * rng.standard_normal((2, 2, int(row.max()) + 2, int(col.max()) + 2))
    return read_only(table[:, hexagon, row, col].astype(np.float32))


def _hexagons(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """Indices (lattice, row, column) of the hexagon that holds each place, its centres one unit
    apart.
    """
    height = np.sqrt(3.0)
    distance, rows, col = [], [], []
    for shift in (0.0, 0.5):
        column = np.broadcast_to(np.round(x - shift), np.broadcast_shapes(x.shape, y.shape))
        row = np.broadcast_to(np.round(y / height - shift), column.shape)
        distance.append((x - shift - column) ** 2 + (y - (shift + row) * height) ** 2)
        col.append(column.astype(int) + 1)
        rows.append(row.astype(int) + 1)
    second = distance[1] < distance[0]
    return (
        second.astype(int),
        np.where(second, rows[1], rows[0]),
        np.where(second, col[1], col[0]),
    )


@lru_cache(maxsize=4)
def prnu_map(shape: tuple[int, int], relative_sd: float, pattern_seed: int) -> NDArray[np.float32]:
    """Return each pixel's response, mean 1, independent from pixel to pixel."""
    rng = np.random.default_rng([pattern_seed, 2])
    return read_only((1.0 + relative_sd * rng.standard_normal(shape)).astype(np.float32))
