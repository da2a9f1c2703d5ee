"""Measurement of a session: every stack goes to the analysis of its kind."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from charact.method import Context
from charact.method.registry import Progress, Spread, ignore_progress
from labdata.camera_description import Parameter
from labdata.errors import BadInput
from labdata.measurement import Result
from labdata.session import MANIFEST, Session, StackEntry, open_session, sha256_of

Task = Callable[[Context], Result]


def measure(
    session: Session | str | Path,
    *,
    quick: bool = False,
    seed: int = 0,
    within_percent: float = 2.0,
    progress: Progress = ignore_progress,
    spread: Spread = map,
) -> Result:
    """Measure everything the stacks of a session support: noise and gain, MTF of every target, halo and blooming.

    Parameters
    ----------
    session
        A session, or the folder of one.
    quick
        Skip posterior sampling; intervals are from the Laplace approximation.
    seed
        Seed of every random step.
    within_percent
        Error tolerance of the automatic choice of methods, percent.
    progress
        Called with a sentence and the fraction done (0..1).
    spread
        Map function that computes parts of the noise analysis, see `charact.method.Context`.

    Returns
    -------
    Result
        Measurements (refused ones with the reason), curves and figure data; the name of a curve ends in ":label" of
        its stack.

    Raises
    ------
    BadInput
        If every stack is of kind scene, which is not measured.
    """
    session = session if isinstance(session, Session) else open_session(session)
    tasks = _tasks(session, within_percent)
    if not tasks:
        raise BadInput(
            "a session must have a stack of kind dark, flat, edge, bars or point to be measured, got only kind "
            f"'scene': say in {session.folder / MANIFEST} what the frames show"
        )
    context, result = method_context(session, quick=quick, seed=seed, spread=spread), Result()
    for done, (sentence, task) in enumerate(tasks):
        progress(sentence, done / len(tasks))
        result += task(replace(context, progress=partial(_within, progress, done, len(tasks))))
        context = _with_measured_gap(context, result)
    progress("measured", 1.0)
    return _combine_targets(session, result, context)


def with_inputs(result: Result, session: Session) -> Result:
    """Return the result with SHA-256 digests of the frames in the provenance of every measurement.

    A measurement of one stack has the digests of that stack; a measurement of the session has those of all stacks.
    """
    digests = {entry.label: _digests(entry) for entry in session.stacks if entry.kind != "scene"}
    everything = {name: digest for one in digests.values() for name, digest in one.items()}
    measurements = tuple(
        m
        if m.provenance is None
        else m.with_(provenance=replace(m.provenance, inputs=digests.get(m.stack or "", everything)))
        for m in result.measurements
    )
    return replace(result, measurements=measurements)


def _digests(entry: StackEntry) -> dict[str, str]:
    """SHA-256 of the files or arrays of a stack, by their names in the manifest."""
    names = (entry.frames,) if isinstance(entry.frames, str) else entry.frames
    return {name: sha256_of(path) for name, path in zip(names, entry.paths, strict=True)}


def _within(progress: Progress, done: int, tasks: int, sentence: str, share: float) -> None:
    """Report the progress of one of several analyses as progress of all."""
    progress(sentence, (done + share) / tasks)


def _combine_targets(session: Session, result: Result, context: Context) -> Result:
    """Add the joint MTF of all targets, MTF consistency, MTF uniformity and the MTF budget to a session's result."""
    from charact.mtf.bars.group_curve import session_curves
    from charact.mtf.session.consistency import mtf_consistency, mtf_uniformity
    from charact.mtf.session.joint import fit_joint_mtf
    from charact.mtf.session.mtf_budget import add_mtf_budget

    targets = session.of_kind("edge", "bars", "point")
    kinds = {entry.label: entry.kind for entry in targets}
    conditions = {entry.label: entry.conditions for entry in targets}
    whole = (
        result
        + session_curves(result, kinds, context=context)
        + fit_joint_mtf(result, kinds, context=context)
        + mtf_consistency(result, kinds)
        + mtf_uniformity(result, kinds, conditions, context=context)
    )
    return add_mtf_budget(whole, kinds, context=context)


def _with_measured_gap(context: Context, result: Result) -> Context:
    """Return the context with the proximity gap measured by the session's own halo, diameter = 4 gaps.

    A point series constrains the gap better than the description; a single edge often fits several gaps.
    """
    found = [m for m in result.find("halo_diameter") if m.status == "ok" and m.interval95 is not None]
    if context.sensor is None or not found or found[0].value is None or found[0].interval95 is None:
        return context
    sensor = context.sensor
    mm_per_px = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification) * 1e-3
    value, low, high = (x * mm_per_px / 4.0 for x in (found[0].value, *found[0].interval95))
    gap = Parameter(value=value, low=low, high=high, standing="fitted", source="halo of the session's point sources")
    return replace(context, sensor=sensor.with_parameters({"photocathode.gap_mm": gap}))


def method_context(
    session: Session, *, quick: bool, seed: int, progress: Progress = ignore_progress, spread: Spread = map
) -> Context:
    """Return the context of the methods that measure a session."""
    full_scale_dn = None if session.bit_depth is None else float(2**session.bit_depth - 1)
    return Context(
        seed=seed,
        quick=quick,
        sensor=session.sensor,
        register=session.register,
        interlaced=session.is_interlaced,
        full_scale_dn=full_scale_dn,
        progress=progress,
        spread=spread,
    )


def _tasks(session: Session, within_percent: float) -> list[tuple[str, Task]]:
    """Sentence and function of every analysis the session has stacks for; the halo precedes the MTF, which uses it."""
    from charact import bloom, mtf, noise

    def of(analysis: Callable[..., Result]) -> Task:
        return lambda context: analysis(session, within_percent=within_percent, context=context)

    tasks: list[tuple[str, Task]] = []
    if session.of_kind("dark", "flat"):
        tasks.append(("noise against gain", of(noise.measure)))
    if session.of_kind("flat"):
        tasks.append(("post-gain MTF from the noise of flats", of(mtf.measure_flats)))
    if session.of_kind("point"):
        tasks.append(("halo and blooming", of(bloom.measure)))
    targets = session.of_kind("edge", "bars")
    tasks += [(f"MTF of {entry.label}", partial(_target, session, entry, within_percent)) for entry in targets]
    if session.of_kind("point"):
        tasks.append(("MTF of a point source", partial(_best_point, session, within_percent)))
    return tasks


def _target(session: Session, entry: StackEntry, within_percent: float, context: Context) -> Result:
    from charact import mtf

    target, stack = entry.target, entry.read()
    if entry.kind == "edge" and stack.black_level_dn is None:
        stack = replace(stack, black_level_dn=session.black_dn(entry))
    arguments = {
        "edge": {},
        "bars": {"bars": target.bars, "frequency_cy_per_px": target.frequency_cy_per_px},
        "point": {"pinhole_px": target.pinhole_px},
    }[entry.kind]
    found = mtf.measure(
        entry.kind, stack, region=target.region, within_percent=within_percent, context=context, **arguments
    )
    return with_stack_label(found, entry.label)


def _best_point(session: Session, within_percent: float, context: Context) -> Result:
    """Measure all point sources; return the MTF with the fewest refusals and flags, of equals the brightest.

    The narrowest interval would select a halo that is too small by chance, with an MTF that is too high.
    """
    from charact.mtf.point.source import source_signal

    found: list[tuple[tuple[int, int], StackEntry, Result]] = []
    for entry in session.of_kind("point"):
        one = _target(session, entry, within_percent, context)
        refusals = sum(m.status == "refused" for m in one.measurements)
        found.append(((refusals, sum(len(m.flags) for m in one.measurements)), entry, one))
    least = min(distrust for distrust, _, _ in found)
    trusted = [(entry, result) for distrust, entry, result in found if distrust == least]
    # Read again: a long series does not fit into memory.
    return max(trusted, key=lambda one: source_signal(one[0].read().data))[1] if len(trusted) > 1 else trusted[0][1]


def with_stack_label(result: Result, label: str) -> Result:
    """Return the result of one stack with the stack's label on measurements, curves and figure data."""
    return Result(
        measurements=tuple(m.with_(stack=label) for m in result.measurements),
        curves={f"{name}:{label}": curve for name, curve in result.curves.items()},
        evidence={f"{name}:{label}": data for name, data in result.evidence.items()},
    )
