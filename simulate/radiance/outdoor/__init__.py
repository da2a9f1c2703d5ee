"""Outdoor scenes: description, geometry, camera and render settings."""
