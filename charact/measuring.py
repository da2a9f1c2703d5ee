"""All that a session's stacks allow: each stack goes to the analysis of its kind."""

from collections.abc import Callable
from pathlib import Path

from charact.method import Context
from labdata.measurement import Measurement, Result
from labdata.session import Session, StackEntry, open_session

Progress = Callable[[str, float], None]


def unheard(sentence: str, share: float) -> None:
    """Progress that nobody listens to."""


def measure(
    session: Session | str | Path,
    *,
    quick: bool = False,
    seed: int = 0,
    within_percent: float = 2.0,
    progress: Progress = unheard,
) -> Result:
    """Measure all that a session allows: noise and gain, MTF of every target, halo and blooming.

    Parameters
    ----------
    session
        A session, or the folder of one.
    quick
        No Markov chain: intervals from the curvature at the maximum.
    seed
        Seed of every random step.
    within_percent
        Error that the automatic choice of a method must meet, percent.
    progress
        Called with a sentence and the share done (0..1).

    Returns
    -------
    Result
        Measurements (some of them refused, with the reason), curves and evidence; several stacks' curves are told
        apart by ":label".
    """
    session = session if isinstance(session, Session) else open_session(session)
    tasks = _tasks(session, context_of(session, quick=quick, seed=seed), within_percent)
    result = Result()
    for done, (sentence, task) in enumerate(tasks):
        progress(sentence, done / len(tasks))
        result += task()
    progress("measured", 1.0)
    return result + _agreement(session, result)


def _agreement(session: Session, result: Result) -> Result:
    """How far apart the targets of a session are in their MTF, where it has several."""
    from charact.mtf.agreement import agreement

    return agreement(result, {entry.label: entry.kind for entry in session.of_kind("edge", "bars", "point")})


def context_of(session: Session, *, quick: bool, seed: int, progress: Progress = unheard) -> Context:
    """What methods are told of a session."""
    full_scale_dn = None if session.bit_depth is None else float(2**session.bit_depth - 1)
    return Context(
        seed=seed,
        quick=quick,
        sensor=session.sensor,
        interlaced=session.is_interlaced,
        full_scale_dn=full_scale_dn,
        progress=progress,
    )


def _tasks(session: Session, context: Context, within_percent: float):
    """Sentence and function of every analysis the session has stacks for."""
    from charact import bloom, noise

    tasks = []
    if session.of_kind("dark", "flat"):
        tasks.append(
            ("noise against gain", lambda: noise.measure(session, within_percent=within_percent, context=context))
        )
    targets = session.of_kind("edge", "bars")
    tasks += [(f"MTF of {entry.label}", _target(entry, context, within_percent)) for entry in targets]
    if session.of_kind("point"):
        tasks.append(("MTF of a point source", lambda: _best_point(session, context, within_percent)))
        tasks.append(
            ("halo and blooming", lambda: bloom.measure(session, within_percent=within_percent, context=context))
        )
    return tasks


def _target(entry: StackEntry, context: Context, within_percent: float):
    def task() -> Result:
        from charact import mtf

        target = entry.target
        asked = {"bars": target.bars, "frequency_cy_per_px": target.frequency_cy_per_px} if entry.kind == "bars" else {}
        found = mtf.measure(
            entry.kind, entry.read(), region=target.region, within_percent=within_percent, context=context, **asked
        )
        return labelled(found, entry.label)

    return task


def _best_point(session: Session, context: Context, within_percent: float) -> Result:
    """The MTF of the brightest point source that no method distrusts, else of the one with the fewest flags."""
    from charact import mtf

    found = []
    for entry in session.of_kind("point"):
        target = entry.target
        one = mtf.measure(
            "point", entry.read(), region=target.region, within_percent=within_percent, context=context,
            pinhole_px=target.pinhole_px,
        )  # fmt: skip
        found.append(labelled(one, entry.label))
    return min(found, key=lambda result: _distrust(result.measurements))


def _distrust(measurements: tuple[Measurement, ...]) -> tuple[int, int, float]:
    refusals = sum(m.status == "refused" for m in measurements)
    widths = [m.interval95[1] - m.interval95[0] for m in measurements if m.interval95]
    return refusals, sum(len(m.flags) for m in measurements), min(widths, default=float("inf"))


def labelled(result: Result, label: str) -> Result:
    """Return the result of one stack with the stack's label on everything in it."""
    return Result(
        measurements=tuple(m.with_(stack=label) for m in result.measurements),
        curves={f"{name}:{label}": curve for name, curve in result.curves.items()},
        evidence={f"{name}:{label}": data for name, data in result.evidence.items()},
    )
