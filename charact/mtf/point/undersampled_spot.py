"""Spots smaller than a pixel: where in its pixel such a spot lies and how wide it is look alike."""

from collections.abc import Iterable

from charact.mtf.point.findings import finding
from charact.mtf.point.source_window import Window
from labdata.measurement import Measurement

# MTF50, pixel included, from which on a spot is so: a Gaussian of 0.3 pixels has it, and it must lie beyond the 95 %
# interval. Cycles per sample.
MAX_MTF50 = 0.42


def flag_undersampled(found: Iterable[Measurement], window: Window) -> tuple[Measurement, ...]:
    """Flag measurements of a spot as `aliased` where MTF50 may be too close to the sampling limit.

    Notes
    -----
    The position of the spot is fitted to first order. A spot of 0.15 px illuminates one pixel wherever it lies in it:
    MTF50 is 10 to 15 % low, and 30 % at the corner of four pixels.
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
