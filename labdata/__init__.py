"""What a lab knows and recorded: frames, conditions, sensors, targets, plans, sessions, measurements, storage."""

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Curve, Measurement, Posterior, Provenance, Result
from labdata.sensor import Sensor
from labdata.session import Session, StackEntry, open_session
from labdata.target import Target

__all__ = [
    "BadInput",
    "Conditions",
    "Curve",
    "FrameStack",
    "Measurement",
    "Posterior",
    "Provenance",
    "Result",
    "Sensor",
    "Session",
    "StackEntry",
    "Target",
    "open_session",
]
