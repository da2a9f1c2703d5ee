"""Live view: preview image and statistics of one frame."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.live.focus import BestFocus, Focus
from charact.live.frame_source import SourceFrame
from charact.live.frame_statistics import FrameStatistics
from charact.mtf.mean_frame import Region

SATURATED_BGR = (255, 200, 0)


@dataclass(frozen=True, kw_only=True)
class PreviewImage:
    """Preview of a frame as JPEG: every step-th pixel, and the grey values shown as black and white, DN."""

    jpeg: bytes
    step: int
    black_dn: float
    white_dn: float


def render_preview(frame: NDArray, meters: FrameStatistics, *, full_scale_dn: float) -> PreviewImage:
    """Return the preview of a frame (row, col), DN: subsampled, stretched, every saturated pixel marked.

    The histogram sets black and white; a skipped pixel at or above full scale is marked too.
    """
    import cv2

    step = -(-frame.shape[1] // 768)
    black, white = _levels(meters)
    small = frame[::step, ::step].astype(np.float32)
    grey = cv2.convertScaleAbs(np.maximum(small - black, 0.0), alpha=255.0 / (white - black))
    preview = grey
    if meters.saturated_px:
        preview = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
        preview[_any_in_blocks(frame >= full_scale_dn, step)] = SATURATED_BGR
    # Full colour resolution, so that the mark of a single pixel is visible.
    finest = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    written, jpeg = cv2.imencode(".jpg", preview, [cv2.IMWRITE_JPEG_QUALITY, 80, *finest])
    if not written:
        raise RuntimeError(f"a preview of {preview.shape} must be encoded as JPEG, and was not")
    return PreviewImage(jpeg=jpeg.tobytes(), step=step, black_dn=black, white_dn=white)


def _levels(meters: FrameStatistics) -> tuple[float, float]:
    """Return the grey values shown as black and white, at least eight bins apart so that noise is not stretched."""
    below = np.cumsum(meters.histogram) / max(meters.pixels, 1)
    # Quantiles of the grey values shown as black and white.
    black, white = np.searchsorted(below, (0.002, 0.998))
    return float(black * meters.bin_dn), float(max(white + 1, black + 8) * meters.bin_dn)


def _any_in_blocks(mask: NDArray[np.bool_], step: int) -> NDArray[np.bool_]:
    """Return whether any pixel of each block of `step` x `step` is set."""
    if step == 1:
        return mask
    rows, cols = mask.shape
    padded = np.pad(mask, ((0, -rows % step), (0, -cols % step)))
    return padded.reshape(padded.shape[0] // step, step, -1, step).max(axis=(1, 3))


@dataclass(frozen=True, kw_only=True)
class LiveView:
    """One frame as shown: statistics, preview, frame rate (Hz, None before two frames), focus and region."""

    number: int
    source_frame: SourceFrame
    statistics: FrameStatistics
    preview: PreviewImage
    frame_rate_hz: float | None = None
    focus: Focus | None = None
    best: BestFocus = field(default_factory=BestFocus)
    region: Region | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the statistics as JSON for the page; units are in the names."""
        meters, conditions = asdict(self.statistics), vars(self.source_frame.conditions)
        return {
            "number": self.number,
            "of": self.source_frame.of,
            "frame": self.source_frame.frame.number,
            "rows_columns": list(self.source_frame.frame.pixels.shape),
            "full_scale_dn": self.source_frame.full_scale_dn,
            "lost_frames": self.source_frame.lost_frames,
            "frame_rate_hz": self.frame_rate_hz,
            "conditions": {name: value for name, value in conditions.items() if value is not None},
            "region": self.region,
            **meters,
            "histogram": self.statistics.histogram.tolist(),
            "focus": None if self.focus is None else asdict(self.focus),
            "best": None if self.best.best is None else asdict(self.best.best),
            "at_best": None if self.focus is None else self.best.is_reached_by(self.focus),
            "step": self.preview.step,
            "black_dn": self.preview.black_dn,
            "white_dn": self.preview.white_dn,
        }
