"""Statistics of darks and flats: one class each, for noise, fit and validation."""

from charact.observables import (
    fixed_pattern,
    level,
    photon_transfer,
    readout,
    temporal_noise,
    values_in_time,
)
from charact.observables.observable import (
    Estimates,
    MeasuredStack,
    Numbers,
    Observable,
    Stacks,
    Values,
    observable,
    observables,
)

__all__ = [
    "Estimates",
    "MeasuredStack",
    "Numbers",
    "Observable",
    "Stacks",
    "Values",
    "fixed_pattern",
    "level",
    "observable",
    "observables",
    "photon_transfer",
    "readout",
    "temporal_noise",
    "values_in_time",
]
