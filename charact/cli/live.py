"""The verbs `live`, `focus` and `watch`: frames and results during an acquisition."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.api import measuring
from charact.cli.options import Events, Json, verb
from charact.cli.output import exit_on_bad_input, print_message, print_text
from charact.cli.sessions import require_session
from labdata.errors import BadInput
from labdata.settings import Roi, Seed, Setting, region_of

if TYPE_CHECKING:
    from charact.live.frame_source import FrameSource
    from charact.live.quick_look import QuickLook
    from charact.method import Context
    from labdata import Measurement, Plan, Step


def _show(
    title: str,
    *,
    camera: Annotated[
        str | None,
        Setting("Aravis identifier, IP address, v4l2:/dev/video0 or replay:FOLDER#LABEL."),
    ] = None,
    plan: Annotated[
        Path | None,
        Setting("Plan whose camera is shown (virtual bench: its first edge)."),
    ] = None,
    session: Annotated[
        Path | None, Setting("Session being acquired; the camera is not accessed.")
    ] = None,
    roi: Roi = None,
    bits: Annotated[
        int | None, Setting("Bit depth, if the pixel format does not state it.")
    ] = None,
    host: Annotated[
        str,
        Setting("Address to listen on; the page requires the printed token."),
    ] = "127.0.0.1",
    port: Annotated[int, Setting("Port of the page; 0 selects a free port.")] = 8600,
    terminal: Annotated[
        bool, Setting("Show statistics in the terminal instead of a web page.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """Show frames of one source in a page or in the terminal."""
    with exit_on_bad_input(title, interrupted="closed"):
        from charact.live.focus import FocusReader
        from charact.live.live_loop import LiveLoop
        from charact.live.server import serve
        from charact.live.terminal import watch_on_terminal

        region = region_of(roi)
        with (
            live_source(
                camera=camera,
                plan=plan,
                session=session,
                bits=bits,
                seed=seed,
                tell=print_message,
            ) as source,
            FocusReader(source.context, region) as reader,
            LiveLoop(source, focus=reader, region=region) as running,
        ):
            heading = f"{title}: {source.name}"
            if terminal:
                watch_on_terminal(running, title=heading)
                return
            serve(
                running,
                title=heading,
                focus_first=title == "charact focus",
                host=host,
                port=port,
                tell=lambda address: print_message(f"{address}   (Ctrl-C to quit)"),
            )


@verb(_show)
def live(**settings: Any) -> None:
    """Live view in a local web page: newest frame, statistics and histogram.

    Read-only: no camera or tube setting is changed. While a plan runs, use --session to view the
    frames it stores.

    Example: charact live --camera Aravis-Fake-GV01
    """
    _show("charact live", **settings)


@verb(_show)
def focus(**settings: Any) -> None:
    """Live view for focusing: MTF50 of an edge, with the best value held.

    Example: charact focus --camera Aravis-Fake-GV01 --roi 150,250,200,200
    """
    _show("charact focus", **settings)


VIRTUAL_SENSOR = "pulnix-ag5745ef3"


@contextmanager
def live_source(
    *,
    camera: str | None,
    plan: Path | None,
    session: Path | None,
    bits: int | None,
    seed: int,
    tell: Callable[[str], None],
) -> "Iterator[FrameSource]":
    """Yield the frame source: a camera, that of a plan (or the virtual bench at its first edge), or
    a growing session.

    `bits`: bit depth, if the pixel format does not state it; `seed`: of the virtual bench.
    """
    if sum(source is not None for source in (camera, plan, session)) > 1:
        raise BadInput(
            "a live view must have one source, got several of --camera, --plan and --session"
        )
    if bits is not None and not 1 <= bits <= 32:
        raise BadInput(f"--bits must lie between 1 and 32, got {bits}")
    full_scale_dn = None if bits is None else float(2**bits - 1)
    if session is not None:
        from charact.live.frame_source import SessionSource

        require_session(session)
        yield SessionSource(session)
        return
    from charact.live.frame_source import CameraSource
    from drivers.acquisition.plans import load_plan
    from drivers.cameras import camera_named

    bench = None if plan is None else load_plan(plan)
    if camera is None and (
        bench is None or (bench.wires.bench != "real" and bench.wires.camera is None)
    ):
        with _virtual(bench, seed, full_scale_dn, tell) as source:
            yield source
        return
    name = camera or (bench.wires.camera if bench else None)
    yield CameraSource(
        camera_named(name, say=tell),
        frames_each=_frames_each(name or ""),
        name=f"camera {name or '(the only one)'}",
        context=_context(bench.sensor if bench else None, full_scale_dn),
    )


def _frames_each(camera: str) -> int:
    """Return the number of frames of one capture: that of the shortest stack of a recording, else
    unlimited.
    """
    from charact.live.frame_source import ENDLESS
    from labdata import open_lazy_stack, open_session

    kind, _, address = camera.partition(":")
    if kind != "replay":
        return ENDLESS
    folder, _, label = address.partition("#")
    session = open_session(folder)
    stacks = (session.stack(label),) if label else session.stacks
    return min(len(open_lazy_stack(stack)) for stack in stacks)


@contextmanager
def _virtual(
    plan: "Plan | None", seed: int, full_scale_dn: float | None, tell: Callable[[str], None]
) -> "Iterator[FrameSource]":
    """Yield the virtual camera with gate and gain fixed at those of the step shown."""
    from charact.live.frame_source import CameraSource
    from labdata.sensors import load_sensor
    from simulate.virtual_bench.in_process import InProcessCamera
    from simulate.virtual_bench.outputs import Outputs, VirtualOperator
    from simulate.virtual_bench.true_sensor import TRUTH, load_or_draw_truth

    name = plan.sensor if plan and plan.sensor else VIRTUAL_SENSOR
    sensor, step = load_sensor(name), _step(plan)
    field_hz = float(sensor.video.field_rate_hz)
    left_at = Outputs(
        mcp_v=step.conditions.mcp_v or 0.0,
        gate_open=True,
        gate_ns=step.conditions.gate_ns or 0.0,
        gate_hz=field_hz,
    )
    tell(
        f"virtual bench: {sensor.name} at {left_at.mcp_v:g} V before the {step.kind} of step "
        f"{step.label!r}; simulating the first frame"
    )
    with TemporaryDirectory(prefix="charact-live-") as made:
        folder = Path(made)
        load_or_draw_truth(folder / TRUTH, sensor, seed if plan is None else plan.seed)
        lux = step.conditions.illuminance_lux or 0.0
        VirtualOperator(folder).place(kind=step.kind, target=step.target, illuminance_lux=lux)
        yield CameraSource(
            InProcessCamera(folder, lambda: left_at),
            name="the virtual camera",
            context=_context(name, full_scale_dn),
            most_hz=field_hz / 2 if sensor.video.interlaced else field_hz,
        )


def _step(plan: "Plan | None") -> "Step":
    """Return the step to show: the first edge, else the first with light; without a plan, from the
    demo's plan.
    """
    if plan is None:
        from charact.cli.demo_loop import demo_plan

        plan = demo_plan(0, quick=True)
    lit = [step for step in plan.steps if step.conditions.illuminance_lux]
    return next((step for step in plan.steps if step.kind == "edge"), (lit or [plan.steps[0]])[0])


def _context(sensor: str | None, full_scale_dn: float | None) -> "Context":
    from charact.method import Context
    from labdata.sensors import load_sensor

    known = None if sensor is None else load_sensor(sensor)
    return Context(
        quick=True,
        camera=known,
        interlaced=known is not None and known.video.interlaced,
        full_scale_dn=full_scale_dn or (float(2**known.video.bit_depth - 1) if known else None),
    )


def watch(
    session: Annotated[
        Path,
        typer.Argument(help="Session folder of a running acquisition, or a folder of plain files."),
    ],
    kind: Annotated[
        str, typer.Option(help="Plain files: kind of their targets, edge, bars or point.")
    ] = "edge",
    once: Annotated[
        bool, typer.Option("--once", help="Process the stacks present now, then exit.")
    ] = False,
    patience_s: Annotated[
        float, typer.Option("--patience-s", help="Maximum wait for the next stack, s.", min=0.0)
    ] = 1800.0,
    seed: Seed = 0,
    as_json: Json = False,
    events: Events = False,
) -> None:
    """Measure each stack of a running acquisition, or each new file of a folder, as it is
    completed: one line each.

    With --json each line is one JSON object. Ends with the run; a folder of plain files is watched
    until Ctrl-C, or until no file has come for --patience-s.

    Example: charact watch day1

    Example: charact watch incoming --kind edge
    """
    interrupted = (
        f"stopped watching; the acquisition continues. Resume with: charact watch {session}"
    )
    with exit_on_bad_input(str(session), as_json=as_json, events=events, interrupted=interrupted):
        from charact.live.quick_look import look_at, watch_stacks
        from labdata.session import MANIFEST

        require_session(session)
        if session.is_dir() and not (session / MANIFEST).is_file():
            _watch_files(
                session,
                kind,
                once=once,
                patience_s=patience_s,
                seed=seed,
                as_json=as_json,
                events=events,
            )
            return
        for so_far, entry in watch_stacks(session, once=once, patience_s=patience_s):
            try:
                looked = look_at(so_far, entry, seed=seed)
            except BadInput as error:
                print_message(f"{entry.label}: {error}", events=events)
                continue
            print_text(json.dumps(_object(looked)) if as_json else _line(looked))


def _watch_files(
    folder: Path,
    kind: str,
    *,
    once: bool,
    patience_s: float,
    seed: int,
    as_json: bool,
    events: bool,
) -> None:
    """Measure the targets of each new file of a folder."""
    from charact.live.quick_look import watch_files
    from charact.reporting.summary import rows_of_file
    from labdata.result_io import to_json

    for path in watch_files(folder, once=once, patience_s=patience_s):
        try:
            result = measuring.mtf(path, kind, quick=True, seed=seed)
        except (BadInput, OSError) as error:
            print_message(f"{path.name}: {error}", events=events)
            continue
        if as_json:
            print_text(json.dumps(to_json(result, given=str(path), version=__version__)))
        else:
            print_text("\n".join(rows_of_file(path.name, result)))


def _line(looked: "QuickLook") -> str:
    """Return the line of a stack: frames, mean, saturation, values with intervals, and flags."""
    from charact.reporting.lines import number_of

    entry = looked.entry
    level = (
        f"{entry.label} ({entry.kind}): {looked.frames} frames, {entry.lost_frames} lost, mean "
        f"{looked.mean_dn:.4g} DN, at most {looked.saturated_px} px at {looked.full_scale_dn:g} DN"
    )
    numbers = [
        f"{_name(m, looked.leading)} {number_of(m)}"
        + ("" if m.value is not None else f": {m.reason}")
        for m in looked.leading
    ]
    flags = dict.fromkeys(flag for m in looked.leading for flag in m.flags)
    return "; ".join([level, *numbers, *([f"flags: {', '.join(flags)}"] if flags else [])])


def _name(m: "Measurement", among: "tuple[Measurement, ...]") -> str:
    """Return a quantity with its frequency, and its direction if there are several of that name."""
    at = "" if m.frequency_cy_per_px is None else f" at {m.frequency_cy_per_px:.3g} cy/px"
    several = (
        sum(other.quantity == m.quantity for other in among) > 1 and m.orientation_deg is not None
    )
    return m.quantity + at + (f" along {m.orientation_deg:.3g} deg" if several else "")


def _object(looked: "QuickLook") -> dict:
    from labdata.result_io import to_json

    return {
        **to_json(looked.result, given=looked.entry.label, version=__version__),
        "stack": looked.entry.label,
        "kind": looked.entry.kind,
        "frames": looked.frames,
        "lost_frames": looked.entry.lost_frames,
        "mean_dn": looked.mean_dn,
        "most_saturated_px": looked.saturated_px,
        "full_scale_dn": looked.full_scale_dn,
    }
