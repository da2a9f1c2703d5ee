"""How far pictures are from a converged one of a path tracer."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.radiance.path_tracer import PathTracer
from benchmarks.radiance.scenes import Case
from simulate.radiance.geometry.ray_tracer import NOTHING
from simulate.radiance.integrator.subpixel_sources import add_small_sources

# Samples of one part of a reference; seeds of references begin here.
PART, FIRST_SEED = 512, 100
# Scenes in which a lamp lights a patch that rays from the eye find once in thousands: 2048 samples
# of the path tracer miss nine tenths of the light of many pixels. Their references have the sky by
# the path tracer, and what lamps send by way of other places by its particle tracer, of so many
# samples in a part.
SEEN_FROM_LAMPS, PARTICLES = ("road",), 8192
# Pixels so close to the horizon are left out: the path tracer blurs its sky's edge there, deg.
HORIZON_DEG = 0.3


@dataclass(frozen=True)
class Reference:
    """Independent pictures of one scene by many samples.

    Parameters
    ----------
    parts
        Shape (part, row, col).
    counts
        Pixels that count: not of lamps themselves, which only we show, nor at the horizon.
    """

    parts: NDArray[np.floating]
    counts: NDArray[np.bool_]

    @property
    def samples(self) -> int:
        """Samples of a pixel in all."""
        return PART * len(self.parts)

    @property
    def image(self) -> NDArray[np.floating]:
        """Mean of all parts."""
        return self.parts.mean(axis=0)

    def errors(self, image: NDArray[np.floating]) -> dict[str, float]:
        """Return the median relative error, the relative RMSE and the mean relative difference of a
        picture.

        Notes
        -----
        The RMSE is that of picture and truth: the noise of the reference, whose halves A and B know
        nothing of each other, falls out of the mean of (picture - A) (picture - B). The median
        keeps it.
        """
        scale = np.where(self.counts, self.image, 1.0)
        each = ((image - self.image) / scale)[self.counts]
        halves = [
            ((image - self.parts[first::2].mean(axis=0)) / scale)[self.counts] for first in (0, 1)
        ]
        return {
            "median": float(np.median(np.abs(each))),
            "rms": float(np.sqrt(max(float(np.mean(halves[0] * halves[1])), 0.0))),
            "mean": float(image[self.counts].sum() / self.image[self.counts].sum() - 1.0),
        }

    @property
    def noise(self) -> float:
        """Median relative error of the reference itself, by its halves."""
        a, b = (self.parts[first::2].mean(axis=0)[self.counts] for first in (0, 1))
        return float(np.median(np.abs(a - b) / (a + b)))


def reference(case: Case, tracer: PathTracer, folder: Path, samples: int) -> Reference:
    """Return the reference of a scene; parts that are kept in a folder are not rendered again."""
    parts = []
    for seed in range(FIRST_SEED, FIRST_SEED + samples // PART):
        path = folder / f"{case.name}-{PART}-{seed}.npy"
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            np.save(path, _part(case, tracer, seed).astype(np.float32))
        parts.append(np.load(path))
    found = np.array(parts, float)
    return Reference(found, _counts(case) & (found.mean(axis=0) > 0.0))


def _part(case: Case, tracer: PathTracer, seed: int) -> NDArray[np.floating]:
    """One of the independent pictures of a reference."""
    if case.name not in SEEN_FROM_LAMPS:
        return tracer.picture(case.name, PART, seed).image
    assert case.max_bounces is not None
    sky = tracer.picture(case.name, PART, seed, lights="sky").image
    direct = tracer.picture(case.name, PART, seed, lights="lamps", depth=2).image
    # Particles of the same seed go the same ways: what they bring at once falls out.
    all_ways, at_once = (
        tracer.picture(case.name, PARTICLES, seed, lights="lamps", by="ptracer", depth=depth).image
        for depth in (case.max_bounces + 2, 2)
    )
    return sky + direct + all_ways - at_once


def _counts(case: Case) -> NDArray[np.bool_]:
    rows, columns = case.view.shape
    lamps = np.zeros((rows * columns, 1), np.float32)
    add_small_sources(case.stage, case.view, lamps)
    row, col = (
        axis.ravel() + 0.5
        for axis in np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    )
    origin, towards = case.view.rays(row, col)
    level = np.abs(np.rad2deg(np.arcsin(towards[:, 2]))) < HORIZON_DEG
    away = case.stage.surfaces.tracer.first_hit(origin, towards) == NOTHING
    grown = np.pad((level & away).reshape(rows, columns), 1)
    horizon = np.logical_or.reduce(
        [grown[1 + i : rows + 1 + i, 1 : columns + 1] for i in (-1, 0, 1)]
    )
    return (lamps[:, 0] == 0.0).reshape(rows, columns) & ~horizon
