"""Lamps: spectra and intensity distributions."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from simulate.radiance.lamps.distribution import (
        Cosine,
        Distribution,
        Isotropic,
        Lamp,
        MeasuredDistribution,
        SpotBeam,
        parse_photometry,
        read_ies,
    )
    from simulate.radiance.lamps.spectra import read_spectrum, spectrum

__all__ = [
    "Cosine",
    "Distribution",
    "Isotropic",
    "Lamp",
    "MeasuredDistribution",
    "SpotBeam",
    "parse_photometry",
    "read_ies",
    "read_spectrum",
    "spectrum",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "simulate.radiance.lamps.distribution": (
            "Cosine Distribution Isotropic Lamp MeasuredDistribution SpotBeam parse_photometry "
            "read_ies"
        ),
        "simulate.radiance.lamps.spectra": "read_spectrum spectrum",
    },
)
