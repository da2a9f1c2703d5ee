"""The quantities that have a study: the kinds of target that give each, and where their cases come
from.
"""

from argparse import ArgumentParser
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from charact.method import Method
from charact.method.registry import methods_of_kind
from labdata import BadInput
from tests.truth.cases import (
    bars,
    bloom,
    covariance_gain,
    edge,
    fusion,
    noise_spectrum,
    point,
    system_gain,
)
from tests.truth.cases.case import Case


@dataclass(frozen=True, kw_only=True)
class Study:
    """Where the cases of a quantity and a kind of target come from.

    `kind`: kind of the methods; `axes`: the axes along which the methods break; `chart_cases`,
    `stability_cases`: functions of (seed, count) and of (seed, repeats, axes) that return cases;
    `chart_count`, `quick_count`, `repeats`: number of cases of a chart, of a first look, and of
    draws at a position of the stability map.
    """

    kind: str
    axes: tuple[str, ...]
    chart_cases: Callable[[int, int], tuple[Case, ...]]
    stability_cases: Callable[..., tuple[Case, ...]]
    chart_count: int
    quick_count: int
    repeats: int


def _study(kind: str, cases: ModuleType, chart_count: int, quick_count: int, repeats: int) -> Study:
    return Study(
        kind=kind,
        axes=tuple(cases.AXES),
        chart_cases=cases.chart_cases,
        stability_cases=cases.stability_cases,
        chart_count=chart_count,
        quick_count=quick_count,
        repeats=repeats,
    )


POINT = _study("point", point, 200, 4, 2)
# A table holds a quantity's methods of every kind: `auto` compares those of one kind with each
# other.
STUDIES: dict[str, tuple[Study, ...]] = {
    "mtf50": (_study("edge", edge, 100, 6, 2), POINT),
    "mtf": (_study("bars", bars, 100, 6, 2),),
    "covariance_gain": (_study("flats", covariance_gain, 24, 2, 1),),
    "system_gain": (_study("flats", system_gain, 8, 2, 1),),
    "post_gain_mtf50": (_study("post-gain", noise_spectrum, 40, 4, 2),),
    "fusion_error": (_study("fusion", fusion, 40, 4, 2),),
    "halo_diameter": (_study("bloom", bloom, 40, 3, 2),),
}


def studies_of(quantity: str) -> tuple[Study, ...]:
    """The studies of a quantity, one for each kind of target; a quantity without one is a
    BadInput.
    """
    if quantity not in STUDIES:
        raise BadInput(
            f"QUANTITY of a study must be one of {', '.join(STUDIES)}, got "
            f"{quantity or 'none'}: give one, as QUANTITY=mtf50 to make study"
        )
    return STUDIES[quantity]


def methods_of(quantity: str) -> tuple[Method, ...]:
    """All registered methods that measure a quantity and have a study of their kind, kind by
    kind.
    """
    studies = studies_of(quantity)
    return tuple(
        method
        for study in studies
        for method in methods_of_kind(study.kind).values()
        if quantity in method.quantities
    )


def argument_parser(name: str, description: str) -> ArgumentParser:
    """Return a parser of what the studies of a quantity are given on the command line."""
    parser = ArgumentParser(
        prog=f"python -m benchmarks.studies run {name}", description=description
    )
    parser.add_argument("quantity", nargs="?", default="", help=", ".join(STUDIES))
    parser.add_argument(
        "--out", type=Path, default=Path("study"), help="folder of table and figure"
    )
    parser.add_argument("--quick", action="store_true", help="fewer cases, no Markov chains")
    parser.add_argument("--seed", type=int, default=0, help="seed of the cases")
    return parser
