"""Sessions of a point source far too bright, whose truth is known in closed form.

Neither the simulator nor a formula of the analysis has a part in it: `BloomScene` is the source with all that may be
wrong, `noiseless_frame` its noiseless picture, `stack` and `bloom_session` draw frames, `truth` says what should be
found.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from charact.study.bloom.camera import digitise_frames, noiseless_frame, stack
from charact.study.bloom.source import BloomScene
from charact.study.bloom.truth import truth
from charact.study.flats.flat_cases import InMemoryStack
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.session import Kind, Session

__all__ = ["BloomScene", "bloom_session", "noiseless_frame", "stack", "truth"]

LUX_AT_OVERLOAD_1 = 1e-6


def bloom_session(
    scene: BloomScene, overloads: Sequence[float], rng: np.random.Generator, *, darks: bool = True
) -> Session:
    """Draw a point stack for each overload, and a dark stack of as many frames."""
    children = rng.spawn(len(overloads) + 1)
    faintest = min(overloads)
    entries = [
        _entry(scene, "point", f"point-{number}", overload, stack(scene, overload, child, faintest=faintest), child)
        for number, (overload, child) in enumerate(zip(overloads, children[1:], strict=True))
    ]
    if darks:
        level = np.full((scene.frames, scene.rows, scene.cols), scene.dark_dn + scene.wrong_dark_dn)
        entries.insert(0, _entry(scene, "dark", "dark", 0.0, digitise_frames(scene, level, children[0]), children[0]))
    return Session(folder=Path("."), name="a point source of closed form", stacks=tuple(entries))


def _entry(
    scene: BloomScene, kind: Kind, label: str, overload: float, frames: FrameStack, rng: np.random.Generator
) -> InMemoryStack:
    stated = LUX_AT_OVERLOAD_1 * overload * float(np.exp(scene.light_sd * rng.standard_normal()))
    conditions = Conditions(illuminance_lux=stated, mcp_v=800.0, gate_ns=1.6e7, exposure_s=0.0167)
    return InMemoryStack(label=label, kind=kind, frames="", conditions=conditions, folder=Path("."), held=frames)
