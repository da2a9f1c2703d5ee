"""Level, temporal variance and fixed pattern of one stack."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.frames.components import shading
from charact.observables.dark_spectrum import ReadoutSpectrum, readout_spectrum
from labdata import Conditions, StackEntry


@dataclass(frozen=True, kw_only=True)
class StackLevel:
    """Level of one stack under its conditions, its temporal variance and fixed pattern."""

    label: str  # label of the stack
    mean_dn: float  # mean over frames and pixels, DN
    mean_sd_dn: float  # its standard error, from the scatter of the frames' means, DN
    noise_dn: float  # robust noise of a pixel, DN: half the range of the central 68 %
    # illuminance_lux, gate_s, exposure_s, mcp_v: conditions; a dark has no illuminance, nan is
    # unknown
    illuminance_lux: float
    gate_s: float
    exposure_s: float
    mcp_v: float
    entry: StackEntry | None = None  # the stack
    full_scale_dn: float = np.nan  # highest code of the digitiser, DN
    step_dn: float = 1.0  # step of its codes, DN: above 1 of codes shifted left
    light_known: bool = True  # whether its light is stated; otherwise it shows noise alone
    # mean over pixels of the variance between frames, variance over pixels of the mean frame
    # without its noise and smooth shading, and the standard errors of both, DN^2; nan of a single
    # frame
    variance_dn2: float = np.nan
    variance_sd_dn2: float = np.nan
    spatial_variance_dn2: float = np.nan
    spatial_sd_dn2: float = np.nan

    @property
    def conditions(self) -> Conditions:
        """Conditions of the stack."""
        return Conditions() if self.entry is None else self.entry.conditions

    @property
    def dark(self) -> bool:
        """Whether the stack is a dark."""
        return self.illuminance_lux == 0.0

    @property
    def data(self) -> NDArray:
        """Frames, shape (frame, row, col), DN; none where the stack is not known."""
        return np.zeros((0, 0, 0)) if self.entry is None else self.entry.read().data

    @cached_property
    def readout(self) -> ReadoutSpectrum | None:
        """Spectrum of what changes from frame to frame; None of too few frames or pixels."""
        return readout_spectrum(self.data)

    @cached_property
    def shape(self) -> tuple[int, int, int]:
        """Frames, rows and columns; a row of a stack that is not known."""
        return (0, 1, 0) if self.entry is None else self.entry.read().shape


def variances_of(data: NDArray) -> dict[str, float]:
    """Return temporal variance and variance of the fixed pattern with their standard errors, by the
    names of `StackLevel`; nan of a single frame.

    Removed are the frames' offsets and, of the fixed pattern, shading of light and lens up to the
    fourth order, the offsets of rows, and interference, whose phases of few frames do not average
    to their expectation.

    Standard errors are from the scatter over pixels, taken as independent: for white noise.
    """
    count, pixels = len(data), data[0].size
    if count < 2:
        return {}
    sums = np.zeros((4, *data.shape[1:]))
    for frame in data:
        for index, axes in ((0, (0, 1)), (2, 1)):
            residuals = frame - frame.mean(axis=axes, keepdims=True, dtype=np.float64)
            sums[index] += residuals
            sums[index + 1] += residuals**2
    pixel_variance, in_rows = (
        (square - total**2 / count) / (count - 1) for total, square in (sums[:2], sums[2:])
    )
    spectrum = readout_spectrum(data)
    peak = None if spectrum is None else spectrum.interference
    pattern, noise_dn2 = _without_shading(sums[2] / count), in_rows
    if peak is not None:
        pattern, noise_dn2 = peak.remove_from(pattern), in_rows - peak.mean_square_dn2
    pattern_square = pattern**2 - noise_dn2 / count
    return {
        "variance_dn2": float(pixel_variance.mean()),
        "variance_sd_dn2": float(pixel_variance.std() / np.sqrt(pixels)),
        "spatial_variance_dn2": float(pattern_square.mean()),
        "spatial_sd_dn2": float(pattern_square.std() / np.sqrt(pixels)),
    }


def _without_shading(image: NDArray) -> NDArray:
    """Return an image without products of polynomials along rows and columns."""
    down, across = (np.column_stack([np.full(n, n**-0.5), shading(n)]) for n in image.shape)
    return image - down @ (down.T @ image @ across) @ across.T
