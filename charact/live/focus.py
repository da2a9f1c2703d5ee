"""Focus: the MTF50 of an edge in the newest frames, and the best so far, which noise alone cannot push upwards."""

from dataclasses import dataclass

from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.mean_frame import Region
from labdata.frames import FrameStack
from labdata.measurement import Interval

# In 0.04 s on a window of this size; the fits that tell more take ten times as long.
METHOD = "edge-gradient"
WINDOW_PX = 220


@dataclass(frozen=True, kw_only=True)
class Focus:
    """One reading of the focus.

    Parameters
    ----------
    mtf50_cy_per_px, interval95
        MTF50 across the edge with its 95 % interval, cy/px; None where there is none.
    orientation_deg
        Direction of the edge's normal, degrees.
    region
        ROW, COL, HEIGHT, WIDTH that was measured, px.
    flags
        What is to be distrusted.
    reason
        Why there is no number.
    seconds
        Time that it took, s.
    """

    mtf50_cy_per_px: float | None = None
    interval95: Interval | None = None
    orientation_deg: float | None = None
    region: Region | None = None
    flags: tuple[str, ...] = ()
    reason: str | None = None
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True)
class BestFocus:
    """The best focus so far.

    Parameters
    ----------
    best
        The reading that is held.
    above
        A reading whose whole 95 % interval lies above it, and that the next one has yet to confirm.

    Notes
    -----
    Two readings on end, of frames of their own, must lie above the best with the whole of their intervals, and the
    lower of them takes its place. One alone is no proof: of a lens that nobody turns the highest of 3,000 readings is
    some 3.4 standard errors too high and could never be found again, and steps of two errors each climb there too.
    So held, half of such bests are less than 1.5 standard errors too high, and 2 in a thousand more than three.
    """

    best: Focus | None = None
    above: Focus | None = None

    def after(self, now: Focus) -> "BestFocus":
        """Return what is held after a further reading, which shares no frame with the one before."""
        value, interval = now.mtf50_cy_per_px, now.interval95
        if value is None or interval is None or "saturated" in now.flags:
            return BestFocus(best=self.best)
        if self.best is None or self.best.mtf50_cy_per_px is None:
            return BestFocus(best=now)
        if interval[0] <= self.best.mtf50_cy_per_px:
            return BestFocus(best=self.best)
        if self.above is None or self.above.mtf50_cy_per_px is None:
            return BestFocus(best=self.best, above=now)
        lower, higher = sorted((self.above, now), key=lambda one: one.mtf50_cy_per_px or 0.0)
        return BestFocus(best=lower).after(higher)

    def is_reached_by(self, now: Focus) -> bool | None:
        """Whether a reading cannot be told from the best, their intervals overlapping; None where one is missing."""
        if self.best is None or self.best.interval95 is None or now.interval95 is None:
            return None
        return now.interval95[1] >= self.best.interval95[0]


def read_focus(frames: NDArray, region: Region | None, context: Context) -> Focus:
    """Measure the sharpness of an edge.

    Parameters
    ----------
    frames
        Newest frames, shape (frame, row, col), DN; they are averaged.
    region
        ROW, COL, HEIGHT, WIDTH that holds the edge; None: the most prominent edge of the frame.
    context
        The camera's pitch ratio, fields and full scale.
    """
    from charact.mtf import measure

    found = measure("edge", FrameStack(data=frames), region=region, method=METHOD, context=context).find("mtf50")[0]
    return Focus(
        mtf50_cy_per_px=found.value,
        interval95=found.interval95,
        orientation_deg=found.orientation_deg,
        region=found.region,
        flags=found.flags,
        reason=found.reason,
        seconds=found.seconds or 0.0,
    )


def window_about(region: Region) -> Region:
    """Return the middle of a region, no larger than can be measured many times a second."""
    row, col, height, width = region
    rows, cols = min(height, WINDOW_PX), min(width, WINDOW_PX)
    return row + (height - rows) // 2, col + (width - cols) // 2, rows, cols
