"""Characterize image-intensified cameras: measurements with posteriors, validation against simulation, reports.

import charact, labdata

session = labdata.open_session("day1")
result = charact.measure(session)
for measurement in result.find("mtf50"):
    print(measurement.value, measurement.interval95, measurement.status)
"""

from typing import TYPE_CHECKING, Any

from labdata.numba_cache import keep_loops

__version__ = "0.1.0"

keep_loops()

if TYPE_CHECKING:
    from charact.fit import fit_sensor
    from charact.session_measurement import measure
    from charact.validation import validate

__all__ = ["fit_sensor", "measure", "validate"]

_HOMES = {"measure": "charact.session_measurement", "fit_sensor": "charact.fit", "validate": "charact.validation"}


def __getattr__(name: str) -> Any:
    """Import the analysis on first use, so that the command line starts fast."""
    if name in _HOMES:
        from importlib import import_module

        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'charact' has no attribute {name!r}")
