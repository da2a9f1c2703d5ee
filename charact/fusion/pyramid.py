"""Laplacian pyramids of OpenCV, and what they do to noise: variances of levels and of pictures
built from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from charact.fusion.thresholds import FUSION

Array = NDArray[np.float64]
Image = NDArray[Any]  # float32


def level_count(shape: tuple[int, ...]) -> int:
    """Return the number of detail levels of an image, 2 to 5, whose coarsest side is 6 px or
    more.
    """
    return int(
        np.clip(
            np.log2(max(min(shape[:2]) / FUSION.coarsest_px, 4.0)),
            FUSION.map_level,
            FUSION.most_levels,
        )
    )


def reduce_image(image: Image, levels: int) -> list[Image]:
    """Return the Gaussian pyramid: the image and `levels` images of half the size each."""
    out = [image]
    for _ in range(levels):
        out.append(cv2.pyrDown(out[-1]))
    return out


def map_samples(image: NDArray[Any]) -> NDArray[Any]:
    """Return every fourth row and column of a picture: the pixels of `FUSION.map_level`."""
    step = 2**FUSION.map_level
    return image[::step, ::step].copy()


def halved(image: Image, times: int) -> Image:
    """Return the means over blocks of 2 x 2 px, taken several times; of odd sizes the blocks
    overlap slightly.
    """
    for _ in range(times):
        rows, cols = image.shape
        image = cv2.resize(
            image, ((cols + 1) // 2, (rows + 1) // 2), interpolation=cv2.INTER_LINEAR
        )
    return image


def resized(image: Image | np.float32 | float, shape: tuple[int, int]) -> Image:
    """Return a map at a shape (row, col), linearly interpolated; a number is the same
    everywhere.
    """
    if np.ndim(image) == 0:
        return np.full(shape, image, np.float32)
    image = np.asarray(image, np.float32)
    return (
        image
        if image.shape == shape
        else cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR)
    )


def expand(image: Image, shape: tuple[int, ...], out: Image | None = None) -> Image:
    """Return an image expanded to the shape (row, col) of the next finer level, in `out` if there
    is one.
    """
    return cv2.pyrUp(image, out, dstsize=(shape[1], shape[0]))


def decompose(image: Image, levels: int) -> list[Image]:
    """Return the Laplacian pyramid: `levels` detail images, finest first, and the base.

    L_l = G_l - expand(G_(l+1)), G_(l+1) = reduce(G_l), with the taps (1, 4, 6, 4, 1)/16 (Burt and
    Adelson 1983, a = 3/8).
    """
    smooth = reduce_image(image, levels)
    details = [expand(coarse, fine.shape) for fine, coarse in pairwise(smooth)]
    for fine, detail in zip(smooth, details, strict=False):
        cv2.subtract(fine, detail, detail)
    return [*details, smooth[-1]]


def collapse(pyramid: list[Image]) -> Image:
    """Return the image of a Laplacian pyramid."""
    image = pyramid[-1]
    for detail in reversed(pyramid[:-1]):
        image = expand(image, detail.shape)
        cv2.add(image, detail, image)
    return image


def weigh(image: Image, weight: Image | np.float32 | float, out: Image | None = None) -> Image:
    """Return an image times a number or a map of any size, written to `out` if there is one.

    New arrays of a whole frame cost more than the arithmetic: the memory is returned to the system
    each time.
    """
    if np.ndim(weight) == 0:
        return cv2.addWeighted(image, float(weight), image, 0.0, 0.0, out)
    out = cv2.resize(
        np.asarray(weight, np.float32), image.shape[::-1], out, interpolation=cv2.INTER_LINEAR
    )
    return cv2.multiply(image, out, out)


def weighted_sum(images: Sequence[Image], weights: Sequence[Image | np.float32 | float]) -> Image:
    """Return the sum of images times weights, numbers or maps of any size."""
    total, scratch = weigh(images[0], weights[0]), None
    for image, weight in zip(images[1:], weights[1:], strict=True):
        if np.ndim(weight) == 0:
            cv2.scaleAdd(image, float(weight), total, total)
        else:
            scratch = weigh(image, weight, scratch)
            cv2.add(total, scratch, total)
    return total


def fill_holes(image: Image, hole: NDArray[np.bool_]) -> Image:
    """Return the image with a hole filled by means of known blocks of 4 x 4 px, see
    `fill_means`.
    """
    seen = (~hole).view(np.uint8)
    known = halved(seen.astype(np.float32), 2)
    filled = fill_means(halved(cv2.copyTo(image, seen), 2), known)
    fill = cv2.resize(filled, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return cv2.copyTo(image, seen, fill)


def fill_means(sums: Image, known: Image) -> Image:
    """Return means from sums over the known share of each pixel; with less than half known, the
    next coarser one.
    """
    levels = level_count(known.shape) + 1
    weights = reduce_image(known, levels)
    totals = reduce_image(sums, levels)
    mean = np.float32(cv2.sumElems(sums)[0] / max(cv2.sumElems(known)[0], 1e-3))
    filled = np.where(weights[-1] > 0.02, totals[-1] / np.maximum(weights[-1], 0.02), mean)
    for total, weight in zip(totals[-2::-1], weights[-2::-1], strict=True):
        trust = np.clip(2.0 * weight, 0.0, 1.0)
        filled = trust * (total / np.maximum(weight, 1e-3)) + (1.0 - trust) * expand(
            filled, total.shape
        )
    return filled.astype(np.float32)


@dataclass(frozen=True)
class NoiseGains:
    """Variances by a pyramid for noise of power 1 at low frequency.

    `detail`: variance of a coefficient of each level, the base last, shape (level + 1,); `joint`:
    covariances of the pictures G_l expanded to full size, shape (level + 1, level + 1). `pixel` is
    the variance of a pixel.
    """

    detail: Array
    joint: Array

    @property
    def pixel(self) -> float:
        """Variance of a pixel over the noise power."""
        return float(self.joint[0, 0])


def _matrices(levels: int) -> tuple[list[Array], list[Array], list[Array]]:
    """Return the matrices of G_l, of its expansion by one level, and of G_l at full size, of a
    periodic line.
    """
    reduced, ups, grown = [np.eye(8 << levels)], [], [np.eye(8 << levels)]
    back = grown[0]
    for _ in range(levels):
        coarse = len(reduced[-1]) // 2
        up, at = np.zeros((2 * coarse, coarse)), np.arange(coarse)
        for tap, weight in zip((-2, -1, 0, 1, 2), (1, 4, 6, 4, 1), strict=True):
            up[(2 * at + tap) % (2 * coarse), at] = weight / 8.0
        back = back @ up
        reduced.append(0.5 * up.T @ reduced[-1])
        ups.append(up)
        grown.append(back @ reduced[-1])
    return reduced, ups, grown


def _gaussians(size: int, sigma: float) -> Array:
    """Return a Gaussian of peak 1 around each pixel of a periodic line, shape (pixel, pixel)."""
    away = np.minimum(np.arange(size), size - np.arange(size))
    line = np.exp(-0.5 * (away / sigma) ** 2)
    return np.stack([np.roll(line, shift) for shift in range(size)])


@cache
def noise_gains(blur_px: float, levels: int) -> NoiseGains:
    """Return the variances of noise that is white, then blurred by a Gaussian of `blur_px`.

    Blur and pyramid are separable: covariances are squares of those of a line of pixels, averaged
    over the phases of the levels, without simulation.
    """
    reduced, ups, grown = _matrices(levels)
    blur = _gaussians(len(grown[0]), max(blur_px, 1e-3))
    blur = blur / blur[0].sum()
    covariance = blur @ blur.T

    def mean_square(first: Array, second: Array) -> float:
        return float(np.sum((first @ covariance) * second, axis=1).mean() ** 2)

    detail = []
    for fine, coarse, up in zip(reduced, reduced[1:], ups, strict=False):
        smooth = up @ coarse
        detail.append(
            mean_square(fine, fine) - 2.0 * mean_square(fine, smooth) + mean_square(smooth, smooth)
        )
    detail.append(mean_square(reduced[-1], reduced[-1]))
    joint = np.array([[mean_square(one, other) for other in grown] for one in grown])
    return NoiseGains(np.array(detail), joint)


@cache
def object_response(levels: int) -> Array:
    """Return the share of each level, the base last, in the centre of a Gaussian object of 3 px,
    shape (level + 1,).
    """
    grown = _matrices(levels)[2]
    objects = _gaussians(len(grown[0]), FUSION.object_px)
    centre = [float(np.einsum("ij,ij->i", one, objects).mean() ** 2) for one in grown]
    return np.array([*(-np.diff(centre)), centre[-1]])


def variance_of(weights: list[Image], joint: Array) -> Image:
    """Return the variance of a picture built with slowly varying weights of each level, per noise
    power.

    `weights`: maps of one shape for each detail level and the base; `joint`: see `NoiseGains`.
    sum_l w_l (A_l - A_(l+1)) = sum_l (w_l - w_(l-1)) A_l with A_l x = G_l expanded, so that the
    variance is a quadratic form of the differences of the weights in the covariances of A_l.
    """
    stacked = np.stack([np.asarray(one, np.float32).ravel() for one in weights])
    steps = np.diff(stacked, axis=0, prepend=np.float32(0.0))
    found = np.einsum("ln,ln->n", steps, joint.astype(np.float32) @ steps)
    return np.maximum(found, 0.0).reshape(np.shape(weights[0]))
