"""Invent programs of one to three faults, and shrink one that leaves the tube hot.

`python -m benchmarks.studies.faults.inventing --seconds 120 --seed 1`; needs a C compiler for
errors and delays of system calls.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import count
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.studies.faults.inventing.faults import (
    TABLE,
    Fault,
    draw_of_table,
    draw_program,
    smaller,
)
from benchmarks.studies.faults.inventing.trial import Verdict, try_program

SHIM = "CHARACT_INVENTING_SHIM"
# A folder of devices: the guard waits for ports there for as long as they stay away
PORTS = Path("/dev/shm")
# Longest time of an open gate in the kinds of the table, but where an instrument was not reached
GATE_LIMIT_S = 1.0
TRIES = 2  # Tries in which a smaller program must fail once to be taken


def main() -> int:
    """Try programs until the time is over; exit code 1 if one failed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.studies.faults.inventing", description=__doc__
    )
    parser.add_argument("--seconds", type=float, default=120.0, help="begin no program after this")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=3, help="programs at a time")
    parser.add_argument("--only", type=int, help="number of the only program to try")
    parser.add_argument("--table", type=int, help="strikes of each kind of the table instead")
    asked = parser.parse_args()
    if SHIM not in os.environ and shutil.which("cc"):
        return _begin_with_shim()
    if asked.table is not None:
        return strike_table(asked.table, asked.seed, asked.jobs)
    tried, failed, beyond = 0, dict[int, Verdict](), list[int]()
    worst_s = {"gate": 0.0, "supply": 0.0}
    until_s = time.monotonic() + asked.seconds
    numbers = iter([asked.only]) if asked.only is not None else count()
    running: dict[Future[Verdict], int] = {}
    with ProcessPoolExecutor(asked.jobs, mp_context=get_context("fork")) as pool:
        while True:
            while len(running) < asked.jobs and time.monotonic() < until_s:
                if (number := next(numbers, None)) is None:
                    break
                running[pool.submit(attempt, program_of(asked.seed, number), number)] = number
            if not running:
                break
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                number, verdict = running.pop(done), done.result()
                tried += 1
                if verdict.beyond_software:
                    beyond.append(number)
                elif verdict.broken:
                    failed[number] = verdict
                    tell(f"FAILED {number}", program_of(asked.seed, number), verdict)
                else:
                    for who, hot_s in verdict.hot_s.items():
                        worst_s[who] = max(worst_s[who], hot_s - verdict.slack_s)
    if failed:
        shrink(program_of(asked.seed, min(failed)), min(failed))
    print(
        f"seed {asked.seed}: {tried} programs, {len(failed)} failed {sorted(failed)}, "
        f"{len(beyond)} left nobody to act {beyond}; longest time on of the others, beyond what "
        f"the machine's delays explain: gate {worst_s['gate']:.2f} s, voltage "
        f"{worst_s['supply']:.2f} s"
    )
    return 1 if failed else 0


def _begin_with_shim() -> int:
    """Compile the library that strikes system calls, and begin anew with it."""
    with tempfile.TemporaryDirectory() as name:
        shim, source = Path(name) / "inject.so", Path(__file__).with_name("inject.c")
        compile_it = ["cc", "-shared", "-fPIC", "-O1", "-o", str(shim), str(source), "-ldl"]
        subprocess.run(compile_it, check=True)
        environment = os.environ | {SHIM: str(shim), "LD_PRELOAD": str(shim)}
        command = [sys.executable, "-m", "benchmarks.studies.faults.inventing", *sys.argv[1:]]
        return subprocess.run(command, env=environment).returncode


def strike_table(strikes: int, seed: int, jobs: int) -> int:
    """Strike each kind of the table at random moments; exit code 1 if one left the tube hot."""
    programs = {
        kind: [draw_of_table(kind, np.random.default_rng([seed, at, n])) for n in range(strikes)]
        for at, kind in enumerate(TABLE)
        if SHIM in os.environ or "EIO" not in kind
    }
    is_broken = False
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        for kind, drawn in programs.items():
            verdicts = list(pool.map(attempt, drawn, range(strikes)))
            late = [sentence for verdict in verdicts for sentence in verdict.broken]
            late += [
                f"gate on for {verdict.hot_s['gate']:.2f} s, of which the machine explains "
                f"{verdict.slack_s:.2f} s"
                for program, verdict in zip(drawn, verdicts, strict=True)
                if verdict.hot_s["gate"] > GATE_LIMIT_S + verdict.slack_s
                and not any(fault.is_away for fault in program)
            ]
            gate_s, supply_s = (
                max(verdict.hot_s[who] for verdict in verdicts) for who in ("gate", "supply")
            )
            explained_s = max(verdict.slack_s for verdict in verdicts)
            print(
                f"{kind}: {strikes} strikes, gate on for {gate_s:.2f} s, voltage {supply_s:.2f} s "
                f"at most, the machine late by {explained_s:.2f} s; broken: {late or 'none'}",
                flush=True,
            )
            is_broken = is_broken or bool(late)
    return int(is_broken)


def program_of(seed: int, number: int) -> tuple[Fault, ...]:
    """Return a program by its number."""
    return draw_program(np.random.default_rng([seed, number]), calls=SHIM in os.environ)


def attempt(program: tuple[Fault, ...], number: int) -> Verdict:
    """Try a program in a folder of its own."""
    with tempfile.TemporaryDirectory(dir=PORTS, prefix="charact-inventing-") as name:
        return try_program(program, Path(name) / "run", os.environ.get(SHIM), number)


def tell(title: str, program: tuple[Fault, ...], verdict: Verdict) -> None:
    """Print a program and what broke."""
    print(f"{title}: {'; '.join(verdict.broken)} | {verdict.ended}")
    for fault in program:
        print(f"  {fault}", flush=True)


def shrink(program: tuple[Fault, ...], number: int) -> None:
    """Print the smallest program that still fails."""
    steps = smaller(program)
    while steps:
        step = steps.pop(0)
        verdicts = [attempt(step, number) for _ in range(TRIES)]
        if failing := [each for each in verdicts if each.broken and not each.beyond_software]:
            tell(f"still fails ({len(failing)} of {TRIES})", step, failing[0])
            steps = smaller(step)
    print("smaller programs do not fail", flush=True)


if __name__ == "__main__":
    sys.exit(main())
