"""Registered methods, and `auto`: the fastest method whose measured error meets the tolerance."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Any

from charact.method.catalogue import CHARTED, MODULES, load
from charact.method.cluster import Spread
from charact.method.stopwatch import with_timing
from charact.method.threads import with_single_blas_thread
from charact.method.tolerance import meets
from labdata.errors import BadInput
from labdata.measurement import Result
from labdata.sensor import Sensor
from labdata.solid_state import Register


def ignore_progress(sentence: str, share: float) -> None:
    """Discard a progress message."""


@dataclass(frozen=True, kw_only=True)
class Context:
    """Settings common to all methods.

    Parameters
    ----------
    seed
        Seed of every random step.
    quick
        No Markov chain: intervals from the Laplace approximation or importance sampling.
    sensor
        Sensor description, for pixel pitches and priors; None if unknown.
    register
        Electron-multiplying register of a camera without a tube; None if absent or unknown.
    interlaced
        Whether each frame consists of two interlaced fields.
    full_scale_dn
        Full scale, DN; None: determined from the data.
    progress
        Called with a message and the completed fraction (0..1) during long work.
    spread
        Maps a function over parts of the work, as `map` does, in this process or on the workers of a cluster.
    """

    seed: int = 0
    quick: bool = False
    sensor: Sensor | None = None
    register: Register | None = None
    interlaced: bool = False
    full_scale_dn: float | None = None
    progress: Callable[[str, float], None] = ignore_progress
    spread: Spread = map

    @property
    def pitch_ratio(self) -> float:
        """Row pitch over column pitch; 1 if the sensor is unknown."""
        if self.sensor is None:
            return 1.0
        return float(self.sensor.ccd.pitch_y_um) / float(self.sensor.ccd.pitch_x_um)


@dataclass(frozen=True, kw_only=True)
class Method:
    """A registered estimator.

    Parameters
    ----------
    kind
        Kind of target: "edge", "bars", "point", "flats", "post-gain" (flats, for the MTF), "bloom".
    name
        Name on the command line.
    quantities
        Measured quantities; the accuracy chart shows the first.
    scope
        One sentence on the range of validity.
    function
        The estimator. Its arguments depend on the kind, see the package of that kind.
    """

    kind: str
    name: str
    quantities: tuple[str, ...]
    scope: str
    function: Callable[..., Result]


METHODS: dict[tuple[str, str], Method] = {}


def register(kind: str, name: str, *, quantities: tuple[str, ...], scope: str) -> Callable[[Any], Any]:
    """Register a function as a named method of a kind; it is timed and runs on one BLAS thread."""

    def enter(function: Callable[..., Result]) -> Callable[..., Result]:
        function = with_single_blas_thread(with_timing(function))
        METHODS[kind, name] = Method(kind=kind, name=name, quantities=quantities, scope=scope, function=function)
        return function

    return enter


def methods_of_kind(kind: str) -> dict[str, Method]:
    """Return the methods of a kind by name."""
    load(kind)
    return {name: method for (of, name), method in METHODS.items() if of == kind}


def chart_table(quantity: str) -> list[dict[str, Any]]:
    """Return the rows of the measured speed and accuracy table of a quantity; empty if there is none."""
    path = resources.files("charact.method") / "tables" / f"{quantity}.json"
    return json.loads(path.read_text())["methods"] if path.is_file() else []


def choose(kind: str, name: str = "auto", *, within_percent: float = 2.0) -> Method:
    """Return the named method, or for "auto" the fastest one whose measured error meets the tolerance.

    Parameters
    ----------
    within_percent
        Tolerance on the relative error, percent: the 95th percentile over the chart's cases must be below it by its
        upper confidence limit. If no method meets it, the most accurate one is taken.

    Raises
    ------
    BadInput
        If the name is not registered.
    """
    if name != "auto":
        load(kind, name)
        if (kind, name) not in METHODS:
            raise BadInput(f"--method must be auto or one of {', '.join(sorted(methods_of_kind(kind)))}, got {name!r}")
        return METHODS[kind, name]
    if kind not in MODULES:
        raise BadInput(f"the kind of target must be one of {', '.join(sorted(MODULES))}, got {kind!r}")
    quantity, preferred = CHARTED[kind]
    names = {*MODULES[kind], *(method for of, method in METHODS if of == kind)}
    rows = [row for row in chart_table(quantity) if row["method"] in names]
    if not rows:
        return choose(kind, preferred)
    inside = [row for row in rows if meets(row, within_percent)]
    best = min(inside, key=lambda row: row["seconds"]) if inside else min(rows, key=lambda row: row["error_percent"])
    return choose(kind, best["method"])
