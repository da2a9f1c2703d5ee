"""How surfaces scatter light: reciprocal, never more than arrives."""

from simulate.radiance.brdf.protocol import Brdf

__all__ = ["Brdf"]
