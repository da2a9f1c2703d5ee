"""Bidirectional reflectance distribution functions (BRDFs), reciprocal and energy-conserving."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.brdf.glossy import Glossy, Metal, Retroreflector
    from simulate.radiance.brdf.microfacet import dielectric, specular_albedo
    from simulate.radiance.brdf.protocol import (
        Brdf,
        Lambert,
        MeasuredTable,
        Reflectance,
        directions_at_cosine,
        grey,
        read_measured,
    )

__all__ = [
    "Brdf",
    "Glossy",
    "Lambert",
    "MeasuredTable",
    "Metal",
    "Reflectance",
    "Retroreflector",
    "dielectric",
    "directions_at_cosine",
    "grey",
    "read_measured",
    "specular_albedo",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.brdf.glossy": "Glossy Metal Retroreflector",
        "simulate.radiance.brdf.microfacet": "dielectric specular_albedo",
        "simulate.radiance.brdf.protocol": (
            "Brdf Lambert MeasuredTable Reflectance directions_at_cosine grey read_measured"
        ),
    },
)
