"""What a plan would do, with nothing switched on: its steps, time, disk, the dose of the tube and its hottest step."""

from dataclasses import dataclass

from drivers.acquisition.plan_check import bytes_of, field_hz
from drivers.acquisition.run import DISCARDED_FRAMES
from labdata.calibrated_gain import gain_table_of
from labdata.gain_table import GainTable
from labdata.gating import out_of_step
from labdata.limits import LimitsInForce, limits_in_force
from labdata.plan import Plan, Step
from labdata.sensor import Sensor
from labdata.tube_dose import Dose, dose_of, total_dose

CHANGE_S = 0.3
"""Time on the wires to set gate, camera and light of a step, s."""

GAIN_SETTLES_S = 0.5
"""Time that a supply's output takes to settle and be read after a ramp, s."""

FALL_V_PER_S = 300.0
"""Unloaded fall of the high voltage, V/s."""

FRAMES_PER_S = 30.0
"""Frame rate taken for a camera that nobody described, Hz."""


@dataclass(frozen=True, kw_only=True)
class StepForecast:
    """What one step would do; a step that may stop early counts with all its frames."""

    step: Step
    seconds: float
    """Time with everything, s."""
    anode_na_per_cm2: float
    """Current density that its light would ask of the plate, nA/cm2."""
    share_of_limit: float
    """That, over what is allowed."""
    dose: Dose


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """What a whole plan would do, in the order of its steps."""

    steps: tuple[StepForecast, ...]
    bytes: int
    """What its frames would take on the disk; 0 where no sensor tells the size of a frame."""
    limits: LimitsInForce
    gain_table: GainTable | None
    out_of_step: tuple[str, ...] = ()
    """One sentence for each way in which gate and fields do not keep step."""

    @property
    def seconds(self) -> float:
        """Time of the whole plan, s."""
        return sum(one.seconds for one in self.steps)

    @property
    def dose(self) -> Dose:
        """What the tube would go through in all."""
        return total_dose(one.dose for one in self.steps)

    @property
    def hottest(self) -> StepForecast:
        """The step nearest to what the plate may be asked; the first of equals."""
        return max(self.steps, key=lambda one: one.share_of_limit)


def forecast(plan: Plan, sensor: Sensor | None) -> Forecast:
    """Return what a plan, in volts and checked by `check_plan`, would do with a camera."""
    limits = limits_in_force(plan.limits, sensor, plan.overrides)
    befores = (None, *plan.steps[:-1])
    steps = tuple(_step(plan, step, before, sensor, limits) for step, before in zip(plan.steps, befores, strict=True))
    return Forecast(
        steps=steps,
        bytes=bytes_of(plan, sensor),
        limits=limits,
        gain_table=gain_table_of(plan, sensor),
        out_of_step=sentences_out_of_step(plan, sensor),
    )


def sentences_out_of_step(plan: Plan, sensor: Sensor | None) -> tuple[str, ...]:
    """Return one sentence for each pair of gate and exposure in a plan that does not keep step with the fields."""
    rate_hz = field_hz(sensor)
    asked = (one.conditions for one in plan.steps)
    pairs = dict.fromkeys((one.gate_ns or 0.0, one.exposure_s or 1.0 / rate_hz) for one in asked)
    told = (
        out_of_step(plan.gating, width_ns=gate_ns, exposure_s=exposure_s, field_hz=rate_hz)
        for gate_ns, exposure_s in pairs
    )
    return tuple(dict.fromkeys(one for one in told if one is not None))


def _step(plan: Plan, step: Step, before: Step | None, sensor: Sensor | None, limits: LimitsInForce) -> StepForecast:
    asked, point = step.brightest.conditions, step.kind == "point"
    settle_s = plan.settle.wait_s(None if before is None else before.conditions, step.conditions)
    moving_s = CHANGE_S + _gain_moves_s(before, step, limits)
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
    )


def _gain_moves_s(before: Step | None, step: Step, limits: LimitsInForce) -> float:
    present_v = 0.0 if before is None else before.conditions.mcp_v or 0.0
    change_v = (step.conditions.mcp_v or 0.0) - present_v
    if not change_v:
        return 0.0
    return GAIN_SETTLES_S + (change_v / limits.ramp_v_per_s if change_v > 0.0 else -change_v / FALL_V_PER_S)


def _frame_s(step: Step, sensor: Sensor | None) -> float:
    """Time from frame to frame, s: two fields of interlaced video, one exposure of another."""
    if sensor is None:
        period_s = 1.0 / FRAMES_PER_S
    else:
        period_s = (2.0 if sensor.video.interlaced else 1.0) / float(sensor.video.field_rate_hz)
    return max(period_s, step.conditions.exposure_s or 0.0)
