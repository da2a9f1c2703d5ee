"""Laboratory data: frames, conditions, sensors, targets, plans, sessions and measurements."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labdata.camera.description import Camera
    from labdata.conditions import Conditions
    from labdata.errors import BadInput
    from labdata.frames import FrameStack
    from labdata.measurement import Curve, Measurement, Posterior, Provenance, Result
    from labdata.sensors import load_sensor
    from labdata.session import Session, StackEntry, open_session
    from labdata.target import Target

__all__ = [
    "BadInput",
    "Camera",
    "Conditions",
    "Curve",
    "FrameStack",
    "Measurement",
    "Posterior",
    "Provenance",
    "Result",
    "Session",
    "StackEntry",
    "Target",
    "load_sensor",
    "open_session",
]

_HOMES = {
    "labdata.camera.description": ("Camera",),
    "labdata.conditions": ("Conditions",),
    "labdata.errors": ("BadInput",),
    "labdata.frames": ("FrameStack",),
    "labdata.measurement": ("Curve", "Measurement", "Posterior", "Provenance", "Result"),
    "labdata.sensors": ("load_sensor",),
    "labdata.session": ("Session", "StackEntry", "open_session"),
    "labdata.target": ("Target",),
}


def __getattr__(name: str) -> Any:
    """Import a name's module on first use, so that the command line starts quickly."""
    for home, names in _HOMES.items():
        if name in names:
            from importlib import import_module

            return getattr(import_module(home), name)
    raise AttributeError(f"module 'labdata' has no attribute {name!r}")
