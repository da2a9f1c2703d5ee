"""Tables of a report: quantities, stacks, sensor parameters, provenance."""

import platform
import shlex
import sys
from collections.abc import Iterable
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from charact import __version__
from charact.method.registry import chart_table
from charact.method.stopwatch import time_text
from labdata import FLAGS, QUANTITIES, Camera, Conditions, Measurement, Result, Session, Target
from labdata.number_format import (
    interval_text,
    plus_minus,
    quantity_title,
    round_to_spread,
    short_text,
    value_text,
)

LIBRARIES = ("numpy", "scipy", "emcee", "matplotlib", "zarr", "trimesh", "embreex")
# A method with more stacks than this has one table for all of them.
SERIES = 4


def quantity_row(m: Measurement, where: str = "") -> dict[str, Any]:
    """Return the row of a measurement; `where`: direction, region and time."""
    return {
        "title": quantity_title(m),
        "name": m.quantity,
        "value": value_text(m),
        "plus_minus": plus_minus(m),
        "interval68": interval_text(m, m.interval68),
        "interval95": interval_text(m, m.interval95),
        "where": where,
        "stack": m.stack or "",
        **{name: getattr(m, name) for name in ("unit", "status", "flags", "reason")},
    }


def places(m: Measurement) -> dict[str, str]:
    """Return stack, direction, region and time of a measurement as text."""
    texts = {"stack": m.stack} if m.stack else {}
    if m.orientation_deg is not None:
        texts["direction"] = f"{m.orientation_deg:.4g}° to the rows"
    if m.amplifier:
        texts["amplifier"] = f"amplifier {m.amplifier}"
    if m.region is not None:
        row, col, height, width = m.region
        texts["region"] = f"rows {row}–{row + height - 1}, cols {col}–{col + width - 1}"
    if m.seconds is not None:
        texts["time"] = time_text(m.seconds)
    return texts


def bases(measurements: Iterable[Measurement]) -> list[tuple[str, str]]:
    """Return the title of each measurement with its method, stack, region and seed."""
    seeds = [(m, None if m.provenance is None else m.provenance.seed) for m in measurements]
    return [
        (
            f"{quantity_title(m).partition(':')[0]} ({m.unit})".replace(" (1)", ""),
            ", ".join((m.method, *places(m).values(), *([] if seed is None else [f"seed {seed}"]))),
        )
        for m, seed in seeds
    ]


def quantity_groups(result: Result) -> tuple[dict[str, Any], ...]:
    """Return all measurements by stack and method in the order of the vocabulary; a series of
    stacks is one group.

    A group has a title, rows, and its flags and notes with the quantities and stacks they concern
    ("" if all).
    """
    order = list(QUANTITIES)
    stacks: dict[str, set[str]] = {}
    for m in result.measurements:
        stacks.setdefault(m.method, set()).add(m.stack or "whole session")
    groups: dict[tuple[str, str], list[Measurement]] = {}
    for m in sorted(result.measurements, key=lambda m: order.index(m.quantity)):
        is_series = len(stacks[m.method]) > SERIES
        stack = f"{len(stacks[m.method])} stacks" if is_series else m.stack or "whole session"
        groups.setdefault((stack, m.method), []).append(m)
    return tuple(_group(stack, method, members) for (stack, method), members in groups.items())


def _group(stack: str, method: str, members: list[Measurement]) -> dict[str, Any]:
    """Return a group with the attributes common to all rows in its title."""
    where = [places(m) for m in members]
    common = {
        key: text for key, text in where[0].items() if all(at.get(key) == text for at in where)
    }
    row_places = ["; ".join(text for key, text in at.items() if key not in common) for at in where]
    flags = dict.fromkeys(flag for m in members for flag in m.flags)
    notes = dict.fromkeys(note for m in members for note in m.notes)
    return {
        "title": " · ".join(
            (stack, method, *(text for key, text in common.items() if key != "stack"))
        ),
        "rows": [quantity_row(m, text) for m, text in zip(members, row_places, strict=True)],
        "flags": [
            (flag, FLAGS[flag], _scope_text(members, [m for m in members if flag in m.flags]))
            for flag in flags
        ],
        "notes": [
            (note, _scope_text(members, [m for m in members if note in m.notes])) for note in notes
        ],
    }


def _scope_text(members: list[Measurement], those: list[Measurement]) -> str:
    """Return the quantities and stacks of some measurements; "" if these are all with a value."""
    if len(those) >= sum(m.value is not None for m in members) > 1:
        return ""
    quantities = ", ".join(dict.fromkeys(m.quantity for m in those))
    stacks = list(dict.fromkeys(m.stack or "whole session" for m in those))
    if len(stacks) == len({m.stack for m in members}):
        return quantities
    more = f" and {len(stacks) - SERIES} more" if len(stacks) > SERIES else ""
    return f"{quantities} of {', '.join(stacks[:SERIES])}{more}"


def best(measurements: Iterable[Measurement]) -> Measurement | None:
    """Return the first measurement with status ok, else the first with a value."""
    return min(
        (m for m in measurements if m.value is not None),
        key=lambda m: m.status != "ok",
        default=None,
    )


def verdicts(result: Result) -> dict[str, int]:
    """Return the number of ok, suspect and refused measurements."""
    return {
        status: sum(m.status == status for m in result.measurements)
        for status in ("ok", "suspect", "refused")
    }


CONDITION_UNITS = {
    "exposure_s": ("Exposure", "s"),
    "mcp_v": ("MCP voltage", "V"),
    "luminous_gain": ("Luminous gain by calibration", "lm/lm"),
    "luminous_gain_relative_sd": ("Relative uncertainty of the luminous gain", "1"),
    "gate_ns": ("Gate", "ns"),
    "illuminance_lux": ("Illuminance on the photocathode", "lux"),
    "filter_density": ("Optical density of the filter", "1"),
    "lamp_a": ("Current through the lamp", "A"),
    "illuminance_relative_sd": ("Relative uncertainty of the illuminance", "1"),
    "photons_per_px": ("Photons per pixel", "1"),
    "camera_gain_db": ("Camera gain", "dB"),
    "metered_w": ("Light meter", "W"),
    "metered_lux": ("Illuminance by the light meter", "lux"),
    "temperature_c": ("Temperature", "°C"),
    "blackbody_c": ("Black body", "°C"),
    "focus_mm": ("Focus", "mm"),
    "background_c": ("Background", "°C"),
    "wavelength_nm": ("Wavelength", "nm"),
}


def stack_table(session: Session) -> dict[str, Any]:
    """Return columns and rows of the session's stacks, for conditions known in at least one
    stack.
    """
    known = [
        name
        for name in CONDITION_UNITS
        if any(getattr(s.conditions, name) is not None for s in session.stacks)
    ]
    rows = [
        {
            "label": entry.label,
            "kind": entry.kind,
            "target": _target_text(entry.target),
            "conditions": [_condition(entry.conditions, entry.asked, name) for name in known],
        }
        for entry in session.stacks
    ]
    return {"columns": [CONDITION_UNITS[name] for name in known], "rows": rows}


def _target_text(target: Target) -> str:
    parts = {
        "bars": "{} bars",
        "frequency_cy_per_px": "{} cy/px",
        "angle_deg": "{} °",
        "pinhole_px": "{} px pinhole",
        "contrast": "contrast {}",
    }
    known = [
        (text, getattr(target, name))
        for name, text in parts.items()
        if getattr(target, name) is not None
    ]
    return "; ".join(text.format(short_text(value)) for text, value in known) or "—"


def _condition(got: Conditions, set_points: Conditions | None, name: str) -> str:
    """Return the read-back of a condition, and the set-point if it differs."""
    value, wanted = getattr(got, name), None if set_points is None else getattr(set_points, name)
    text = short_text(value)
    return text if wanted is None or wanted == value else f"{text} (requested {short_text(wanted)})"


def sensor_rows(sensor: Camera) -> list[dict[str, str]]:
    """Return every sensor parameter with 95 % bounds, basis and source."""
    rows = []
    for path, p in sensor.parameters().items():
        stage, _, name = path.partition(".")
        spread, bounds = None, "exact"
        if p.low is not None and p.high is not None:
            spread = (p.high - p.low) / 4
            bounds = f"{round_to_spread(p.low, spread)} … {round_to_spread(p.high, spread)}"
        rows.append(
            {
                "stage": stage.replace("_", " "),
                "name": name.replace("_", " "),
                "value": round_to_spread(p.value, spread),
                "bounds": bounds,
                "standing": p.standing,
                "source": p.source,
            }
        )
    return rows


def sensor_facts(sensor: Camera) -> list[tuple[str, str]]:
    """Return the sensor attributes other than parameters: materials, size and video."""
    facts = []
    for stage in fields(sensor):
        part = getattr(sensor, stage.name)
        for item in (
            fields(part) if hasattr(part, "__dataclass_fields__") and stage.name != "draws" else ()
        ):
            value = getattr(part, item.name)
            if isinstance(value, (str, int, bool)):
                facts.append((f"{stage.name} {item.name}".replace("_", " "), short_text(value)))
    return facts


def chart_rows(result: Result) -> list[dict[str, str]]:
    """Return the chart rows of `auto`: measured error and time of every method for each quantity of
    the result.
    """
    used_methods = {m.method for m in result.measurements}
    quantities = dict.fromkeys(m.quantity for m in result.measurements)
    return [
        {
            "quantity": quantity,
            "method": row["method"],
            "used": "yes" if row["method"] in used_methods else "no",
            "error": f"{row['error_percent']:.2g} %",
            "seconds": time_text(row["seconds"]),
            "cases": short_text(row.get("cases")),
            "silent": short_text(row.get("silent")),
        }
        for quantity in quantities
        for row in chart_table(quantity)
    ]


def provenance(measurements: Iterable[Measurement]) -> dict[str, Any]:
    """Return versions, seeds, settings and SHA-256 of inputs recorded in the measurements."""
    records = [(m.method, m.provenance) for m in measurements if m.provenance is not None]
    settings: dict[str, dict[str, str]] = {}
    for method, record in records:
        settings.setdefault(method, {}).update(
            {key: short_text(value) for key, value in record.settings.items()}
        )
    inputs = {path: digest for _, record in records for path, digest in record.inputs.items()}
    seeds = sorted({record.seed for _, record in records if record.seed is not None})
    return {
        "versions": [
            ("charact", __version__),
            ("Python", platform.python_version()),
            *((name, _installed(name)) for name in LIBRARIES),
        ],
        "measured_by": sorted({record.version for _, record in records}),
        "seeds": ", ".join(str(seed) for seed in seeds) or "none recorded",
        "settings": settings,
        "inputs": inputs,
        "command": shlex.join(sys.argv),
        "platform": f"{platform.system()} {platform.machine()}",
    }


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
