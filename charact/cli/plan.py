"""The verb `plan`: what a plan would do to disk, clock and tube, with nothing switched on."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input

if TYPE_CHECKING:
    from drivers.acquisition.forecast import Forecast, StepForecast
    from labdata.conditions import Conditions
    from labdata.gain_table import GainTable
    from labdata.plan import Plan
    from labdata.sensor import Sensor
    from labdata.tube_dose import Dose

MOST_LINES = 40


def plan(
    plan: Annotated[Path, typer.Argument(help="Acquisition plan, TOML, or the name of a shipped one.")],
    as_json: options.Json = False,
    every: Annotated[bool, typer.Option("--all", help=f"Print every step, not only {MOST_LINES}.")] = False,
) -> None:
    """What an acquisition plan would do: steps, time, disk, dose of the tube, hottest step. Nothing is switched on.

    Example: charact plan gain-by-light

    \b
    A plan with a sweep:
      name = "gain by light"
      sensor = "pulnix-ag5745ef3"
      [[sweep]]
      kind = "flat"
      frames = 16
      mcp_v = [600.0, 700.0, 800.0]
      gate_ns = 1.6e7
      illuminance_lux = [2e-5, 6e-5, 2e-4]
      order = "boustrophedon"
      dark_every = 3
    """
    with exit_on_bad_input(str(plan), as_json=as_json):
        from charact.cli.benches import load_plan
        from drivers.acquisition.forecast import forecast
        from drivers.acquisition.plan_check import check_plan
        from labdata.calibrated_gain import in_volts
        from labdata.sensors import load_sensor

        asked = load_plan(plan)
        sensor = None if asked.sensor is None else load_sensor(asked.sensor)
        asked = in_volts(asked, sensor)
        check_plan(asked, Path.cwd(), sensor)
        foreseen = forecast(asked, sensor)
        if as_json:
            print(json.dumps(_document(str(plan), asked, foreseen, sensor), allow_nan=False))
        else:
            print("\n".join(_lines(asked, foreseen, sensor, every=every)))
            if sys.stdout.isatty():
                print(f"\nNext: charact acquire {plan} OUT")


def _document(given: str, asked: "Plan", foreseen: "Forecast", sensor: "Sensor | None") -> dict[str, Any]:
    from labdata.limits import LIMITS

    before = _before(asked)
    return {
        "charact": __version__,
        "input": given,
        "name": asked.name,
        "steps": [_step_document(one, asked, foreseen.gain_table) for one in foreseen.steps],
        "gain_table": None if foreseen.gain_table is None else foreseen.gain_table.provenance,
        "seconds": round(foreseen.seconds, 1),
        "bytes": foreseen.bytes,
        "dose": _dose_document(foreseen.dose),
        "dose_before": None if before is None else _dose_document(before),
        "lamp": None if asked.lamp is None else asked.lamp.provenance,
        "hottest": _step_document(foreseen.hottest, asked, foreseen.gain_table),
        "limits": {name: getattr(foreseen.limits, name) for name in LIMITS},
        "overridden": list(foreseen.limits.overridden),
        "tube_known": foreseen.limits.known,
        "warnings": list(_warnings(foreseen, before, sensor)),
    }


def _step_document(one: "StepForecast", plan: "Plan", table: "GainTable | None") -> dict[str, Any]:
    from labdata.calibrated_gain import by_calibration

    asked, gain = one.step.conditions, by_calibration(table, one.step.conditions.mcp_v)
    lit = _lamp_setting(one, plan)
    return {
        "label": one.step.label,
        "kind": one.step.kind,
        "frames": one.step.most_frames,
        "mcp_v": asked.mcp_v,
        "luminous_gain": gain.luminous_gain,
        "luminous_gain_relative_sd": gain.luminous_gain_relative_sd,
        "gate_ns": asked.gate_ns,
        "exposure_s": asked.exposure_s,
        "illuminance_lux": one.step.brightest.conditions.illuminance_lux,
        "filter_density": asked.filter_density if lit is None else lit.filter_density,
        "lamp_a": None if lit is None else lit.lamp_a,
        "seconds": round(one.seconds, 3),
        "anode_na_per_cm2": one.anode_na_per_cm2,
        "share_of_limit": one.share_of_limit,
    }


def _lamp_setting(one: "StepForecast", plan: "Plan") -> "Conditions | None":
    """How the lamp of the bench makes a step's light: filter and current; None in the dark or by a person's hand."""
    asked = one.step.brightest.conditions
    if plan.lamp is None or not asked.illuminance_lux:
        return None
    return plan.lamp.setting(asked.illuminance_lux, asked.filter_density).read


def _dose_document(dose: "Dose") -> dict[str, float]:
    return {
        "screen_c_per_cm2": dose.screen_c_per_cm2,
        "point_c_per_cm2": dose.point_c_per_cm2,
        "hours_at_gain": dose.hours_at_gain,
        "factor95": dose.factor95,
    }


def _lines(asked: "Plan", foreseen: "Forecast", sensor: "Sensor | None", *, every: bool) -> list[str]:
    from drivers.acquisition.run_progress import duration

    shown = foreseen.steps if every else foreseen.steps[:MOST_LINES]
    left = len(foreseen.steps) - len(shown)
    hottest, before = foreseen.hottest, _before(asked)
    limit = foreseen.limits.largest_anode_na_per_cm2(point=hottest.step.kind == "point")
    known = "" if foreseen.limits.known else "The tube is not described: cautious limits hold, its load is a guess."
    table = foreseen.gain_table
    gain = "" if table is None else f" {'lm/lm':>9}"
    lamp = "" if asked.lamp is None else f" {'lamp mA':>8} {'filter':>6}"
    rest = f"{'lux':>9}{lamp} {'nA/cm2':>9} {'limit':>6}"
    return [
        f"{asked.name}: {len(foreseen.steps)} steps, nothing is switched on",
        f"{'label':<32} {'kind':<6} {'frames':>6} {'V':>6}{gain} {'gate ms':>8} {rest}",
        *(_line(one, asked, table) for one in shown),
        *([f"... and {left} more; --all prints them"] if left else []),
        f"time: {duration(foreseen.seconds)}",
        f"disk: {foreseen.bytes / 1e6:.0f} MB" if sensor else "disk: unknown without a sensor",
        f"dose: {_dose_words(foreseen.dose)}",
        f"dose before: {_before_words(asked, before)}",
        f"hottest: {hottest.step.label}, {hottest.anode_na_per_cm2:.3g} nA/cm2 asked of the plate, "
        f"{hottest.share_of_limit:.0%} of the {limit:g} allowed",
        *([known] if known else []),
        *([table.provenance] if table else []),
        *([asked.lamp.provenance] if asked.lamp else []),
        *foreseen.limits.overridden,
        *_warnings(foreseen, before, sensor),
    ]


def _line(one: "StepForecast", plan: "Plan", table: "GainTable | None") -> str:
    from labdata.calibrated_gain import by_calibration

    asked = one.step.brightest.conditions
    gain = by_calibration(table, asked.mcp_v).luminous_gain or 0.0
    gain_words = "" if table is None else f" {gain:>9.4g}"
    return (
        f"{one.step.label:<32} {one.step.kind:<6} {one.step.most_frames:>6} {asked.mcp_v or 0.0:>6g}"
        f"{gain_words} {(asked.gate_ns or 0.0) * 1e-6:>8.4g} {asked.illuminance_lux or 0.0:>9.3g}"
        f"{_lamp_words(one, plan)} {one.anode_na_per_cm2:>9.3g} {one.share_of_limit:>6.1%}"
    )


def _lamp_words(one: "StepForecast", plan: "Plan") -> str:
    if plan.lamp is None:
        return ""
    lit = _lamp_setting(one, plan)
    return f" {'out':>8} {'':>6}" if lit is None else f" {1e3 * (lit.lamp_a or 0.0):>8g} {lit.filter_density:>6g}"


def _dose_words(dose: "Dose") -> str:
    points = f", and {dose.point_c_per_cm2:.2g} inside pinholes" if dose.point_c_per_cm2 else ""
    return (
        f"{dose.screen_c_per_cm2:.2g} C/cm2 through the screen{points}, within a factor of {dose.factor95:.2g} "
        f"(95 %); {60 * dose.hours_at_gain:.3g} min at gain"
    )


def _before(asked: "Plan") -> "Dose | None":
    from labdata.dose_ledger import ledger_of

    return None if asked.tube is None else ledger_of(asked.tube).total()


def _before_words(asked: "Plan", before: "Dose | None") -> str:
    if before is None:
        return "unknown, the plan names no tube"
    return f"{before.charge_c_per_cm2:.2g} C/cm2, {before.hours_at_gain:.3g} h at gain of tube {asked.tube}"


def _warnings(foreseen: "Forecast", before: "Dose | None", sensor: "Sensor | None") -> tuple[str, ...]:
    from labdata.tube_dose import total_dose, warnings

    doses = warnings(total_dose([foreseen.dose, *([] if before is None else [before])]), sensor)
    return (*doses, *foreseen.out_of_step)
