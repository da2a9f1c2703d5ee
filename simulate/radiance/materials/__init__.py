"""What things are made of."""

from simulate.radiance.materials.library import material, material_names
from simulate.radiance.materials.material import Material
from simulate.radiance.materials.reflectance import Reflectance, grey

__all__ = ["Material", "Reflectance", "grey", "material", "material_names"]
