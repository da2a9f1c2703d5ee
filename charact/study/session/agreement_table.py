"""How often the targets of one camera agree, and how surely one out of focus is found: the table, measured anew.

`python -m charact.study.session.agreement_table` measures a hundred sessions and those with a fault and keeps what came
of it.
"""

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from charact.mtf.session.joint import joint
from charact.study.session.agreement import KINDS, SessionScene
from charact.study.session.agreement_simulated import SimulatedScene

TABLE = Path(__file__).resolve().parents[1] / "tables" / "agreement.json"
MADE = {"closed form": SessionScene, "simulated": SimulatedScene}
# A fault: the blur of these targets is wider by this share (of a simulated camera: by this share of a pixel, squared).
FAULTS = {
    "closed form": (("edge", 0.05), ("edge", 0.15), ("bars", 0.15), ("point", 0.05), ("point", 0.15)),
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
    z
        (MTF50 - truth) over half of its 68 % interval.
    """

    probability: float
    inside: bool
    ok: bool
    differs_most: str
    targets: int
    z: float


def judged(number: int, *, made: str, seed: int, defocus: float = 0.0, of: str = "edge", quick: bool = True) -> Judged:
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
    together = joint(scene.measured(rng, context, defocus=defocus, of=of), KINDS, context=context)
    found = together.find("mtf50", orientation_deg=0.0)
    if not found or found[0].value is None or found[0].interval68 is None:
        return Judged(probability=np.nan, inside=False, ok=False, differs_most="", targets=0, z=np.nan)
    test, (low, high) = together.evidence["joint MTF"], found[0].interval68
    return Judged(
        probability=test["probability"],
        inside=test["inside_joint_95_percent_region"],
        ok=found[0].status == "ok",
        differs_most=test["differs_most"],
        targets=len(test["target"]),
        z=(found[0].value - scene.truth_mtf50) / (0.5 * (high - low)),
    )


def row(sessions: Sequence[Judged], *, made: str, defocus: float, of: str) -> dict:
    """Sum up sessions made alike."""
    z = np.array([one.z for one in sessions])
    return {
        "made": made,
        "out_of_focus": of if defocus else "none",
        "defocus": defocus,
        "sessions": len(sessions),
        "agree": sum(one.inside for one in sessions),
        "ok": sum(one.ok for one in sessions),
        "named_rightly": sum(one.differs_most.startswith(of) for one in sessions) if defocus else None,
        "least_targets": min(one.targets for one in sessions),
        "mtf50_inside_95_percent": int(np.sum(np.abs(z) < 1.97)) if not defocus else None,
        "mtf50_rms_z": float(np.sqrt(np.nanmean(z**2))) if not defocus else None,
    }


def measured(counts: dict[str, tuple[int, int]], *, seed: int, workers: int) -> list[dict]:
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
            for of, defocus, count in [("edge", 0.0, plain), *((of, share, faulty) for of, share in FAULTS[made])]:
                judge = partial(judged, made=made, seed=seed, defocus=defocus, of=of)
                if count:
                    rows.append(row(list(pool.map(judge, range(count))), made=made, defocus=defocus, of=of))
                    print(line(rows[-1]), flush=True)
    return rows


def line(one: dict) -> str:
    """One row for people."""
    fault = "no fault" if not one["defocus"] else f"{one['out_of_focus']} blurred by {100 * one['defocus']:.0f} % more"
    named = "" if one["named_rightly"] is None else f", named rightly {one['named_rightly']}"
    truth = "" if one["mtf50_rms_z"] is None else (
        f", joint MTF50 inside 95 % {one['mtf50_inside_95_percent']}, rms z {one['mtf50_rms_z']:.2f}"
    )  # fmt: skip
    return f"{one['made']}, {fault}: {one['agree']} of {one['sessions']} agree, {one['ok']} ok{named}{truth}"


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
        "closed form": (asked.sessions, asked.faulty), "simulated": (asked.simulated, asked.simulated_faulty)
    }  # fmt: skip
    rows = measured(counts, seed=asked.seed, workers=asked.workers)
    if asked.keep:
        TABLE.parent.mkdir(exist_ok=True)
        TABLE.write_text(json.dumps({"seed": asked.seed, "rows": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
