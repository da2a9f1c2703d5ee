"""Tables of numbers that ship with a package: comma-separated, a comment on top that says whose they are."""

from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from labdata.frames import read_only


@cache
def table(package: str, name: str) -> dict[str, NDArray[np.float64]]:
    """Return the columns of `tables/name.csv` of a package by their headings."""
    text = (resources.files(package) / "tables" / f"{name}.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    return {heading: read_only(column) for heading, column in zip(lines[0].split(","), values.T, strict=True)}
