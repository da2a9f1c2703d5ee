"""Virtual instruments by model name: those in the package `instruments`, and those of other packages.

A package brings one with a Python entry point of the group `charact.virtual_instruments` whose value is a
`VirtualModel`; its name is the one of the driver's model in the group `charact.instruments`.
"""

from labdata.errors import BadInput
from labdata.instrument_config import models_by_name
from simulate.virtual_bench.instrument import VirtualModel

__all__ = ["VirtualModel", "virtual_model", "virtual_models"]

GROUP = "charact.virtual_instruments"


def virtual_models() -> dict[str, VirtualModel]:
    """Return all virtual models by name."""
    return models_by_name("simulate.virtual_bench.instruments", VirtualModel, GROUP)


def virtual_model(name: str) -> VirtualModel:
    """Return a virtual model by its name."""
    known = virtual_models()
    if name not in known:
        raise BadInput(f"a virtual instrument must be one of {', '.join(sorted(known))}, got {name!r}")
    return known[name]
