"""Bench of a plan: virtual instruments, or real ports, camera and operator."""

import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from charact.cli.output import Progress, print_message
from charact.cli.outputs import remove_session
from labdata.camera.description import has_tube
from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.plan import Plan
from labdata.session import Session
from labdata.tube_dose import warnings

if TYPE_CHECKING:
    from drivers.acquisition.run import Predict
    from drivers.interface import Camera
    from simulate.virtual_bench.bench import VirtualBench
    from simulate.virtual_bench.rehearsal import FaultScript


def acquire_session(
    plan: Plan,
    session: Path,
    *,
    resume: bool,
    progress: Progress,
    tell: Callable[[str], None] = print_message,
    inject_faults: "FaultScript | None" = None,
    time_scale: float = 1.0,
) -> Session:
    """Run a plan on its bench and return the session.

    `inject_faults`: faults to inject into a virtual bench; `time_scale`: how many times faster than
    real ones the instruments of a virtual bench move.
    """
    from charact.cli.prompting import PromptingOperator, TargetPlacer
    from charact.live.judge import SaturationJudge
    from drivers import acquire, bench_of
    from drivers.acquisition.acquire import dose_ledger
    from drivers.acquisition.run_control import RunControl
    from drivers.errors import BenchError

    real = plan.wires.bench == "real"
    if real and inject_faults is not None:
        raise BadInput("fault injection needs a virtual bench, got a real one")
    try:
        with ExitStack() as running:
            rig: dict[str, Any] = (
                {
                    "bench": bench_of(plan, session),
                    "operator": PromptingOperator() if plan.lamp is None else TargetPlacer(),
                }
                if real
                else _virtual_rig(plan, session, inject_faults, time_scale, tell, running)
            )
            try:
                acquired = acquire(
                    plan,
                    session,
                    **rig,
                    judge=SaturationJudge(),
                    predict=_level_predictor(plan),
                    resume=resume,
                    progress=progress,
                    requests=RunControl(tell),
                )
            finally:
                if rig["bench"].last_words:
                    tell(f"The tube: {rig['bench'].last_words}.")
    except BenchError as error:
        raise BadInput(str(error)) from error
    sensor = acquired.camera if has_tube(acquired.camera) else None
    for sentence in warnings(dose_ledger(plan, session).total(), sensor):
        tell(sentence)
    return acquired


def _level_predictor(plan: Plan) -> "Predict | None":
    """Return the level of evenly lit pixels above black, DN, by the description of the plan's tube;
    None without one, or with a gamma.
    """
    from labdata.sensors import load_sensor
    from simulate.camera import tube_photometry
    from simulate.camera.camera import CameraModel
    from simulate.camera.chain import Slot
    from simulate.camera.moments import PulseMoments

    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    if not has_tube(sensor) or float(sensor.video.gamma) != 1.0:
        return None
    camera = CameraModel(sensor)
    gain_dn_per_e = float(sensor.video.conversion_gain_dn_per_e)
    electrons_per_lux_s = tube_photometry.photoelectrons_per_lumen_s(sensor) * 1e-4
    electrons_per_lux_s *= camera.field_pixel_area_cm2
    ebi_lux = float(sensor.photocathode.ebi_lm_per_cm2) * 1e4

    def predict(conditions: Conditions) -> float:
        open_s = camera.stage(Slot.PHOTOCATHODE, conditions).open_s
        gain_dn = PulseMoments(camera.chain(conditions)).gain_e * gain_dn_per_e
        gain_dn *= 10.0 ** ((conditions.camera_gain_db or 0.0) / 20.0)
        lux = (conditions.illuminance_lux or 0.0) + ebi_lux
        return gain_dn * electrons_per_lux_s * open_s * lux

    predict(Conditions())  # compiles what the run must not wait for
    return predict


def remove_run(plan: Plan, session: Path) -> None:
    """Delete the session of an earlier run and its virtual bench, after the check of the plan that
    replaces it.
    """
    from drivers import plan_report
    from drivers.acquisition.acquire import bench_folder
    from simulate.virtual_bench.true_sensor import TRUTH

    plan_report(plan, session)
    remove_session(session, "plan")
    if (bench_folder(session) / TRUTH).is_dir():
        shutil.rmtree(bench_folder(session))


def _virtual_rig(
    plan: Plan,
    session: Path,
    script: "FaultScript | None",
    time_scale: float,
    tell: Callable[[str], None],
    running: ExitStack,
) -> dict[str, Any]:
    """Start virtual instruments, with the faults of a script, and return bench, camera and
    operator.
    """
    from drivers.acquisition.acquire import LOG, SAFETY_LOG, bench_folder, bench_of
    from drivers.instruments.models import lines_on
    from labdata.sensors import load_sensor
    from simulate.virtual_bench.bench import VirtualBench
    from simulate.virtual_bench.instrument import LINE_HZ
    from simulate.virtual_bench.rehearsal import Rehearsal

    if plan.sensor is None:
        raise BadInput("a plan for the virtual bench must name its sensor, got none")
    if plan.gating.sync == "line-locked" and plan.gating.line_hz != LINE_HZ:
        raise BadInput(
            f"the mains frequency of the virtual bench must be {LINE_HZ:g} Hz, got "
            f"{plan.gating.line_hz:g}"
        )
    folder = bench_folder(session)
    virtual = running.enter_context(
        VirtualBench(
            folder,
            load_sensor(plan.sensor),
            plan.seed,
            wires=plan.wires,
            lamp=plan.lamp,
            time_scale=time_scale,
            say=tell,
        )
    )
    if script is not None:
        log = folder / "rehearsal.jsonl"
        running.enter_context(
            Rehearsal(script, provoke=virtual.provoke, steps=session / LOG, log=log, say=tell)
        )
    session.parent.mkdir(parents=True, exist_ok=True)
    lines = None if virtual.inside is None else lines_on(virtual.inside.ports, virtual.wires)
    log = folder / SAFETY_LOG
    return {
        "bench": bench_of(plan, session, wires=virtual.wires, log=log, lines=lines),
        "camera": _virtual_camera(plan, virtual, tell),
        "operator": virtual.operator,
    }


def _virtual_camera(
    plan: Plan, virtual: "VirtualBench", tell: Callable[[str], None]
) -> "AbstractContextManager[Camera]":
    """Return the camera that the plan names, else that of the virtual bench."""
    if plan.wires.camera is not None:
        from drivers.cameras import camera_named

        return camera_named(plan.wires.camera, say=tell)
    if virtual.camera is None:
        return virtual.in_process_camera()
    from drivers.cameras.aravis.camera import AravisCamera

    return AravisCamera(virtual.camera.identifier, silence_s=virtual.silence_s, say=tell)
