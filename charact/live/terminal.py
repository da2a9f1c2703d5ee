"""Live view on a terminal."""

import math
from typing import TYPE_CHECKING

from charact.live.live_loop import LiveLoop
from charact.live.live_view import LiveView
from labdata.errors import BadInput

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

BLOCKS = " ▁▂▃▄▅▆▇█"
HISTOGRAM_WIDTH = 64


def watch_on_terminal(running: LiveLoop, *, title: str, console: "Console | None" = None) -> None:
    """Show the newest view until the user interrupts; raise BadInput with the reason when the
    frames end.
    """
    from rich.live import Live

    number = 0
    with Live(console=console, refresh_per_second=10, transient=False) as shown:
        while (why := running.newest.end_reason) is None:
            view = running.newest.after(number, timeout_s=0.5)
            if view is not None:
                number = view.number
                shown.update(table(view, title))
    raise BadInput(why)


def table(view: LiveView, title: str) -> "Table":
    """Return the statistics of a view as a table."""
    from rich.table import Table

    rows = Table(title=title, show_header=False)
    for name, text in lines(view).items():
        rows.add_row(name, text)
    return rows


def lines(view: LiveView) -> dict[str, str]:
    """Return the statistics of a view as text, by name."""
    meters, focus, best = view.statistics, view.focus, view.best.best
    percent = 100.0 * meters.saturated_px / meters.pixels
    error = "" if meters.noise_se_dn is None else f" ± {meters.noise_se_dn:.2g}"
    texts = {
        "frame": f"{view.source_frame.frame.number} of {view.source_frame.of}",
        "saturated": f"{meters.saturated_px} of {meters.pixels} px ({percent:.3g} %) at or above "
        f"{view.source_frame.full_scale_dn:g} DN",
        "mean": f"{meters.mean_dn:.4g} DN",
        "temporal noise": "needs two frames"
        if meters.noise_dn is None
        else f"{meters.noise_dn:.4g}{error} DN",
        "highest pixel": f"{meters.highest_dn:g} DN",
        "frame rate": "needs two frames"
        if view.frame_rate_hz is None
        else f"{view.frame_rate_hz:.2f} Hz",
        "lost frames": str(view.source_frame.lost_frames),
        f"histogram 0 to {view.source_frame.full_scale_dn:g} DN": sparkline(view),
    }
    if focus is None:
        return texts
    if focus.mtf50_cy_per_px is None or focus.interval95 is None:
        return {**texts, "edge MTF50": focus.reason or "none"}
    low, high = focus.interval95
    reached = ", reached" if view.best.is_reached_by(focus) else ""
    texts["edge MTF50"] = f"{focus.mtf50_cy_per_px:.4f} cy/px [{low:.4f}, {high:.4f}] 95 %"
    if focus.flags:
        texts["flags"] = ", ".join(focus.flags)
    if best is not None and best.mtf50_cy_per_px is not None:
        texts["best so far"] = f"{best.mtf50_cy_per_px:.4f} cy/px{reached}"
        texts["focus"] = _bar(focus.mtf50_cy_per_px / best.mtf50_cy_per_px)
    return texts


def sparkline(view: LiveView) -> str:
    """Return the histogram as one line of block characters, logarithmic."""
    counts = view.statistics.histogram
    together = -(-len(counts) // HISTOGRAM_WIDTH)
    sums = [
        int(counts[first : first + together].sum()) for first in range(0, len(counts), together)
    ]
    log_highest = math.log(1 + max(sums))
    return "".join(
        BLOCKS[math.ceil((len(BLOCKS) - 1) * math.log(1 + number) / log_highest)] for number in sums
    )


def _bar(fraction: float) -> str:
    filled = round(40 * min(max(fraction, 0.0), 1.0))
    return "█" * filled + "░" * (40 - filled) + f" {100 * fraction:.0f} % of the best"
