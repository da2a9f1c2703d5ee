"""Pixels that misbehave and the step of the digitiser: found once a session, before anything is measured."""

from charact.noise.sound.session import Prepared, prepared

__all__ = ["Prepared", "prepared"]
