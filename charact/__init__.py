"""Characterize image-intensified cameras: measurements with posteriors, validation against simulation, reports."""

__version__ = "0.1.0"
