"""The quantities that have a study: the kind of method that measures each, and where its cases come from."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

from charact.method import Method
from charact.method.registry import of_kind
from charact.study import edge_cases, flats, white_flats
from charact.study.harness import Case
from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Study:
    """Where the cases of a quantity come from.

    Parameters
    ----------
    kind, package
        Kind of the methods, and the package that registers them.
    axes
        The axes along which the methods break.
    chart_cases, stability_cases
        Functions of (seed, count) and of (seed, repeats, axes) that return cases.
    chart_count, quick_count, repeats
        How many cases a chart holds, how many a first look, and how many draws a position of the stability map.
    """

    kind: str
    package: str
    axes: tuple[str, ...]
    chart_cases: Callable[[int, int], tuple[Case, ...]]
    stability_cases: Callable[..., tuple[Case, ...]]
    chart_count: int
    quick_count: int
    repeats: int


STUDIES = {
    "mtf50": Study(
        kind="edge",
        package="charact.mtf",
        axes=tuple(edge_cases.AXES),
        chart_cases=edge_cases.chart_cases,
        stability_cases=edge_cases.stability_cases,
        chart_count=40,
        quick_count=6,
        repeats=2,
    ),
    "covariance_gain": Study(
        kind="flats",
        package="charact.noise",
        axes=tuple(flats.AXES),
        chart_cases=flats.chart_cases,
        stability_cases=flats.stability_cases,
        chart_count=8,
        quick_count=2,
        repeats=1,
    ),
    "system_gain": Study(
        kind="flats",
        package="charact.noise",
        axes=tuple(white_flats.AXES),
        chart_cases=white_flats.chart_cases,
        stability_cases=white_flats.stability_cases,
        chart_count=8,
        quick_count=2,
        repeats=1,
    ),
}


def methods_of(quantity: str) -> tuple[Method, ...]:
    """All registered methods that measure a quantity; one without a study is a BadInput."""
    if quantity not in STUDIES:
        raise BadInput(f"a study must be of one of {', '.join(STUDIES)}, got {quantity!r}")
    importlib.import_module(STUDIES[quantity].package)
    return tuple(method for method in of_kind(STUDIES[quantity].kind).values() if quantity in method.quantities)
