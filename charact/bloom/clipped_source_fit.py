"""Least squares for the light of clipped sources: what one unit of it leaves in the pixels around them.

The pixels around that are not clipped say how bright the halo is; the clipped ones say "at least so much", and count
only while the model is below their code.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.lattice import FrameGrid, profiles
from charact.bloom.posterior_psf import PosteriorPsf

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Columns on either side of a source that overflow and smear fill.
STREAK_PX = 2
# Share by which the spread may be off where it is far above the noise, and by how many px where it is steep.
MODEL_SHARE, MODEL_PX = 0.05, 0.25
# Most pixels of a group of sources that enter the fit, and how many of them share their noise.
MOST_PIXELS, SHARING = 4000, 10.0
ROUNDS = 8


@dataclass(frozen=True, kw_only=True)
class Guess:
    """What a clipped source may be: a point in the middle of some pixels, or an even patch over them."""

    shape: str
    lit: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """The pixels that tell the light of a group of sources near each other."""

    places: NDArray[np.int64]
    signal: Array
    sd: Array
    floor: Array
    thinned: int


def surroundings(
    regions: list[NDArray[np.int64]], signal: NDArray, clipped: Mask, lattice: FrameGrid, reach: float, margin: int,
    *, noise_dn: NDArray, clip_dn: float,
) -> Surroundings:  # fmt: skip
    """Pixels near any source of the group, and the clipped ones, which say "at least"."""
    from scipy import ndimage

    spoilt = np.asarray(ndimage.binary_dilation(clipped, np.ones((2 * margin + 1,) * 2, bool)), bool)
    away = np.ones(signal.shape, bool)
    for region in regions:
        _, col = lattice.middle(region)
        away.ravel()[region] = False
        spoilt[:, np.abs(np.arange(signal.shape[1]) - col) <= STREAK_PX] = True
    near = np.asarray(ndimage.distance_transform_edt(away, sampling=(lattice.pitch_ratio, 1.0))) < reach
    open_px = np.flatnonzero(near & ~spoilt)
    step = -(-len(open_px) // MOST_PIXELS) if len(open_px) else 1
    open_px = open_px[::step]
    shut = np.concatenate(regions)
    shut = shut[:: max(1, len(shut) // (MOST_PIXELS // 4))]
    places = np.concatenate([open_px, shut])
    values = np.asarray(signal, float).ravel()[places]
    floor = np.concatenate([np.zeros(len(open_px), bool), np.ones(len(shut), bool)])
    steep = np.hypot(*np.gradient(np.asarray(signal, float))).ravel()[places] * (1.0 - floor.astype(float))
    sd = np.sqrt(noise_dn.ravel()[places] ** 2 + (MODEL_SHARE * values) ** 2 + (MODEL_PX * steep) ** 2)
    return Surroundings(places=places, signal=np.where(floor, clip_dn, values), sd=sd, floor=floor.astype(float),
                        thinned=step)  # fmt: skip


def tables(spread: PosteriorPsf, lattice: FrameGrid) -> tuple[Array, Array]:
    """Density against distance and transfer against frequency of every draw."""
    return profiles(spread), spread.transfer(lattice.frequency)


def templates(
    guesses: list[Guess], tables: tuple[Array, Array], draw: int, lattice: FrameGrid, around: Surroundings
) -> Array:
    """What one unit of light of every source leaves in the pixels around, shape (pixel, source)."""
    laid = [
        lattice.point_image(lattice.middle(guess.lit), tables[0][draw], around.places)
        if guess.shape == "point"
        else lattice.patch(guess.lit, tables[1][draw]).ravel()[around.places]
        for guess in guesses
    ]
    return np.stack(laid, axis=1).astype(np.float64)


@dataclass(frozen=True, kw_only=True)
class ClippedSourceFit:
    """Light of the sources of a group, DN px, its standard errors, and the misfit: of the usual pixel, and rms."""

    light: Array
    sd: Array
    misfit: float
    rms: float


def fit(templates: Array, around: Surroundings) -> ClippedSourceFit:
    """Weighted least squares with a common background; a clipped pixel counts only while the model is below its code.

    What departs by more than twice its standard deviation counts less (Huber): a scene has other things in it.
    """
    design = np.concatenate([templates, np.ones((len(templates), 1))], axis=1)
    scale = np.abs(design).max(axis=0)
    weight = (around.floor == 0) / around.sd
    best = np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        best = np.linalg.lstsq(design / scale * weight[:, None], around.signal * weight, rcond=None)[0]
        pull = (design / scale @ best - around.signal) / around.sd
        counted = (around.floor == 0) | (pull < 0)
        weight = counted / around.sd * np.minimum(1.0, np.sqrt(2.0 / np.maximum(np.abs(pull), 1e-9)))
    # Half of the pixels may show other things of the scene.
    misfit = 1.4826 * float(np.median(np.abs(pull[counted])))
    rms = float(np.sqrt(np.mean(np.minimum(pull[counted] ** 2, 100.0))))
    normal = (design / scale * weight[:, None]).T @ (design / scale * weight[:, None])
    covariance = np.linalg.pinv(normal) * SHARING * max(misfit, 0.3) ** 2
    return ClippedSourceFit(
        light=(best / scale)[:-1], sd=(np.sqrt(np.diag(covariance)) / scale)[:-1], misfit=misfit, rms=rms
    )
