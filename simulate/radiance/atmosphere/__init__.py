"""Air between things: what it takes from light, and what light it adds."""

from simulate.radiance.atmosphere.air import Atmosphere

__all__ = ["Atmosphere"]
