"""Geometry of two cameras of one scene: place of each pixel of one frame in the other, and what it
cannot see.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from charact.fusion.thresholds import REGISTRATION
from labdata.errors import BadInput

Array = NDArray[Any]
Mask = NDArray[np.bool_]
# Radii of the table that inverts a distortion: nodes, and the largest in corner radii.
NODES, FARTHEST = 4096, 2.0


@dataclass(frozen=True, kw_only=True)
class CameraGeometry:
    """Pose and lens of a camera: a pinhole with radial distortions, and the range of what it sees.

    `shape`: rows and columns of the frame, px; `focal_px`: focal length over the pitch of columns
    and of rows (x, y); `position_m`: place of the lens in the world, shape (3,), None: unknown;
    `rotation`: turns directions of the world into those to the right, down and ahead of the camera,
    shape (3, 3); `distortion_fraction`: displacement at the corner over its distance from the axis,
    positive is pincushion; `frame_distortion`: further ones of the frame, which the range has not,
    in the order of the light; `range_m`: distance along the ray of each pixel, shape (row, col), m,
    infinite for sky, None: unknown.
    """

    shape: tuple[int, int]
    focal_px: tuple[float, float]
    position_m: Array | None = None
    rotation: Array | None = None
    distortion_fraction: float = 0.0
    frame_distortion: tuple[float, ...] = ()
    range_m: Array | None = None

    def __post_init__(self) -> None:
        if not min(self.focal_px) > 0.0:
            raise BadInput(f"focal_px of a camera must be positive, got {self.focal_px}")
        if self.range_m is not None and self.range_m.shape != self.shape:
            raise BadInput(
                f"range_m must have the frame's shape {self.shape}, got {self.range_m.shape}"
            )

    @cached_property
    def _corner(self) -> float:
        return 0.5 * float(
            np.hypot(self.shape[1] / self.focal_px[0], self.shape[0] / self.focal_px[1])
        )

    def _distortions(self, of_range: bool) -> tuple[float, ...]:
        return (self.distortion_fraction, *(() if of_range else self.frame_distortion))

    def pixels_of(self, x: Array, y: Array, *, of_range: bool = False) -> tuple[Array, Array]:
        """Return column and row, px, of rays with tangents (x, y); integers are the centres of
        pixels.

        `of_range`: in the range map, not in the frame.
        """
        for fraction in self._distortions(of_range):
            stretch = 1.0 + fraction * np.minimum(np.hypot(x, y) / self._corner, FARTHEST) ** 2
            x, y = x * stretch, y * stretch
        rows, cols = self.shape
        return x * self.focal_px[0] + 0.5 * (cols - 1), y * self.focal_px[1] + 0.5 * (rows - 1)

    @cached_property
    def tangents(self) -> tuple[Array, Array]:
        """Tangents (x, y) of the rays of all pixels, shape (row, col) each."""
        rows, cols = self.shape
        row, col = np.mgrid[:rows, :cols].astype(np.float64)
        x, y = (
            (col - 0.5 * (cols - 1)) / self.focal_px[0],
            (row - 0.5 * (rows - 1)) / self.focal_px[1],
        )
        came = np.linspace(0.0, FARTHEST, NODES)
        for fraction in reversed(self._distortions(of_range=False)):
            radius = np.interp(
                np.hypot(x, y) / self._corner, came * (1.0 + fraction * came**2), came
            )
            shrink = 1.0 / (1.0 + fraction * radius**2)
            x, y = x * shrink, y * shrink
        return x, y

    @cached_property
    def pixel_range_m(self) -> Array | None:
        """Distance along the ray of each pixel of the frame, shape (row, col), m."""
        return None if self.range_m is None else self.on_frame(self.range_m)

    def on_frame(self, layer: Array) -> Array:
        """Return a layer of the truth, such as the range, at the pixels of the frame, shape (row,
        col).
        """
        if not self.frame_distortion:
            return layer
        return _nearest(layer, *self.pixels_of(*self.tangents, of_range=True))


def are_posed(*cameras: CameraGeometry | None) -> bool:
    """Return whether place and direction of all cameras are known."""
    return all(
        one is not None and one.position_m is not None and one.rotation is not None
        for one in cameras
    )


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Place of the pixels of a fixed frame in a moving one: column and row, px, and what is not
    there.

    `outside`: beyond the moving frame; `occluded`: hidden from the moving camera by a nearer
    surface; shape (row, col).
    """

    col: Array
    row: Array
    outside: Mask
    occluded: Mask

    @property
    def unseen(self) -> Mask:
        """Pixels of the fixed frame that the moving one does not see."""
        return self.outside | self.occluded

    def shifted(self, shift_px: tuple[float, float]) -> "Placement":
        """Return the placement of a moving frame whose content lies (x, y) px further, as seen in
        the fixed frame.
        """
        return replace(self, col=self.col + shift_px[0], row=self.row + shift_px[1])

    def warp(self, image: Array) -> NDArray[np.float32]:
        """Return a moving image on the pixels of the fixed frame, of the nearest pixel where it is
        not seen.

        A windowed sinc of 8 x 8 px keeps the power of the noise better than a spline.
        """
        col, row = self.col.astype(np.float32), self.row.astype(np.float32)
        picture = np.asarray(image, np.float32)
        found = cv2.remap(picture, col, row, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, np.float32)

    @cached_property
    def noise_change(self) -> tuple[float, float]:
        """Change of white noise by the warp: power at the scale of objects, and variance of pixels
        over that.

        Measured by warping white noise: means over 8 x 8 px of 6,000 blocks know the power within 2
        %.
        """
        reach = [max(64, int(one.max()) + 9) for one in (self.row, self.col)]
        noise = np.random.default_rng(0).standard_normal(reach, np.float32)
        warped = self.warp(noise)
        seen = ~cv2.dilate(self.outside.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
        rows, cols = (side // 8 for side in warped.shape)
        blocks = [one[: 8 * rows, : 8 * cols].reshape(rows, 8, cols, 8) for one in (warped, seen)]
        whole = blocks[1].all(axis=(1, 3))
        if np.count_nonzero(whole) < 100:
            return 1.0, 1.0
        power = 64.0 * float(np.mean(blocks[0].mean(axis=(1, 3))[whole] ** 2))
        return power, float(np.mean(warped[seen] ** 2)) / power


def place_pixels(
    fixed: CameraGeometry, moving: CameraGeometry, *, distance_m: float | None = None
) -> Placement:
    """Return the place of each pixel of a fixed camera in the frame of a moving one.

    Cameras without a pose have parallel axes and stand in one place. `distance_m`: distance ahead
    of the fixed camera of a plane in which all is taken to lie; None: the range of each pixel,
    where the fixed camera has one, else infinite. A distance between cameras of unknown place is
    BadInput.

    Notes
    -----
    A surface at range Z along the unit direction d of the fixed camera lies along R_m (d + (p_f -
    p_m)/Z) of the moving one, with the positions p and the rotation R_m. It is occluded where the
    range of the moving camera, if it has one, is shorter there by more than
    `REGISTRATION.occlusion_depth`.

    Examples
    --------
    >>> one = CameraGeometry(
    ...     shape=(64, 64), focal_px=(100.0, 100.0), position_m=np.zeros(3), rotation=np.eye(3)
    ... )
    >>> other = replace(one, position_m=np.array([0.5, 0.0, 0.0]))
    >>> placed = place_pixels(one, other, distance_m=10.0)
    >>> float(np.round(placed.col[32, 32] - 32.0, 3))
    -5.0
    """
    if distance_m is not None and not distance_m > 0.0:
        raise BadInput(f"range_m must be positive, got {distance_m:g}")
    x, y = fixed.tangents
    length = np.sqrt(x * x + y * y + 1.0)
    ray = np.stack([x, y, np.ones_like(x)], axis=-1)
    range_m: Array | None = None
    if are_posed(fixed, moving):
        range_m = fixed.pixel_range_m if distance_m is None else distance_m * length
        ray = ray / length[..., None] @ np.asarray(fixed.rotation)
        if range_m is not None:
            ray = (
                ray
                + (np.asarray(fixed.position_m) - np.asarray(moving.position_m))
                / range_m[..., None]
            )
        ray = ray @ np.asarray(moving.rotation).T
    elif distance_m is not None:
        raise BadInput(
            "range_m needs the places of both cameras, which only the truth of a simulated "
            "session has"
        )
    ahead = ray[..., 2] > 1e-6
    depth = np.where(ahead, ray[..., 2], 1.0)
    x, y = ray[..., 0] / depth, ray[..., 1] / depth
    col, row = moving.pixels_of(x, y)
    rows, cols = moving.shape
    outside = ~(
        ahead
        & (np.abs(col - 0.5 * (cols - 1)) <= 0.5 * cols)
        & (np.abs(row - 0.5 * (rows - 1)) <= 0.5 * rows)
    )
    occluded = np.zeros(fixed.shape, bool)
    if range_m is not None and distance_m is None and moving.range_m is not None:
        # The farthest surface within a pixel: an edge hides nothing of its surroundings.
        farthest = cv2.dilate(
            np.nan_to_num(moving.range_m, posinf=1e9).astype(np.float32), np.ones((3, 3), np.uint8)
        )
        seen = _nearest(farthest, *moving.pixels_of(x, y, of_range=True))
        there = np.minimum(range_m * np.linalg.norm(ray, axis=-1), 1e9)
        occluded = ~outside & (seen < there * (1.0 - REGISTRATION.occlusion_depth))
    return Placement(col=col, row=row, outside=outside, occluded=occluded)


def _nearest(image: Array, col: Array, row: Array) -> Array:
    """Return the values of the nearest pixels of an image."""
    rows, cols = image.shape
    return image[
        np.clip(np.rint(row), 0, rows - 1).astype(np.intp),
        np.clip(np.rint(col), 0, cols - 1).astype(np.intp),
    ]
