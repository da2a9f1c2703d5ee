"""Power spectrum of what changes from frame to frame in a dark: rows, neighbours along a row,
interference.

Rows that are offset as a whole have their power at the horizontal frequency 0; interference is a
peak; read noise of neighbours that differ more, or less, than independent ones has a density that
rises, or falls, with the horizontal frequency.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.observables.thresholds import READOUT

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Interference:
    """A peak of the spectrum: frequencies, cy/px, and mean square with its standard error, DN^2."""

    x_cy_per_px: float
    y_cy_per_px: float
    mean_square_dn2: float
    sd_dn2: float

    def remove_from(self, image: Array) -> Array:
        """Return an image (row, col) without its component of these frequencies."""
        rows, columns = image.shape
        down = np.exp(2j * np.pi * self.y_cy_per_px * np.arange(rows))
        across = np.exp(2j * np.pi * self.x_cy_per_px * np.arange(columns))
        amplitude = (down.conj() @ image @ across.conj()) / image.size
        real = np.isclose(np.mean(down**2).real * np.mean(across**2).real, 1.0)
        return image - (1.0 if real else 2.0) * np.real(amplitude * np.outer(down, across))


@dataclass(frozen=True, kw_only=True)
class ReadoutSpectrum:
    """Power spectrum of the changes of a dark, its interference removed."""

    shape: tuple[int, int, int]  # frames, rows, columns
    # mean over frames, whole plane, shape (row, col), 1 for white noise of variance 1, DN^2
    power: Array
    # power of the rows' means times columns at the vertical frequencies above 0, DN^2
    row_power: Array
    row_frequency: Array  # those frequencies, cy/row
    interference: Interference | None

    @property
    def near_rows(self) -> float:
        """Density of pixels next to the horizontal frequency 0, DN^2."""
        return float(self.power[:, 1 : 1 + READOUT.near_columns].mean())

    @property
    def neighbour_covariance(self) -> tuple[float, float]:
        """Covariance of neighbours along a row without that of rows, and its standard error,
        DN^2.
        """
        frames, rows, columns = self.shape
        density = self.power.mean(axis=0)
        # The bin of the rows' offsets stands for the density of pixels there.
        density = np.append(density[1 : 1 + READOUT.near_columns].mean(), density[1:])
        covariance = float(np.mean(density * np.cos(2.0 * np.pi * np.fft.fftfreq(columns))))
        return covariance, float(density.mean() / np.sqrt((frames - 1) * rows * columns))


def readout_spectrum(data: NDArray) -> ReadoutSpectrum | None:
    """Return the spectrum of a dark (frame, row, col), DN; None if it has too few frames or pixels.

    Notes
    -----
    Changes are frames less the mean frame, scaled to the variance of a frame. The power of a bin is
    a mean of exponential numbers, one a frame: its relative standard error is 1/sqrt(frames - 1).
    """
    frames, rows, columns = data.shape
    if frames < READOUT.fewest_frames or min(rows, columns) < READOUT.fewest_pixels:
        return None
    mean = data.mean(axis=0, dtype=np.float64)
    total = np.zeros((rows, columns))
    for frame in data:
        total += np.abs(np.fft.fft2(frame - mean)) ** 2
    power = total / ((frames - 1) * rows * columns)
    # Mean power of the frames themselves: that of their changes and of their mean.
    frame_power = total / (frames * rows * columns) + np.abs(
        np.fft.fft2(mean - mean.mean())
    ) ** 2 / (rows * columns)
    interference = _highest_peak(power, frame_power, frames)
    half = np.arange(1, (rows - 1) // 2 + 1)
    return ReadoutSpectrum(
        shape=(frames, rows, columns),
        power=power,
        row_power=power[half, 0],
        row_frequency=half / rows,
        interference=interference,
    )


def _highest_peak(power: Array, frame_power: Array, frames: int) -> Interference | None:
    """Return the highest peak off both axes if noise does not explain it; its bin then has the
    median power.

    `power` is that of changes, `frame_power` that of frames with their fixed pattern: the latter
    does not depend on the phases that the frames happen to have, and is used for the height.
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.special import gammaincc, gammaincinv

    rows, columns = power.shape
    # Density of each column of the spectrum, from the median of its exponential numbers: peaks do
    # not raise it.
    level = uniform_filter1d(
        np.median(power[1:], axis=0), 2 * READOUT.near_columns + 1, mode="wrap"
    )
    level = level * (frames - 1) / float(gammaincinv(frames - 1, 0.5))
    if not np.all(level > 0.0):
        # Frames of a digitiser too coarse for their noise repeat each other.
        return None
    searched = power / level
    searched[0], searched[:, 0] = 0.0, 0.0
    row, column = (int(at) for at in np.unravel_index(np.argmax(searched), power.shape))
    real = (2 * row) % rows == 0 and (2 * column) % columns == 0
    degrees = (0.5 if real else 1.0) * (frames - 1)
    if (
        power.size / 2 * float(gammaincc(degrees, degrees * searched[row, column]))
        > READOUT.chance_of_peak
    ):
        return None
    if column > columns // 2:
        row, column = -row % rows, -column % columns
    neighbours = [
        ((row + i) % rows, (column + j) % columns) for i in (-2, -1, 1, 2) for j in (-2, -1, 1, 2)
    ]
    ground = float(np.mean([frame_power[at] for at in neighbours]))
    bins = 1.0 if real else 2.0
    height = max(float(frame_power[row, column]) - ground, 1e-12)
    # Of a bin's power with signal s and noise b: b^2 + 2 s b, twice that of a real bin, over
    # frames.
    variance = (ground**2 + 2.0 * height * ground) * (2.0 / bins) / frames + ground**2 / len(
        neighbours
    )
    for at in ((row, column), (-row % rows, -column % columns)):
        power[at] = level[at[1]]
    size = rows * columns
    return Interference(
        x_cy_per_px=column / columns,
        y_cy_per_px=row / rows,
        mean_square_dn2=bins * height / size,
        sd_dn2=bins * float(np.sqrt(variance)) / size,
    )
