"""`python -m tests.fuzz --seconds 3600`: every parser of bytes from outside, each for its share of
the time, in its own processes; `--mutations 300` gives each kind of file, document and reply as
many cases instead.

A parser that crashes takes only its own process along: decoders that are not ours are among them.
What broke is told with the seed that makes it again: `python -m tests.fuzz --again PARSER SEED`.
"""

import argparse
import json
import math
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.fuzz import documents, kernel_answers, pictures, serial_replies
from tests.fuzz.bounds import LONGEST_S, in_time, limit_memory, most_resident_mb, require_little

PARSERS: dict[str, Callable[[random.Random, Path], bool]] = {
    "serial": serial_replies.once,
    "v4l2": kernel_answers.once,
    "documents": documents.once,
    "pictures": pictures.once,
}
"""What is fuzzed: each reads something drawn, in a folder of its own, and returns whether it was
sound."""

KINDS: dict[str, Callable[[random.Random, Path], bool]] = {
    **{f"file {name}": partial(pictures.read, name) for name in pictures.FILES},
    **{f"document {name}": partial(documents.mangle_and_read, name) for name in documents.TARGETS},
    **{f"reply {name}": partial(serial_replies.hear, name) for name in serial_replies.PARSERS},
    "v4l2": kernel_answers.once,
}
"""The same by kind."""

SLICE_S = 120.0
STUCK_S = 300.0  # of a busy machine; the processor time of a case has its own bound


def main() -> int:
    """Fuzz and print the tally; exit code 1 if anything broke."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=3600.0, help="time in all, s")
    parser.add_argument("--seed", type=int, default=time.time_ns() % 2**31)
    parser.add_argument("--mutations", type=int, help="cases of each kind, in place of a time")
    parser.add_argument("--only", choices=PARSERS)
    parser.add_argument(
        "--again", nargs=2, metavar=("PARSER", "SEED"), help="one case, with what it raises"
    )
    parser.add_argument(
        "--slice",
        nargs=4,
        metavar=("PARSER", "SECONDS", "CASES", "STATE"),
        help=argparse.SUPPRESS,
    )
    asked = parser.parse_args()
    if asked.again:
        return _again(asked.again[0], int(asked.again[1]))
    if asked.slice:
        name, seconds, cases, state = asked.slice
        return _slice(name, float(seconds), int(cases), Path(state), asked.seed)
    if asked.mutations:
        return _every_kind(asked.mutations, asked.seed)
    return _all([asked.only] if asked.only else list(PARSERS), asked.seconds, asked.seed)


def _all(names: list[str], seconds: float, seed: int) -> int:
    """Give each parser a slice in turn until the time is over."""
    print(f"seed {seed}, {seconds:g} s for {', '.join(names)}", flush=True)
    slice_s = min(SLICE_S, seconds / len(names))
    tallies: dict[str, Counter[str]] = {name: Counter() for name in names}
    for turn in range(round(seconds / slice_s)):
        name = names[turn % len(names)]
        found = _sliced(name, slice_s, seed + (turn << 32))
        most = {key: max(tallies[name][key], found.pop(key, 0)) for key in ("most_mb", "worst_ms")}
        tallies[name].update(found)
        tallies[name] |= Counter(most)
    for name, tally in tallies.items():
        print(
            f"{name}: {tally['read']} read in {tally['seconds']} s, {tally['sound']} of them "
            f"still sound, {tally['broken']} broke it; {tally['most_mb']} MB at most"
        )
    return 1 if any(tally["broken"] for tally in tallies.values()) else 0


def _every_kind(cases: int, seed: int) -> int:
    """Give each kind its cases."""
    print(f"seed {seed}, {cases} cases of each of {len(KINDS)} kinds", flush=True)
    tallies = {name: _sliced(name, math.inf, seed, cases) for name in KINDS}
    for name, tally in tallies.items():
        print(
            f"{name}: {tally.get('read', 0)} read, {tally.get('sound', 0)} of them still sound, "
            f"{tally['broken']} broke it; {tally.get('worst_ms', 0)} ms of the processor and "
            f"{tally.get('most_mb', 0)} MB at most"
        )
    return 1 if any(tally["broken"] for tally in tallies.values()) else 0


def _sliced(name: str, seconds: float, seed: int, cases: int = 0) -> dict[str, int]:
    """Run one slice in its own process; one that crashes or goes no further there has broken
    something.
    """
    with tempfile.TemporaryDirectory() as folder:
        state = Path(folder) / "seed"
        state.touch()
        command = [
            sys.executable,
            "-m",
            "tests.fuzz",
            "--slice",
            name,
            str(seconds),
            str(cases),
            str(state),
            "--seed",
            str(seed),
        ]
        said, how = _outlived(subprocess.Popen(command, stdout=subprocess.PIPE, text=True), state)
        last = state.read_text()
    lines = said.splitlines()
    tally = {"broken": 1} if how else json.loads(lines.pop())
    for line in (*lines, *([f"its process {how} at --again {name} {last}"] if how else [])):
        print(f"BROKEN {name}: {line}", flush=True)
    return tally


def _outlived(process: subprocess.Popen, state: Path) -> tuple[str, str]:
    """Wait for the end of a slice; return what it said, and how it ended if that was no good
    end.
    """
    before = ""
    while True:
        try:
            said, _ = process.communicate(timeout=STUCK_S)
            return (
                said,
                "" if process.returncode == 0 else f"ended with {_ended(process.returncode)}",
            )
        except subprocess.TimeoutExpired:
            if (now := state.read_text()) and now == before:
                process.kill()
                return process.communicate()[0], f"went no further for {STUCK_S:g} s"
            before = now


def _ended(code: int) -> str:
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"


def _slice(name: str, seconds: float, cases: int, state: Path, seed: int) -> int:
    """Fuzz one parser for a time, or with a number of cases; tell what breaks it, line by line, and
    the tally last.
    """
    limit_memory()
    tally: Counter[str] = Counter(broken=0, worst_ms=0)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder, state.open("w") as file:
        while time.monotonic() < began_s + seconds and tally["read"] < (cases or math.inf):
            seed += 1
            file.seek(0)
            file.write(f"{seed:20d}")
            file.flush()
            tally["read"] += 1
            before_mb, before_s = most_resident_mb(), time.process_time()
            try:
                tally["sound"] += _once(name, seed, Path(folder))
                require_little(most_resident_mb() - before_mb)
            except Exception as error:  # whatever it is, it is what is looked for
                tally["broken"] += 1
                print(
                    f"{type(error).__name__}: {str(error)[:200]!r} at --again {name} {seed}",
                    flush=True,
                )
            worst_ms = round(1e3 * (time.process_time() - before_s))
            tally["worst_ms"] = max(tally["worst_ms"], worst_ms)
    tally["seconds"] = round(time.monotonic() - began_s)
    tally["most_mb"] = round(most_resident_mb())
    print(json.dumps(tally))
    return 0


def _once(name: str, seed: int, folder: Path) -> bool:
    with in_time(LONGEST_S):
        return (PARSERS | KINDS)[name](random.Random(seed), folder)


def _again(name: str, seed: int) -> int:
    limit_memory()
    with tempfile.TemporaryDirectory() as folder:
        print("sound" if _once(name, seed, Path(folder)) else "refused")
    return 0


if __name__ == "__main__":
    sys.exit(main())
