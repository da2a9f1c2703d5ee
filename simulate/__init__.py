"""Simulation: scene radiance, intensified and solid-state cameras, and virtual instruments."""

from typing import TYPE_CHECKING, Any

from labdata.numba_cache import keep_loops

if TYPE_CHECKING:
    from simulate.api import SimulationRequest, conditions_of, load_described_camera, simulate
    from simulate.session_files import save_session

keep_loops()

__all__ = [
    "SimulationRequest",
    "conditions_of",
    "load_described_camera",
    "save_session",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import the use cases on first use, so that the command line starts fast."""
    if name in __all__:
        from simulate import api, session_files

        return getattr(session_files if name == "save_session" else api, name)
    raise AttributeError(f"module 'simulate' has no attribute {name!r}")
