"""Live view of one frame: statistics, histogram and preview image."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.mean_frame import Region
from charact.live.focus import BestFocus, Focus
from charact.live.frame_source import SourceFrame
from labdata.errors import BadInput
from labdata.frames import FrameStack, read_only

BINS = 256


@dataclass(frozen=True, kw_only=True)
class FrameStatistics:
    """Statistics of one frame and of its difference to the previous one.

    Mean and temporal noise (with its standard error; None without a previous frame) are over the
    region, DN; highest pixel, saturated pixels and histogram over the whole frame. The last bin
    holds all values above full scale.
    """

    mean_dn: float
    highest_dn: float
    pixels: int
    saturated_px: int
    noise_dn: float | None
    noise_se_dn: float | None
    histogram: NDArray[np.int64]
    bin_dn: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "histogram", read_only(self.histogram))


def measure_frame(
    frame: NDArray,
    before: NDArray | None = None,
    *,
    full_scale_dn: float,
    region: Region | None = None,
) -> FrameStatistics:
    """Measure the statistics of a frame (row, col) of unsigned integers, DN, and its difference to
    the previous one.

    `region`: ROW, COL, HEIGHT, WIDTH of mean and noise; None: the whole frame. Raises BadInput if
    the pixels are not unsigned integers, the frames differ in shape, or the region exceeds them.
    """
    if frame.ndim != 2 or frame.dtype.kind != "u":
        raise BadInput(
            f"frame statistics need a frame (row, col) of unsigned integers, got {frame.ndim} "
            f"axes of {frame.dtype}"
        )
    if before is not None and before.shape != frame.shape:
        raise BadInput(
            f"two frames must have one shape to be compared, got {before.shape} and {frame.shape}"
        )
    region_pixels = _inside(frame, region)
    noise, error = (
        (None, None) if before is None else temporal_noise(region_pixels, _inside(before, region))
    )
    histogram, bin_dn = _histogram(frame, full_scale_dn)
    return FrameStatistics(
        mean_dn=float(region_pixels.mean()),
        highest_dn=float(frame.max()),
        pixels=frame.size,
        noise_dn=noise,
        saturated_px=int(np.count_nonzero(frame >= full_scale_dn)),
        noise_se_dn=error,
        histogram=histogram,
        bin_dn=bin_dn,
    )


def temporal_noise(frame: NDArray, before: NDArray) -> tuple[float, float | None]:
    """Return the temporal noise of two frames (row, col), root mean square over the pixels, and its
    standard error, DN.

    Half the variance of the difference, which removes the scene, the fixed pattern and uniform
    flicker. Image lag biases it low. The standard error is from the scatter between neighbouring
    tiles, half the mean square of successive differences (J. von Neumann, Ann. Math. Statist. 12
    (1941) 367); it accounts for correlated and for non-uniform noise.
    """
    difference = frame.astype(np.float32) - before
    difference -= difference.mean()
    square = np.square(difference, out=difference)
    noise = float(np.sqrt(0.5 * square.mean(dtype=np.float64)))
    tiles = _tiles(square)
    if tiles.size < 16 or min(tiles.shape) < 2 or noise == 0.0:
        return noise, None
    # The axis with the smaller scatter: across an edge the tiles differ by more than noise.
    scatter = min(np.mean(np.diff(tiles, axis=axis) ** 2) for axis in (0, 1))
    error_of_mean_square = np.sqrt(0.5 * scatter / tiles.size)
    return noise, float(0.25 * error_of_mean_square / noise)


def _tiles(values: NDArray) -> NDArray[np.float64]:
    """Return the means of square tiles, shape (tile row, tile col); incomplete tiles are
    dropped.
    """
    # Wider than the blur, so that the means are independent; smaller in a small region.
    side = int(np.clip(min(values.shape) // 8, 8, 32))
    rows, cols = (length // side for length in values.shape)
    complete_tiles = values[: rows * side, : cols * side]
    return complete_tiles.reshape(rows, side, cols, side).mean(axis=(1, 3), dtype=np.float64)


def _histogram(frame: NDArray, full_scale_dn: float) -> tuple[NDArray[np.int64], float]:
    bits = max(int(full_scale_dn).bit_length() - BINS.bit_length() + 1, 0)
    counts = np.bincount((frame >> bits).ravel(), minlength=BINS)
    last = int(full_scale_dn) >> bits
    return np.append(counts[:last], counts[last:].sum()), float(1 << bits)


def _inside(frame: NDArray, region: Region | None) -> NDArray:
    return frame if region is None else FrameStack(data=frame[None]).region(*region).data[0]


SATURATED_BGR = (255, 200, 0)


@dataclass(frozen=True, kw_only=True)
class PreviewImage:
    """Preview of a frame as JPEG: every step-th pixel, and the grey values shown as black and
    white, DN.
    """

    jpeg: bytes
    step: int
    black_dn: float
    white_dn: float


def render_preview(
    frame: NDArray, meters: FrameStatistics, *, full_scale_dn: float
) -> PreviewImage:
    """Return the preview of a frame (row, col), DN: subsampled, stretched, every saturated pixel
    marked.

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
    """Return the grey values shown as black and white, at least eight bins apart so that noise is
    not stretched.
    """
    cumulative = np.cumsum(meters.histogram) / max(meters.pixels, 1)
    # Quantiles of the grey values shown as black and white.
    black, white = np.searchsorted(cumulative, (0.002, 0.998))
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
    """One frame as shown: statistics, preview, frame rate (Hz, None before two frames), focus and
    region.
    """

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
