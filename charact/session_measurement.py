"""Measurement of a session: every stack goes to the analysis of its kind."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from charact.method import Context
from charact.method.registry import Progress, Spread, ignore_progress
from charact.verdict import judge
from labdata import (
    MANIFEST,
    BadInput,
    Result,
    Session,
    StackEntry,
    has_tube,
    make_refusal,
    open_lazy_stack,
    open_session,
    sha256_of,
)
from labdata.camera.parameters import Parameter

R = TypeVar("R", bound=Result)
Quantities = tuple[tuple[str, str], ...]
METHOD = "session"
# Height and width that an image must have for a spot with its surroundings, px: twice the 8 px of
# an edge's region.
LEAST_PX = 16


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """One analysis of a session: its sentence of progress, and the quantities that it gives, by
    name and unit.
    """

    sentence: str
    run: Callable[[Context], Result]
    quantities: Quantities
    stack: str | None = None  # label of its stack, if it is of one


def attempt(
    run: Callable[[], Result],
    quantities: Quantities,
    *,
    stack: str | None = None,
    before: Result | None = None,
) -> Result:
    """Return the result of an analysis; a numerical failure becomes a refusal of its quantities.

    Parameters
    ----------
    run
        The analysis.
    quantities
        Name and unit of each quantity that it gives.
    stack
        Label of its stack; None for one of several stacks.
    before
        Result that the analysis extends; returned with the refusals if it fails.
    """
    try:
        return run()
    except (np.linalg.LinAlgError, ArithmeticError) as failure:
        reason = f"the computation failed numerically: {str(failure) or type(failure).__name__}"
        return (before or Result()) + _refusals(quantities, reason, stack)


def _refusals(quantities: Quantities, reason: str, stack: str | None) -> Result:
    return Result(
        measurements=tuple(
            make_refusal(*quantity, reason, method=METHOD, stack=stack) for quantity in quantities
        )
    )


def _require_size(entries: tuple[StackEntry, ...]) -> None:
    """Raise BadInput for the first stack whose images are too small for a bloom."""
    for entry in entries:
        _, rows, columns = open_lazy_stack(entry).shape
        if min(rows, columns) < LEAST_PX:
            raise BadInput(
                f"images of a bloom must have at least {LEAST_PX} x {LEAST_PX} pixels, got {rows} "
                f"x {columns} in stack {entry.label!r}"
            )


def measure(
    session: Session | str | Path,
    *,
    quick: bool = False,
    seed: int = 0,
    within_percent: float = 2.0,
    also: str | None = None,
    disc: tuple[float, float] = Context.disc,
    amplifier: int | None = None,
    progress: Progress = ignore_progress,
    spread: Spread = map,
) -> Result:
    """Measure everything the stacks of a session support: noise and gain, MTF of every target, halo
    and blooming.

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
    also
        "sfr": the conventional SFR of each edge as well.
    disc
        Diameter, px, and contrast of the disc whose detectability is computed.
    amplifier
        Number of the amplifier whose noise is measured, from 1 by rows; None: all.
    progress
        Called with a sentence and the fraction done (0..1).
    spread
        Map function that computes parts of the noise analysis, see `charact.method.Context`.

    Returns
    -------
    Result
        Measurements (refused ones with the reason), curves and figure data; the name of a curve
        ends in ":label" of its stack.

    Raises
    ------
    BadInput
        If every stack is of kind scene, which is not measured, or no analysis can use the session.

    Notes
    -----
    An analysis that fails numerically, or that the session's frames do not suit, becomes a refusal
    of its quantities with the reason; the others go on.
    """
    session = session if isinstance(session, Session) else open_session(session)
    tasks = _tasks(session, within_percent, also)
    if not tasks:
        raise BadInput(
            "a session must have a stack of kind dark, flat, edge, bars or point to be measured, "
            f"got only kind 'scene': say in {session.folder / MANIFEST} what the frames show"
        )
    from charact.estimators.infrared import is_linear

    context = method_context(session, quick=quick, seed=seed, amplifier=amplifier, spread=spread)
    context = replace(context, disc=disc)
    result = Result()
    complaints: list[BadInput] = []
    for done, task in enumerate(tasks):
        progress(task.sentence, done / len(tasks))
        task_context = replace(context, progress=partial(_within, progress, done, len(tasks)))
        try:
            result += attempt(partial(task.run, task_context), task.quantities, stack=task.stack)
        except BadInput as complaint:
            complaints.append(complaint)
            result += _refusals(task.quantities, str(complaint), task.stack)
        context = _with_measured_gap(replace(context, linear=is_linear(result)), result)
    if len(complaints) == len(tasks):
        raise complaints[0]
    progress("measured", 1.0)
    return _combine_targets(session, result, context)


def measure_noise(
    session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context
) -> Result:
    """Measure the noise of darks and flats, of flats of a black body in kelvin.

    Parameters
    ----------
    session
        Session with at least one dark or flat stack.
    method, within_percent
        As for `charact.estimators.noise.measure`; flats of a black body have one method.
    context
        Settings of the methods.

    Raises
    ------
    BadInput
        If the session has neither darks nor flats, or the method is unknown.
    """
    from charact.estimators import infrared, noise
    from charact.method import choose

    choose("flats", method, within_percent=within_percent)
    heated, visible = bool(infrared.blackbody_flats(session)), _of_light(session)
    result = Result()
    if visible.of_kind("dark", "flat") or not heated:
        run = partial(
            noise.measure, visible, method=method, within_percent=within_percent, context=context
        )
        result += _with_step(attempt(run, NOISE), visible)
    if heated:
        result += attempt(
            partial(infrared.measure, session, context=context), (("sitf", "DN/K"), ("netd", "mK"))
        )
    return result


def _with_step(result: Result, session: Session) -> Result:
    """Return the result with the finding of a coarse digitiser at the quantities that contain dark
    noise or level.
    """
    from charact.estimators.noise.findings import step_finding

    coarse_step = step_finding(session)
    if coarse_step is None:
        return result
    return replace(
        result,
        measurements=tuple(
            judge(m, (coarse_step,)) if m.quantity in OF_DARK and m.status != "refused" else m
            for m in result.measurements
        ),
    )


OF_DARK = (
    "read_noise",
    "dark_signal",
    "dynamic_range",
    "minimum_illumination",
    "minimum_illumination_area",
    "snr",
)
NOISE = (("system_gain", "DN/e-"), ("read_noise", "DN"))
BLOOM = (("halo_diameter", "px"), ("bloom_diameter", "px"))


def measure_bloom(
    session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context
) -> Result:
    """Measure halo and blooming of point sources; arguments as for
    `charact.estimators.bloom.measure`.

    Raises
    ------
    BadInput
        If the session has no point source, or its images are too small for one.
    """
    from charact.estimators import bloom

    _require_size(session.of_kind("point") or session.of_kind("edge"))
    return attempt(
        partial(
            bloom.measure, session, method=method, within_percent=within_percent, context=context
        ),
        BLOOM,
    )


def _of_light(session: Session) -> Session:
    """Return a session without its flats of a black body."""
    from charact.estimators.infrared import blackbody_flats

    heated = {entry.label for entry in blackbody_flats(session)}
    return replace(
        session, stacks=tuple(entry for entry in session.stacks if entry.label not in heated)
    )


def with_inputs(result: R, session: Session) -> R:
    """Return the result with SHA-256 digests of the frames in the provenance of every measurement.

    A measurement of one stack has the digests of that stack; a measurement of the session has those
    of all stacks.
    """
    digests = {entry.label: _digests(entry) for entry in session.stacks if entry.kind != "scene"}
    everything = {name: digest for files in digests.values() for name, digest in files.items()}
    measurements = tuple(
        m
        if m.provenance is None
        else m.with_(
            provenance=replace(m.provenance, inputs=digests.get(m.stack or "", everything))
        )
        for m in result.measurements
    )
    return replace(result, measurements=measurements)


def _digests(entry: StackEntry) -> dict[str, str]:
    """SHA-256 of the files or arrays of a stack, by their names in the manifest."""
    names = (entry.frames,) if isinstance(entry.frames, str) else entry.frames
    return {name: sha256_of(path) for name, path in zip(names, entry.paths, strict=True)}


def _within(progress: Progress, done: int, tasks: int, sentence: str, fraction: float) -> None:
    """Report the progress of one of several analyses as progress of all."""
    progress(sentence, (done + fraction) / tasks)


def _combine_targets(session: Session, result: Result, context: Context) -> Result:
    """Add the joint MTF of all targets, its consistency, uniformity and budget, and the MRTD of an
    infrared camera.
    """
    from charact.estimators.infrared import add_mrtd, blackbody_flats
    from charact.estimators.mtf.bars.group_curve import session_curves
    from charact.estimators.mtf.session.consistency import mtf_consistency, mtf_uniformity
    from charact.estimators.mtf.session.detectability import add_detectability
    from charact.estimators.mtf.session.joint import fit_joint_mtf
    from charact.estimators.mtf.session.through_focus import through_focus

    targets = session.of_kind("edge", "bars", "point")
    kinds = {entry.label: entry.kind for entry in targets}
    conditions = {entry.label: entry.conditions for entry in targets}
    joint: Quantities = (("mtf50", "cy/px"),)
    combined = attempt(
        partial(add_detectability, session, result, kinds, context),
        (("detectability", "1"),),
        before=result,
    )
    if _is_through_focus(targets):  # one MTF of targets in and out of focus means nothing
        focus = partial(through_focus, result, kinds, conditions, context)
        combined += attempt(focus, (("best_focus", "mm"),))
    elif len(targets) > 1:
        combined += (
            attempt(partial(session_curves, result, kinds, context=context), joint)
            + attempt(partial(fit_joint_mtf, result, kinds, context=context), joint)
            + attempt(partial(mtf_consistency, result, kinds), joint)
            + attempt(partial(mtf_uniformity, result, kinds, conditions, context=context), joint)
        )
    if has_tube(context.camera):
        from charact.estimators.mtf.session.mtf_budget import add_mtf_budget

        combined = attempt(
            partial(add_mtf_budget, combined, kinds, context=context), joint, before=combined
        )
    flats = blackbody_flats(session)
    if flats:
        return attempt(
            partial(add_mrtd, session, flats, combined, context=context),
            (("mrtd", "K"),),
            before=combined,
        )
    if not has_tube(context.camera):
        return combined
    from charact.estimators.tube import add_resolution

    known = {entry.label: entry.conditions for entry in session.stacks}
    resolution = (("limiting_resolution", "lp/mm"),)
    return attempt(
        partial(add_resolution, combined, known, context=context), resolution, before=combined
    )


def _with_measured_gap(context: Context, result: Result) -> Context:
    """Return the context with the proximity gap measured by the session's own halo, diameter = 4
    gaps.

    A point series constrains the gap better than the description; a single edge often fits several
    gaps.
    """
    halos = [
        m for m in result.find("halo_diameter") if m.status == "ok" and m.interval95 is not None
    ]
    camera = context.camera
    if not has_tube(camera) or not halos or halos[0].value is None or halos[0].interval95 is None:
        return context
    mm_per_px = float(camera.ccd.pitch_x_um) * float(camera.taper.demagnification) * 1e-3
    value, low, high = (x * mm_per_px / 4.0 for x in (halos[0].value, *halos[0].interval95))
    gap = Parameter(
        value=value,
        low=low,
        high=high,
        standing="fitted",
        source="halo of the session's point sources",
    )
    return replace(context, camera=camera.with_parameters({"photocathode.gap_mm": gap}))


def method_context(
    session: Session,
    *,
    quick: bool,
    seed: int,
    amplifier: int | None = None,
    progress: Progress = ignore_progress,
    spread: Spread = map,
) -> Context:
    """Return the context of the methods that measure a session."""
    full_scale_dn = None if session.bit_depth is None else float(2**session.bit_depth - 1)
    return Context(
        seed=seed,
        quick=quick,
        camera=session.camera,
        interlaced=session.is_interlaced,
        full_scale_dn=full_scale_dn,
        amplifier=amplifier,
        progress=progress,
        spread=spread,
    )


def _tasks(session: Session, within_percent: float, also: str | None) -> list[Analysis]:
    """Every analysis that the session has stacks for; the halo precedes the MTF, which uses it."""
    from charact.estimators import mtf

    def of(
        analysis: Callable[..., Result], stacks: Session = session
    ) -> Callable[[Context], Result]:
        return lambda context: analysis(stacks, within_percent=within_percent, context=context)

    tasks: list[Analysis] = []
    lit, points = _of_light(session), session.of_kind("point")
    mtf50 = (("mtf50", "cy/px"),)
    if session.of_kind("dark", "flat"):
        tasks.append(
            Analysis(sentence="noise against gain", run=of(measure_noise), quantities=NOISE)
        )
    if lit.of_kind("flat"):
        spectrum, after = of(mtf.measure_flats, lit), (("post_gain_mtf50", "cy/px"),)
        tasks.append(
            Analysis(
                sentence="post-gain MTF from the noise of flats", run=spectrum, quantities=after
            )
        )
    if points:
        tasks.append(
            Analysis(sentence="halo and blooming", run=of(measure_bloom), quantities=BLOOM)
        )
    series = points if _is_through_focus(points) else ()
    for entry in (*session.of_kind("edge", "bars"), *series):
        run = partial(
            _target, session, entry, within_percent, also=also if entry.kind == "edge" else None
        )
        sentence = f"MTF of {entry.label}"
        tasks.append(Analysis(sentence=sentence, run=run, quantities=mtf50, stack=entry.label))
    if points and not series:
        run = partial(_best_point, session, within_percent)
        tasks.append(Analysis(sentence="MTF of a point source", run=run, quantities=mtf50))
    return tasks


def _is_through_focus(targets: tuple[StackEntry, ...]) -> bool:
    """Whether targets were taken at several positions of the focus."""
    return len({entry.conditions.focus_mm for entry in targets} - {None}) > 1


def _target(
    session: Session,
    entry: StackEntry,
    within_percent: float,
    context: Context,
    *,
    also: str | None = None,
) -> Result:
    from charact.estimators import mtf
    from charact.estimators.infrared import scan_directions

    target, stack = entry.target, entry.read()
    if entry.kind == "edge" and stack.black_level_dn is None:
        stack = replace(stack, black_level_dn=session.black_dn(entry))
    arguments = {
        "edge": {},
        "bars": {"bars": target.bars, "frequency_cy_per_px": target.frequency_cy_per_px},
        "point": {"pinhole_px": target.pinhole_px},
    }[entry.kind]
    result = Result()
    for direction, part, region, direction_context in scan_directions(
        stack, target.region, context=context
    ):
        part_result = mtf.measure(
            entry.kind,
            part,
            region=region,
            within_percent=within_percent,
            also=also,
            context=direction_context,
            **arguments,
        )
        result += with_stack_label(
            part_result, f"{entry.label}, lines {direction}" if direction else entry.label
        )
    return result


def _best_point(session: Session, within_percent: float, context: Context) -> Result:
    """Measure point sources from the brightest on; return the first MTF with the fewest refusals
    and flags.

    The narrowest interval would select a halo that is too small by chance, with an MTF that is too
    high.
    """
    from charact.estimators.mtf.point.source import source_signal

    candidates: list[tuple[tuple[int, int], Result]] = []
    # Read again when measured: a long series does not fit into memory.
    for entry in sorted(
        session.of_kind("point"), key=lambda candidate: -source_signal(candidate.read().data)
    ):
        result = _target(session, entry, within_percent, context)
        refusals = sum(m.status == "refused" for m in result.measurements)
        candidates.append(((refusals, sum(len(m.flags) for m in result.measurements)), result))
        if candidates[-1][0] == (0, 0):
            break
    return min(candidates, key=lambda candidate: candidate[0])[1]


def with_stack_label(result: Result, label: str) -> Result:
    """Return the result of one stack with the stack's label on measurements, curves and figure
    data.
    """
    return Result(
        measurements=tuple(m.with_(stack=label) for m in result.measurements),
        curves={f"{name}:{label}": curve for name, curve in result.curves.items()},
        evidence={f"{name}:{label}": data for name, data in result.evidence.items()},
    )
