"""How surfaces scatter light: reciprocal, and never more than arrives."""

from simulate.radiance.brdf.glossy import Glossy
from simulate.radiance.brdf.lambert import Lambert
from simulate.radiance.brdf.measured import MeasuredTable
from simulate.radiance.brdf.metal import Metal
from simulate.radiance.brdf.protocol import Brdf
from simulate.radiance.brdf.retroreflector import Retroreflector

__all__ = ["Brdf", "Glossy", "Lambert", "MeasuredTable", "Metal", "Retroreflector"]
