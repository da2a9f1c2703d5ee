"""Pixels that misbehave and the step of the digitiser: found once a session, before anything is measured."""

from charact.noise.sound.session import Prepared, prepare

__all__ = ["Prepared", "prepare"]
