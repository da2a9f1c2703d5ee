"""Charts of exactly known MTF made of many targets: tilted squares, an edge, bars and pinholes on
one frame.
"""

from dataclasses import dataclass, field

import numpy as np

from tests.truth.blur import Array, TrueBlur
from tests.truth.camera_effects import correlate_noise
from tests.truth.edge import edge_spread


@dataclass(frozen=True, kw_only=True)
class TiltedSquares:
    """Dark squares on a bright ground, each turned by the same angle, blurred exactly on every
    side.

    Within a corner the blur of a separable half plane product is taken; beyond four blurs of it an
    edge is exact.
    """

    blur: TrueBlur = field(default_factory=TrueBlur)
    rows: int = 493
    cols: int = 768
    down: int = 1
    across: int = 5
    side_px: float = 84.0
    tilt_deg: float = 6.0
    dark_dn: float = 600.0
    bright_dn: float = 2600.0

    def centres(self) -> list[tuple[float, float]]:
        """Return (row, col) of the squares' middles."""
        rows = (np.arange(self.down) + 0.5) * self.rows / self.down - 0.5
        cols = (np.arange(self.across) + 0.5) * self.cols / self.across - 0.5
        return [(float(row), float(col)) for row in rows for col in cols]

    def edges(self) -> list[tuple[float, float, float]]:
        """Return (row, col) of the middle of every edge and the direction of its normal, degrees in
        [0, 180).
        """
        edges = []
        for row, col in self.centres():
            for turn in range(4):
                angle = np.deg2rad(self.tilt_deg + 90.0 * turn)
                half = self.side_px / 2
                middle = (row + half * np.sin(angle), col + half * np.cos(angle))
                edges.append((*middle, float(np.rad2deg(angle)) % 180.0))
        return edges

    def mean(self) -> Array:
        """Return the noiseless frame, DN, shape (row, col)."""
        covered = np.zeros((self.rows, self.cols))
        row, col = np.mgrid[: self.rows, : self.cols].astype(float)
        angle = np.deg2rad(self.tilt_deg)
        for middle_row, middle_col in self.centres():
            x = (col - middle_col) * np.cos(angle) + (row - middle_row) * np.sin(angle)
            y = (row - middle_row) * np.cos(angle) - (col - middle_col) * np.sin(angle)
            covered += self._slab(x, self.tilt_deg) * self._slab(y, self.tilt_deg + 90.0)
        return self.bright_dn - (self.bright_dn - self.dark_dn) * covered

    def _slab(self, distance: Array, angle_deg: float) -> Array:
        """Return a blurred strip of the square's width."""
        half = self.side_px / 2
        return edge_spread(self.blur, distance + half, angle_deg) - edge_spread(
            self.blur, distance - half, angle_deg
        )


def noisy(
    mean: Array,
    rng: np.random.Generator,
    *,
    sd_dn: float,
    shot_share: float = 0.0,
    blur_px: float = 0.0,
) -> np.ndarray:
    """Return one frame with noise of a standard deviation half way up, a share of its variance
    growing with light.
    """
    half_way = 0.5 * (mean.max() + mean.min())
    variance = sd_dn**2 * (1.0 - shot_share + shot_share * mean / half_way)
    drawn = correlate_noise((np.sqrt(variance) * rng.standard_normal(mean.shape))[None], blur_px)[0]
    return np.clip(np.rint(mean + drawn), 0, 4095).astype(np.uint16)


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Where a group of bright bars stands: its middle, frequency, number, and the direction across
    it.
    """

    row: float
    col: float
    frequency: float
    bars: int = 4
    angle_deg: float = 0.0
    aspect: float = 7.0


@dataclass(frozen=True, kw_only=True)
class BarChart:
    """Groups of bars on a dark ground, blurred exactly but at the bars' corners."""

    groups: tuple[Bars, ...]
    blur: TrueBlur = field(default_factory=lambda: TrueBlur(sigma_px=0.7))
    rows: int = 493
    cols: int = 768
    dark_dn: float = 300.0
    bright_dn: float = 2300.0

    def mean(self) -> Array:
        """Return the noiseless frame, DN, shape (row, col)."""
        light = np.zeros((self.rows, self.cols))
        for group in self.groups:
            half_size = 0.5 * max(group.bars, group.aspect / 2) / group.frequency * 1.5 + 12
            first_row, first_col = (
                max(int(group.row - half_size), 0),
                max(int(group.col - half_size), 0),
            )
            cut = (
                slice(first_row, int(group.row + half_size)),
                slice(first_col, int(group.col + half_size)),
            )
            part = light[cut]
            row = np.arange(first_row, first_row + part.shape[0])[:, None] - group.row
            col = np.arange(first_col, first_col + part.shape[1])[None, :] - group.col
            angle = np.deg2rad(group.angle_deg)
            across, along = (
                col * np.cos(angle) + row * np.sin(angle),
                row * np.cos(angle) - col * np.sin(angle),
            )
            width = 0.5 / group.frequency
            strip = self._slab(along, group.angle_deg + 90.0, group.aspect * width)
            for centre in (np.arange(group.bars) - (group.bars - 1) / 2) / group.frequency:
                part += self._slab(across - centre, group.angle_deg, width) * strip
        return self.dark_dn + (self.bright_dn - self.dark_dn) * light

    def _slab(self, distance: Array, angle_deg: float, width: float) -> Array:
        ends = (edge_spread(self.blur, distance + sign * width / 2, angle_deg) for sign in (1, -1))
        return next(ends) - next(ends)
