"""Wires a live view to its frames: a growing session, a real camera, or the virtual bench before an edge."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from charact.cli.single_image import require_session
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.live.frame_source import FrameSource
    from charact.method import Context
    from labdata.plan import Plan, Step

VIRTUAL_SENSOR = "pulnix-ag5745ef3"


@contextmanager
def live_source(
    *, camera: str | None, plan: Path | None, session: Path | None, bits: int | None, seed: int,
    tell: Callable[[str], None],
) -> "Iterator[FrameSource]":  # fmt: skip
    """Yield where the frames come from.

    Parameters
    ----------
    camera
        A camera as a plan names it, see `labdata.plan.InstrumentConfig`.
    plan
        A plan: its camera, or the virtual bench with what its first lit target asks for.
    session
        A growing session.
    bits
        Bits of the digitiser where the camera's pixel format does not tell them.
    seed
        Seed of the virtual bench, if that is what it comes to.
    tell
        Told what is virtual.
    """
    if sum(given is not None for given in (camera, plan, session)) > 1:
        raise BadInput("a live view must have one source, got several of --camera, --plan and --session")
    if bits is not None and not 1 <= bits <= 32:
        raise BadInput(f"--bits must lie between 1 and 32, got {bits}")
    full_scale_dn = None if bits is None else float(2**bits - 1)
    if session is not None:
        from charact.live.frame_source import SessionSource

        require_session(session)
        yield SessionSource(session)
        return
    asked = None if plan is None else _plan(plan)
    if camera is None and (asked is None or (asked.wires.bench != "real" and asked.wires.camera is None)):
        with _virtual(asked, seed, full_scale_dn, tell) as source:
            yield source
        return
    yield _camera_source(camera or (asked.wires.camera if asked else None), asked, full_scale_dn, tell)


def _plan(path: Path) -> "Plan":
    from labdata.plan import Plan
    from labdata.serialiser import from_toml

    plan = from_toml(path, Plan)
    beside = path.parent / (plan.sensor or "")
    return replace(plan, sensor=str(beside.resolve())) if plan.sensor and beside.is_file() else plan


def _camera_source(
    camera: str | None, plan: "Plan | None", full_scale_dn: float | None, tell: Callable[[str], None]
) -> "FrameSource":
    from charact.cli.benches import camera_named
    from charact.live.frame_source import CameraSource

    return CameraSource(
        camera_named(camera, tell=tell),
        frames_each=_frames_each(camera or ""),
        name=f"camera {camera or 'that is there'}",
        context=_context(plan.sensor if plan else None, full_scale_dn),
    )


def _frames_each(camera: str) -> int:
    """Return how many frames one capture may ask for: a recording plays what it holds, again and again."""
    from charact.live.frame_source import ENDLESS
    from labdata.lazy_stack import open_lazy_stack
    from labdata.session import open_session

    kind, _, place = camera.partition(":")
    if kind != "replay":
        return ENDLESS
    folder, _, label = place.partition("#")
    session = open_session(folder)
    stacks = (session.stack(label),) if label else session.stacks
    return min(len(open_lazy_stack(stack)) for stack in stacks)


@contextmanager
def _virtual(
    plan: "Plan | None", seed: int, full_scale_dn: float | None, tell: Callable[[str], None]
) -> "Iterator[FrameSource]":
    """The virtual camera, its tube as somebody left it: gate and gain of the step shown, moved by nobody."""
    from charact.live.frame_source import CameraSource
    from labdata.sensors import load_sensor
    from simulate.virtual_bench.in_process import InProcessCamera
    from simulate.virtual_bench.outputs import Outputs, VirtualOperator
    from simulate.virtual_bench.true_sensor import TRUTH, load_or_draw_truth

    name = plan.sensor if plan and plan.sensor else VIRTUAL_SENSOR
    sensor, step = load_sensor(name), _step(plan)
    field_hz = float(sensor.video.field_rate_hz)
    left_at = Outputs(
        mcp_v=step.conditions.mcp_v or 0.0, gate_open=True, gate_ns=step.conditions.gate_ns or 0.0, gate_hz=field_hz
    )
    tell(
        f"virtual bench: {sensor.name} at {left_at.mcp_v:g} V before the {step.kind} of step {step.label!r}; "
        "the first frame is being drawn"
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
    """Return the step to show: the first edge, else the first with light; without a plan, the demonstration's."""
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
        sensor=known,
        interlaced=known is not None and known.video.interlaced,
        full_scale_dn=full_scale_dn or (float(2**known.video.bit_depth - 1) if known else None),
    )
