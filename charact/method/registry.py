"""Registered methods, and `auto`: the fastest method whose measured error meets the tolerance."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module, resources
from importlib.metadata import entry_points
from socket import create_connection
from typing import TYPE_CHECKING, Any

from charact.method.descriptions import DESCRIPTIONS
from charact.method.stopwatch import with_timing
from labdata.errors import BadInput
from labdata.settings import Progress, ignore_progress

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

    from labdata import Camera, Measurement, Result

Spread = Callable[[Callable[..., Any], Sequence[Any]], Iterable[Any]]


@contextmanager
def parallel_map(scheduler: str | None, *, timeout_s: float = 10.0) -> Iterator[Spread]:
    """Yield a function that maps another function over parts of the work, results in order.

    `scheduler`: address of a Dask scheduler, such as "tcp://host:8786", whose workers see the
    session's files under the same paths; None: `map` in this process. Raises BadInput if Dask is
    not installed, no scheduler answers, or a worker dies.
    """
    if scheduler is None:
        yield map
        return
    try:
        from distributed import Client, KilledWorker
        from distributed.comm.addressing import get_address_host_port
    except ImportError:
        raise BadInput(
            "`scheduler` needs Dask (pip install 'charact[dask]'), which is not installed"
        ) from None
    try:
        # A client without a scheduler prints a traceback when it is garbage-collected, so the port
        # is tried first.
        create_connection(get_address_host_port(scheduler), timeout=timeout_s).close()
        client = Client(scheduler, timeout=timeout_s, set_as_default=False)
    except (OSError, OverflowError, ValueError, TimeoutError):
        raise BadInput(
            f"`scheduler` must be the address of a running Dask scheduler, got {scheduler!r}"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise BadInput(
                f"a Dask scheduler must have at least one worker, got none at {scheduler}"
            )
        try:
            yield lambda function, parts: _in_order(client.map(function, parts, pure=False))
        except KilledWorker as error:
            raise BadInput(
                f"Dask workers must survive their part of the work, got: {error}"
            ) from None


def _in_order(futures: list[Any]) -> Iterator[Any]:
    """Yield the results of futures, each released once its result has arrived."""
    while futures:
        yield futures.pop(0).result()


ENTRY_POINTS = "charact.methods"  # Group of entry points by which other packages add methods
MODULES: dict[str, dict[str, str]] = {
    kind: {name: method.module for name, method in methods.items()}
    for kind, methods in DESCRIPTIONS.items()
}


# By kind of target: the quantity in the accuracy chart of its methods, and the default of "auto"
# without a chart.
CHARTED: dict[str, tuple[str, str]] = {
    "edge": ("mtf50", "edge-forward"),
    "bars": ("mtf", "bars-forward"),
    "point": ("mtf50", "point-forward"),
    "post-gain": ("post_gain_mtf50", "noise-spectrum"),
    "flats": ("covariance_gain", "covariance-sum"),
    "bloom": ("halo_diameter", "series-forward"),
    "lit-edge": ("halo_diameter", "lit-edge"),
    "fusion": ("fusion_error", "noise-aware"),
}


def load(kind: str, name: str | None = None) -> None:
    """Import the modules that register the methods of a kind, or only the named method.

    A name that is not ours, and None, also load the entry points `charact.methods` of other
    packages, which name modules that call `register`; one that cannot be imported is BadInput.

    Examples
    --------
    >>> from charact.method import METHODS
    >>> load("edge", "edge-slanted")
    >>> ("edge", "edge-slanted") in METHODS
    True
    """
    for method, module in MODULES.get(kind, {}).items():
        if name in (None, method):
            import_module(module)
    if name in MODULES.get(kind, {}):
        return
    for point in entry_points(group=ENTRY_POINTS):
        try:
            point.load()
        except Exception as error:  # another package may raise anything
            raise BadInput(
                f"the method {point.name!r} must be importable, got {error!r} from {point.value}"
            ) from None


@contextmanager
def single_blas_thread() -> Iterator[None]:
    """Use one BLAS thread and restore the previous number afterwards.

    On two cores an edge takes twice as long on two threads as on one, and forty times as long when
    other work runs.
    """
    with _libraries(compiled="numba" in sys.modules).limit(limits=1):
        yield


@lru_cache(maxsize=2)
def _libraries(*, compiled: bool) -> "ThreadpoolController":
    """Return the BLAS libraries of this process: NumPy's, and SciPy's if compiled functions may
    call it.
    """
    if compiled:
        import scipy.linalg  # noqa: F401  # loads its own
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")


def meets(row: Mapping[str, Any], within_percent: float) -> bool:
    """Return whether a method's row in a chart meets a tolerance.

    The upper confidence limit of the 95th error percentile must meet it; older tables contain the
    percentile alone.
    """
    return row.get("error_limit_percent", row["error_percent"]) <= within_percent


def reach_percent(value: float, interval95: tuple[float, float]) -> float:
    """Return the longer arm of a 95 % interval relative to its value, percent."""
    return 100.0 * max(value - interval95[0], interval95[1] - value) / abs(value)


def beyond_note(measurement: "Measurement", within_percent: float) -> str | None:
    """Return the note on an interval wider than the tolerance; None if it is not wider."""
    if not measurement.value or measurement.interval95 is None:
        return None
    arm_percent = reach_percent(measurement.value, measurement.interval95)
    if arm_percent <= within_percent:
        return None
    return (
        f"95 % interval extends {arm_percent:.2g} % from the value, beyond the tolerance "
        f"`within_percent` {within_percent:g} %."
    )


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
        Camera description, for pixel pitches and priors; None if unknown.
    register
        Electron-multiplying register of a camera without a tube; None if absent or unknown.
    imager
        Description of an infrared imager; None if it is none or unknown.
    interlaced
        Whether each frame consists of two interlaced fields.
    linear
        Whether the response was measured to be linear, as by the signal transfer of an infrared
        camera.
    full_scale_dn
        Full scale, DN; None: determined from the data.
    amplifier
        Number (from 1, by rows) of the amplifier whose area alone is measured; None: the chip, and
        also each amplifier that its frames show.
    disc
        Diameter, px, and contrast of the disc whose detectability is computed.
    progress
        Called with a message and the completed fraction (0..1) during long work.
    spread
        Maps a function over parts of the work, as `map` does, in this process or on the workers of
        a cluster.
    """

    seed: int = 0
    quick: bool = False
    camera: "Camera | None" = None
    interlaced: bool = False
    linear: bool = False
    full_scale_dn: float | None = None
    amplifier: int | None = None
    disc: tuple[float, float] = (10.0, 0.1)
    progress: Progress = ignore_progress
    spread: Spread = map

    @property
    def pitch_ratio(self) -> float:
        """Row pitch over column pitch; 1 if the camera is unknown."""
        return 1.0 if self.camera is None else self.camera.pitch_ratio


@dataclass(frozen=True, kw_only=True)
class Method:
    """A registered estimator: kind of target, name on the command line, and range of validity.

    The accuracy chart shows the first of the measured quantities. The arguments of the function
    depend on the kind, see the package of that kind.
    """

    kind: str
    name: str
    quantities: tuple[str, ...]
    scope: str
    function: "Callable[..., Result]"


METHODS: dict[tuple[str, str], Method] = {}


def register(
    kind: str, name: str, *, quantities: tuple[str, ...] | None = None, scope: str | None = None
) -> Callable[[Any], Any]:
    """Register a function as a named method of a kind; it is timed and runs on one BLAS thread.

    `quantities`, `scope`: None for our methods, which `DESCRIPTIONS` describes.
    """
    if quantities is None or scope is None:
        _, quantities, scope = DESCRIPTIONS[kind][name]

    def enter(function: "Callable[..., Result]") -> "Callable[..., Result]":
        function = with_timing(function, single_blas_thread)
        METHODS[kind, name] = Method(
            kind=kind, name=name, quantities=quantities, scope=scope, function=function
        )
        return function

    return enter


def describe_methods() -> list[dict[str, Any]]:
    """Return kind, name, quantities and scope of all methods; ours are not imported for it."""
    load("")
    ours = [
        (kind, name, *description[1:])
        for kind, methods in DESCRIPTIONS.items()
        for name, description in methods.items()
    ]
    foreign = [
        (m.kind, m.name, m.quantities, m.scope)
        for m in METHODS.values()
        if m.name not in MODULES.get(m.kind, "")
    ]
    rows: list[dict[str, Any]] = [
        dict(zip(("kind", "name", "quantities", "scope"), row, strict=True))
        for row in (*ours, *foreign)
    ]
    return [row for kind in MODULES for row in rows if row["kind"] == kind]


def methods_of_kind(kind: str) -> dict[str, Method]:
    """Return the methods of a kind by name."""
    load(kind)
    names = dict.fromkeys((*MODULES.get(kind, ()), *(name for of, name in METHODS if of == kind)))
    return {name: METHODS[kind, name] for name in names}


TABLES = resources.files("charact.method") / "tables"


def charted_quantities() -> list[str]:
    """Return the quantities whose methods have a measured speed and accuracy table."""
    return sorted(file.name.removesuffix(".json") for file in TABLES.iterdir())


def chart_table(quantity: str) -> list[dict[str, Any]]:
    """Return the rows of the measured speed and accuracy table of a quantity; empty if there is
    none.
    """
    path = TABLES / f"{quantity}.json"
    return json.loads(path.read_text())["methods"] if path.is_file() else []


def choose(
    kind: str,
    name: str = "auto",
    *,
    within_percent: float = 2.0,
    among: Sequence[str] | None = None,
) -> Method:
    """Return the named method, or for "auto" the fastest one whose measured error meets the
    tolerance.

    Parameters
    ----------
    within_percent
        Tolerance on the relative error, percent: the 95th percentile over the chart's cases must be
        below it by its upper confidence limit. If no method meets it, the most accurate one is
        taken.
    among
        Names of methods from which "auto" chooses, the first of them without a chart; None: all.

    Raises
    ------
    BadInput
        If the name is not registered.
    """
    if name == "auto":
        name = automatic(kind, within_percent=within_percent, among=among)
    load(kind, name)
    if (kind, name) not in METHODS:
        raise BadInput(
            f"`method` must be auto or one of {', '.join(sorted(methods_of_kind(kind)))}, got "
            f"{name!r}"
        )
    return METHODS[kind, name]


def automatic(kind: str, *, within_percent: float = 2.0, among: Sequence[str] | None = None) -> str:
    """Return the name of the method that `choose` takes for "auto", without its module."""
    if kind not in MODULES:
        raise BadInput(
            f"the kind of target must be one of {', '.join(sorted(MODULES))}, got {kind!r}"
        )
    quantity, preferred = CHARTED[kind]
    names = among or {*MODULES[kind], *(method for of, method in METHODS if of == kind)}
    preferred = among[0] if among else preferred
    rows = [row for row in chart_table(quantity) if row["method"] in names]
    if not rows:
        return preferred
    accurate = [row for row in rows if meets(row, within_percent)]
    best = (
        min(accurate, key=lambda row: row["seconds"])
        if accurate
        else min(rows, key=lambda row: row["error_percent"])
    )
    return str(best["method"])
