"""Quantities of a camera with an image intensifier that need both its MTF and its noise."""

from charact.estimators.tube.resolution import add_resolution

__all__ = ["add_resolution"]
