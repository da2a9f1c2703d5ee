"""Known transfer of a camera along one direction: pixel aperture, video filter, size of a halo."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.mean_frame import OrientedFrame
from charact.method import Context
from charact.transfer.stages import aperture
from charact.transfer.video_filter import VideoFilter
from labdata.camera.description import has_tube

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class KnownTransfer:
    """Known transfer across an edge of an oriented frame.

    Parameters
    ----------
    angle_rad
        Angle of the direction to the column direction of the oriented frame.
    along_px, across_px
        Pixel aperture along that grid axis and across it, in pitches of that axis.
    video
        Video filter along the column direction, or None.
    mirrored
        Whether the oriented frame runs against the read-out.
    """

    angle_rad: float
    along_px: float
    across_px: float
    video: VideoFilter | None
    mirrored: bool

    def __call__(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the known transfer at frequencies along the direction, complex."""
        plain = aperture(frequency, self.angle_rad, self.along_px, self.across_px).astype(complex)
        if self.video is None:
            return plain
        return plain * self._as_read(self.video(frequency * np.cos(self.angle_rad)))

    def bend(self, frequency: Array) -> NDArray[np.complex128] | None:
        """Return the derivatives of ln transfer by ln bandwidth, see `VideoFilter.bend`; None: no
        dependence.
        """
        if self.video is None or not self.video.parameters:
            return None
        return self._as_read(self.video.bend(frequency * np.cos(self.angle_rad)))

    def doubt(self, frequency: Array) -> Array:
        """Return the relative standard uncertainty of the known transfer, shape (f,)."""
        if self.video is None:
            return np.zeros(np.shape(frequency))
        return self.video.doubt(frequency * np.cos(self.angle_rad))

    def _as_read(self, transfer: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.conj(transfer) if self.mirrored else transfer


def known_transfer(picture: OrientedFrame, angle_rad: float, context: Context) -> KnownTransfer:
    """Return the known transfer across an edge of an oriented frame."""
    rows_summed = 2.0 if has_tube(context.camera) and context.interlaced else 1.0
    along, across = (
        (rows_summed, picture.pitch_ratio)
        if picture.transposed
        else (1.0, rows_summed * picture.pitch_ratio)
    )
    video = None if picture.transposed else VideoFilter.of(context.camera)
    return KnownTransfer(
        angle_rad=angle_rad,
        along_px=along / picture.stack.frames.sample_pitch_px,
        across_px=across / picture.stack.frames.sample_pitch_px,
        video=video,
        mirrored=picture.mirrored,
    )


def halo_diameters_px(context: Context, *, transposed: bool) -> tuple[float, float]:
    """Return the range of the halo diameter, four proximity gaps, in pitches of the direction,
    px.
    """
    sensor = context.camera
    assert sensor is not None
    gap, pitch = (
        sensor.photocathode.gap_mm,
        sensor.ccd.pitch_y_um if transposed else sensor.ccd.pitch_x_um,
    )
    px_per_mm = 1e3 / (float(pitch) * float(sensor.taper.demagnification))
    low = float(gap.low if gap.low is not None else 0.85 * gap.value)
    high = float(gap.high if gap.high is not None else 1.15 * gap.value)
    return 4.0 * low * px_per_mm * 0.9, 4.0 * high * px_per_mm * 1.1
