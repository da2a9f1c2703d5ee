"""Fit of a sensor description to a session's measurements."""

from charact.fitting.sensor import fit_sensor

__all__ = ["fit_sensor"]
