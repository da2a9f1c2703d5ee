"""The quantities that have a study: the kinds of target that give each, and where their cases come from."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass

from charact.method import Method
from charact.method.registry import methods_of_kind
from charact.study.bars import cases as bar_cases
from charact.study.bloom import cases as bloom_cases
from charact.study.edge import cases as edge_cases
from charact.study.flats import flat_cases as flats
from charact.study.flats import noise_spectrum_cases, white_flats
from charact.study.harness import Case
from charact.study.point import cases as point_cases
from labdata.errors import BadInput


@dataclass(frozen=True, kw_only=True)
class Study:
    """Where the cases of a quantity and a kind of target come from.

    `kind`, `package`: kind of the methods, and the package that registers them; `axes`: the axes along which the
    methods break; `chart_cases`, `stability_cases`: functions of (seed, count) and of (seed, repeats, axes) that return
    cases; `chart_count`, `quick_count`, `repeats`: how many cases a chart holds, how many a first look, and how many
    draws a position of the stability map.
    """

    kind: str
    package: str
    axes: tuple[str, ...]
    chart_cases: Callable[[int, int], tuple[Case, ...]]
    stability_cases: Callable[..., tuple[Case, ...]]
    chart_count: int
    quick_count: int
    repeats: int


# A table holds a quantity's methods of every kind: `auto` compares those of one kind with each other.
EDGE = Study(
    kind="edge",
    package="charact.mtf",
    axes=tuple(edge_cases.AXES),
    chart_cases=edge_cases.chart_cases,
    stability_cases=edge_cases.stability_cases,
    chart_count=100,
    quick_count=6,
    repeats=2,
)
POINT = Study(
    kind="point",
    package="charact.mtf",
    axes=tuple(point_cases.AXES),
    chart_cases=point_cases.chart_cases,
    stability_cases=point_cases.stability_cases,
    chart_count=200,
    quick_count=4,
    repeats=2,
)
BARS = Study(
    kind="bars",
    package="charact.mtf",
    axes=tuple(bar_cases.AXES),
    chart_cases=bar_cases.chart_cases,
    stability_cases=bar_cases.stability_cases,
    chart_count=100,
    quick_count=6,
    repeats=2,
)
FLATS = Study(
    kind="flats",
    package="charact.noise",
    axes=tuple(flats.AXES),
    chart_cases=flats.chart_cases,
    stability_cases=flats.stability_cases,
    chart_count=24,
    quick_count=2,
    repeats=1,
)
WHITE_FLATS = Study(
    kind="flats",
    package="charact.noise",
    axes=tuple(white_flats.AXES),
    chart_cases=white_flats.chart_cases,
    stability_cases=white_flats.stability_cases,
    chart_count=8,
    quick_count=2,
    repeats=1,
)
NOISE_SPECTRUM = Study(
    kind="post-gain",
    package="charact.mtf",
    axes=tuple(noise_spectrum_cases.AXES),
    chart_cases=noise_spectrum_cases.chart_cases,
    stability_cases=noise_spectrum_cases.stability_cases,
    chart_count=40,
    quick_count=4,
    repeats=2,
)
BLOOM = Study(
    kind="bloom",
    package="charact.bloom",
    axes=tuple(bloom_cases.AXES),
    chart_cases=bloom_cases.chart_cases,
    stability_cases=bloom_cases.stability_cases,
    chart_count=40,
    quick_count=3,
    repeats=2,
)

STUDIES: dict[str, tuple[Study, ...]] = {
    "mtf50": (EDGE, POINT),
    "mtf": (BARS,),
    "covariance_gain": (FLATS,),
    "system_gain": (WHITE_FLATS,),
    "post_gain_mtf50": (NOISE_SPECTRUM,),
    "halo_diameter": (BLOOM,),
}


def studies_of(quantity: str) -> tuple[Study, ...]:
    """The studies of a quantity, one for each kind of target; a quantity without one is a BadInput."""
    if quantity not in STUDIES:
        raise BadInput(f"a study must be of one of {', '.join(STUDIES)}, got {quantity!r}")
    return STUDIES[quantity]


def methods_of(quantity: str) -> tuple[Method, ...]:
    """All registered methods that measure a quantity and have a study of their kind, kind by kind."""
    studies = studies_of(quantity)
    for study in studies:
        importlib.import_module(study.package)
    return tuple(
        method for study in studies for method in methods_of_kind(study.kind).values() if quantity in method.quantities
    )
