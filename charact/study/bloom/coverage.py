"""How well the bloom methods measure halo and blooms, and how often their intervals hold: `make bloom-study`.

Series inside the scope (`charact.study.bloom.series`); series of sources without a halo, where it must be refused; and
series whose halo is hidden under the noise, where it must be refused or its interval must hold.
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np

import charact.bloom  # registers the methods
from charact.method.registry import of_kind
from charact.study.bloom.series import BloomSeries, halo_overload, measured, series_in_scope, without_halo
from charact.study.failure_map import one_thread_each
from labdata.measurement import Measurement

TABLE = Path(__file__).resolve().parents[1] / "tables" / "bloom_coverage.json"
Kind = Literal["halo", "no halo", "hidden halo"]
COUNTS: dict[Kind, int] = {"halo": 400, "no halo": 300, "hidden halo": 100}
# One series in ten of those with a halo is measured by Markov chains too.
CHAINED = 10
# Series with silent failures that the table names.
NAMED = 20
# Parts in which all series are measured, each a sample of them.
BLOCKS = 40
SERIES, NOISE = 31, 32
# Plateau of a hidden halo at the brightest level, standard deviations of a pixel of the mean frame.
HIDDEN = (0.02, 0.3)
# What a number may be off by: px or a share of the truth, whichever is more.
WITHIN_PX = 1.0
WITHIN = {"halo_diameter": 0.02}
WITHIN_ELSE = 0.05


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What a method made of one quantity of one series.

    Parameters
    ----------
    kind, number
        Kind of the series, and its seed.
    truth
        What should be found; None: there is nothing to find.
    """

    kind: Kind
    number: int
    method: str
    quick: bool
    quantity: str
    unit: str
    stack: str | None
    status: str
    truth: float | None
    value: float | None
    covers68: bool | None
    covers95: bool | None
    silent: bool
    seconds: float


def series_of(kind: Kind, number: int) -> BloomSeries:
    """Return a series by its number."""
    rng = np.random.default_rng([number, SERIES, list(COUNTS).index(kind)])
    series = series_in_scope(rng)
    if kind == "no halo":
        return without_halo(series)
    return _hidden(series, rng) if kind == "hidden halo" else series


def _hidden(series: BloomSeries, rng: np.random.Generator) -> BloomSeries:
    """A series whose halo stays under the noise at its brightest level."""
    scene = series.scene
    noise = np.sqrt(scene.photoelectron_dn * scene.excess * scene.background_dn / scene.frames)
    low, high = np.log(HIDDEN)
    brightest = halo_overload(scene) * noise / scene.span_dn * float(np.exp(rng.uniform(low, high)))
    return replace(series, overloads=tuple(float(one) for one in brightest * np.geomspace(0.01, 1.0, 5)))


def trials_of(kind: Kind, number: int, methods: Sequence[str], *, quick: bool = True) -> list[Trial]:
    """Draw a series and put the methods to it."""
    series = series_of(kind, number)
    drawn = series.session_drawn(np.random.default_rng([number, NOISE]))
    out = []
    for name in methods:
        found, seconds = measured(of_kind("bloom")[name], series, drawn, seed=number, quick=quick)
        given = {"kind": kind, "number": number, "method": name, "quick": quick, "seconds": seconds}
        judged = list(_judged(found or (), series, given))
        if not any(one.quantity == "halo_diameter" for one in judged):
            judged.append(_none(series, given, "crashed" if found is None else "refused"))
        out += judged
    return out


def _judged(found: Iterable[Measurement], series: BloomSeries, given: dict[str, Any]) -> Iterable[Trial]:
    for one in found:
        known = series.truth(one.quantity, one.stack)
        if known is None and one.quantity != "halo_diameter":
            continue
        yield Trial(
            **given, quantity=one.quantity, stack=one.stack, status=one.status, truth=known, value=one.value,
            covers68=_covers(one.interval68, known), covers95=_covers(one.interval95, known),
            silent=is_silent(one, known), unit=one.unit,
        )  # fmt: skip


def _none(series: BloomSeries, given: dict[str, Any], status: str) -> Trial:
    """What stands for a result without a halo diameter."""
    return Trial(
        **given, quantity="halo_diameter", unit="px", stack=None, status=status, value=None, covers68=None,
        truth=series.truth("halo_diameter", None), covers95=None, silent=False,
    )  # fmt: skip


def _covers(interval: tuple[float, float] | None, truth: float | None) -> bool | None:
    return None if interval is None or truth is None else bool(interval[0] <= truth <= interval[1])


def is_silent(found: Measurement, *truths: float | None) -> bool:
    """Tell whether an ok number is beyond twice its 95 % half interval from every truth; where none is, it is."""
    if found.status != "ok" or found.value is None:
        return False
    low, high = found.interval95 or (found.value, found.value)
    known = [truth for truth in truths if truth is not None]
    return all(
        abs(truth - found.value) > 2.0 * ((high - found.value) if truth > found.value else (found.value - low))
        for truth in known
    )


def told(trials: Sequence[Trial], method: str, *, quick: bool = True) -> dict[str, Any]:
    """Return what became of the series of one method: each quantity of those with a halo, refusals of the others."""
    own = [one for one in trials if one.method == method and one.quick == quick]
    seen = [one for one in own if one.kind == "halo"]
    halos = {kind: [one for one in own if one.kind == kind and one.quantity == "halo_diameter"] for kind in COUNTS}
    return {
        "method": method,
        "median_seconds": float(np.median([one.seconds for one in halos["halo"]])) if halos["halo"] else None,
        "quantities": {
            name: quantity_told([one for one in seen if one.quantity == name])
            for name in dict.fromkeys(one.quantity for one in seen)
        },
        "no halo": _refusals(halos["no halo"]),
        "hidden halo": _refusals(halos["hidden halo"]),
    }


def quantity_told(trials: Sequence[Trial]) -> dict[str, Any]:
    """Return bias, error, cover and silent failures of one quantity; due is what the picture has more than none of."""
    sure = [one for one in trials if one.status == "ok" and one.value is not None and one.truth is not None]
    due = [one for one in trials if one.truth]
    out: dict[str, Any] = {
        "due": len(due),
        "due_and_ok": sum(one.status == "ok" for one in due),
        **{status: sum(one.status == status for one in trials) for status in ("ok", "suspect", "refused", "crashed")},
        "silent": sum(one.silent for one in trials),
        "silent_series": sorted({one.number for one in trials if one.silent})[:NAMED],
    }
    return out | _errors(sure) if sure else out


def _errors(sure: Sequence[Trial]) -> dict[str, Any]:
    """Errors and cover of ok numbers."""
    truth = np.array([one.truth for one in sure], float)
    off = np.array([one.value for one in sure], float) - truth
    share = WITHIN.get(sure[0].quantity, WITHIN_ELSE)
    allowed = np.maximum(WITHIN_PX if sure[0].unit == "px" else 0.0, share * truth)
    relative = np.abs(off[truth > 0]) / truth[truth > 0]
    return {
        "bias": float(off.mean()),
        "rms": float(np.sqrt((off**2).mean())),
        "median_error_percent": 100.0 * float(np.median(relative)) if relative.size else None,
        "error_p95_percent": 100.0 * float(np.quantile(relative, 0.95)) if relative.size else None,
        "within_tolerance_percent": 100.0 * float(np.mean(np.abs(off) <= allowed)),
        "covers68_percent": 100.0 * float(np.mean([bool(one.covers68) for one in sure])),
        "covers95_percent": 100.0 * float(np.mean([bool(one.covers95) for one in sure])),
    }


def _refusals(trials: Sequence[Trial]) -> dict[str, int]:
    return {
        "series": len(trials),
        "refused": sum(one.status == "refused" for one in trials),
        "suspect": sum(one.status == "suspect" for one in trials),
        "crashed": sum(one.status == "crashed" for one in trials),
        "ok": sum(one.status == "ok" for one in trials),
        "ok_and_covers": sum(one.status == "ok" and bool(one.covers95) for one in trials),
        "silent": sum(one.silent for one in trials),
    }


def measured_block(block: int, counts: dict[Kind, int], methods: Sequence[str], *, workers: int = 1) -> list[Trial]:
    """Put the methods to one of `BLOCKS` like parts of all series, and by Markov chains to one in ten with a halo."""
    with one_thread_each(), ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        parts = []
        for kind, count in counts.items():
            numbers = range(block, count, BLOCKS)
            parts.append(pool.map(partial(trials_of, kind, methods=methods), numbers))
            if kind == "halo":
                parts.append(pool.map(partial(trials_of, kind, methods=methods, quick=False), numbers[::CHAINED]))
        return [trial for part in parts for found in part for trial in found]


def table_of(trials: Sequence[Trial], methods: Sequence[str]) -> dict[str, Any]:
    """Return the table: what the series say of each method, and the halo of each series."""
    counts = {kind: len({one.number for one in trials if one.kind == kind}) for kind in COUNTS}
    rows = [
        [one.method, one.kind, one.number, one.status, _short(one.truth), _short(one.value), one.covers95]
        for one in trials
        if one.quick and one.quantity == "halo_diameter"
    ]
    return {
        "charact": charact.__version__,
        "series": counts,
        "seed": f"[series, {SERIES}, place of the kind]",
        "quick": [told(trials, method) for method in methods],
        "chains": [told(trials, method, quick=False) for method in methods],
        "columns": ["method", "kind", "number", "status", "truth", "value", "covers95"],
        "rows": rows,
    }


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.5g}")


def main() -> None:
    """Run the study part by part, print it and write the table; a run that is stopped goes on where it was."""
    parser = argparse.ArgumentParser(prog="python -m charact.study.bloom.coverage", description=__doc__)
    parser.add_argument("--share", type=float, default=1.0, help="share of the series, 1: all")
    parser.add_argument("--methods", default="", help="names of bloom methods, commas between; all by default")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--trials", type=Path, default=Path("study"), help="folder that keeps what is measured")
    parser.add_argument("--out", type=Path, default=TABLE, help="table to write")
    asked = parser.parse_args()
    methods = tuple(asked.methods.split(",")) if asked.methods else tuple(of_kind("bloom"))
    counts: dict[Kind, int] = {kind: max(1, round(asked.share * count)) for kind, count in COUNTS.items()}
    asked.trials.mkdir(parents=True, exist_ok=True)
    trials: list[Trial] = []
    for block in range(BLOCKS):
        kept = asked.trials / f"bloom-coverage-{block}.json"
        if not kept.is_file():
            new = measured_block(block, counts, methods, workers=asked.workers)
            kept.write_text(json.dumps([asdict(one) for one in new]), encoding="utf-8")
        trials += [Trial(**one) for one in json.loads(kept.read_text())]
        text = json.dumps(table_of(trials, methods), allow_nan=False).replace("], [", "],\n[")
        asked.out.write_text(text + "\n", encoding="utf-8")
    found = table_of(trials, methods)
    for part in ("quick", "chains"):
        print(json.dumps(found[part], indent=1))


if __name__ == "__main__":
    main()
