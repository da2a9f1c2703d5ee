"""Infrared cameras: signal transfer (SiTF), NETD and 3-D noise in kelvin from black-body flats, and
MRTD.
"""

from charact.estimators.infrared.blackbody_flats import blackbody_flats, is_linear, measure
from charact.estimators.infrared.mrtd import add_mrtd

__all__ = ["add_mrtd", "blackbody_flats", "is_linear", "measure"]
