"""Frames a second that the store acknowledges, against plain files flushed to disk."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.row import Row, best_seconds

FRAMES = 60


def rows() -> Iterator[Row]:
    """One row: a stack of 768x493 frames of 16 bits."""
    frames = np.random.default_rng(1).integers(0, 4096, (FRAMES, 493, 768), dtype=np.uint16)
    with tempfile.TemporaryDirectory() as folder:
        counter = iter(range(1000))
        ours = best_seconds(lambda: _store(Path(folder) / f"ours-{next(counter)}", frames), 3)
        peer = best_seconds(lambda: _files(Path(folder) / f"peer-{next(counter)}", frames), 3)
    yield Row(
        name=f"store of {FRAMES} frames, acknowledged",
        seconds=ours,
        peer="numpy.save and fsync",
        peer_seconds=peer,
        limit_seconds=FRAMES / 30,
    )


def _store(folder: Path, frames: np.ndarray) -> None:
    from labdata import Conditions, Target
    from labdata.session_writer import SessionWriter

    writer = SessionWriter.create(folder, name="benchmark")
    stack = writer.begin_stack(
        "flat", "flat", frames.shape[1:], frames.dtype, Conditions(), None, Target()
    )
    for number, frame in enumerate(frames):
        stack.append(frame, number / 30, number)
    stack.finish()


def _files(folder: Path, frames: np.ndarray) -> None:
    folder.mkdir()
    for number, frame in enumerate(frames):
        with open(folder / f"{number}.npy", "wb") as file:
            np.save(file, frame)
            file.flush()
            os.fsync(file.fileno())
