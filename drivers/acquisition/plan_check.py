"""What is checked of a plan before anything is switched on."""

import shutil
from dataclasses import fields, replace
from pathlib import Path

from drivers.bench.interlock import Interlock
from drivers.bench.setup import FIELD_RATE_HZ
from drivers.bench.state import Command, InterlockRefused, OpenGate, RaiseGain, SetLight, TubeState
from labdata.capture import PIXEL_BITS, CameraSettings
from labdata.errors import BadInput
from labdata.gating import Gating
from labdata.lamp_calibration import LampCalibration
from labdata.limits import LimitsInForce, limits_in_force
from labdata.plan import Plan, Step
from labdata.sensor import Sensor

_NEEDED = {"bars": ("bars", "frequency_cy_per_px"), "edge": (), "point": (), "flat": (), "dark": (), "scene": ()}
_SPARE_BYTES = 64 << 20
# Conditions that no driver sets or reads back: the record would repeat what was asked as if it had been in force.
_READ_BESIDE = ("metered_w", "metered_lux", "metered_time_s", "temperature_time_s")
_SET_BY_NOBODY = ("automatic_gain", "brightness_control", "em_gain", "gain_control", "lamp_a", *_READ_BESIDE)


def check_plan(plan: Plan, folder: Path, sensor: Sensor | None) -> None:
    """Check a plan in full.

    Parameters
    ----------
    plan
        The plan.
    folder
        Where the session will be.
    sensor
        The camera it is for, or None.

    Raises
    ------
    BadInput
        At the first rule broken: what the interlock would refuse, a limit above the tube's, a label that is no file
        name, light on a dark, a target without its numbers, a gate wider than the exposure, a condition that no driver
        sets, a picture that the sensor does not have, or a disk too small.
    """
    limits = limits_in_force(plan.limits, sensor, plan.overrides)
    for step in plan.steps:
        _check_step(step, sensor)
        _check_light(step, plan.lamp)
        _check_rules(step.brightest, limits, plan.gating.most_hz(field_hz(sensor)))
        _check_phase(step, plan.gating, field_hz(sensor))
    _check_picture(plan, sensor)
    _check_disk(plan, folder, sensor)


def field_hz(sensor: Sensor | None) -> float:
    """Fields of the camera a second, Hz, or of 525-line video if unknown."""
    return float(sensor.video.field_rate_hz) if sensor else FIELD_RATE_HZ


def picture_of(plan: Plan, sensor: Sensor | None) -> CameraSettings:
    """Ask for what the plan names, else for the whole sensor at its depth; the rest stays as it is."""
    whole = CameraSettings()
    if sensor is not None:
        rows, columns = sensor.ccd.rows, sensor.ccd.columns
        wide = "Mono8" if sensor.video.bit_depth <= 8 else "Mono16"
        whole = CameraSettings(rows=rows, columns=columns, first_row=0, first_column=0, pixel_format=wide)
    return replace(whole, **{name: value for name, value in vars(plan.picture).items() if value is not None})


def bytes_of(plan: Plan, sensor: Sensor | None) -> int:
    """Bytes that the frames of a plan will take; 0 where neither plan nor sensor states the size of a frame."""
    picture = picture_of(plan, sensor)
    pixel_bytes = 1 if PIXEL_BITS[picture.pixel_format or "Mono16"] <= 8 else 2
    return sum(step.most_frames for step in plan.steps) * (picture.rows or 0) * (picture.columns or 0) * pixel_bytes


def same_but_wires(plan: Plan, other: Plan) -> str | None:
    """Return what differs between two plans besides their wires, in words; None if nothing does."""
    names = tuple(item.name for item in fields(Plan) if item.name not in ("wires", "steps"))
    if plan.steps == other.steps:
        return next((name for name in names if getattr(plan, name) != getattr(other, name)), None)
    steps = {step.label: step for step in other.steps}
    for step in plan.steps:
        if steps.get(step.label) != step:
            return f"step {step.label!r}"
    return "steps"


def _check_step(step: Step, sensor: Sensor | None) -> None:
    if not step.label or step.label.startswith(".") or set(step.label) & set("/\\\0"):
        raise BadInput(f"a step's label must be a file name without slashes or a leading dot, got {step.label!r}")
    asked = step.conditions
    if step.kind == "dark" and asked.illuminance_lux:
        raise BadInput(f"a dark must be taken without light, got {asked.illuminance_lux:g} lux in {step.label!r}")
    for name in _NEEDED[step.kind]:
        if getattr(step.target, name) is None:
            raise BadInput(f"a {step.kind} target must have its {name}, got none in {step.label!r}")
    for name in _SET_BY_NOBODY:
        if (value := getattr(asked, name)) is not None:
            raise BadInput(f"{name} must be left out of a plan, as no driver sets it, got {value} in {step.label!r}")
    exposure_s = asked.exposure_s or (1.0 / float(sensor.video.field_rate_hz) if sensor else None)
    # A gate of one field time is written rounded; one per mille more than the exposure is still that.
    if asked.gate_ns is not None and exposure_s is not None and asked.gate_ns > exposure_s * 1e9 * 1.001:
        raise BadInput(
            f"gate_ns must not exceed the exposure of {exposure_s * 1e9:g} ns, got {asked.gate_ns:g} in {step.label!r}"
        )


def _check_light(step: Step, lamp: LampCalibration | None) -> None:
    """Refuse a light that the lamp cannot make; a person at the bench is believed to find a way."""
    for lux in {step.conditions.illuminance_lux, step.brightest.conditions.illuminance_lux}:
        if lamp is not None and lux:
            try:
                lamp.setting(lux, step.conditions.filter_density)
            except BadInput as error:
                raise BadInput(f"{error}, in step {step.label!r}") from None


def _check_rules(step: Step, limits: LimitsInForce, rate_hz: float) -> None:
    """Let the interlock's own rules look at what the step will order, with nothing there to obey."""
    asked, point = step.conditions, step.kind == "point"
    commands: list[Command] = [SetLight(illuminance_lux=0.0, point=point, target=step.target)]
    if asked.mcp_v:
        commands.append(RaiseGain(goal_v=asked.mcp_v, rate_v_per_s=limits.ramp_v_per_s))
    if asked.gate_ns:
        commands.append(OpenGate(width_ns=asked.gate_ns, rate_hz=rate_hz))
    if asked.illuminance_lux:
        commands.append(SetLight(illuminance_lux=asked.illuminance_lux, point=point, target=step.target))
    safe = TubeState(duty=0.0, mcp_v=0.0, light_lux=0.0, dark_seen=True, heard_s=0.0)
    try:
        Interlock(limits, clock=lambda: 0.0).foresee(*commands, state=safe)
    except InterlockRefused as error:
        raise BadInput(f"{error}, in step {step.label!r}") from None


def _check_phase(step: Step, gating: Gating, field_hz: float) -> None:
    """A triggered gate must open inside the exposure, which ends with its field."""
    asked = step.conditions
    if gating.sync != "triggered" or not asked.gate_ns:
        return
    field_ns = 1e9 / field_hz
    latest_ns = field_ns - asked.gate_ns
    earliest_ns = max(0.0, field_ns - (asked.exposure_s or 1.0 / field_hz) * 1e9)
    if not earliest_ns - 1e-3 * field_ns <= gating.delay_ns <= latest_ns + 1e-3 * field_ns:
        raise BadInput(
            f"delay_ns must open the gate inside the exposure, {earliest_ns:.6g} to {latest_ns:.6g}, "
            f"got {gating.delay_ns:g} in {step.label!r}"
        )


def _check_picture(plan: Plan, sensor: Sensor | None) -> None:
    """Refuse (BadInput) a picture that the sensor does not have, parts its fields, or cuts its codes."""
    if sensor is None:
        return
    asked = picture_of(plan, sensor)
    for first, size, there in (
        ("first_row", "rows", sensor.ccd.rows),
        ("first_column", "columns", sensor.ccd.columns),
    ):
        end = (getattr(asked, first) or 0) + (getattr(asked, size) or 0)
        if end > there:
            raise BadInput(f"{first} + {size} of the picture must not exceed the sensor's {there}, got {end}")
    if sensor.video.interlaced and (asked.first_row or 0) % 2:
        raise BadInput(f"first_row of interlaced video must be even, so that fields keep order, got {asked.first_row}")
    bits = PIXEL_BITS[asked.pixel_format or "Mono16"]
    if bits < sensor.video.bit_depth:
        raise BadInput(
            f"pixel_format must hold the sensor's {sensor.video.bit_depth} bits, got {asked.pixel_format} of {bits}"
        )


def _check_disk(plan: Plan, folder: Path, sensor: Sensor | None) -> None:
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free, needed = shutil.disk_usage(there).free, bytes_of(plan, sensor) + _SPARE_BYTES
    if free < needed:
        raise BadInput(f"the disk must have {needed // 10**6} MB free for this plan, got {free // 10**6} MB")
