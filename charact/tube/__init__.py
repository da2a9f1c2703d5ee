"""Quantities of a camera with an image intensifier that need both its MTF and its noise."""

from charact.tube.resolution import add_resolution

__all__ = ["add_resolution"]
