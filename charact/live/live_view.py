"""What the bench shows at one moment, and how it is written for a page."""

from dataclasses import asdict, dataclass, field
from typing import Any

from charact.live.focus import BestFocus, Focus
from charact.live.frame_source import SourceFrame
from charact.live.frame_statistics import FrameStatistics
from charact.live.preview_image import PreviewImage
from charact.mtf.mean_frame import Region


@dataclass(frozen=True, kw_only=True)
class LiveView:
    """One moment.

    Parameters
    ----------
    number
        Counts moments.
    seen
        The frame.
    meters, picture
        Its meters and its picture.
    frame_rate_hz
        Frames per second by the camera's own numbers and time stamps, Hz; None until there are two.
    focus, best
        Newest reading of the focus, and the best held; None where the focus is not read.
    region
        ROW, COL, HEIGHT, WIDTH of mean, noise and focus; None: the whole frame.
    """

    number: int
    seen: SourceFrame
    meters: FrameStatistics
    picture: PreviewImage
    frame_rate_hz: float | None = None
    focus: Focus | None = None
    best: BestFocus = field(default_factory=BestFocus)
    region: Region | None = None

    def as_json(self) -> dict[str, Any]:
        """Return its numbers as the page reads them; units are in the names."""
        meters, conditions = asdict(self.meters), vars(self.seen.conditions)
        return {
            "number": self.number,
            "of": self.seen.of,
            "frame": self.seen.frame.number,
            "rows_columns": list(self.seen.frame.pixels.shape),
            "full_scale_dn": self.seen.full_scale_dn,
            "lost_frames": self.seen.lost_frames,
            "frame_rate_hz": self.frame_rate_hz,
            "conditions": {name: value for name, value in conditions.items() if value is not None},
            "region": self.region,
            **meters,
            "histogram": self.meters.histogram.tolist(),
            "focus": None if self.focus is None else asdict(self.focus),
            "best": None if self.best.best is None else asdict(self.best.best),
            "at_best": None if self.focus is None else self.best.is_reached_by(self.focus),
            "step": self.picture.step,
            "black_dn": self.picture.black_dn,
            "white_dn": self.picture.white_dn,
        }
