"""Small targets in the plane: the picture of a known object through a transfer, as a linear map of that transfer.

An object's spectrum times aperture, video filter and one hat of radial frequency, transformed back, is the picture
that this hat alone would give; a target's picture is the sum of them weighted with the transfer at the nodes.
Distances are column pitches; rows are `pitch_ratio` of them apart.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf import transfer as forms
from charact.mtf.spread import interpolation

Array = NDArray[np.float64]

OVERSAMPLING = 2
PADDING_PX = 48


class Shape(Protocol):
    """An object of known shape: its spectrum, and its parameters of place and form as a vector."""

    @property
    def vector(self) -> Array:
        """Parameters of place and form."""
        ...

    @property
    def steps(self) -> Array:
        """Steps over which the picture changes about linearly with them."""
        ...

    def moved(self, vector: Array) -> "Shape":
        """Return the object with other parameters."""
        ...

    def spectrum(self, fx: Array, fy: Array) -> NDArray[np.complex128]:
        """Return the spectrum at frequencies along rows and columns, cycles per column pitch, in (column pitch)^2."""
        ...


@dataclass(frozen=True, kw_only=True)
class Bars:
    """Bars of width 1/(2 f), bright on dark.

    Parameters
    ----------
    count
        Number of bars.
    frequency
        Cycles per column pitch.
    angle_rad
        Direction across the bars from the row direction, rad.
    length_px
        Length of a bar, column pitches.
    x_px, y_px
        Centre, column pitches from the middle of the region.
    """

    count: int
    frequency: float
    angle_rad: float
    length_px: float
    x_px: float
    y_px: float

    @property
    def vector(self) -> Array:
        return np.array([self.x_px, self.y_px, self.angle_rad, np.log(self.frequency), np.log(self.length_px)])

    @property
    def steps(self) -> Array:
        width = 0.5 / self.frequency
        turn = 0.2 * width / (0.5 * self.length_px)
        return np.array([0.1 * width, 0.1 * width, turn, 0.1 / self.count, 0.05])

    def moved(self, vector: Array) -> "Bars":
        x, y, angle, log_frequency, log_length = (float(number) for number in vector)
        return Bars(
            count=self.count,
            frequency=float(np.exp(log_frequency)),
            angle_rad=angle,
            length_px=float(np.exp(log_length)),
            x_px=x,
            y_px=y,
        )

    def spectrum(self, fx: Array, fy: Array) -> NDArray[np.complex128]:
        """Return w sinc(w u) sin(pi N u P)/sin(pi u P) times L sinc(L v), u across and v along the bars."""
        across = fx * np.cos(self.angle_rad) - fy * np.sin(self.angle_rad)
        along = fx * np.sin(self.angle_rad) + fy * np.cos(self.angle_rad)
        period, width = 1.0 / self.frequency, 0.5 / self.frequency
        places = period * (np.arange(self.count) - (self.count - 1) / 2.0)
        comb = sum(np.cos(2.0 * np.pi * across * place) for place in places)
        shape = width * np.sinc(width * across) * comb * self.length_px * np.sinc(self.length_px * along)
        return shape * np.exp(-2j * np.pi * (fx * self.x_px + fy * self.y_px))


@dataclass(frozen=True, kw_only=True)
class Disc:
    """A bright disc: the image of a pinhole.

    Parameters
    ----------
    diameter_px
        Diameter, column pitches; known, not fitted.
    x_px, y_px
        Centre, column pitches from the middle of the region.
    """

    diameter_px: float
    x_px: float
    y_px: float

    @property
    def vector(self) -> Array:
        return np.array([self.x_px, self.y_px])

    @property
    def steps(self) -> Array:
        return np.array([0.05, 0.05])

    def moved(self, vector: Array) -> "Disc":
        return Disc(diameter_px=self.diameter_px, x_px=float(vector[0]), y_px=float(vector[1]))

    def spectrum(self, fx: Array, fy: Array) -> NDArray[np.complex128]:
        """Return the disc's transform, normalised to 1 at zero: the mean over chords of cos(pi d f t)."""
        radial = np.hypot(fx, fy)
        turn = (np.arange(24) + 0.5) * np.pi / 24
        weight = np.sin(turn) ** 2
        shape = sum(
            w * np.cos(np.pi * self.diameter_px * radial * np.cos(t)) for w, t in zip(weight, turn, strict=True)
        )
        return shape / weight.sum() * np.exp(-2j * np.pi * (fx * self.x_px + fy * self.y_px))


@dataclass(frozen=True, kw_only=True)
class Plane:
    """The pixels of a region and the frequencies on which their picture is made.

    Parameters
    ----------
    rows, cols
        Size of the region.
    pitch_ratio
        Row pitch over column pitch.
    rows_summed
        CCD rows that a frame row sums.
    video
        (bandwidth MHz, pixel clock MHz, order) or None.
    """

    rows: int
    cols: int
    pitch_ratio: float
    rows_summed: float
    video: tuple[float, float, int] | None

    @property
    def _size(self) -> tuple[int, int]:
        return tuple(OVERSAMPLING * _fast(n + PADDING_PX) for n in (self.rows, self.cols))  # type: ignore[return-value]

    def frequencies(self) -> tuple[Array, Array]:
        """Return frequencies along rows and columns, cycles per column pitch, of the half plane that FFTs keep."""
        tall, wide = self._size
        fy = np.fft.fftfreq(tall, 1.0 / OVERSAMPLING)[:, None] / self.pitch_ratio
        return np.fft.rfftfreq(wide, 1.0 / OVERSAMPLING)[None, :] + 0.0 * fy, fy + np.zeros((1, wide // 2 + 1))

    def known(self, fx: Array, fy: Array) -> NDArray[np.complex128]:
        """Return aperture and video filter at frequencies in cycles per column pitch."""
        box = np.sinc(fx) * np.sinc(fy * self.pitch_ratio * self.rows_summed)
        if self.video is None:
            return box.astype(complex)
        flat, index = np.unique(fx.round(12), return_inverse=True)
        return box * forms.video(flat, *self.video)[index].reshape(fx.shape)

    def picture(self, spectrum: NDArray[np.complex128]) -> Array:
        """Return the picture (row, col) of a spectrum on `frequencies`, the middle of the region being the origin."""
        tall, wide = self._size
        fx, fy = self.frequencies()
        middle = np.exp(2j * np.pi * (-fx * (self.cols - 1) / 2.0 - fy * self.pitch_ratio * (self.rows - 1) / 2.0))
        # A transform over samples 1/OVERSAMPLING apart: the inverse carries their density.
        scale = OVERSAMPLING**2 / self.pitch_ratio
        fine = np.fft.irfft2(spectrum * middle, (tall, wide)) * scale
        return fine[: self.rows * OVERSAMPLING : OVERSAMPLING, : self.cols * OVERSAMPLING : OVERSAMPLING]

    def basis(self, shape: Shape, grid: Array) -> Array:
        """Return the pictures of single nodes, shape (row * col, node)."""
        fx, fy = self.frequencies()
        carried = (shape.spectrum(fx, fy) * self.known(fx, fy)).ravel()
        radial = np.hypot(fx, fy).ravel()
        inside = radial <= grid[-1]
        hats = np.zeros((radial.size, 1))
        pictures = np.empty((self.rows * self.cols, grid.size))
        weights = interpolation(grid, np.maximum(radial[inside], grid[0]))
        for node in range(grid.size):
            hats[inside, 0] = weights[:, node]
            pictures[:, node] = self.picture((carried * hats[:, 0]).reshape(fx.shape)).ravel()
        return pictures

    def through(self, shape: Shape, transfer_at) -> Array:
        """Return the picture of an object through a radial transfer, shape (row, col)."""
        fx, fy = self.frequencies()
        return self.picture(shape.spectrum(fx, fy) * self.known(fx, fy) * transfer_at(np.hypot(fx, fy)))


def plane_of(rows: int, cols: int, context: Context) -> Plane:
    """Return the plane of a region under what is known of the camera."""
    video = None
    if context.sensor is not None:
        chain = context.sensor.video
        video = (float(chain.bandwidth_mhz), float(chain.pixel_clock_mhz), int(chain.filter_order))
    rows_summed = 2.0 if context.sensor is not None and context.interlaced else 1.0
    return Plane(rows=rows, cols=cols, pitch_ratio=context.pitch_ratio, rows_summed=rows_summed, video=video)


def _fast(size: int) -> int:
    """Return the next size that is 2^k or 3 * 2^k."""
    powers = [2**k for k in range(4, 14)] + [3 * 2**k for k in range(3, 13)]
    return min(power for power in powers if power >= size)
