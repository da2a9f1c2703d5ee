"""Gain by calibration in a plan: asked in luminous gain, set in volts, and what is read back recorded in both."""

from dataclasses import replace

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.gain_table import GainTable
from labdata.plan import Plan, Step
from labdata.sensor import Sensor

SETTABLE_V = 1.0
"""Volts are rounded to what every supply can set, V."""

READ_V = 2.0
"""How far beyond the table's end a supply that was set to it may read, V: what counts as settled."""


def gain_table_of(plan: Plan, sensor: Sensor | None) -> GainTable | None:
    """Return the calibration that holds for a plan: its own, else that of its sensor, else None."""
    if plan.gain_table is not None:
        return plan.gain_table
    return None if sensor is None else sensor.gain_table


def in_volts(plan: Plan, sensor: Sensor | None) -> Plan:
    """Return the plan with every gain in volts and, where the tube is calibrated, as luminous gain.

    Parameters
    ----------
    plan
        The plan.
    sensor
        The camera it is for, or None.

    Raises
    ------
    BadInput
        If a step asks for a luminous gain without a table, for volts or gain outside it, or for both and they differ;
        or if the table is of another tube.
    """
    table = gain_table_of(plan, sensor)
    if table is not None and None not in (table.tube, plan.tube) and table.tube != plan.tube:
        raise BadInput(f"a gain table must be of the plan's tube {plan.tube!r}, got one of {table.tube!r}")
    return replace(plan, steps=tuple(_resolve_gain(step, table) for step in plan.steps))


def by_calibration(table: GainTable | None, mcp_v: float | None) -> Conditions:
    """Return the luminous gain at a voltage as read back, V; nothing without a table or with the plate off."""
    if table is None or not mcp_v or mcp_v < table.mcp_v[0] - READ_V:
        return Conditions()
    gain, relative_sd = table.gain_at(mcp_v, beyond_v=READ_V)
    return Conditions(luminous_gain=gain, luminous_gain_relative_sd=relative_sd)


def _resolve_gain(step: Step, table: GainTable | None) -> Step:
    asked = step.conditions
    if table is None:
        if asked.luminous_gain is not None:
            raise BadInput(
                f"luminous_gain must have a gain table in the plan or its sensor, got none in step {step.label!r}"
            )
        return step
    try:
        return replace(step, conditions=_both(asked, table))
    except BadInput as error:
        raise BadInput(f"{error}, in step {step.label!r}") from None


def _both(asked: Conditions, table: GainTable) -> Conditions:
    """Conditions with the volts that give the luminous gain; those in volts stay, if the table holds them."""
    if asked.luminous_gain is None:
        if asked.mcp_v:
            table.gain_at(asked.mcp_v)
        return asked
    volts = round(table.volts_for(asked.luminous_gain) / SETTABLE_V) * SETTABLE_V
    if asked.mcp_v is not None and asked.mcp_v != volts:
        raise BadInput(
            f"mcp_v must be left out or be what luminous_gain {asked.luminous_gain:g} needs by the gain table, "
            f"{volts:g}, got {asked.mcp_v:g}"
        )
    return replace(asked, mcp_v=volts)
