"""Characterize image-intensified cameras: measurements with posteriors, validation against
simulation, reports.

import charact

result = charact.mtf("edge.tif", quick=True)  # an array, a file or a stack
print(result)  # result.mtf50.value, .interval95, .status; result.plot()
for measurement in charact.measure("day1").find("mtf50"):
    print(measurement.value, measurement.interval95, measurement.status)
"""

from typing import TYPE_CHECKING, Any

from labdata.numba_cache import keep_loops

__version__ = "0.1.0"

keep_loops()

if TYPE_CHECKING:
    from charact.api import (
        Analysis,
        bloom,
        check,
        compare,
        fit,
        frames_of,
        measure,
        mtf,
        noise,
        report,
        session,
        simulate,
        stack,
        validate,
    )
    from charact.api.fusing import fuse, fusion_colours, fusion_scores
    from labdata.errors import BadInput

__all__ = [
    "Analysis",
    "BadInput",
    "bloom",
    "check",
    "compare",
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


def __getattr__(name: str) -> Any:
    """Import the analysis on first use, so that the command line starts fast."""
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module 'charact' has no attribute {name!r}")
    elsewhere = {"BadInput": "labdata.errors", "fuse": "charact.api.fusing"}
    elsewhere |= {"fusion_colours": "charact.api.fusing", "fusion_scores": "charact.api.fusing"}
    return getattr(import_module(elsewhere.get(name, "charact.api")), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
