"""Characterize image-intensified cameras: measurements with posteriors, validation against
simulation, reports.

import charact

result = charact.mtf("edge.tif", quick=True)  # an array, a file or a stack
print(result)  # result.mtf50.value, .interval95, .status; result.plot()
for measurement in charact.measure("day1").find("mtf50"):
    print(measurement.value, measurement.interval95, measurement.status)
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use
from labdata.numba_cache import keep_loops
from labdata.quantity import QUANTITIES

__version__ = "0.1.0"

keep_loops()


def _declare_quantities() -> None:
    import charact.observables  # noqa: F401


QUANTITIES.declare_more = _declare_quantities

if TYPE_CHECKING:
    from charact.api.analysis import Analysis
    from charact.api.deciding import check, compare
    from charact.api.exposing import expose
    from charact.api.fusing import fuse, fusion_colours, fusion_scores
    from charact.api.inputs import frames_of, session, stack
    from charact.api.measuring import bloom, measure, mtf, noise
    from charact.api.modelling import fit, report, simulate, validate
    from labdata.errors import BadInput

__all__ = [
    "Analysis",
    "BadInput",
    "bloom",
    "check",
    "compare",
    "expose",
    "fit",
    "frames_of",
    "fuse",
    "fusion_colours",
    "fusion_scores",
    "measure",
    "mtf",
    "noise",
    "report",
    "session",
    "simulate",
    "stack",
    "validate",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.api.analysis": "Analysis",
        "charact.api.deciding": "check compare",
        "charact.api.exposing": "expose",
        "charact.api.fusing": "fuse fusion_colours fusion_scores",
        "charact.api.inputs": "frames_of session stack",
        "charact.api.measuring": "bloom measure mtf noise",
        "charact.api.modelling": "fit report simulate validate",
        "labdata.errors": "BadInput",
    },
)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
