"""How a run begins: the plan kept or compared, the session made or gone on with."""

from pathlib import Path

from drivers.acquisition.forecast import sentences_out_of_step
from drivers.acquisition.plan_check import same_but_wires
from labdata.border import from_toml, to_toml
from labdata.calibrated_gain import gain_table_of
from labdata.capture import PIXEL_BITS, CameraSettings
from labdata.durable import write_durably
from labdata.errors import BadInput
from labdata.limits import limits_in_force
from labdata.plan import Plan
from labdata.sensor import Sensor
from labdata.sensors import save_sensor, shipped
from labdata.session import MANIFEST
from labdata.store import SessionWriter

PLAN = "plan.toml"


def bit_depth(sensor: Sensor | None, settings: CameraSettings) -> int:
    """Return the bits of the digitiser: those of the sensor's description, else those of the camera's format."""
    return sensor.video.bit_depth if sensor else PIXEL_BITS[settings.pixel_format or "Mono16"]


def keep_plan(plan: Plan, folder: Path, *, resume: bool) -> None:
    """Keep the plan beside its session, or compare it with the one kept there."""
    kept = folder / PLAN
    if not resume:
        if kept.exists() or (folder / MANIFEST).exists():
            raise BadInput(f"a run must begin in a folder without a session, or be resumed, got {folder}")
        folder.mkdir(parents=True, exist_ok=True)
        write_durably(kept, to_toml(plan).encode())
        return
    if not kept.exists():
        raise BadInput(f"a resumed run must have been begun before, got no {PLAN} in {folder}")
    if difference := same_but_wires(plan, from_toml(kept, Plan)):
        raise BadInput(f"a resumed run must keep its plan, got another {difference} than {kept} has")


def session_writer(plan: Plan, folder: Path, sensor: Sensor | None, settings: CameraSettings) -> SessionWriter:
    """Begin the session in a folder, or go on with the one that is there."""
    if (folder / MANIFEST).exists():
        return SessionWriter.resume(folder)
    return SessionWriter.create(
        folder,
        name=plan.name,
        sensor=_sensor_name(plan, folder, sensor),
        bit_depth=bit_depth(sensor, settings),
        interlaced=sensor.video.interlaced if sensor else _interlaced(settings),
        notes=(
            *_notes_of(settings),
            *([] if (table := gain_table_of(plan, sensor)) is None else [table.provenance]),
            *([] if plan.lamp is None else [plan.lamp.provenance]),
            *sentences_out_of_step(plan, sensor),
            *limits_in_force(plan.limits, sensor, plan.overrides).overridden,
        ),
    )


def _interlaced(settings: CameraSettings) -> bool | None:
    """Whether the two fields of a frame follow one another, as the camera says."""
    return None if settings.field_order is None else settings.field_order in ("top first", "bottom first")


def _notes_of(settings: CameraSettings) -> tuple[str, ...]:
    fields = () if settings.field_order is None else (f"field order of the camera: {settings.field_order}",)
    return (*fields, *settings.notes)


def _sensor_name(plan: Plan, folder: Path, sensor: Sensor | None) -> str | None:
    """Return how the session names its sensor: a shipped one by name, any other by a copy inside the session."""
    if sensor is None or plan.sensor in shipped():
        return plan.sensor
    save_sensor(sensor, folder / "sensor.toml")
    return "sensor.toml"
