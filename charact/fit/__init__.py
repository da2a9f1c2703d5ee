"""The missing arc: from a session's measurements back to the sensor that made them."""

from charact.fit.sensor import fit_sensor

__all__ = ["fit_sensor"]
