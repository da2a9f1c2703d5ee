"""Camera drivers: V4L2, Aravis (GigE Vision, USB3 Vision) and replayed sessions."""
