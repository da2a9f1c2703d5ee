"""The wavelengths at which a scene is computed: every line of a source, and as few others as will do."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from simulate.radiance.cube import band_widths
from simulate.radiance.spectrum import SourceSpectrum

# Step of the fine grid on which errors are judged, besides the knots of all tables.
FINE_NM = 1.0
# Bands begin no further apart than this, so that materials and gases between sources' features are seen.
WIDEST_NM = 50.0
# A line's neighbours stand this close, so that its light stays at its own wavelength.
LINE_FOOT_NM = 4.0


def spectral_grid(
    sources: Sequence[SourceSpectrum],
    response_nm: ArrayLike,
    response: ArrayLike,
    *,
    tolerance: float = 0.003,
    spectra: Sequence[tuple[ArrayLike, ArrayLike]] = (),
    widest_nm: float = WIDEST_NM,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return wavelengths that follow sources and sensor, and their widths.

    Parameters
    ----------
    sources
        Spectra of the lights.
    response_nm, response
        The sensor's response per W at wavelengths, ascending, linear between them; the grid covers where it is above
        zero.
    tolerance
        Largest error of any source's detected light, as a sum over |error| between bands, as a fraction of it.
    spectra
        Reflectances, transmittances: wavelengths and values of tables that light is multiplied with.
    widest_nm
        Largest distance of neighbours, nm.

    Returns
    -------
    wavelength_nm
        Bands, ascending, shape (band,), nm: both ends of the response, each line between them, and bands put in where
        response or spectra bend most.
    width_nm
        Width of each band (`cube.band_widths`), shape (band,), nm: an integral is the sum of value times width.

    Raises
    ------
    BadInput
        If the response is nowhere positive, or the tolerance is not.
    """
    if not tolerance > 0.0:
        raise BadInput(f"the tolerance of a spectral grid must be positive, got {tolerance:g}")
    sensor_nm, sensor_response = np.asarray(response_nm, float), np.asarray(response, float)
    low, high = _span(sensor_nm, sensor_response)
    grid = _start(low, high, widest_nm, [nm for source in sources for nm in source.line_nm if low < nm < high])
    knots = [sensor_nm, *(np.asarray(nm, float) for nm, _ in spectra), *(source.wavelength_nm for source in sources)]
    fine = np.unique(np.concatenate([np.arange(low, high, FINE_NM), grid, *knots]))
    fine = fine[(fine >= low) & (fine <= high)]
    sensor = np.interp(fine, sensor_nm, sensor_response, left=0.0, right=0.0)
    factors = [
        sensor,
        *(sensor * np.interp(fine, np.asarray(nm, float), np.asarray(value, float)) for nm, value in spectra),
    ]
    while True:
        error, next_nm = _worst(grid, fine, factors, sources)
        if error <= tolerance:
            return grid, np.asarray(band_widths(grid), float)
        grid = np.union1d(grid, next_nm)


def _span(wavelength_nm: NDArray[np.floating], response: NDArray[np.floating]) -> tuple[float, float]:
    positive = np.flatnonzero(response > 0.0)
    if positive.size == 0:
        raise BadInput("a sensor must respond at some wavelength, got a response that is nowhere positive")
    first, last = max(positive[0] - 1, 0), min(positive[-1] + 1, len(response) - 1)
    if first == last:
        raise BadInput("a sensor's response must have at least two wavelengths, got one")
    return float(wavelength_nm[first]), float(wavelength_nm[last])


def _start(low: float, high: float, widest_nm: float, lines: list[float]) -> NDArray[np.float64]:
    """Return an even grid with every line, and a foot on both sides of it where nothing else stands close."""
    grid = np.linspace(low, high, max(2, int(np.ceil((high - low) / widest_nm)) + 1))
    grid = np.union1d(grid, lines)
    for line in lines:
        for foot in (line - LINE_FOOT_NM, line + LINE_FOOT_NM):
            between = (grid > min(foot, line)) & (grid < max(foot, line))
            if low < foot < high and not between.any():
                grid = np.union1d(grid, foot)
    return grid


def _worst(
    grid: NDArray[np.float64],
    fine: NDArray[np.float64],
    factors: Sequence[NDArray[np.floating]],
    sources: Sequence[SourceSpectrum],
) -> tuple[float, float]:
    """Return the largest relative error of any source seen through any factor, and the wavelength of the next band.

    That is where the factor is farthest from the line between bands, in the interval that adds most to the error. A
    source is averaged over bands (`SourceSpectrum.on`), so that only the bending of a factor between bands is an error.
    """
    worst, place = 0.0, 0.0
    interval = np.clip(np.searchsorted(grid, fine, side="right") - 1, 0, grid.size - 2)
    width = band_widths(fine)
    bents = [np.abs(factor - np.interp(fine, grid, np.interp(grid, fine, factor))) for factor in factors]
    for source in sources:
        density = np.interp(fine, source.wavelength_nm, source.density, left=0.0, right=0.0) * width
        lines = np.asarray(source.line_nm, float)
        for factor, bent in zip(factors, bents, strict=True):
            seen = np.sum(factor * density)
            seen += np.sum(np.interp(lines, fine, factor, left=0.0, right=0.0) * np.asarray(source.line_power))
            part = bent * density
            if seen > 0.0 and part.sum() / seen > worst:
                worst = float(part.sum() / seen)
                most = int(np.argmax(np.bincount(interval, weights=part, minlength=grid.size - 1)))
                place = float(fine[np.argmax(np.where(interval == most, bent, 0.0))])
    return worst, place
