"""Laboratory data: frames, conditions, sensors, targets, plans, sessions and measurements."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labdata.camera.description import Camera
    from labdata.conditions import Conditions
    from labdata.errors import BadInput
    from labdata.frames import FrameStack
    from labdata.importers import read_frames
    from labdata.instrument_config import InstrumentConfig
    from labdata.limits import Limits
    from labdata.measurement import (
        Curve,
        Measurement,
        Posterior,
        Provenance,
        Result,
        make_measurement,
        make_refusal,
        measurement_from_draws,
        measurement_from_sd,
    )
    from labdata.plan import Plan, Step
    from labdata.sensors import load_camera, load_sensor, save_sensor
    from labdata.session import Session, StackEntry, open_session
    from labdata.target import Target

__all__ = [
    "BadInput",
    "Camera",
    "Conditions",
    "Curve",
    "FrameStack",
    "InstrumentConfig",
    "Limits",
    "Measurement",
    "Plan",
    "Posterior",
    "Provenance",
    "Result",
    "Session",
    "StackEntry",
    "Step",
    "Target",
    "load_camera",
    "load_sensor",
    "make_measurement",
    "make_refusal",
    "measurement_from_draws",
    "measurement_from_sd",
    "open_session",
    "read_frames",
    "save_sensor",
]

_HOMES = {
    "labdata.camera.description": ("Camera",),
    "labdata.conditions": ("Conditions",),
    "labdata.errors": ("BadInput",),
    "labdata.frames": ("FrameStack",),
    "labdata.importers": ("read_frames",),
    "labdata.instrument_config": ("InstrumentConfig",),
    "labdata.limits": ("Limits",),
    "labdata.measurement": (
        "Curve",
        "Measurement",
        "Posterior",
        "Provenance",
        "Result",
        "make_measurement",
        "make_refusal",
        "measurement_from_draws",
        "measurement_from_sd",
    ),
    "labdata.plan": ("Plan", "Step"),
    "labdata.sensors": ("load_camera", "load_sensor", "save_sensor"),
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
