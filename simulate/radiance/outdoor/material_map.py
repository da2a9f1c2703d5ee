"""A picture says which material lies where on a plane: stains, markings, a sign, each with a spectrum of its own."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.radiance.outdoor.shapes import Mesh

# Runs of one material along a row are one rectangle each; a picture of more is a photograph and no map.
MOST_RUNS = 500_000


def split_by_material(path: Path, size_m: tuple[float, ...], materials: Sequence[str]) -> list[tuple[str, Mesh]]:
    """Return a plane in parts, one for each material of a picture that covers it.

    Parameters
    ----------
    path
        A picture of one channel whose values are numbers into the materials, 0 the first; its first row lies at +y, its
        first column at -x.
    size_m
        Size of the plane, (x, y), m.
    materials
        Names of materials.

    Raises
    ------
    BadInput
        If the picture cannot be read, holds other numbers, or changes too often for a map.
    """
    from labdata.importers import read_frames

    values = np.asarray(read_frames(path).data[0])
    wrong = values[(values < 0) | (values >= len(materials)) | (values != np.round(values))]
    if wrong.size:
        raise BadInput(
            f"a material map must hold whole numbers from 0 to {len(materials) - 1}, got {wrong.flat[0]:g} "
            f"in {path.name}"
        )
    row, first, last, number = _runs(values.astype(np.int64))
    if len(row) > MOST_RUNS:
        raise BadInput(
            f"a material map must change at most {MOST_RUNS} times along its rows, got {len(row)} in {path.name}"
        )
    rows, columns = values.shape
    x = np.stack([first, last], axis=1) / columns * size_m[0] - 0.5 * size_m[0]
    y = 0.5 * size_m[1] - np.stack([row, row + 1], axis=1) / rows * size_m[1]
    return [
        (name, _rectangles(x[number == which], y[number == which]))
        for which, name in enumerate(materials)
        if (number == which).any()
    ]


def _runs(values: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Row, first and last column and number of each run of one number along a row."""
    columns = values.shape[1]
    begins = np.ones(values.shape, bool)
    begins[:, 1:] = values[:, 1:] != values[:, :-1]
    place = np.flatnonzero(begins)
    row, first = place // columns, place % columns
    last = np.append(first[1:], 0)
    last[last == 0] = columns
    return row, first, last, values.ravel()[place]


def _rectangles(x: NDArray[np.float64], y: NDArray[np.float64]) -> Mesh:
    """Rectangles at z = 0 that face up, x from left to right and y from top to bottom, each of shape (rectangle, 2)."""
    corners = np.stack([x[:, [0, 1, 1, 0]], y[:, [1, 1, 0, 0]], np.zeros((len(x), 4))], axis=-1)
    first = 4 * np.arange(len(x))[:, None]
    halves = [first + np.array(half) for half in ([0, 1, 2], [0, 2, 3])]
    return Mesh(corners.reshape(-1, 3), np.concatenate(halves))
