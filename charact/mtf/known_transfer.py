"""What the camera's description says of a direction: its aperture, its video filter and the halo to expect."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.blur_models import transfer as forms
from charact.mtf.blur_models.one_dimensional import ExtendedComponent, HaloComponent, ScatterComponent
from charact.mtf.mean_frame import OrientedFrame
from charact.video_filter import VideoFilter

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class KnownTransfer:
    """The known part of the transfer of one upright picture.

    Parameters
    ----------
    angle_rad
        Angle of the direction measured to the columns' direction of the picture.
    along_px, across_px
        Aperture along that grid axis and across it, in pitches of that axis.
    video
        Filter along the picture's columns' direction, or None.
    mirrored
        Whether the picture runs against the read-out.
    """

    angle_rad: float
    along_px: float
    across_px: float
    video: VideoFilter | None
    mirrored: bool

    def __call__(self, frequency: Array) -> NDArray[np.complex128]:
        """Return the known part at frequencies along the direction, complex."""
        plain = forms.aperture(frequency, self.angle_rad, self.along_px, self.across_px).astype(complex)
        if self.video is None:
            return plain
        return plain * self._as_read(self.video(frequency * np.cos(self.angle_rad)))

    def bend(self, frequency: Array) -> NDArray[np.complex128] | None:
        """Return how ln of the known part moves with ln of the bandwidth, see `VideoFilter.bend`; None: it does not."""
        if self.video is None or not self.video.parameters:
            return None
        return self._as_read(self.video.bend(frequency * np.cos(self.angle_rad)))

    def doubt(self, frequency: Array) -> Array:
        """Return by how much of itself the known part may be wrong, one standard deviation, shape (f,)."""
        if self.video is None:
            return np.zeros(np.shape(frequency))
        return self.video.doubt(frequency * np.cos(self.angle_rad))

    def _as_read(self, transfer: NDArray[np.complex128]) -> NDArray[np.complex128]:
        return np.conj(transfer) if self.mirrored else transfer


def known_transfer(picture: OrientedFrame, angle_rad: float, context: Context) -> KnownTransfer:
    """Return what is known of the transfer across an edge in an upright picture."""
    rows_summed = 2.0 if context.sensor is not None and context.interlaced else 1.0
    along, across = (
        (rows_summed, picture.pitch_ratio) if picture.transposed else (1.0, rows_summed * picture.pitch_ratio)
    )
    video = None if picture.transposed else VideoFilter.of(context.sensor)
    return KnownTransfer(angle_rad=angle_rad, along_px=along, across_px=across, video=video, mirrored=picture.mirrored)


def halo_of(picture: OrientedFrame, half_width_px: float, context: Context) -> tuple[ExtendedComponent | None, bool]:
    """Return the prior of a halo that the window can show, and whether the camera is known to have one.

    An intensifier's halo is four gaps wide. Of an unknown camera only glare that fades inside the window, with
    plateau beyond it, can be told from a slope of the illumination.
    """
    if context.sensor is None:
        longest = 0.25 * half_width_px
        return (ScatterComponent(size_px=(2.0, longest)), False) if longest > 4.0 else (None, False)
    low, high = halo_diameters_px(context, transposed=picture.transposed)
    if half_width_px < 0.6 * high:
        return None, False
    return HaloComponent(size_px=(low, high), fraction=(0.0, 0.4)), True


def halo_diameters_px(context: Context, *, transposed: bool) -> tuple[float, float]:
    """Return the range of the halo's diameter, four gaps, in pitches of the direction, px."""
    sensor = context.sensor
    assert sensor is not None
    gap, pitch = sensor.photocathode.gap_mm, sensor.ccd.pitch_y_um if transposed else sensor.ccd.pitch_x_um
    px_per_mm = 1e3 / (float(pitch) * float(sensor.taper.demagnification))
    low = float(gap.low if gap.low is not None else 0.85 * gap.value)
    high = float(gap.high if gap.high is not None else 1.15 * gap.value)
    return 4.0 * low * px_per_mm * 0.9, 4.0 * high * px_per_mm * 1.1
