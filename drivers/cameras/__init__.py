"""Cameras: V4L2, Aravis and GigE Vision, and a recorded session played back."""
