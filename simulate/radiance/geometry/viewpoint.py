"""Pose and lens of a camera: rays of image coordinates, and image coordinates of directions."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from labdata.errors import BadInput, check
from simulate.arrays import Array, Mask

# Largest radius, in corner radii, and nodes of the table that inverts a distortion.
FARTHEST, STEPS = 2.0, 4096


@dataclass(frozen=True, kw_only=True)
class RasterGeometry:
    """Motion of a line scanner during its rows.

    Parameters
    ----------
    line_time_s
        Time from one row to the next, s.
    velocity_m_per_s
        Velocity (east, north, up), m/s.
    turn_deg_per_s
        Rate of turning about the vertical, clockwise from above, deg/s.
    """

    line_time_s: float
    velocity_m_per_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg_per_s: float = 0.0

    def __post_init__(self) -> None:
        check(self, positive="line_time_s")

    def at(self, row: Array) -> tuple[Array, Array]:
        """Return displacement (row, 3), m, and rotation (row,), rad, of the scanner in the middle
        of rows' times.
        """
        time_s = (np.floor(row) + 0.5) * self.line_time_s
        return time_s[:, None] * np.asarray(self.velocity_m_per_s), np.deg2rad(
            -self.turn_deg_per_s * time_s
        )


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """Rows that a camera takes from one position at one time."""

    eye_m: Array  # position of the lens, shape (3,), m
    turn_rad: float  # rotation about the vertical, counterclockwise from above, rad
    # First row through the lens, as `Viewpoint.project` counts them, and number of rows.
    first: float
    rows: int
    picture_row: int  # row of the image that the first one is

    def direction_before_turn(self, direction: Array) -> Array:
        """Return directions (ray, 3) in the frame of the camera before its rotation."""
        return _turn_about_vertical(direction, -self.turn_rad)


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """A camera with a pose and a lens: a pinhole with radial distortion."""

    position_m: tuple[float, float, float]  # position of the lens (east, north, up), m
    forward: tuple[float, float, float]  # direction of its axis, shape (3,), unit length
    shape: tuple[int, int]  # pixels, (row, col)
    focal_px: tuple[
        float, float
    ]  # focal length over the pitch of columns and of rows (x, y), dimensionless
    roll_deg: float = 0.0  # rotation about the axis, clockwise as the camera sees it, deg
    # D of r' = r (1 + D (r/R)^2), R the corner's distance from the axis; positive is pincushion.
    distortion_fraction: float = 0.0
    # For a line scanner, whose rows all view the central row, each at its own time; None: framing
    # camera.
    scan: RasterGeometry | None = None

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.forward) > 0.0:
            raise BadInput("a camera must look somewhere, got a direction of no length")
        if not min(self.focal_px) > 0.0 or min(self.shape) < 1:
            raise BadInput(
                f"a camera must have pixels and a focal length, got {self.shape} and "
                f"{self.focal_px}"
            )
        if not -1.0 / (3.0 * FARTHEST**2) < self.distortion_fraction < 1.0:
            raise BadInput(
                "a distortion must lie between -1/12 and 1 at the corner, got "
                f"{self.distortion_fraction:g}"
            )

    @cached_property
    def axes(self) -> Array:
        """Directions to the right, down and forward in the image, rows of a (3, 3) array."""
        forward = np.asarray(self.forward) / np.linalg.norm(self.forward)
        # A camera that looks straight up or down has north at the top of the image.
        zenith = (
            np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 1.0 - 1e-9 else np.array([0.0, 1.0, 0.0])
        )
        right = np.cross(forward, zenith)
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        roll = np.deg2rad(self.roll_deg)
        return np.array(
            [
                np.cos(roll) * right + np.sin(roll) * down,
                np.cos(roll) * down - np.sin(roll) * right,
                forward,
            ]
        )

    def smaller(self, factor: int) -> "Viewpoint":
        """Return the same view with fewer pixels on each side, by a factor."""
        shape = tuple(max(1, -(-side // factor)) for side in self.shape)
        focal = tuple(
            f * size / full_size
            for f, size, full_size in zip(self.focal_px, shape[::-1], self.shape[::-1], strict=True)
        )
        scan = (
            None
            if self.scan is None
            else replace(self.scan, line_time_s=self.scan.line_time_s * factor)
        )
        return replace(self, shape=(shape[0], shape[1]), focal_px=(focal[0], focal[1]), scan=scan)

    def rays(self, row: Array, col: Array) -> tuple[Array, Array]:
        """Return origins, m, and unit directions of rays, each of shape (ray, 3), through image
        coordinates (ray,).

        Coordinates are integers at the corners of pixels.
        """
        lens_row = 0.5 * self.shape[0] + row % 1.0 - 0.5 if self.scan else row
        x = (col - 0.5 * self.shape[1]) / self.focal_px[0]
        y = np.broadcast_to((lens_row - 0.5 * self.shape[0]) / self.focal_px[1], x.shape)
        if self.distortion_fraction:
            shrink = 1.0 / (
                1.0
                + self.distortion_fraction * self._undistorted(np.hypot(x, y) / self._corner) ** 2
            )
            x, y = x * shrink, y * shrink
        direction = np.stack([x, y, np.ones_like(x)], axis=1) @ self.axes
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        origin = np.broadcast_to(np.asarray(self.position_m, float), direction.shape)
        if self.scan is None:
            return origin, direction
        displacement, rotation = self.scan.at(row)
        return origin + displacement, _turn_about_vertical(direction, rotation)

    def exposures(self) -> Iterator[Exposure]:
        """Yield the rows taken at one time: all of a framing camera, each of a scanner."""
        eye = np.asarray(self.position_m, float)
        if self.scan is None:
            yield Exposure(eye_m=eye, turn_rad=0.0, first=0.0, rows=self.shape[0], picture_row=0)
            return
        for row in range(self.shape[0]):
            displacement, rotation = self.scan.at(np.array([float(row)]))
            yield Exposure(
                eye_m=eye + displacement[0],
                turn_rad=float(rotation[0]),
                first=0.5 * (self.shape[0] - 1),
                rows=1,
                picture_row=row,
            )

    def project(self, direction: Array) -> tuple[Array, Array, Mask]:
        """Return image coordinates (row, col) of directions, and whether they are in front of the
        lens, shape (ray,).

        Those of a scanner are without its motion. Radii are limited to `FARTHEST`.
        """
        right, down, depth = self.axes @ np.asarray(direction, float).T
        front = depth > 1e-9
        x, y = (
            np.divide(side, depth, out=np.zeros_like(side), where=front) for side in (right, down)
        )
        radius = np.hypot(x, y) / self._corner
        limited_radius = np.minimum(radius, FARTHEST)
        magnification = (
            limited_radius
            / np.maximum(radius, 1e-300)
            * (1.0 + self.distortion_fraction * limited_radius**2)
        )
        row = (
            y * np.where(radius > 0.0, magnification, 1.0) * self.focal_px[1] + 0.5 * self.shape[0]
        )
        col = (
            x * np.where(radius > 0.0, magnification, 1.0) * self.focal_px[0] + 0.5 * self.shape[1]
        )
        return row, col, front

    def solid_angle_sr(self, row: Array, col: Array) -> Array:
        """Return the solid angle of a pixel at image coordinates, shape (point,), sr.

        |d1 x d2| of the unit directions' derivatives along row and column.
        """
        step = 0.25
        _, towards_left = self.rays(row, col - step)
        _, towards_right = self.rays(row, col + step)
        _, towards_upper = self.rays(row - step, col)
        _, towards_lower = self.rays(row + step, col)
        return (
            np.linalg.norm(
                np.cross(towards_right - towards_left, towards_lower - towards_upper), axis=1
            )
            / (2.0 * step) ** 2
        )

    @cached_property
    def _corner(self) -> float:
        return 0.5 * float(
            np.hypot(self.shape[1] / self.focal_px[0], self.shape[0] / self.focal_px[1])
        )

    def _undistorted(self, radius: Array) -> Array:
        """Return the undistorted radii of radii in the image, corner radii."""
        undistorted = np.linspace(0.0, FARTHEST, STEPS)
        return np.interp(
            radius, undistorted * (1.0 + self.distortion_fraction * undistorted**2), undistorted
        )


def _turn_about_vertical(direction: Array, turn_rad: Array | float) -> Array:
    """Rotate directions (ray, 3) about the vertical, counterclockwise from above."""
    x = np.cos(turn_rad) * direction[:, 0] - np.sin(turn_rad) * direction[:, 1]
    y = np.sin(turn_rad) * direction[:, 0] + np.cos(turn_rad) * direction[:, 1]
    return np.stack([x, y, direction[:, 2]], axis=1)
