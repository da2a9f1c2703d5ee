"""Methods put to cases of known truth: error, honesty of the interval, verdict and time, one row
for each pair.
"""

import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, Method
from labdata import BadInput, Measurement
from tests.truth.cases.case import Case

Progress = Callable[[str, float], None]


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """What one method made of one case.

    `status`: that of the measurement, or "crashed" where the method raised anything but a
    `BadInput`; `error_percent`: |value - truth| / |truth|, percent; None without a value or a
    truth; `covers`: whether the truth lies in the 95 % interval; `silent`: silent failure: ok, and
    the truth further from the value than twice the 95 % half-interval on that side.
    """

    method: str
    kind: str
    case: str
    axis: str
    position: float
    unit: str
    in_scope: bool
    seed: int
    truth: float | None
    value: float | None = None
    low95: float | None = None
    high95: float | None = None
    status: Literal["ok", "suspect", "refused", "crashed"]
    flags: tuple[str, ...] = ()
    reason: str | None = None
    seconds: float = 0.0
    error_percent: float | None = None
    covers: bool | None = None
    silent: bool = False

    def as_json(self) -> dict[str, Any]:
        """The row as plain numbers and words; a bound that is not finite becomes null."""
        endless = {
            key
            for key, value in asdict(self).items()
            if isinstance(value, float) and not np.isfinite(value)
        }
        return {key: None if key in endless else value for key, value in asdict(self).items()}


def judge_measurement(measurement: Measurement, truth: float | None) -> dict[str, Any]:
    """Compare a measurement with the truth: error, cover and silent failure, as fields of a
    `CaseResult`.

    Silent: status ok and |value - truth| > 2 |end of the 95 % interval on the truth's side -
    value|. An honest Gaussian interval does that once in ten thousand. An ok number without
    interval claims to be exact. Where the truth is 0, as of an error in percent, the error is the
    value itself.
    """
    if measurement.value is None:
        return {}
    if truth is None:
        return {"silent": measurement.status == "ok"}
    low, high = measurement.interval95 or (measurement.value, measurement.value)
    off = truth - measurement.value
    half = (high - measurement.value) if off > 0 else (measurement.value - low)
    return {
        "error_percent": float(abs(off / truth) * 100) if truth else float(abs(off)),
        "covers": bool(low <= truth <= high),
        "silent": bool(measurement.status == "ok" and abs(off) > 2 * max(half, 0.0)),
    }


class CaseTimer:
    """Time that an idle machine would have taken: the smaller of wall time and of the process's
    processor time.
    """

    def __init__(self) -> None:
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def seconds(self) -> float:
        """Seconds since it was made."""
        return min(time.perf_counter() - self._wall, time.process_time() - self._processor)


def attempt(method: Method, case: Case, context: Context, *, material: Any = None) -> CaseResult:
    """Give one case to one method and judge what comes back; `material` is what the case draws, if
    it is drawn already.

    A `BadInput` is a refusal. Any other exception, and any warning, is a crash: a user would see
    it.
    """
    base = {
        key: getattr(case, key)
        for key in ("kind", "axis", "position", "unit", "in_scope", "seed", "truth")
    }
    material = case.drawn() if material is None else material
    context = replace(context, **{"seed": case.seed, **case.context})
    clock, result = CaseTimer(), None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if case.call is None:
                result = method.function(material, **case.arguments, context=context)
            else:
                result = case.call(method, material, context)
        outcome: dict[str, Any] = {
            "status": "refused",
            "reason": f"the result holds no {case.quantity}",
        }
    except BadInput as error:
        outcome = {"status": "refused", "reason": str(error)}
    except Exception as error:  # the study must outlive the method it breaks
        outcome = {"status": "crashed", "reason": f"{type(error).__name__}: {error}"}
    outcome["seconds"] = clock.seconds()
    if case.score is not None and result is not None:
        result = case.score(result)
    for measurement in result.find(case.quantity)[:1] if result else ():
        low, high = measurement.interval95 or (None, None)
        outcome |= {
            "value": measurement.value,
            "low95": low,
            "high95": high,
            "status": measurement.status,
            "flags": measurement.flags,
            "reason": measurement.reason,
            **judge_measurement(measurement, case.truth),
        }
    return CaseResult(method=method.name, case=case.name, **base, **outcome)


def run(
    methods: Iterable[Method],
    cases: Sequence[Case],
    *,
    context: Context,
    progress: Progress = lambda sentence, fraction: None,
) -> tuple[CaseResult, ...]:
    """Put every method to every case of its kind, one after the other so that the times can be
    compared.

    `methods`, `cases`: what to try on what; `context`: context of every method; each case sets its
    own seed and what else it names; `progress`: called with a sentence and the share done.
    """
    methods = tuple(methods)
    rows: list[CaseResult] = []
    for number, case in enumerate(cases):
        progress(case.name, number / len(cases))
        material = case.drawn()
        rows += [
            attempt(method, case, context, material=material)
            for method in methods
            if method.kind == case.kind
        ]
    progress("cases done", 1.0)
    return tuple(rows)


@dataclass(frozen=True, kw_only=True)
class MethodSummary:
    """How one method did over many cases.

    `error_percent`: 95th percentile of the relative error, percent; a refusal or crash counts as
    100 %; `error_limit_percent`: upper 95 % confidence limit of that percentile, percent, by
    `percentile_limit`; `seconds`: median time, s; `cases`, `ok`, `suspect`, `refused`, `crashed`:
    how many there were, and of each verdict; `silent`: silent failures; `ok_fraction`: share of
    cases with status ok; `missed_fraction`: share of ok cases whose 95 % interval misses the truth;
    0 where none is ok.
    """

    method: str
    error_percent: float
    error_limit_percent: float
    seconds: float
    cases: int
    ok: int
    suspect: int
    refused: int
    crashed: int
    silent: int
    ok_fraction: float
    missed_fraction: float


def percentile_limit(
    errors: NDArray[np.floating], *, fraction: float = 0.95, confidence: float = 0.95
) -> float:
    """Return an upper confidence limit of a percentile of what errors were drawn from, whatever its
    distribution.

    `errors`: independent errors, shape (case,); `fraction`, `confidence`: the percentile as a
    fraction, and the chance that the limit lies above it. The k-th smallest of n errors lies above
    the percentile unless k or more lie below it, a binomial(n, fraction) chance: k is the least
    with P(fewer than k below) >= confidence. Of fewer than 59 errors none will do at 95 %, and the
    largest stands in: it lies above the 95th percentile with a chance of 1 - 0.95^n, 71 % for 24
    and 87 % for 40.
    """
    from scipy.stats import binom

    ordered = np.sort(errors)
    fewer = binom.cdf(np.arange(ordered.size), ordered.size, fraction)
    return float(ordered[min(int(np.searchsorted(fewer, confidence)), ordered.size - 1)])


def summary(rows: Iterable[CaseResult], method: str) -> MethodSummary:
    """Summarise the rows of one method."""
    method_rows = [row for row in rows if row.method == method]
    if not method_rows:
        raise BadInput(f"the study holds no rows of the method {method!r}")
    known = [row for row in method_rows if row.truth is not None]
    errors = np.array([100.0 if row.value is None else row.error_percent for row in known], float)
    count = {
        status: sum(row.status == status for row in method_rows)
        for status in ("ok", "suspect", "refused", "crashed")
    }
    ok_rows = [row for row in method_rows if row.status == "ok"]
    missed = sum(not row.covers for row in ok_rows)
    return MethodSummary(
        method=method,
        error_percent=float(np.percentile(errors, 95)) if errors.size else 0.0,
        error_limit_percent=percentile_limit(errors) if errors.size else 0.0,
        seconds=float(np.median([row.seconds for row in method_rows])),
        cases=len(method_rows),
        **count,
        silent=sum(row.silent for row in method_rows),
        ok_fraction=count["ok"] / len(method_rows),
        missed_fraction=missed / len(ok_rows) if ok_rows else 0.0,
    )


def axes_of(rows: Sequence[CaseResult]) -> tuple[str, ...]:
    """Axes in the order they were swept."""
    return tuple(dict.fromkeys(row.axis for row in rows))
