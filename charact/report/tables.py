"""Tables of a report: quantities, EMVA 1288 summary, stacks, sensor parameters, provenance."""

import platform
import shlex
import sys
from collections.abc import Iterable
from dataclasses import dataclass, fields
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from charact import __version__
from charact.method.registry import chart_table
from charact.method.stopwatch import time_text
from charact.report.number_format import (
    interval_text,
    plus_minus,
    quantity_title,
    round_to_spread,
    short_text,
    value_text,
)
from labdata.camera_description import Parameter
from labdata.conditions import Conditions
from labdata.flags import FLAGS
from labdata.measurement import Measurement, Result
from labdata.quantity import QUANTITIES
from labdata.sensor import Sensor
from labdata.session import Session

LIBRARIES = ("numpy", "scipy", "emcee", "matplotlib", "zarr", "trimesh", "embreex")
HEADLINES = (
    "mtf50", "covariance_gain", "system_gain", "blur_factor", "excess_noise_factor", "ebi", "read_noise",
    "halo_diameter",
)  # fmt: skip

# A method with more stacks than this has one table for all of them.
SERIES = 4


@dataclass(frozen=True, kw_only=True)
class QuantityRow:
    """One measurement of the table of quantities."""

    title: str
    name: str
    value: str
    plus_minus: str
    interval68: str
    interval95: str
    unit: str
    status: str
    where: str
    flags: tuple[str, ...]
    reason: str | None
    stack: str


@dataclass(frozen=True, kw_only=True)
class QuantityGroup:
    """Measurements of one method in one stack.

    Parameters
    ----------
    title
        Stack, method, and the time, direction and region common to all rows.
    rows
        The measurements.
    flags
        Each flag with its sentence and the quantities and stacks it concerns ("" if all).
    notes
        Each note with the quantities and stacks it concerns.
    """

    title: str
    rows: tuple[QuantityRow, ...]
    flags: tuple[tuple[str, str, str], ...]
    notes: tuple[tuple[str, str], ...]


def quantity_row(m: Measurement, where: str = "") -> QuantityRow:
    """Return the row of a measurement; `where`: direction, region and time."""
    return QuantityRow(
        title=quantity_title(m),
        name=m.quantity,
        value=value_text(m),
        plus_minus=plus_minus(m),
        interval68=interval_text(m, m.interval68),
        interval95=interval_text(m, m.interval95),
        unit=m.unit,
        status=m.status,
        where=where,
        flags=m.flags,
        reason=m.reason,
        stack=m.stack or "",
    )


def places(m: Measurement) -> dict[str, str]:
    """Return stack, direction, region and time of a measurement as text."""
    found = {"stack": m.stack} if m.stack else {}
    if m.orientation_deg is not None:
        found["direction"] = f"{m.orientation_deg:.4g}° to the rows"
    if m.region is not None:
        row, col, height, width = m.region
        found["region"] = f"rows {row}–{row + height - 1}, cols {col}–{col + width - 1}"
    if m.seconds is not None:
        found["time"] = time_text(m.seconds)
    return found


def quantity_groups(result: Result) -> tuple[QuantityGroup, ...]:
    """Return all measurements by stack and method in the order of the vocabulary; a series of stacks is one group."""
    order = list(QUANTITIES)
    stacks: dict[str, set[str]] = {}
    for m in result.measurements:
        stacks.setdefault(m.method, set()).add(m.stack or "whole session")
    groups: dict[tuple[str, str], list[Measurement]] = {}
    for m in sorted(result.measurements, key=lambda m: order.index(m.quantity)):
        many = len(stacks[m.method]) > SERIES
        stack = f"{len(stacks[m.method])} stacks" if many else m.stack or "whole session"
        groups.setdefault((stack, m.method), []).append(m)
    return tuple(_group(stack, method, own) for (stack, method), own in groups.items())


def _group(stack: str, method: str, own: list[Measurement]) -> QuantityGroup:
    """Return a group with the attributes common to all rows in its title."""
    where = [places(m) for m in own]
    common = {key: text for key, text in where[0].items() if all(at.get(key) == text for at in where)}
    rest = ["; ".join(text for key, text in at.items() if key not in common) for at in where]
    flags = dict.fromkeys(flag for m in own for flag in m.flags)
    notes = dict.fromkeys(note for m in own for note in m.notes)
    return QuantityGroup(
        title=" · ".join((stack, method, *(text for key, text in common.items() if key != "stack"))),
        rows=tuple(quantity_row(m, text) for m, text in zip(own, rest, strict=True)),
        flags=tuple((flag, FLAGS[flag], _scope_text(own, [m for m in own if flag in m.flags])) for flag in flags),
        notes=tuple((note, _scope_text(own, [m for m in own if note in m.notes])) for note in notes),
    )


def _scope_text(own: list[Measurement], those: list[Measurement]) -> str:
    """Return the quantities and stacks of some measurements; "" if these are all with a value."""
    if len(those) >= sum(m.value is not None for m in own) > 1:
        return ""
    quantities = ", ".join(dict.fromkeys(m.quantity for m in those))
    stacks = list(dict.fromkeys(m.stack or "whole session" for m in those))
    if len(stacks) == len({m.stack for m in own}):
        return quantities
    more = f" and {len(stacks) - SERIES} more" if len(stacks) > SERIES else ""
    return f"{quantities} of {', '.join(stacks[:SERIES])}{more}"


def headlines(result: Result) -> tuple[QuantityRow, ...]:
    """Return the first measurement with status ok, else the first with a value, of each headline quantity."""
    chosen = []
    for quantity in HEADLINES:
        found = [m for m in result.find(quantity) if m.value is not None]
        if found:
            chosen.append(quantity_row(min(found, key=lambda m: m.status != "ok")))
    return tuple(chosen)


def verdicts(result: Result) -> dict[str, int]:
    """Return the number of ok, suspect and refused measurements."""
    return {status: sum(m.status == status for m in result.measurements) for status in ("ok", "suspect", "refused")}


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
    "wavelength_nm": ("Wavelength", "nm"),
}


def stack_table(session: Session) -> dict[str, Any]:
    """Return columns and rows of the session's stacks, for conditions known in at least one stack."""
    known = [name for name in CONDITION_UNITS if any(getattr(s.conditions, name) is not None for s in session.stacks)]
    rows = [
        {
            "label": entry.label,
            "kind": entry.kind,
            "target": "; ".join(_target_parts(entry.target)) or "—",
            "conditions": [_condition(entry.conditions, entry.asked, name) for name in known],
        }
        for entry in session.stacks
    ]
    return {"columns": [CONDITION_UNITS[name] for name in known], "rows": rows}


def _target_parts(target: Any) -> list[str]:
    units = {"bars": "bars", "frequency_cy_per_px": "cy/px", "angle_deg": "°", "pinhole_px": "px pinhole"}
    parts = [
        f"{short_text(getattr(target, name))} {unit}"
        for name, unit in units.items()
        if getattr(target, name) is not None
    ]
    return parts if target.contrast is None else [*parts, f"contrast {short_text(target.contrast)}"]


def _condition(got: Conditions, set_points: Conditions | None, name: str) -> str:
    """Return the read-back of a condition, and the set-point if it differs."""
    value, wanted = getattr(got, name), None if set_points is None else getattr(set_points, name)
    text = short_text(value)
    return text if wanted is None or wanted == value else f"{text} (requested {short_text(wanted)})"


def sensor_rows(sensor: Sensor) -> list[dict[str, str]]:
    """Return every sensor parameter with 95 % bounds, basis and source."""
    return [_parameter_row(path, parameter) for path, parameter in sensor.parameters().items()]


def _parameter_row(path: str, p: Parameter) -> dict[str, str]:
    spread = None if p.low is None or p.high is None else (p.high - p.low) / 4
    bounds = (
        "exact"
        if p.low is None or p.high is None
        else f"{round_to_spread(p.low, spread)} … {round_to_spread(p.high, spread)}"
    )
    stage, _, name = path.partition(".")
    return {
        "stage": stage.replace("_", " "),
        "name": name.replace("_", " "),
        "value": round_to_spread(p.value, spread),
        "bounds": bounds,
        "standing": p.standing,
        "source": p.source,
    }


def sensor_facts(sensor: Sensor) -> list[tuple[str, str]]:
    """Return the sensor attributes other than parameters: materials, size and video."""
    facts = []
    for stage in fields(sensor):
        part = getattr(sensor, stage.name)
        for item in fields(part) if hasattr(part, "__dataclass_fields__") and stage.name != "draws" else ():
            value = getattr(part, item.name)
            if isinstance(value, (str, int, bool)):
                facts.append((f"{stage.name} {item.name}".replace("_", " "), short_text(value)))
    return facts


def chart_rows(result: Result) -> list[dict[str, str]]:
    """Return the chart rows of `auto`: measured error and time of every method for each quantity of the result."""
    used = {m.method for m in result.measurements}
    quantities = dict.fromkeys(m.quantity for m in result.measurements)
    return [
        {
            "quantity": quantity,
            "method": row["method"],
            "used": "yes" if row["method"] in used else "no",
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
    kept = [(m.method, m.provenance) for m in measurements if m.provenance is not None]
    settings: dict[str, dict[str, str]] = {}
    for method, record in kept:
        settings.setdefault(method, {}).update({key: short_text(value) for key, value in record.settings.items()})
    inputs = {path: digest for _, record in kept for path, digest in record.inputs.items()}
    seeds = sorted({record.seed for _, record in kept if record.seed is not None})
    return {
        "versions": [("charact", __version__), ("Python", platform.python_version()), *_libraries()],
        "measured_by": sorted({record.version for _, record in kept}),
        "seeds": ", ".join(str(seed) for seed in seeds) or "none recorded",
        "settings": settings,
        "inputs": inputs,
        "command": shlex.join(sys.argv),
        "platform": f"{platform.system()} {platform.machine()}",
    }


def _libraries() -> list[tuple[str, str]]:
    """Return the installed versions of the libraries that affect results."""
    found = []
    for name in LIBRARIES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            found.append((name, "not installed"))
    return found


# Quantity, unit, name and symbol of EMVA 1288, and the section of its Release 3.1 that defines it.
NAMES = (
    ("quantum_efficiency", "%", "Quantum efficiency η", "2.1"),
    ("system_gain", "DN/e-", "Overall system gain K", "2.2"),
    ("read_noise", "e-", "Temporal dark noise σ_d", "2.2"),
    ("read_noise", "DN", "Temporal dark noise σ_y.dark", "2.2"),
    ("snr_max", "1", "Largest signal-to-noise ratio SNR_max", "2.3"),
    ("saturation_capacity", "e-", "Saturation capacity μ_e.sat", "2.4"),
    ("dynamic_range", "1", "Dynamic range DR", "2.4"),
    ("linearity_error", "%", "Linearity error LE", "6.7"),
    ("dark_current", "e-/s", "Dark current μ_I.mean", "3.1"),
    ("dark_doubling_temperature", "K", "Doubling temperature T_d", "3.2"),
    ("dsnu", "e-", "Dark signal non-uniformity DSNU_1288", "4.1"),
    ("prnu", "%", "Photoresponse non-uniformity PRNU_1288", "4.1"),
    ("defect_pixels", "px", "Defect pixels, by the rule in the notes", "4.3"),
)


@dataclass(frozen=True, kw_only=True)
class EmvaSummary:
    """Quantities of EMVA 1288, or the reason why it does not apply.

    Parameters
    ----------
    rows
        Name in the standard, section, and measurement.
    left_out
        Names of quantities not measured.
    reason
        Why the standard does not apply; "" if it does.
    """

    rows: tuple[tuple[str, str, QuantityRow], ...] = ()
    left_out: tuple[str, ...] = ()
    reason: str = ""


def emva_summary(result: Result) -> EmvaSummary | None:
    """Return the EMVA 1288 summary; None for a result without gain.

    The standard assumes white noise. With correlated noise, as of an intensifier, the variance does not count
    electrons, and no quantity is given.
    """
    gains = (*result.find("system_gain"), *result.find("covariance_gain"))
    if not any(m.value is not None for m in gains):
        return None
    white = [m for m in result.find("system_gain") if m.value is not None and "correlated-noise" not in m.flags]
    if not white:
        return EmvaSummary(
            reason="EMVA 1288 assumes white noise; the noise of this camera is correlated between pixels (as of an "
            "intensifier). The photon transfer curve would give a gain too low by the blur factor, and wrong values in "
            "electrons. Use the covariance gain above."
        )
    rows, left_out = [], []
    for quantity, unit, name, section in NAMES:
        found = _best(result.find(quantity, unit=unit))
        if found is None:
            left_out.append(name)
        else:
            rows.append((name, section, quantity_row(found, found.stack or "")))
    return EmvaSummary(rows=tuple(rows), left_out=tuple(left_out))


def _best(found: tuple[Measurement, ...]) -> Measurement | None:
    """Return the first measurement with status ok, else the first with a value."""
    known = [m for m in found if m.value is not None]
    return next((m for m in known if m.status == "ok"), known[0] if known else None)
