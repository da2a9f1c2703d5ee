"""Plans by path or by the name of a shipped one, each with its sensor found beside it."""

import os
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from labdata.border import from_mapping, from_toml, read_toml
from labdata.errors import BadInput
from labdata.plan import Plan


def shipped_plans() -> tuple[str, ...]:
    """Names of the plans that come with the package."""
    files = (resources.files("charact.cli") / "plans").iterdir()
    return tuple(sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml")))


def load_plan(path: Path) -> Plan:
    """Read a plan from a file, or a shipped one by its name; a sensor file or gain table is found beside it.

    Raises
    ------
    BadInput
        If there is no such plan or it breaks a rule.
    """
    if str(path) in shipped_plans():
        with resources.as_file(resources.files("charact.cli") / "plans" / f"{path}.toml") as shipped:
            return from_toml(shipped, Plan)
    if not os.path.exists(path):
        raise BadInput(f"a plan must be a file or one of {', '.join(shipped_plans())}, got {path}")
    plan = from_mapping(_gain_table_beside(path), Plan, where=path.name)
    beside = path.parent / (plan.sensor or "")
    return replace(plan, sensor=str(beside.resolve())) if plan.sensor is not None and os.path.isfile(beside) else plan


def _gain_table_beside(path: Path) -> dict[str, Any]:
    """Read a plan's file; the file of its gain table, where it names one, is meant relative to the plan."""
    written = read_toml(path)
    named = written.get("gain_table")
    return {**written, "gain_table": str(path.parent / named)} if isinstance(named, str) else written
