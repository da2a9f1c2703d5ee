"""Directions drawn by how bright the sky is there: the glow around sun and moon, which rays by the cosine law miss.

A degree from the sun the sky is thousands of times as bright as elsewhere. Places that gather the sky by rays would
meet that glow once in many hundred and be far too bright then; they look for it by name as for a lamp, and share it
with what gathering finds of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport.environment_map import EnvironmentMap, azimuth_turns

Array = NDArray[np.floating]
# Mean square of the radiance over the square of its mean, over the hemisphere, from which on it is worth the rays.
UNEVEN = 2.0


@dataclass(frozen=True)
class SkyImportance:
    """Chances of the cells between the entries of a dome's table, as the light that they hold.

    Parameters
    ----------
    cumulated
        Chance that a draw falls on a cell up to each, height by height, shape (cell,).
    per_sr
        Density in each, sr-1, shape (height, azimuth).
    """

    cumulated: NDArray[np.float64]
    per_sr: NDArray[np.float64]

    @classmethod
    def of(cls, dome: EnvironmentMap) -> "SkyImportance | None":
        """Return the draw of a sky, or None where its light is so even that nothing is gained."""
        if dome.dark:
            return None
        corners = dome.radiance_table.sum(axis=2, dtype=np.float64)
        mean = 0.25 * (corners[:-1, :-1] + corners[1:, :-1] + corners[:-1, 1:] + corners[1:, 1:])
        sine = np.sin(np.linspace(0.0, 0.5 * np.pi, len(mean) + 1))
        cell_sr = np.broadcast_to(np.diff(sine)[:, None] * 2.0 * np.pi / mean.shape[1], mean.shape)
        light = mean * cell_sr
        if 2.0 * np.pi * (mean * light).sum() < UNEVEN * light.sum() ** 2:
            return None
        chance = light / light.sum()
        return cls(np.cumsum(chance.ravel()), chance / cell_sr)

    def draw(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw unit directions, evenly over the solid angle of each cell, shape (count, 3)."""
        heights, around = self.per_sr.shape
        cell = np.minimum(np.searchsorted(self.cumulated, rng.random(count), side="right"), self.per_sr.size - 1)
        sine = np.sin(np.linspace(0.0, 0.5 * np.pi, heights + 1))
        row, col = np.divmod(cell, around)
        up = sine[row] + rng.random(count) * (sine[row + 1] - sine[row])
        turn = 2.0 * np.pi * (col + rng.random(count)) / around
        flat = np.sqrt(np.maximum(1.0 - up**2, 0.0))
        return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), up])

    def density(self, direction: Array) -> NDArray[np.float64]:
        """Return the density of `draw` in unit directions (ray, 3), sr-1, zero below the horizon."""
        heights, around = self.per_sr.shape
        row = np.arcsin(np.clip(direction[:, 2], 0.0, 1.0)) / (0.5 * np.pi) * heights
        col = azimuth_turns(direction) * around
        cell = np.minimum(row.astype(np.int64), heights - 1), np.minimum(col.astype(np.int64), around - 1)
        return np.where(direction[:, 2] >= 0.0, self.per_sr[cell], 0.0)
