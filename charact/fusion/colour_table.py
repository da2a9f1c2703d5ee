"""Natural colours by a table of visible and thermal values, made from a scene whose materials are
known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from charact.fusion.bands import Band, Image, Span, display_planes
from charact.fusion.checks import find_problems
from charact.fusion.fused import Fused, finish
from charact.fusion.noise_aware import deviations, restore_bands
from labdata.errors import BadInput

# Values of each band that a table tells apart, a step being below the noise of either band, and the
# Gaussian over them.
SIZE, SMOOTH = 64, 1.5


@dataclass(frozen=True, kw_only=True)
class ColourTable:
    """Colour for each pair of display values of two bands, and the spans in which they were shown.

    `colours`: red, green, blue, 0 to 1, shape (visible, thermal, 3), over both display ranges;
    `spans`: values shown as 0 and 1, of the first and the second band. A fixed table gives a
    material one colour over a sequence.
    """

    colours: Image
    spans: tuple[Span, Span]

    def save(self, path: Path) -> None:
        """Write an .npz of `colours` and `spans`."""
        np.savez_compressed(path, colours=self.colours, spans=np.array(self.spans))

    @classmethod
    def load(cls, path: Path) -> "ColourTable":
        """Read what `save` has written; anything else is BadInput."""
        try:
            with np.load(path) as file:
                colours, spans = (
                    np.asarray(file["colours"], np.float32),
                    np.asarray(file["spans"], float),
                )
            (a, b), (c, d) = spans
        except (OSError, ValueError, KeyError) as error:
            raise BadInput(
                f"a colour table must be an .npz of colours and spans, got {path}: {error}"
            ) from None
        if colours.ndim != 3 or colours.shape[2] != 3:
            raise BadInput(
                f"colours of a table must have the shape (visible, thermal, 3), got {colours.shape}"
            )
        return cls(colours=colours, spans=((float(a), float(b)), (float(c), float(d))))


def make_colour_table(
    bands: Sequence[Band],
    materials: NDArray[np.integer],
    colours: Mapping[int, tuple[float, float, float]],
) -> ColourTable:
    """Return the mean daylight colour of all pixels of a scene that have a pair of values.

    `bands`: visible and thermal frame of the scene; `materials`: number of the material of each
    pixel, (row, col), as in the truth of a simulated scene; `colours`: daylight colour (red, green,
    blue, 0 to 1) by that number, other pixels are left out. Sizes that differ, and no pixel with a
    colour, are BadInput.

    M. A. Hogervorst, A. Toet, Information Fusion 11 (2010) 69. Pairs that the scene does not have
    take the colour of the nearest one, and the table is smoothed, so that noise does not switch
    colours.
    """
    if len(bands) != 2 or materials.shape != bands[0].image.shape:
        got = f"{len(bands)} and {materials.shape}"
        raise BadInput(f"a colour table needs two bands and materials of their size, got {got}")
    planes = display_planes(bands, bloom=True)
    places = [np.clip(one * SIZE, 0, SIZE - 1).astype(int) for one in restore_bands(planes)[0]]
    known = np.isin(materials, list(colours))
    if not known.any():
        raise BadInput(f"a colour table needs pixels of the materials {sorted(colours)}, got none")
    cell = (places[0] * SIZE + places[1])[known]
    count = np.bincount(cell, minlength=SIZE**2).reshape(SIZE, SIZE)
    numbers = np.unique(materials)
    paint = np.array([colours.get(int(number), (0.0, 0.0, 0.0)) for number in numbers])
    own = paint[np.searchsorted(numbers, materials[known])]
    sums = np.stack(
        [np.bincount(cell, own[:, k], SIZE**2).reshape(SIZE, SIZE) for k in range(3)], axis=-1
    )
    nearest = distance_transform_edt(count == 0, return_distances=False, return_indices=True)
    table = (sums / np.maximum(count, 1)[..., None])[tuple(np.asarray(nearest))]
    table = cv2.GaussianBlur(
        table.astype(np.float32), (0, 0), SMOOTH, borderType=cv2.BORDER_REPLICATE
    )
    return ColourTable(colours=table, spans=(planes[0].span, planes[1].span))


def fuse_by_table(bands: Sequence[Band], table: ColourTable, *, uncertainty: bool = True) -> Fused:
    """Fuse two bands into the colours of a table; each band is restored as in `fuse_colour`.

    The standard deviation is that of the table's colours over the median noise of both bands,
    around the noisy value: up to twice the spread of repeated frames. The share of a band is that
    of its slope in the table.
    """
    if len(bands) != 2:
        raise BadInput(f"a colour table is of two bands, got {len(bands)}")
    spans = {band.name: span for band, span in zip(bands, table.spans, strict=True)}
    planes = display_planes(bands, bloom=True, spans=spans)
    restored, weights, finest = restore_bands(planes)
    sizes = table.colours.shape[:2]
    places = [
        np.clip(own * size - 0.5, 0.0, size - 1.0)
        for own, size in zip(restored, sizes, strict=True)
    ]
    picture = _look_up(table.colours, places)
    spread = None
    if uncertainty:
        own = zip(deviations(planes, weights), sizes, strict=True)
        rows, cols = (max(float(np.median(one)) * size, 0.1) for one, size in own)
        mean, square = (
            cv2.GaussianBlur(one, (0, 0), cols, sigmaY=rows)
            for one in (table.colours, table.colours**2)
        )
        sd = _look_up(np.sqrt(np.maximum(square - mean**2, 0.0)), places)
        parts = [
            np.abs(_look_up(slope, places)).sum(axis=-1) + 1e-6
            for slope in np.gradient(mean, axis=(0, 1))
        ]
        spread = sd, np.stack([part / sum(parts) for part in parts])
    findings, notes = find_problems(planes, finest)
    return finish("colour-table", planes, picture, spread, findings=findings, notes=notes)


def _look_up(table: Image, places: Sequence[Image]) -> Image:
    """Return the entries of a table at rows and columns, linearly interpolated."""
    rows, cols = (np.asarray(one, np.float32) for one in places)
    return cv2.remap(np.ascontiguousarray(table, np.float32), cols, rows, cv2.INTER_LINEAR)
