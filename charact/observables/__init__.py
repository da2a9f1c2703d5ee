"""Statistics of darks and flats: one class each, for noise, fit and validation.

A statistic is declared where its module is imported, and all modules of this folder are.
"""

from importlib import import_module
from pkgutil import iter_modules

from charact.observables.admissible import admissible_measurements, sd_of
from charact.observables.dark_spectrum import readout_spectrum
from charact.observables.fixed_pattern import Dsnu, Prnu
from charact.observables.frame_view import FrameView
from charact.observables.level import Level
from charact.observables.observable import (
    Case,
    Estimates,
    GivenOthers,
    MeasuredStack,
    Numbers,
    Observable,
    Printed,
    Ridge,
    Stacks,
    Values,
    columns,
    declare,
    observable,
    observables,
)
from charact.observables.photon_transfer import DarkNoise, PhotonTransfer
from charact.observables.readout import Interference
from charact.observables.stack_level import StackLevel
from charact.observables.temporal_noise import NoiseSpectrum
from charact.observables.thresholds import FRAMES
from charact.observables.values_in_time import Histogram

__all__ = [
    "FRAMES",
    "Case",
    "DarkNoise",
    "Dsnu",
    "Estimates",
    "FrameView",
    "GivenOthers",
    "Histogram",
    "Interference",
    "Level",
    "MeasuredStack",
    "NoiseSpectrum",
    "Numbers",
    "Observable",
    "PhotonTransfer",
    "Printed",
    "Prnu",
    "Ridge",
    "StackLevel",
    "Stacks",
    "Values",
    "admissible_measurements",
    "columns",
    "declare",
    "observable",
    "observables",
    "readout_spectrum",
    "sd_of",
]

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
