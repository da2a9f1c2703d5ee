"""Cameras and capture cards of Linux: the kernel's video interface (V4L2) from its structures to a camera."""

from drivers.cameras.v4l2.camera import V4l2Camera
from drivers.cameras.v4l2.listing import VideoDevice, list_devices

__all__ = ["V4l2Camera", "VideoDevice", "list_devices"]
