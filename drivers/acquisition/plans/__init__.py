"""Plans that ship, and plans read by file or by the name of a shipped one."""

import os
from dataclasses import replace
from importlib import resources
from pathlib import Path

from labdata import BadInput, Plan, plan_of, read_plan, read_toml


def builtin_plan_names() -> tuple[str, ...]:
    """Names of the shipped plans."""
    files = resources.files("drivers.acquisition.plans").iterdir()
    return tuple(
        sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))
    )


def load_plan(plan: str | Path | Plan) -> Plan:
    """Return a plan, or read it from a file, or a shipped one by name; paths in a file are relative
    to its folder.

    Raises
    ------
    BadInput
        If there is no such plan or it is invalid.
    """
    if isinstance(plan, Plan):
        return plan
    if str(plan) in builtin_plan_names():
        shipped = resources.files("drivers.acquisition.plans") / f"{plan}.toml"
        with resources.as_file(shipped) as file:
            return read_plan(file)
    path = Path(plan)
    if not os.path.exists(path):
        raise BadInput(
            f"a plan must be a file or one of {', '.join(builtin_plan_names())}, got {path}"
        )
    written = read_toml(path)
    files = {
        key: name for key in ("gain_table", "lamp") if isinstance(name := written.get(key), str)
    }
    placed = {**written, **{key: str(path.parent / name) for key, name in files.items()}}
    loaded = plan_of(placed, where=path.name)
    sensor = path.parent / (loaded.sensor or "")
    return (
        replace(loaded, sensor=str(sensor.resolve()))
        if loaded.sensor is not None and os.path.isfile(sensor)
        else loaded
    )
