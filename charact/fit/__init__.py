"""Fit of a sensor description to a session's measurements."""

from charact.callable_package import make_callable
from charact.fit.sensor import fit_sensor

__all__ = ["fit_sensor"]

make_callable(__name__)
