"""`python -m benchmarks.acquisition`: what acquisition loses, how fast it can store, and what it
adds to each step.

Three promises, each printed with its figure; exit code 1 if one is broken. The first takes ten
minutes: `--minutes` makes it shorter.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.synthetic_rig import COLUMNS, ROWS, NoOperator, PacedCamera, SlowBench
from charact.live import SaturationJudge
from drivers import acquire
from drivers.acquisition.acquire import LOG
from labdata import Conditions, Session
from labdata.capture import Frame
from labdata.event_log import read_events
from labdata.plan import Plan, Step
from labdata.session_writer import SessionWriter
from labdata.storage_thread import CAPACITY_BYTES, Storage

RATE_HZ = 30.0
LEAST_TIMES_RATE = 8.0
LEAST_SHARE_OF_FILES = 0.6
MOST_OVERHEAD_MS = 5.0
MOST_GROWTH_BYTES = CAPACITY_BYTES + (32 << 20)
ROUND_FRAMES, ROUNDS = 400, 5
STEPS, STEP_FRAMES = 60, 5


def main() -> int:
    """Run all three and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--minutes", type=float, default=10.0, help="length of the run at the camera's rate"
    )
    parser.add_argument(
        "--folder", type=Path, help="disk to write to; default: the temporary folder's"
    )
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=asked.folder) as folder:
        checks: tuple[Callable[[Path], bool], ...] = (
            overhead,
            writing,
            lambda inside: at_the_cameras_rate(inside, asked.minutes),
        )
        kept = [check(Path(folder)) for check in checks]
        return 0 if all(kept) else 1


def at_the_cameras_rate(folder: Path, minutes: float) -> bool:
    """A camera of 768 x 493 pixels and 16 bits at 30 frames/s: none lost, and memory that stays."""
    frames = round(minutes * 60.0 * RATE_HZ)
    memory = _Memory()
    session = _taken(
        folder / "rate", [_step("flat", frames)], PacedCamera(rate_hz=RATE_HZ), look=memory.look
    )
    entry = session.stack("flat")
    stored = sum(1 for line in (folder / "rate/frames/flat.zarr/journal.jsonl").open())
    kept = stored == frames and entry.lost_frames == 0 and memory.growth_bytes < MOST_GROWTH_BYTES
    _tell(
        f"{minutes:g} min at {RATE_HZ:g} frames/s",
        f"{stored} of {frames} frames stored, {entry.lost_frames} lost, memory grown by "
        f"{memory.growth_bytes / 1e6:.0f} MB",
        f"none lost, less than {MOST_GROWTH_BYTES / 1e6:.0f} MB",
        kept,
    )
    shutil.rmtree(folder / "rate")
    return kept


def writing(folder: Path) -> bool:
    """Frames stored as fast as they are handed over, and plain files of the same frames, turn by
    turn.
    """
    frames = np.random.default_rng(1).integers(
        0, 4096, (ROUND_FRAMES, ROWS, COLUMNS), dtype=np.uint16
    )
    ours = files = 0.0
    for number in range(ROUNDS):
        ours += _seconds(lambda place: _store(place, frames), folder / f"ours-{number}")
        files += _seconds(lambda place: _plain_files(place, frames), folder / f"files-{number}")
    ours_hz, files_hz = ROUNDS * ROUND_FRAMES / ours, ROUNDS * ROUND_FRAMES / files
    kept = ours_hz >= LEAST_TIMES_RATE * RATE_HZ and ours_hz >= LEAST_SHARE_OF_FILES * files_hz
    _tell(
        f"writing {ROUNDS * ROUND_FRAMES} frames",
        f"{ours_hz:.0f} frames/s, {ours_hz / RATE_HZ:.1f} x the camera's rate, "
        f"{100 * ours_hz / files_hz:.0f} % of plain files ({files_hz:.0f} frames/s)",
        f"at least {LEAST_TIMES_RATE:g} x and {100 * LEAST_SHARE_OF_FILES:.0f} %",
        kept,
    )
    return kept


def overhead(folder: Path) -> bool:
    """Time of each step that is neither settling nor on the wire, with instruments that take 20 ms
    to answer.
    """
    steps = [_step(f"step-{number}", STEP_FRAMES) for number in range(STEPS)]
    _taken(folder / "steps", steps, PacedCamera(rate_hz=RATE_HZ), answer_s=0.02)
    spent_ms = [
        each["overhead_ms"]
        for each in read_events(folder / "steps" / LOG)
        if each["event"] == "step finished"
    ]
    mean_ms, kept = float(np.mean(spent_ms)), float(np.mean(spent_ms)) <= MOST_OVERHEAD_MS
    _tell(
        f"{STEPS} steps of {STEP_FRAMES} frames",
        (
            f"overhead {mean_ms:.1f} ms a step, median {np.median(spent_ms):.1f}, worst "
            f"{max(spent_ms):.1f}"
        ),
        f"at most {MOST_OVERHEAD_MS:g} ms",
        kept,
    )
    return kept


def _taken(
    folder: Path,
    steps: list[Step],
    camera: PacedCamera,
    *,
    answer_s: float = 0.0,
    look: Callable[[], None] = lambda: None,
) -> Session:
    return acquire(
        Plan(name="benchmark", steps=tuple(steps)),
        folder,
        camera=camera,
        bench=SlowBench(answer_s=answer_s),
        operator=NoOperator(),
        judge=SaturationJudge(),
        progress=lambda sentence, share: look(),
    )


def _step(label: str, frames: int) -> Step:
    asked = Conditions(mcp_v=700.0, gate_ns=1.6e7, illuminance_lux=1e-4)
    return Step(label=label, kind="flat", frames=frames, conditions=asked)


def _store(folder: Path, frames: np.ndarray) -> None:
    with (
        SessionWriter.create(folder, name="benchmark") as writer,
        Storage(writer, patience_s=60.0) as storage,
    ):
        stack = storage.begin_stack("flat", "flat", frames.shape[1:], frames.dtype, Conditions())
        for number, pixels in enumerate(frames):
            stack.enqueue(Frame(pixels=pixels, number=number, time_s=number / RATE_HZ))
        stack.finish()
        storage.wait()


def _plain_files(folder: Path, frames: np.ndarray) -> None:
    folder.mkdir()
    for number, frame in enumerate(frames):
        with open(folder / f"{number}.npy", "wb") as file:
            np.save(file, frame)
            file.flush()
            os.fsync(file.fileno())


def _seconds(work: Callable[[Path], None], folder: Path) -> float:
    began_s = time.perf_counter()
    work(folder)
    seconds = time.perf_counter() - began_s
    shutil.rmtree(folder)
    return seconds


class _Memory:
    """How far the memory of this process grew beyond its size at the first look."""

    def __init__(self) -> None:
        self._first: int | None = None
        self.growth_bytes = 0

    def look(self) -> None:
        resident = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        self._first = self._first or resident
        self.growth_bytes = max(self.growth_bytes, resident - self._first)


def _tell(name: str, figure: str, promise: str, kept: bool) -> None:
    print(f"{name:28} {figure}   promised {promise}: {'kept' if kept else 'BROKEN'}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
