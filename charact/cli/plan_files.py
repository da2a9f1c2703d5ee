"""Plans by path or by the name of a shipped one, each with its sensor found beside it."""

import os
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from labdata.errors import BadInput
from labdata.plan import Plan
from labdata.serialiser import from_mapping, from_toml, read_toml


def builtin_plan_names() -> tuple[str, ...]:
    """Names of the plans that come with the package."""
    files = (resources.files("charact.cli") / "plans").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_plan(path: Path) -> Plan:
    """Read a plan from a file, or a shipped one by its name; sensor and calibrations are found beside it.

    Raises
    ------
    BadInput
        If there is no such plan or it breaks a rule.
    """
    if str(path) in builtin_plan_names():
        with resources.as_file(resources.files("charact.cli") / "plans" / f"{path}.toml") as shipped:
            return from_toml(shipped, Plan)
    if not os.path.exists(path):
        raise BadInput(f"a plan must be a file or one of {', '.join(builtin_plan_names())}, got {path}")
    plan = from_mapping(_with_calibration_paths(path), Plan, where=path.name)
    beside = path.parent / (plan.sensor or "")
    return replace(plan, sensor=str(beside.resolve())) if plan.sensor is not None and os.path.isfile(beside) else plan


def _with_calibration_paths(path: Path) -> dict[str, Any]:
    """Read a plan's file; the files of its calibrations, where it names any, are meant relative to the plan."""
    written = read_toml(path)
    named = {key: name for key in ("gain_table", "lamp") if isinstance(name := written.get(key), str)}
    return {**written, **{key: str(path.parent / name) for key, name in named.items()}}
