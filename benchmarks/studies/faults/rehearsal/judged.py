"""What was measured of the night beside what the specimen is: how many 95 % intervals hold, and how
many had to.
"""

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from benchmarks.studies.faults.rehearsal.night import GATE_NS
from charact.reporting import TruthComparison, compare_with_truth
from labdata import Camera, Conditions, Result, Session
from simulate.camera import true_quantities

AT_EACH_GAIN = ("covariance_gain", "blur_factor", "photoelectron_gain", "excess_noise_factor")
CHANCE = 1e-3
"""Chance with which intervals that are what they say would miss more often than is allowed."""
HOLDS = 1.96


def beside(result: Result, session: Session, specimen: Camera) -> tuple[TruthComparison, ...]:
    """Every number with a truth beside it; those of a setting beside the truth at that setting."""
    main = _main_voltage(result, session)

    @cache
    def known(mcp_v: float | None) -> dict[str, float]:
        return true_quantities.true_quantities(specimen, Conditions(mcp_v=mcp_v, gate_ns=GATE_NS))

    rows = list(
        compare_with_truth(
            result, {"gain_exponent": float(specimen.microchannel_plate.gain_exponent)}
        )
    )
    for m in (m for name in AT_EACH_GAIN for m in result.find(name)):
        found = known(main if m.stack is None else session.stack(m.stack).conditions.mcp_v)
        rows += compare_with_truth(Result(measurements=(m,)), {m.quantity: found[m.quantity]})
    return tuple(rows)


def _main_voltage(result: Result, session: Session) -> float | None:
    """The voltage at which the session's own gain was measured: the one that no setting of the
    sweep has.
    """
    swept = {
        session.stack(m.stack).conditions.mcp_v
        for m in result.find("covariance_gain")
        if m.stack is not None
    }
    left = {entry.conditions.mcp_v for entry in session.of_kind("flat")} - swept
    return next(iter(left)) if len(left) == 1 else None


def missing(rows: Sequence[TruthComparison]) -> int:
    """How many intervals of 95 % do not hold the truth."""
    return sum(abs(row.z) > HOLDS for row in rows)


def allowed(count: int) -> int:
    """How many of so many intervals of 95 % may miss: more would by chance be seen once in a
    thousand nights.

    The numbers of one night share their law of the gain and their light, so that they miss together
    more easily than this counts: it is the stricter for it.
    """
    from scipy.stats import binom

    return int(binom.isf(CHANCE, count, 0.05))


def by_quantity(rows: Sequence[TruthComparison]) -> Iterator[str]:
    """A table of Markdown, a row for each quantity and one for all."""
    yield "| quantity | intervals | hold the truth | may miss | worst z | median arm | flags |"
    yield "|---|---:|---:|---:|---:|---:|---|"
    names = list(dict.fromkeys(row.measurement.quantity for row in rows))
    for name in names:
        yield _row(name, [row for row in rows if row.measurement.quantity == name])
    yield _row("all", rows)


def _row(name: str, rows: Sequence[TruthComparison]) -> str:
    arms = [
        abs(m.interval95[1] - m.interval95[0]) / (2.0 * abs(row.truth))
        for row in rows
        if (m := row.measurement).interval95
    ]
    flags = sorted({flag for row in rows for flag in row.measurement.flags})
    cells = (
        name,
        str(len(rows)),
        str(len(rows) - missing(rows)),
        str(allowed(len(rows))),
        f"{max((row.z for row in rows), key=abs):.1f}",
        f"{100.0 * float(np.median(arms)):.1f} %",
        ", ".join(flags) or "none",
    )
    return f"| {' | '.join(cells)} |"
