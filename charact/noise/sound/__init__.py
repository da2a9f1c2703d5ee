"""Preparation of a session: defective pixels replaced, values in units of the quantisation step."""

from charact.noise.sound.session import Prepared, prepare

__all__ = ["Prepared", "prepare"]
