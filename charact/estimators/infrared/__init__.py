"""Infrared cameras: signal transfer (SiTF), NETD and 3-D noise in kelvin from black-body flats, and
MRTD.
"""

from charact.estimators.infrared.blackbody_flats import blackbody_flats, is_linear, measure
from charact.estimators.infrared.mrtd import (
    FOUR_BARS,
    add_mrtd,
    mrtd,
    scan_directions,
)
from charact.estimators.infrared.signal_transfer import Response, fit_signal_transfer
from charact.estimators.infrared.thresholds import INFRARED

__all__ = [
    "FOUR_BARS",
    "INFRARED",
    "Response",
    "add_mrtd",
    "blackbody_flats",
    "fit_signal_transfer",
    "is_linear",
    "measure",
    "mrtd",
    "scan_directions",
]
