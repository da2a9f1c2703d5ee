"""Poses of a scene's camera, of the sensors of its rig and of its objects, and their motion by
keyframes.

The pose in the table of a camera or object is that at the scene's time. Each keyframe states values
at a later time; between two of them values change linearly with time, and those of the last one
stay. A heading that shall turn through north goes on beyond 360 deg.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput, check
from simulate.radiance.geometry.viewpoint import RasterGeometry, Viewpoint

Posed = TypeVar("Posed")


@dataclass(frozen=True, kw_only=True)
class CameraKeyframe:
    """Pose of a camera at a time; what is None is as at the keyframe before, or as in the camera's
    table.

    Parameters
    ----------
    time_s
        Time after the scene's, s.
    position_m, look_at_m, roll_deg
        As in `SceneCamera`.
    """

    time_s: float
    position_m: tuple[float, float, float] | None = None
    look_at_m: tuple[float, float, float] | None = None
    roll_deg: float | None = None


@dataclass(frozen=True, kw_only=True)
class ObjectKeyframe:
    """Pose of an object at a time; what is None is as at the keyframe before, or as in the object's
    table.

    Parameters
    ----------
    time_s
        Time after the scene's, s.
    position_m, heading_deg, pitch_deg, roll_deg
        As in `Pose`.
    """

    time_s: float
    position_m: tuple[float, float, float] | None = None
    heading_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None


def _stated_values(keyframe: Any) -> dict[str, Any]:
    """Return the values that a keyframe states, by their names."""
    values = {
        keyframe_field.name: getattr(keyframe, keyframe_field.name)
        for keyframe_field in fields(keyframe)
        if keyframe_field.name != "time_s"
    }
    return {name: value for name, value in values.items() if value is not None}


def check_keyframes(keyframes: Sequence[CameraKeyframe | ObjectKeyframe], name: str) -> None:
    """Raise BadInput unless keyframes state finite values at ascending times after the scene's."""
    before_s = 0.0
    for keyframe in keyframes:
        if not (math.isfinite(keyframe.time_s) and keyframe.time_s > before_s):
            raise BadInput(
                f"times of keyframes must ascend from 0 s, got {keyframe.time_s:g} s after "
                f"{before_s:g} s of {name}"
            )
        if not (pose_values := _stated_values(keyframe)):
            raise BadInput(
                f"a keyframe must state a pose, got none at {keyframe.time_s:g} s of {name}"
            )
        if not all(np.isfinite(value).all() for value in pose_values.values()):
            raise BadInput(f"places and angles of keyframes must be finite, got others of {name}")
        before_s = keyframe.time_s


def pose_at(
    start: Posed, keyframes: Sequence[CameraKeyframe | ObjectKeyframe], time_s: float
) -> Posed:
    """Return a camera or object with the pose that its keyframes give it at a time after the
    scene's, s.
    """
    pose: Any = start
    before_s = 0.0
    for keyframe in keyframes:
        pose_values = _stated_values(keyframe)
        if time_s < keyframe.time_s:
            fraction = max(time_s - before_s, 0.0) / (keyframe.time_s - before_s)
            return replace(
                pose,
                **{
                    name: _interpolate_pose(getattr(pose, name), end, fraction)
                    for name, end in pose_values.items()
                },
            )
        pose, before_s = replace(pose, **pose_values), keyframe.time_s
    return pose


def _interpolate_pose(start: Any, end: Any, fraction: float) -> Any:
    if isinstance(start, tuple):
        return tuple(
            _interpolate_pose(start_value, end_value, fraction)
            for start_value, end_value in zip(start, end, strict=True)
        )
    return start + fraction * (end - start)


@dataclass(frozen=True, kw_only=True)
class SceneCamera:
    """Pose of the camera; its lens and pixels are the sensor's.

    Parameters
    ----------
    position_m
        Position of the lens (east, north, up), m.
    look_at_m
        A point on its axis, m.
    roll_deg
        Rotation about the axis, clockwise as the camera sees it, deg.
    distortion_fraction
        Radial distortion of the rays at the corner; the sensor's lens has its own, so it is 0
        unless a cube is made for something else.
    scan
        Motion of a line scanner; None for a framing camera.
    keyframe
        Where it stands later.
    """

    position_m: tuple[float, float, float]
    look_at_m: tuple[float, float, float]
    roll_deg: float = 0.0
    distortion_fraction: float = 0.0
    scan: RasterGeometry | None = None
    keyframe: tuple[CameraKeyframe, ...] = ()

    def __post_init__(self) -> None:
        if self.position_m == self.look_at_m:
            raise BadInput(
                f"a camera must look at another place than it stands, got {list(self.position_m)} "
                "for both"
            )
        check_keyframes(self.keyframe, "the camera")


@dataclass(frozen=True, kw_only=True)
class RigSensor:
    """Place of one sensor of a rig against the scene's camera.

    Parameters
    ----------
    offset_m
        Position (right, up, ahead) of its lens from the camera's, in the camera's axes, m.
    pointing_deg
        Turn of its axis to the right and up from the camera's, deg.
    roll_deg
        Rotation about its axis, clockwise as it sees it, beyond the camera's, deg.
    delay_s
        Time by which its first frame is later than the scene's time, s.
    """

    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pointing_deg: tuple[float, float] = (0.0, 0.0)
    roll_deg: float = 0.0
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        check(self, of=" of a rig's sensor", not_negative="delay_s")
        if not max(abs(angle) for angle in self.pointing_deg) < 90.0:
            raise BadInput(
                f"pointing_deg must lie between -90 and 90, got {list(self.pointing_deg)}"
            )

    def camera(self, camera: SceneCamera) -> SceneCamera:
        """Return the camera in this place."""
        pose = Viewpoint(
            position_m=camera.position_m,
            forward=tuple(np.subtract(camera.look_at_m, camera.position_m)),
            shape=(1, 1),
            focal_px=(1.0, 1.0),
            roll_deg=camera.roll_deg,
        )
        axes = pose.axes * [[1.0], [-1.0], [1.0]]
        position = np.asarray(camera.position_m) + np.asarray(self.offset_m) @ axes
        forward = np.append(np.tan(np.deg2rad(self.pointing_deg)), 1.0) @ axes
        distance = float(np.linalg.norm(np.subtract(camera.look_at_m, camera.position_m)))
        look_at = position + distance * forward / np.linalg.norm(forward)
        return replace(
            camera,
            position_m=tuple(position.tolist()),
            look_at_m=tuple(look_at.tolist()),
            roll_deg=camera.roll_deg + self.roll_deg,
        )


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Pose of a copy of an object.

    Parameters
    ----------
    position_m
        Where its origin is (east, north, up), m.
    heading_deg
        Where its own +y points, clockwise from north, deg.
    pitch_deg, roll_deg
        Turn about its own x (nose up) and then, before it, about its own y, deg.
    scale
        Size over that described, dimensionless.
    """

    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        check(self, positive="scale")


def rotation_of(pose: Pose) -> NDArray[np.floating]:
    """Return the rotation (3, 3): roll about y, then pitch about x, then heading about z, clockwise
    from above.
    """
    roll, pitch, heading = np.deg2rad([pose.roll_deg, pose.pitch_deg, -pose.heading_deg])
    about_y = np.array(
        [[np.cos(roll), 0, np.sin(roll)], [0, 1, 0], [-np.sin(roll), 0, np.cos(roll)]]
    )
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    )
    about_z = np.array(
        [[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]]
    )
    return about_z @ about_x @ about_y
