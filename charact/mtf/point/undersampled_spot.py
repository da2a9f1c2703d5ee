"""Spots smaller than a pixel: where in its pixel such a spot lies and how wide it is look alike."""

from collections.abc import Iterable

from charact.mtf.point.findings import finding
from charact.mtf.point.source_window import Window
from labdata.measurement import Measurement

# MTF50, pixel included, from which on a spot is so: a Gaussian of 0.3 pixels has it, and it must lie beyond the 95 %
# interval. Cycles per sample.
MAX_MTF50 = 0.42


def flag_undersampled(found: Iterable[Measurement], window: Window) -> tuple[Measurement, ...]:
    """Return the numbers of a spot, `aliased` where its MTF50 may lie too near the sampling limit.

    Notes
    -----
    The place of the spot is taken to first order. A spot of 0.15 pixels lights one pixel wherever in it the spot
    lies, and MTF50 comes out 10 to 15 % low, at the corner of four 30 %.
    """
    numbers = tuple(found)
    step_px = {0.0: float(window.x[1] - window.x[0]), 90.0: float(window.y[1] - window.y[0])}
    sharp = any(
        one.quantity == "mtf50"
        and one.interval95 is not None
        and one.interval95[1] * step_px[one.orientation_deg or 0.0] > MAX_MTF50
        for one in numbers
    )
    if not sharp:
        return numbers
    effect = f"MTF50 may lie above {MAX_MTF50:g} cycles per sample, where it comes out 10 to 30 % low"
    return tuple(one.with_(findings=[finding("aliased", effect)]) for one in numbers)
