"""Simulation: scene radiance, intensified and solid-state cameras, and virtual instruments."""

from typing import TYPE_CHECKING, Any

from labdata.numba_cache import keep_loops

if TYPE_CHECKING:
    from simulate.api import SimulationRequest, conditions_of, load_described_camera, simulate
    from simulate.session_files import save_session
    from simulate.surface_temperatures import SurfaceTemperatures, temperatures

keep_loops()

__all__ = [
    "SimulationRequest",
    "SurfaceTemperatures",
    "conditions_of",
    "load_described_camera",
    "save_session",
    "simulate",
    "temperatures",
]


def __getattr__(name: str) -> Any:
    """Import the use cases on first use, so that the command line starts fast."""
    if name not in __all__:
        raise AttributeError(f"module 'simulate' has no attribute {name!r}")
    from simulate import api, session_files, surface_temperatures

    rooms = (api, session_files, surface_temperatures)
    return next(getattr(room, name) for room in rooms if hasattr(room, name))
