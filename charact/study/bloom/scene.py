"""Sessions of a point source far too bright, whose truth is known in closed form.

Neither the simulator nor a formula of the analysis has a part in it: `BloomScene` is the source with all that may be
wrong, `expected` its noiseless picture, `stack` and `session` draw frames, `truth` says what should be found.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from charact.study.bloom.camera import digitised, expected, stack
from charact.study.bloom.source import BloomScene
from charact.study.bloom.truth import truth
from charact.study.flats.stacks import HeldStack
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Kind, Session

__all__ = ["BloomScene", "expected", "session", "stack", "truth"]

LUX_AT_OVERLOAD_1 = 1e-6


def session(scene: BloomScene, overloads: Sequence[float], rng: np.random.Generator, *, darks: bool = True) -> Session:
    """Draw a point stack for each overload, and a dark stack of as many frames."""
    children = rng.spawn(len(overloads) + 1)
    faintest = min(overloads)
    entries = [
        _entry(scene, "point", f"point-{number}", overload, stack(scene, overload, child, faintest=faintest), child)
        for number, (overload, child) in enumerate(zip(overloads, children[1:], strict=True))
    ]
    if darks:
        level = np.full((scene.frames, scene.rows, scene.cols), scene.dark_dn + scene.wrong_dark_dn)
        entries.insert(0, _entry(scene, "dark", "dark", 0.0, digitised(scene, level, children[0]), children[0]))
    return Session(folder=Path("."), name="a point source of closed form", stacks=tuple(entries))


def _entry(
    scene: BloomScene, kind: Kind, label: str, overload: float, frames: FrameStack, rng: np.random.Generator
) -> HeldStack:
    stated = LUX_AT_OVERLOAD_1 * overload * float(np.exp(scene.light_sd * rng.standard_normal()))
    conditions = Conditions(illuminance_lux=stated, mcp_v=800.0, gate_ns=1.6e7, exposure_s=0.0167)
    return HeldStack(label=label, kind=kind, frames="", conditions=conditions, folder=Path("."), held=frames)
