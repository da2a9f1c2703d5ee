"""Light and gain on cells, two to a pixel both ways, gathered into the planes of a kernel's
lattice.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simulate.camera.chain import Chain, Slot
from simulate.camera.fast_sampler.kernel import COARSE, FINEST, REACH
from simulate.camera.grid import Grid
from simulate.camera.stage_image import StageImage

# Cells to a pixel pitch, and positions in a cell, both ways.
CELLS, POSITIONS = 2, FINEST // 2


def cell_gain(chain: Chain, at_mcp: StageImage, divisions: tuple[int, int]) -> NDArray[np.float64]:
    """CCD electrons for each detected photoelectron, in planes of cells; where nothing falls, as on
    average.
    """
    mcp = chain[Slot.MCP]
    without_ions = chain.between(Slot.MCP, Slot.TAPER).replacing(
        replace(mcp, ion_events_per_s_cm2=0.0)
    )
    output, photoelectrons = (
        gather_planes(without_ions.mean(at_mcp).values, divisions),
        gather_planes(at_mcp.values, divisions),
    )
    average = output.sum() / photoelectrons.sum() if photoelectrons.sum() > 0.0 else 0.0
    is_lit = photoelectrons > 1e-9 * max(float(photoelectrons.max()), 1e-300)
    gain = np.divide(output, photoelectrons, out=np.full(output.shape, average), where=is_lit)
    return gain * chain[Slot.CCD].quantum_efficiency / mcp.detection_probability


def gather_planes(values: NDArray[np.floating], divisions: tuple[int, int]) -> NDArray[np.float64]:
    """Gather cells, two a pixel both ways, into planes of so many cells a row and a column, shape
    (plane, row, col).
    """
    per_row, per_column = divisions
    rows, cols = values.shape[0] // 2, values.shape[1] // 2
    cells = values.reshape(rows, per_row, 2 // per_row, cols, per_column, 2 // per_column).sum(
        axis=(2, 5), dtype=np.float64
    )
    return cells.transpose(1, 3, 0, 2).reshape(per_row * per_column, rows, cols)


def interleave_planes(planes: NDArray) -> NDArray:
    """Planes of cells, two a pixel both ways, as one image of them."""
    _, rows, cols = planes.shape
    return planes.reshape(2, 2, rows, cols).transpose(2, 0, 3, 1).reshape(2 * rows, 2 * cols)


def cut_to_frame(planes: NDArray, grid: Grid) -> NDArray:
    """Cells under the kernels of the frame's pixels, filled up with empty ones to whole coarse
    cells.
    """
    first_row, first_col = grid.margin_rows - REACH, grid.margin_columns - REACH
    stop = first_row + grid.rows + 2 * REACH, first_col + grid.columns + 2 * REACH
    frame_cells = planes[:, first_row : stop[0], first_col : stop[1]]
    padding = [(0, (-n) % COARSE) for n in frame_cells.shape[1:]]
    return np.pad(frame_cells, ((0, 0), *padding))
