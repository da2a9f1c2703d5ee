"""Comparison of two results, and the check of a result against limits."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from charact.api.inputs import session_of
from charact.api.measuring import measure
from charact.api.settings import MeasuredSource
from labdata.settings import (
    Progress,
    ProgressSink,
    Seed,
    Setting,
    documented,
    ignore_progress,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from charact.comparison import Comparison, LimitCheck, Limits
    from labdata import Result, Session


@documented
def compare(
    a: MeasuredSource,
    b: MeasuredSource,
    *,
    anyway: Annotated[bool, Setting("Compare sessions of unlike conditions, with a flag.")] = False,
    seed: Seed = 0,
    progress: ProgressSink = ignore_progress,
) -> "Comparison":
    """Compare two sessions, or two results: B - A of every quantity with a value in both.

    Returns
    -------
    Comparison
        `differences`, each with `difference`, `interval95`, `probability_better` and `status`;
        `find(quantity)`.

    Raises
    ------
    BadInput
        If the conditions of two sessions are unlike, or no quantity has a value in both.

    Examples
    --------
    >>> import numpy as np
    >>> from charact import mtf
    >>> from scipy.special import erf
    >>> row, col = np.mgrid[:60, :80]
    >>> distance_px = col - 40 + 0.1 * (row - 30)
    >>> rng = np.random.default_rng(1)
    >>> sharp, soft = (
    ...     mtf(rng.poisson(1000 + 400 * erf(distance_px / blur_px)), method="edge-slanted")
    ...     for blur_px in (1.5, 2.5)
    ... )
    >>> compare(sharp, soft).find("mtf50")[0].probability_better < 0.001
    True
    """
    import numpy as np

    from charact.comparison import compare as compare_results
    from charact.comparison import require_alike

    session_a, session_b = _session(a), _session(b)
    sessions = None if session_a is None or session_b is None else (session_a, session_b)
    if sessions is not None and not anyway:  # before an analysis that takes minutes
        require_alike(*sessions)
    results = (_result(a, session_a, seed, progress), _result(b, session_b, seed, progress))
    return compare_results(
        *results, sessions=sessions, anyway=anyway, rng=np.random.default_rng(seed)
    )


@documented
def check(
    source: MeasuredSource,
    limits: Annotated[
        "str | Path | Limits | Sequence[Mapping[str, Any]]",
        Setting(
            "TOML file of limits: [[limit]] with quantity, min, max, and unit or stack; in Python "
            "also a list of such mappings."
        ),
    ],
    *,
    seed: Seed = 0,
    progress: ProgressSink = ignore_progress,
) -> "LimitCheck":
    """Check the measurements of a session against limits.

    Returns
    -------
    LimitCheck
        `verdict` ("pass", "fail" or "undecided") and `outcomes`, each with `verdict` and `reason`.

    Raises
    ------
    BadInput
        If the limits break a rule.

    Examples
    --------
    >>> from labdata.measurement import Result, measurement_from_sd
    >>> mtf50 = measurement_from_sd("mtf50", "cy/px", 0.2, 0.01, method="edge-forward")
    >>> result = Result(measurements=(mtf50,))
    >>> check(result, [{"quantity": "mtf50", "min": 0.3}]).verdict
    'fail'
    """
    from charact.comparison import check as check_limits
    from charact.comparison import load_limits

    demanded = load_limits(limits)
    name = Path(limits).name if isinstance(limits, str | Path) else "limits"
    return check_limits(_result(source, _session(source), seed, progress), demanded, name=name)


def _session(source: MeasuredSource) -> "Session | None":
    """Return the session of a source; None for a result without one."""
    from labdata.measurement import Result

    return getattr(source, "session", None) if isinstance(source, Result) else session_of(source)


def _result(
    source: MeasuredSource, session: "Session | None", seed: int, progress: Progress
) -> "Result":
    """Return a result, that saved in a session's folder, or that of a measurement."""
    from labdata import Result, result_io

    if isinstance(source, Result):
        return source
    assert session is not None
    on_disk = isinstance(source, str | Path) or session.folder != Path()
    saved = result_io.load(session.folder) if on_disk else None
    return saved or measure(session, seed=seed, progress=progress)
