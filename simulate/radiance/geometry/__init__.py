"""Triangle meshes, ray tracing and camera geometry."""
