"""How often the targets of one camera agree and hold its truth, and how surely one out of focus is
found.

`python -m benchmarks.studies.consistency_table` measures a hundred sessions and those with a fault
and keeps what came of it.
"""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.studies.consistency_scenes import KINDS, SessionScene, SimulatedScene
from charact.estimators.mtf.session.joint import fit_joint_mtf
from labdata import Result

TABLE = Path(__file__).with_name("tables") / "agreement.json"
MADE = {"closed form": SessionScene, "simulated": SimulatedScene}
# A fault: the blur of these targets is wider by this share (of a simulated camera: by this share of
# a pixel, squared).
FAULTS = {
    "closed form": (
        ("edge", 0.05),
        ("edge", 0.15),
        ("bars", 0.15),
        ("point", 0.05),
        ("point", 0.15),
    ),
    "simulated": (("edge", 0.5), ("point", 0.5)),
}


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What the joint fit said of one session.

    Parameters
    ----------
    probability
        Chance of a chi squared as large; NaN where there is no joint fit.
    inside
        Whether all targets agree within their joint 95 % region.
    ok
        Whether the joint MTF50 carries no flag.
    differs_most
        The target that differs most from the others.
    targets
        How many took part.
    beside
        Every MTF50 and MTF10 with an interval beside its truth.
    """

    probability: float
    inside: bool
    ok: bool
    differs_most: str
    targets: int
    beside: tuple["CrossingComparison", ...]


@dataclass(frozen=True, kw_only=True)
class CrossingComparison:
    """A frequency at which the MTF falls to a level, beside the true one.

    Parameters
    ----------
    name
        Method, quantity and direction.
    ok
        Whether it carries no flag.
    off
        (Value - truth) over the half of its 95 % interval on the truth's side.
    """

    name: str
    ok: bool
    off: float


LEVELS = {"mtf50": 0.5, "mtf10": 0.1}
# Further off than this without a flag is a silent failure.
SILENT = 2.0


def judge_session(
    number: int, *, made: str, seed: int, defocus: float = 0.0, of: str = "edge", quick: bool = True
) -> Judged:
    """Draw a session, measure every target, fit them together and say what came of it.

    Parameters
    ----------
    number, seed
        The session is drawn with the seed (seed, number).
    made
        "closed form" or "simulated".
    defocus, of
        The targets whose label begins so have a blur wider by this share.
    quick
        No Markov chains.
    """
    rng = np.random.default_rng([seed, number])
    scene = MADE[made].drawn(rng)
    context = scene.context(number, quick=quick)
    result = scene.measured(rng, context, defocus=defocus, of=of)
    together = fit_joint_mtf(result, KINDS, context=context)
    beside = tuple(_compare_with_truth(result + together, scene.truth_at))
    found = together.find("mtf50", orientation_deg=0.0)
    if not found or found[0].value is None:
        return Judged(
            probability=np.nan, inside=False, ok=False, differs_most="", targets=0, beside=beside
        )
    test = together.evidence["joint MTF"]
    return Judged(
        probability=test["probability"],
        inside=test["inside_joint_95_percent_region"],
        ok=found[0].status == "ok",
        differs_most=test["differs_most"],
        targets=len(test["target"]),
        beside=beside,
    )


def _compare_with_truth(
    result: Result, truth_at: Callable[[float, float], float]
) -> Iterator[CrossingComparison]:
    """Yield every MTF50 and MTF10 of a result beside its truth."""
    for m in (*result.find("mtf50"), *result.find("mtf10")):
        if m.value is None or m.interval95 is None:
            continue
        angle_deg = m.orientation_deg or 0.0
        off, (low, high) = m.value - truth_at(LEVELS[m.quantity], angle_deg), m.interval95
        along = "columns" if abs(angle_deg) > 45.0 else "rows"
        arm = m.value - low if off > 0 else high - m.value
        yield CrossingComparison(
            name=f"{m.method} {m.quantity} along {along}",
            ok=m.status == "ok",
            off=off / max(arm, 1e-12),
        )


def row(sessions: Sequence[Judged], *, made: str, defocus: float, of: str) -> dict:
    """Sum up sessions made alike."""
    return {
        "made": made,
        "out_of_focus": of if defocus else "none",
        "defocus": defocus,
        "sessions": len(sessions),
        "agree": sum(one.inside for one in sessions),
        "ok": sum(one.ok for one in sessions),
        "named_rightly": sum(one.differs_most.startswith(of) for one in sessions)
        if defocus
        else None,
        "least_targets": min(one.targets for one in sessions),
        "beside_truth": None
        if defocus
        else _summarise_differences([one for session in sessions for one in session.beside]),
    }


def _summarise_differences(beside: Sequence[CrossingComparison]) -> list[dict]:
    """How far numbers without a flag are off their truth, by name."""
    rows = []
    for name in sorted({one.name for one in beside}):
        own = [one for one in beside if one.name == name]
        off = np.array([one.off for one in own if one.ok])
        rows.append(
            {
                "name": name,
                "numbers": len(own),
                "ok": len(off),
                "missed": int(np.sum(np.abs(off) > 1.0)),
                "silent": int(np.sum(np.abs(off) > SILENT)),
                "rms_standard_errors": float(1.96 * np.sqrt(np.mean(off**2))) if len(off) else None,
            }
        )
    return rows


def measure_table(counts: dict[str, tuple[int, int]], *, seed: int, workers: int) -> list[dict]:
    """Measure the table.

    Parameters
    ----------
    counts
        How many sessions without a fault and with each fault, by how they are made.
    seed
        Seed of all of them.
    workers
        Processes.
    """
    rows = []
    with ProcessPoolExecutor(workers) as pool:
        for made, (plain, faulty) in counts.items():
            for of, defocus, count in [
                ("edge", 0.0, plain),
                *((of, share, faulty) for of, share in FAULTS[made]),
            ]:
                judge = partial(judge_session, made=made, seed=seed, defocus=defocus, of=of)
                if count:
                    rows.append(
                        row(list(pool.map(judge, range(count))), made=made, defocus=defocus, of=of)
                    )
                    print(line(rows[-1]), flush=True)
    return rows


def line(one: dict) -> str:
    """One row for people."""
    fault = (
        "no fault"
        if not one["defocus"]
        else f"{one['out_of_focus']} blurred by {100 * one['defocus']:.0f} % more"
    )
    named = "" if one["named_rightly"] is None else f", named rightly {one['named_rightly']}"
    truth = "".join(
        (
            f"\n    {name['name']}: {name['ok']} ok of {name['numbers']}, {name['missed']} miss, "
            f"{name['silent']} silent"
        )
        for name in one["beside_truth"] or ()
    )
    return (
        f"{one['made']}, {fault}: {one['agree']} of {one['sessions']} agree, {one['ok']} "
        f"ok{named}{truth}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the table, print it and keep it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--faulty", type=int, default=25)
    parser.add_argument("--simulated", type=int, default=20)
    parser.add_argument("--simulated-faulty", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--keep", action="store_true", help="rewrite the table")
    asked = parser.parse_args(arguments)
    counts = {
        "closed form": (asked.sessions, asked.faulty),
        "simulated": (asked.simulated, asked.simulated_faulty),
    }
    rows = measure_table(counts, seed=asked.seed, workers=asked.workers)
    if asked.keep:
        TABLE.parent.mkdir(exist_ok=True)
        TABLE.write_text(json.dumps({"seed": asked.seed, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
