"""Quick look at the stacks of a running acquisition: grey values and quick measurements."""

import stat
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from charact.live.frame_source import full_scale_of
from charact.session_measurement import measure, method_context
from labdata import BadInput, Kind, Measurement, Result, open_lazy_stack, read_events
from labdata.session import MANIFEST, Session, StackEntry, read_manifest, session_of

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
    """Quick look at one stack.

    Mean over all pixels and frames, DN; largest number of pixels at or above full scale in any
    frame; all measurements.
    """

    entry: StackEntry
    frames: int
    mean_dn: float
    saturated_px: int
    full_scale_dn: float
    result: Result

    @property
    def leading(self) -> tuple[Measurement, ...]:
        """The main measurements, for one line."""
        names = LEADING[self.entry.kind]
        of_stack = [m for m in self.result.measurements if m.stack in (None, self.entry.label)]
        leading = [
            m for name in names for m in of_stack if m.quantity == name and m.value is not None
        ]
        return tuple(leading or [m for name in names[:1] for m in of_stack if m.quantity == name])


def look_at(session: Session, entry: StackEntry, *, seed: int = 0) -> QuickLook:
    """Measure one stack of a session quickly; a flat or point uses the last dark with its
    settings.
    """
    means, most_saturated, full_scale_dn = _levels(entry)
    return QuickLook(
        entry=entry,
        frames=len(means),
        mean_dn=float(means.mean()),
        saturated_px=most_saturated,
        full_scale_dn=full_scale_dn,
        result=_measure_stack(
            replace(session, stacks=(*_dark_of(session, entry), entry)), entry, seed
        ),
    )


def _measure_stack(alone: Session, entry: StackEntry, seed: int) -> Result:
    if entry.kind == "scene":
        return Result()
    if entry.kind not in ("dark", "flat"):
        return measure(alone, quick=True, seed=seed)
    from charact.estimators import noise

    return noise.measure(alone, context=method_context(alone, quick=True, seed=seed))


def _dark_of(session: Session, entry: StackEntry) -> tuple[StackEntry, ...]:
    """Return the last dark with the gain, gate and exposure of a flat or point."""
    if entry.kind not in ("flat", "point"):
        return ()
    return tuple(dark for dark in session.of_kind("dark") if _setting(dark) == _setting(entry))[-1:]


def _setting(entry: StackEntry) -> tuple[object, ...]:
    setting = entry.asked or entry.conditions
    return setting.mcp_v, setting.gate_ns, setting.exposure_s, setting.camera_gain_db


def _levels(entry: StackEntry) -> tuple[np.ndarray, int, float]:
    """Return frame means, the largest number of saturated pixels of a frame, and full scale, DN;
    read in blocks.
    """
    stack = open_lazy_stack(entry)
    full_scale_dn = stack.full_scale_dn or full_scale_of(stack.dtype)
    means, most_saturated = [], 0
    for first in range(0, len(stack), BLOCK_FRAMES):
        frames = stack.frames(first, min(first + BLOCK_FRAMES, len(stack)))
        means.append(frames.mean(axis=(1, 2), dtype=np.float64))
        most_saturated = max(
            most_saturated, int(np.count_nonzero(frames >= full_scale_dn, axis=(1, 2)).max())
        )
    return np.concatenate(means), most_saturated, full_scale_dn


def watch_stacks(
    folder: str | Path, *, once: bool = False, patience_s: float = 1800.0, look_s: float = 0.5
) -> Iterator[tuple[Session, StackEntry]]:
    """Yield each finished stack of a running acquisition, with the session up to it.

    Parameters
    ----------
    folder
        Folder of the session.
    once
        Whether to end with the stacks present now.
    patience_s, look_s
        Maximum wait for the next stack, and interval between two reads, s.

    Raises
    ------
    BadInput
        If there is no session, the run ended before its plan was completed, or no stack was
        completed in time.
    """
    folder, seen_labels, since_s = Path(folder), set[str](), time.monotonic()
    if not (folder / MANIFEST).is_file():
        raise BadInput(f"a session must be a folder with a {MANIFEST}, got {folder}")
    while True:
        # The log is read before the stacks, so that a stack finished in between is not missed.
        ended = run_outcome(folder)
        for session, entry in _stacks_on_disk(folder):
            if entry.label not in seen_labels:
                seen_labels.add(entry.label)
                yield session, entry
                since_s = time.monotonic()
        if ended == "" or once:
            return
        if ended is not None:
            raise BadInput(f"the run ended before its plan was completed: {ended}")
        if time.monotonic() - since_s > patience_s:
            raise BadInput(
                f"a stack must be completed within {patience_s:g} s, got none; resume the "
                "acquisition"
            )
        time.sleep(look_s)


def run_outcome(folder: Path) -> str | None:
    """Return None while a plan runs, "" once it is completed (or has no log), else why it ended."""
    try:
        runs = [
            event
            for event in read_events(folder / "log.jsonl")
            if event.get("event") in ("run begins", "run ends")
        ]
    except FileNotFoundError:
        return ""
    if not runs or runs[-1]["event"] == "run begins":
        return None
    return "" if runs[-1].get("whole") else str(runs[-1].get("reason", "no reason was logged"))


def _stacks_on_disk(folder: Path) -> Iterator[tuple[Session, StackEntry]]:
    form = read_manifest(folder)
    if not form.stack:
        return
    session = session_of(folder, form)
    for index, entry in enumerate(session.stacks):
        if entry.finished:
            yield replace(session, stacks=session.stacks[: index + 1]), entry


def watch_files(
    folder: Path,
    *,
    once: bool,
    patience_s: float,
    poll_s: float = 0.5,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[Path]:
    """Yield each file of frames in a folder once it is complete, in the order of their times.

    A file is complete when its size has not changed for one poll. Ends with `once` after the files
    that are there, else when no file has come for `patience_s`.
    """
    from labdata.importers import module_of

    seen_paths: set[Path] = set()
    sizes: dict[Path, int] = {}
    waited_s = 0.0
    while True:
        states = {}
        for path in folder.iterdir():
            if module_of(path) and path not in seen_paths:
                with suppress(FileNotFoundError):  # renamed or deleted meanwhile
                    states[path] = path.stat()
        new = [path for path, state in states.items() if stat.S_ISREG(state.st_mode)]
        ready = [path for path in new if sizes.get(path) == states[path].st_size]
        sizes = {path: states[path].st_size for path in new}
        for path in sorted(ready, key=lambda path: (states[path].st_mtime, path.name)):
            seen_paths.add(path)
            yield path
        waited_s = 0.0 if ready else waited_s + poll_s
        if (once and not set(new) - set(ready)) or waited_s > patience_s:
            return
        sleep(poll_s)
