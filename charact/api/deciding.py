"""Comparison of two results, and the check of a result against limits."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from charact.api.inputs import session_of
from charact.api.measuring import measure
from charact.comparison import Comparison, LimitCheck, Limits, load_limits, require_alike
from charact.method.registry import Progress, ignore_progress
from labdata import result_io
from labdata.measurement import Result
from labdata.session import Session

#: A session, its folder, or the result of an analysis
Measured = str | Path | Session | Result


def compare(
    a: Measured,
    b: Measured,
    *,
    anyway: bool = False,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> Comparison:
    """Compare two sessions, or two results: B - A of every quantity with a value in both.

    Parameters
    ----------
    a, b
        Sessions, their folders, or results. Of a folder the saved result is used; a session without
        one is measured.
    anyway
        Compare sessions of unlike conditions, with a flag.
    seed
        Seed of the draws, and of a measurement.
    progress
        Called with a sentence and the fraction done (0..1).

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
    >>> from charact.api import mtf
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
    from charact.comparison import compare as compare_results

    one, other = _session(a), _session(b)
    sessions = None if one is None or other is None else (one, other)
    if sessions is not None and not anyway:  # before an analysis that takes minutes
        require_alike(*sessions, remedy="anyway=True")
    results = (_result(a, one, seed, progress), _result(b, other, seed, progress))
    return compare_results(
        *results, sessions=sessions, anyway=anyway, rng=np.random.default_rng(seed)
    )


def check(
    source: Measured,
    limits: str | Path | Limits | Sequence[Mapping[str, Any]],
    *,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> LimitCheck:
    """Check the measurements of a session against limits.

    Parameters
    ----------
    source
        A session, its folder, or a result, as for `compare`.
    limits
        A limits file, or a list of mappings with its keys: quantity, min, max, and where needed
        unit, stack, frequency_cy_per_px, orientation_deg.
    seed, progress
        As for `compare`.

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

    demanded = load_limits(limits)
    name = Path(limits).name if isinstance(limits, str | Path) else "limits"
    return check_limits(_result(source, _session(source), seed, progress), demanded, name=name)


def _session(source: Measured) -> Session | None:
    """Return the session of a source; None for a result without one."""
    return getattr(source, "session", None) if isinstance(source, Result) else session_of(source)


def _result(source: Measured, given: Session | None, seed: int, progress: Progress) -> Result:
    """Return a result, that saved in a session's folder, or that of a measurement."""
    if isinstance(source, Result):
        return source
    assert given is not None
    on_disk = not isinstance(source, Session) or source.folder != Path()
    saved = result_io.load(given.folder) if on_disk else None
    return saved or measure(given, seed=seed, progress=progress)
