"""Lamps: their spectra, and where they shine."""

from simulate.radiance.lamps.distribution import Cosine, Isotropic, MeasuredDistribution, SpotBeam
from simulate.radiance.lamps.ies import Photometry, read_ies
from simulate.radiance.lamps.lamp import Lamp
from simulate.radiance.lamps.spectra import KINDS, read_spectrum, spectrum

__all__ = [
    "KINDS",
    "Cosine",
    "Isotropic",
    "Lamp",
    "MeasuredDistribution",
    "Photometry",
    "SpotBeam",
    "read_ies",
    "read_spectrum",
    "spectrum",
]
