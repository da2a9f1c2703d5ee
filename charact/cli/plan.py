"""The verb `plan`: forecast of an acquisition plan."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input

if TYPE_CHECKING:
    from collections.abc import Sequence

    from drivers.acquisition.plan_check import Forecast, StepForecast
    from labdata.calibration import GainTable
    from labdata.camera.description import Camera
    from labdata.conditions import Conditions
    from labdata.plan import Plan
    from labdata.tube_dose import Dose

MAX_LINES = 40


def plan(
    plan: Annotated[
        Path, typer.Argument(help="Acquisition plan, TOML, or the name of a shipped one.")
    ],
    as_json: options.Json = False,
    every: Annotated[
        bool, typer.Option("--all", help=f"Print every step instead of the first {MAX_LINES}.")
    ] = False,
) -> None:
    """Forecast an acquisition plan: steps, time, disk space, tube dose, hottest step. Nothing is
    switched on.

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
        from drivers.acquisition.plan_check import check_plan, forecast
        from labdata.plan import in_volts
        from labdata.sensors import load_sensor

        loaded = load_plan(plan)
        sensor = None if loaded.sensor is None else load_sensor(loaded.sensor)
        loaded = in_volts(loaded, sensor)
        check_plan(loaded, Path.cwd(), sensor)
        prediction = forecast(loaded, sensor)
        if as_json:
            print(json.dumps(_document(str(plan), loaded, prediction, sensor), allow_nan=False))
        else:
            print("\n".join(_lines(loaded, prediction, sensor, every=every)))
            if sys.stdout.isatty():
                print(f"\nNext: charact acquire {plan} OUT")


def _document(
    given: str, plan: "Plan", prediction: "Forecast", sensor: "Camera | None"
) -> dict[str, Any]:
    from labdata.limits import LIMITS

    before = _before(plan)
    return {
        "charact": __version__,
        "input": given,
        "name": plan.name,
        "steps": [_step_document(one, plan, prediction.gain_table) for one in prediction.steps],
        "gain_table": None if prediction.gain_table is None else prediction.gain_table.provenance,
        "seconds": round(prediction.seconds, 1),
        "bytes": prediction.bytes,
        "dose": _dose_document(prediction.dose),
        "dose_before": None if before is None else _dose_document(before),
        "lamp": None if plan.lamp is None else plan.lamp.provenance,
        "hottest": _step_document(prediction.hottest, plan, prediction.gain_table),
        "limits": {name: getattr(prediction.limits, name) for name in LIMITS},
        "overridden": list(prediction.limits.overridden),
        "tube_known": prediction.limits.known,
        "warnings": list(_warnings(prediction, before, sensor)),
    }


def _step_document(one: "StepForecast", plan: "Plan", table: "GainTable | None") -> dict[str, Any]:
    from labdata.plan import by_calibration

    conditions, gain = one.step.conditions, by_calibration(table, one.step.conditions.mcp_v)
    lit = _lamp_setting(one, plan)
    return {
        "label": one.step.label,
        "kind": one.step.kind,
        "frames": one.step.most_frames,
        **{name: getattr(conditions, name) for name in ("mcp_v", "gate_ns", "exposure_s")},
        "luminous_gain": gain.luminous_gain,
        "luminous_gain_relative_sd": gain.luminous_gain_relative_sd,
        "illuminance_lux": one.step.brightest.conditions.illuminance_lux,
        "filter_density": conditions.filter_density if lit is None else lit.filter_density,
        "lamp_a": None if lit is None else lit.lamp_a,
        "seconds": round(one.seconds, 3),
        "anode_na_per_cm2": one.anode_na_per_cm2,
        "share_of_limit": one.share_of_limit,
    }


def _lamp_setting(one: "StepForecast", plan: "Plan") -> "Conditions | None":
    """Return filter and lamp current of a step; None in the dark or if a person sets the light."""
    conditions = one.step.brightest.conditions
    if plan.lamp is None or not conditions.illuminance_lux:
        return None
    return plan.lamp.setting(conditions.illuminance_lux, conditions.filter_density).read


def _dose_document(dose: "Dose") -> dict[str, float]:
    names = ("screen_c_per_cm2", "point_c_per_cm2", "hours_at_gain", "factor95")
    return {name: getattr(dose, name) for name in names}


def _lines(
    plan: "Plan", prediction: "Forecast", sensor: "Camera | None", *, every: bool
) -> list[str]:
    from drivers.acquisition.run_progress import duration

    shown = prediction.steps if every else prediction.steps[:MAX_LINES]
    left = len(prediction.steps) - len(shown)
    hottest, before, dose, table = (
        prediction.hottest,
        _before(plan),
        prediction.dose,
        prediction.gain_table,
    )
    limit = prediction.limits.largest_anode_na_per_cm2(point=hottest.step.kind == "point")
    points = f", and {dose.point_c_per_cm2:.2g} inside pinholes" if dose.point_c_per_cm2 else ""
    earlier = (
        "unknown, the plan names no tube"
        if before is None
        else (
            f"{before.charge_c_per_cm2:.2g} C/cm2, {before.hours_at_gain:.3g} h at gain of tube "
            f"{plan.tube}"
        )
    )
    known = "No sensor description: default tube limits apply, and the tube load is an estimate."
    return [
        f"{plan.name}: {len(prediction.steps)} steps, nothing is switched on",
        *_table(shown, plan, table),
        *([f"... and {left} more; --all prints them"] if left else []),
        f"time: {duration(prediction.seconds)}",
        f"disk: {prediction.bytes / 1e6:.0f} MB" if sensor else "disk: unknown without a sensor",
        f"dose: {dose.screen_c_per_cm2:.2g} C/cm2 at the phosphor{points}, within a factor of "
        f"{dose.factor95:.2g} (95 %); {60 * dose.hours_at_gain:.3g} min at gain",
        f"dose before: {earlier}",
        f"hottest: {hottest.step.label}, {hottest.anode_na_per_cm2:.3g} nA/cm2 MCP output current, "
        f"{hottest.share_of_limit:.0%} of the limit {limit:g}",
        *([] if prediction.limits.known else [known]),
        *([table.provenance] if table else []),
        *([plan.lamp.provenance] if plan.lamp else []),
        *prediction.limits.overridden,
        *_warnings(prediction, before, sensor),
    ]


def _table(
    shown: "Sequence[StepForecast]", plan: "Plan", table: "GainTable | None"
) -> Iterator[str]:
    """Yield the header and one line per step, with columns for a gain table and a lamp if there
    are.
    """
    from labdata.plan import by_calibration

    gain = "" if table is None else f" {'lm/lm':>9}"
    lamp = "" if plan.lamp is None else f" {'lamp mA':>8} {'filter':>6}"
    rest = f"{'lux':>9}{lamp} {'nA/cm2':>9} {'limit':>6}"
    yield f"{'label':<32} {'kind':<6} {'frames':>6} {'V':>6}{gain} {'gate ms':>8} {rest}"
    for one in shown:
        conditions, lit = one.step.brightest.conditions, _lamp_setting(one, plan)
        if table is not None:
            gain = f" {by_calibration(table, conditions.mcp_v).luminous_gain or 0.0:>9.4g}"
        if plan.lamp is not None:
            lamp = f" {'out':>8} {'':>6}"
            lamp = (
                lamp
                if lit is None
                else f" {1e3 * (lit.lamp_a or 0.0):>8g} {lit.filter_density:>6g}"
            )
        yield (
            f"{one.step.label:<32} {one.step.kind:<6} {one.step.most_frames:>6} "
            f"{conditions.mcp_v or 0.0:>6g}{gain} {(conditions.gate_ns or 0.0) * 1e-6:>8.4g} "
            f"{conditions.illuminance_lux or 0.0:>9.3g}{lamp} {one.anode_na_per_cm2:>9.3g} "
            f"{one.share_of_limit:>6.1%}"
        )


def _before(plan: "Plan") -> "Dose | None":
    from labdata.tube_dose import ledger_of

    return None if plan.tube is None else ledger_of(plan.tube).total()


def _warnings(
    prediction: "Forecast", before: "Dose | None", sensor: "Camera | None"
) -> tuple[str, ...]:
    from labdata.tube_dose import total_dose, warnings

    doses = warnings(total_dose([prediction.dose, *([] if before is None else [before])]), sensor)
    return (*doses, *prediction.out_of_step)
