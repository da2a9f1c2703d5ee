"""What one stack tells as soon as it is there: its level, and the quick measurements of its kind."""

from dataclasses import dataclass, replace

import numpy as np

from charact.live.frame_source import highest_code
from charact.session_measurement import measure, method_context
from labdata.lazy_stack import open_lazy_stack
from labdata.measurement import Measurement, Result
from labdata.session import Kind, Session, StackEntry

LEADING: dict[Kind, tuple[str, ...]] = {
    "dark": ("dark_signal", "read_noise", "noise_tvh"),
    "flat": ("covariance_gain", "system_gain", "snr"),
    "edge": ("mtf50",),
    "bars": ("mtf",),
    "point": ("bloom_diameter", "mtf50"),
    "scene": (),
}
BLOCK_FRAMES = 16


@dataclass(frozen=True, kw_only=True)
class QuickLook:
    """One stack looked at.

    Parameters
    ----------
    entry
        The stack.
    frames
        Its frames.
    mean_dn
        Mean over all pixels and frames, DN.
    saturated_px
        Pixels at or above full scale, the most of any frame.
    full_scale_dn
        Highest code, DN.
    result
        All that was measured.
    """

    entry: StackEntry
    frames: int
    mean_dn: float
    saturated_px: int
    full_scale_dn: float
    result: Result

    @property
    def leading(self) -> tuple[Measurement, ...]:
        """The measurements that a line has room for."""
        names = LEADING[self.entry.kind]
        own = [m for m in self.result.measurements if m.stack in (None, self.entry.label)]
        given = [m for name in names for m in own if m.quantity == name and m.value is not None]
        return tuple(given or [m for name in names[:1] for m in own if m.quantity == name])


def look_at(session: Session, entry: StackEntry, *, seed: int = 0) -> QuickLook:
    """Look at one stack of a session.

    Parameters
    ----------
    session
        The session up to the stack: a flat and a point are measured over the dark taken last at their settings.
    entry
        The stack.
    seed
        Seed of every random step.

    Raises
    ------
    BadInput
        If its frames cannot be read.
    """
    means, most_saturated, full_scale_dn = _levels(entry)
    return QuickLook(
        entry=entry,
        frames=len(means),
        mean_dn=float(means.mean()),
        saturated_px=most_saturated,
        full_scale_dn=full_scale_dn,
        result=_measure_stack(replace(session, stacks=(*_dark_of(session, entry), entry)), entry, seed),
    )


def _measure_stack(alone: Session, entry: StackEntry, seed: int) -> Result:
    if entry.kind == "scene":
        return Result()
    if entry.kind not in ("dark", "flat"):
        return measure(alone, quick=True, seed=seed)
    from charact import noise

    return noise.measure(alone, context=method_context(alone, quick=True, seed=seed))


def _dark_of(session: Session, entry: StackEntry) -> tuple[StackEntry, ...]:
    """Return the last dark before a flat or a point that was taken at its gain, gate and exposure."""
    if entry.kind not in ("flat", "point"):
        return ()
    return tuple(dark for dark in session.of_kind("dark") if _setting(dark) == _setting(entry))[-1:]


def _setting(entry: StackEntry) -> tuple[object, ...]:
    asked = entry.asked or entry.conditions
    return asked.mcp_v, asked.gate_ns, asked.exposure_s, asked.camera_gain_db


def _levels(entry: StackEntry) -> tuple[np.ndarray, int, float]:
    """Return the mean of each frame, the most saturated pixels of any frame, and full scale; read a few at a time."""
    stack = open_lazy_stack(entry)
    full_scale_dn = stack.full_scale_dn or highest_code(stack.dtype)
    means, most = [], 0
    for first in range(0, len(stack), BLOCK_FRAMES):
        frames = stack.frames(first, min(first + BLOCK_FRAMES, len(stack)))
        means.append(frames.mean(axis=(1, 2), dtype=np.float64))
        most = max(most, int(np.count_nonzero(frames >= full_scale_dn, axis=(1, 2)).max()))
    return np.concatenate(means), most, full_scale_dn
