"""Linux cameras and capture cards (V4L2)."""

from drivers.cameras.v4l2.camera import V4l2Camera
from drivers.cameras.v4l2.listing import VideoDevice, list_devices

__all__ = ["V4l2Camera", "VideoDevice", "list_devices"]
