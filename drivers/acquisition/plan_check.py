"""Check a plan before anything is switched on, and forecast its time, disk space and dose."""

import shutil
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated

from drivers.acquisition.plans import load_plan
from drivers.acquisition.run import DISCARDED_FRAMES
from drivers.bench.interlock import Interlock
from drivers.bench.setup import FIELD_RATE_HZ
from drivers.bench.state import Command, InterlockRefused, OpenGate, RaiseGain, SetLight, TubeState
from labdata import (
    BadInput,
    Camera,
    Conditions,
    GainTable,
    Gating,
    LampCalibration,
    load_sensor,
    out_of_step,
)
from labdata.capture import PIXEL_BITS, CameraSettings
from labdata.limits import LimitsInForce, limits_in_force
from labdata.plan import Plan, Step, by_calibration, gain_table_of, in_volts
from labdata.settings import Argument, documented
from labdata.tube_dose import Dose, dose_of, ledger_of, total_dose, warnings

_NEEDED = {
    "bars": ("bars", "frequency_cy_per_px"),
    "edge": (),
    "point": (),
    "flat": (),
    "dark": (),
    "scene": (),
}
# Conditions that no driver sets or reads back: the record would contain a set-point that was never
# in force.
_METERED = ("metered_w", "metered_lux", "metered_time_s", "temperature_time_s")
_SET_BY_NOBODY = (
    "automatic_gain",
    "brightness_control",
    "em_gain",
    "gain_control",
    "lamp_a",
    *_METERED,
)


def check_plan(plan: Plan, folder: Path, sensor: Camera | None) -> None:
    """Check a plan completely; the first broken rule is BadInput.

    Rules: a command that the interlock refuses, a limit above the tube's, a label that is no file
    name, light on a dark, an incomplete target, a gate wider than the exposure, a condition that no
    driver sets, a frame format outside the sensor, or a full disk.
    """
    limits = limits_in_force(plan.limits, sensor, plan.overrides)
    for step in plan.steps:
        _check_step(step, sensor)
        _check_light(step, plan.lamp)
        _check_rules(step.brightest, limits, plan.gating.most_hz(field_hz(sensor)))
        _check_phase(step, plan.gating, field_hz(sensor))
    _check_picture(plan, sensor)
    _check_disk(plan, folder, sensor)


def field_hz(sensor: Camera | None) -> float:
    """Return the field rate of the camera, Hz, or of 525-line video if unknown."""
    return float(sensor.video.field_rate_hz) if sensor else FIELD_RATE_HZ


def picture_of(plan: Plan, sensor: Camera | None) -> CameraSettings:
    """Return the frame format of a plan, by default the full sensor at its bit depth."""
    full_frame = CameraSettings()
    if sensor is not None:
        rows, columns = sensor.ccd.rows, sensor.ccd.columns
        pixel_format = "Mono8" if sensor.video.bit_depth <= 8 else "Mono16"
        full_frame = CameraSettings(
            rows=rows, columns=columns, first_row=0, first_column=0, pixel_format=pixel_format
        )
    return replace(
        full_frame,
        **{name: value for name, value in vars(plan.picture).items() if value is not None},
    )


def bytes_of(plan: Plan, sensor: Camera | None) -> int:
    """Return the bytes of the frames of a plan; 0 where neither plan nor sensor states the frame
    size.
    """
    picture = picture_of(plan, sensor)
    pixel_bytes = 1 if PIXEL_BITS[picture.pixel_format or "Mono16"] <= 8 else 2
    return (
        sum(step.most_frames for step in plan.steps)
        * (picture.rows or 0)
        * (picture.columns or 0)
        * pixel_bytes
    )


def same_but_wires(plan: Plan, other: Plan) -> str | None:
    """Return the first difference between two plans other than their wires; None if there is
    none.
    """
    names = tuple(item.name for item in fields(Plan) if item.name not in ("wires", "steps"))
    if plan.steps == other.steps:
        return next((name for name in names if getattr(plan, name) != getattr(other, name)), None)
    steps = {step.label: step for step in other.steps}
    for step in plan.steps:
        if steps.get(step.label) != step:
            return f"step {step.label!r}"
    return "steps"


def _check_step(step: Step, sensor: Camera | None) -> None:
    if not step.label or step.label.startswith(".") or set(step.label) & set("/\\\0"):
        raise BadInput(
            f"a step's label must be a file name without slashes or a leading dot, got "
            f"{step.label!r}"
        )
    asked = step.conditions
    if step.kind == "dark" and asked.illuminance_lux:
        raise BadInput(
            f"a dark must be taken without light, got {asked.illuminance_lux:g} lux in "
            f"{step.label!r}"
        )
    for name in _NEEDED[step.kind]:
        if getattr(step.target, name) is None:
            raise BadInput(f"a {step.kind} target must have its {name}, got none in {step.label!r}")
    for name in _SET_BY_NOBODY:
        if (value := getattr(asked, name)) is not None:
            raise BadInput(
                f"{name} must be left out of a plan, as no driver sets it, got {value} in "
                f"{step.label!r}"
            )
    exposure_s = asked.exposure_s or (1.0 / float(sensor.video.field_rate_hz) if sensor else None)
    # A gate of one field time is written rounded, so one per mille more than the exposure is
    # allowed.
    if (
        asked.gate_ns is not None
        and exposure_s is not None
        and asked.gate_ns > exposure_s * 1e9 * 1.001
    ):
        raise BadInput(
            f"gate_ns must not exceed the exposure of {exposure_s * 1e9:g} ns, got "
            f"{asked.gate_ns:g} in {step.label!r}"
        )


def _check_light(step: Step, lamp: LampCalibration | None) -> None:
    """Require lights within the range of the lamp, if there is one."""
    for lux in {step.conditions.illuminance_lux, step.brightest.conditions.illuminance_lux}:
        if lamp is not None and lux:
            try:
                lamp.setting(lux, step.conditions.filter_density)
            except BadInput as error:
                raise BadInput(f"{error}, in step {step.label!r}") from None


def _check_rules(step: Step, limits: LimitsInForce, rate_hz: float) -> None:
    """Check the commands of a step by the rules of the interlock, without instruments."""
    asked, point = step.conditions, step.kind == "point"
    commands: list[Command] = [SetLight(illuminance_lux=0.0, point=point, target=step.target)]
    if asked.mcp_v:
        commands.append(RaiseGain(goal_v=asked.mcp_v, rate_v_per_s=limits.ramp_v_per_s))
    if asked.gate_ns:
        commands.append(OpenGate(width_ns=asked.gate_ns, rate_hz=rate_hz))
    if asked.illuminance_lux:
        commands.append(
            SetLight(illuminance_lux=asked.illuminance_lux, point=point, target=step.target)
        )
    safe = TubeState(duty=0.0, mcp_v=0.0, light_lux=0.0, dark_seen=True, heard_s=0.0)
    try:
        Interlock(limits, clock=lambda: 0.0).foresee(*commands, state=safe)
    except InterlockRefused as error:
        raise BadInput(f"{error}, in step {step.label!r}") from None


def _check_phase(step: Step, gating: Gating, field_hz: float) -> None:
    """Require a triggered gate to open inside the exposure, which ends with its field."""
    asked = step.conditions
    if gating.sync != "triggered" or not asked.gate_ns:
        return
    field_ns = 1e9 / field_hz
    latest_ns = field_ns - asked.gate_ns
    earliest_ns = max(0.0, field_ns - (asked.exposure_s or 1.0 / field_hz) * 1e9)
    if not earliest_ns - 1e-3 * field_ns <= gating.delay_ns <= latest_ns + 1e-3 * field_ns:
        raise BadInput(
            f"delay_ns must open the gate inside the exposure, {earliest_ns:.6g} to "
            f"{latest_ns:.6g}, got {gating.delay_ns:g} in {step.label!r}"
        )


def _check_picture(plan: Plan, sensor: Camera | None) -> None:
    """Require a frame format that lies within the sensor, keeps the field order and has all its
    bits.
    """
    if sensor is None:
        return
    asked = picture_of(plan, sensor)
    for first, size, sensor_size in (
        ("first_row", "rows", sensor.ccd.rows),
        ("first_column", "columns", sensor.ccd.columns),
    ):
        end = (getattr(asked, first) or 0) + (getattr(asked, size) or 0)
        if end > sensor_size:
            raise BadInput(
                f"{first} + {size} of the picture must not exceed the sensor's "
                f"{sensor_size}, got {end}"
            )
    if sensor.video.interlaced and (asked.first_row or 0) % 2:
        raise BadInput(
            f"first_row of interlaced video must be even, so that fields keep order, got "
            f"{asked.first_row}"
        )
    bits = PIXEL_BITS[asked.pixel_format or "Mono16"]
    if bits < sensor.video.bit_depth:
        raise BadInput(
            f"pixel_format must hold the sensor's {sensor.video.bit_depth} bits, got "
            f"{asked.pixel_format} of {bits}"
        )


def _check_disk(plan: Plan, folder: Path, sensor: Camera | None) -> None:
    existing_folder = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free, needed = shutil.disk_usage(existing_folder).free, bytes_of(plan, sensor) + (64 << 20)
    if free < needed:
        raise BadInput(
            f"the disk must have {needed // 10**6} MB free for this plan, got {free // 10**6} MB"
        )


FRAMES_PER_S = 30.0  # Frame rate assumed for an unknown camera, Hz


@dataclass(frozen=True, kw_only=True)
class StepForecast:
    """Forecast of one step, with all its frames."""

    step: Step
    seconds: float  #: Duration, s
    anode_na_per_cm2: float  #: MCP output current density without saturation, nA/cm2
    share_of_limit: float  #: Fraction of the allowed current density
    dose: Dose
    gain: Conditions  #: Luminous gain by the gain table; empty without one
    lamp: Conditions | None  #: Lamp current and filter; None in the dark, or if a person sets light


@dataclass(frozen=True, kw_only=True)
class PlanReport:
    """What a plan would do, in the order of its steps."""

    plan: Plan  #: The plan with every gain in volts
    sensor: Camera | None
    steps: tuple[StepForecast, ...]
    bytes: int  #: Disk space of its frames; 0 where no sensor gives the frame size
    limits: LimitsInForce
    gain_table: GainTable | None
    dose_before: Dose | None  #: Dose of the tube so far; None where the plan names no tube
    warnings: tuple[str, ...]  #: Sentences on the tube's life, and on gates out of step with fields

    @property
    def seconds(self) -> float:
        """Duration of the plan, s."""
        return sum(forecast.seconds for forecast in self.steps)

    @property
    def dose(self) -> Dose:
        """Total dose of the tube."""
        return total_dose(forecast.dose for forecast in self.steps)

    @property
    def hottest(self) -> StepForecast:
        """The step nearest to the limit of current density."""
        return max(self.steps, key=lambda forecast: forecast.share_of_limit)


@documented
def plan_report(
    plan: Annotated[
        str | Path | Plan, Argument("A plan, its TOML file, or the name of a shipped one.")
    ],
    out: Annotated[
        str | Path, Argument("Folder of the session, whose disk must have space for the frames.")
    ] = ".",
) -> PlanReport:
    """Check an acquisition plan and forecast its time, disk space and tube dose.

    Nothing is switched on.

    Returns
    -------
    PlanReport
        `steps`, each with its duration (s), MCP output current density (nA/cm2) and fraction of the
        limit; `seconds`, `bytes`, `dose` (C/cm2 and hours at gain), `hottest`, `warnings`.

    Raises
    ------
    BadInput
        If there is no such plan, or it breaks a rule of the tube, the camera or the disk.

    Examples
    --------
    >>> report = plan_report("gain-by-light")
    >>> f"{report.hottest.share_of_limit:.0%} of the limit in {report.hottest.step.label}"
    '2% of the limit in flat-850V-0.0002lux'
    """
    asked = load_plan(plan)
    sensor = None if asked.sensor is None else load_sensor(asked.sensor)
    asked = in_volts(asked, sensor)
    check_plan(asked, Path(out), sensor)
    limits = limits_in_force(asked.limits, sensor, asked.overrides)
    befores = (None, *asked.steps[:-1])
    steps = tuple(
        _step(asked, step, before, sensor, limits)
        for step, before in zip(asked.steps, befores, strict=True)
    )
    spent = None if asked.tube is None else ledger_of(asked.tube).total()
    doses = [total_dose(forecast.dose for forecast in steps), *([] if spent is None else [spent])]
    return PlanReport(
        plan=asked,
        sensor=sensor,
        steps=steps,
        bytes=bytes_of(asked, sensor),
        limits=limits,
        gain_table=gain_table_of(asked, sensor),
        dose_before=spent,
        warnings=(*warnings(total_dose(doses), sensor), *sentences_out_of_step(asked, sensor)),
    )


def sentences_out_of_step(plan: Plan, sensor: Camera | None) -> tuple[str, ...]:
    """Return one sentence for each pair of gate and exposure that is not synchronous with the
    fields.
    """
    rate_hz = field_hz(sensor)
    asked = (step.conditions for step in plan.steps)
    pairs = dict.fromkeys((c.gate_ns or 0.0, c.exposure_s or 1.0 / rate_hz) for c in asked)
    sentences = (
        out_of_step(plan.gating, width_ns=gate_ns, exposure_s=exposure_s, field_hz=rate_hz)
        for gate_ns, exposure_s in pairs
    )
    return tuple(dict.fromkeys(filter(None, sentences)))


def _step(
    plan: Plan, step: Step, before: Step | None, sensor: Camera | None, limits: LimitsInForce
) -> StepForecast:
    asked, point = step.brightest.conditions, step.kind == "point"
    settle_s = plan.settle.wait_s(None if before is None else before.conditions, step.conditions)
    # Time to set gate, camera and light of a step, s
    moving_s = 0.3 + _gain_moves_s(before, step, limits)
    lit_s = settle_s + (step.most_frames + DISCARDED_FRAMES) * _frame_s(step, sensor)
    lux, volts = asked.illuminance_lux or 0.0, asked.mcp_v or 0.0
    duty = min(1.0, (asked.gate_ns or 0.0) * 1e-9 * plan.gating.most_hz(field_hz(sensor)))
    anode = limits.load.anode_na_per_cm2(lux, volts, duty)
    dose = dose_of(
        delivered_na_per_cm2=limits.load.screen_na_per_cm2(lux, volts, duty),
        lit_s=lit_s,
        at_gain_s=(moving_s + lit_s) if volts else 0.0,
        point=point,
        log_sd=limits.load.log_sd(volts),
    )
    return StepForecast(
        step=step,
        seconds=moving_s + lit_s,
        anode_na_per_cm2=anode,
        share_of_limit=anode / limits.largest_anode_na_per_cm2(point=point),
        dose=dose,
        gain=by_calibration(gain_table_of(plan, sensor), step.conditions.mcp_v),
        lamp=None
        if plan.lamp is None or not asked.illuminance_lux
        else plan.lamp.setting(asked.illuminance_lux, asked.filter_density).read,
    )


def _gain_moves_s(before: Step | None, step: Step, limits: LimitsInForce) -> float:
    present_v = 0.0 if before is None else before.conditions.mcp_v or 0.0
    change_v = (step.conditions.mcp_v or 0.0) - present_v
    if not change_v:
        return 0.0
    # Settle and read time of a supply after a ramp, s
    # Rate of fall of the unloaded high voltage, V/s
    return 0.5 + (change_v / limits.ramp_v_per_s if change_v > 0.0 else -change_v / 300.0)


def _frame_s(step: Step, sensor: Camera | None) -> float:
    """Return the frame period, s: two fields of interlaced video, else one exposure."""
    if sensor is None:
        period_s = 1.0 / FRAMES_PER_S
    else:
        period_s = (2.0 if sensor.video.interlaced else 1.0) / float(sensor.video.field_rate_hz)
    return max(period_s, step.conditions.exposure_s or 0.0)
