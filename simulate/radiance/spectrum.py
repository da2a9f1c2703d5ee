"""Spectra of light sources, with a continuum and lines, black bodies, and the spectral grid of a
rendering.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from labdata.frames import read_only
from simulate.arrays import Array
from simulate.radiance.cube import band_widths

# CODATA 2018: W m-2 K-4; J s; m/s; J/K.
STEFAN_BOLTZMANN = 5.670374419e-8
PLANCK, LIGHT, BOLTZMANN = 6.62607015e-34, 2.99792458e8, 1.380649e-23
# Terms of the series: exp(-n x) is below 1e-9 of the first one after these, for x of 0.5 (14 um at
# 2000 K) and more.
TERMS = 40


def band_radiance(
    low_um: ArrayLike, high_um: ArrayLike, temperature_k: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the radiance of a black body between two wavelengths, W m-2 sr-1.

    Parameters
    ----------
    low_um, high_um
        Ends of the band, um; any shapes that broadcast with the temperature's.
    temperature_k
        Temperature, K, above 0.

    Notes
    -----
    .. math:: L = \frac{2 k^4 T^4}{h^3 c^2} \sum_n e^{-nx} (x^3/n + 3x^2/n^2 + 6x/n^3 + 6/n^4),
        \quad x = \frac{hc}{\lambda k T}

    from the low end minus from the high end (Chang and Rhee, Int. Comm. Heat Mass Transfer 11, 451,
    1984). `TERMS` terms are exact to 1e-8 for wavelength times temperature below 28,000 um K.
    """
    kelvin = np.asarray(temperature_k, float)
    scale = 2.0 * BOLTZMANN**4 / (PLANCK**3 * LIGHT**2) * kelvin**4
    return scale * (_series(_exponent(high_um, kelvin), 3) - _series(_exponent(low_um, kelvin), 3))


def band_photon_radiance(
    low_um: ArrayLike, high_um: ArrayLike, temperature_k: ArrayLike
) -> NDArray[np.float64]:
    """Return the photon radiance of a black body between two wavelengths, s-1 m-2 sr-1, as
    `band_radiance`.
    """
    kelvin = np.asarray(temperature_k, float)
    scale = 2.0 * BOLTZMANN**3 / (PLANCK**3 * LIGHT**2) * kelvin**3
    return scale * (_series(_exponent(high_um, kelvin), 2) - _series(_exponent(low_um, kelvin), 2))


def band_radiance_slope(
    low_um: ArrayLike, high_um: ArrayLike, temperature_k: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the derivative of `band_radiance` with temperature, W m-2 sr-1 K-1.

    Notes
    -----
    .. math::

        T \frac{dL}{dT} = 4 L
        + \left[\frac{2 k^4 T^4}{h^3 c^2} \frac{x^4}{e^x - 1}\right]_{low}^{high}
    """
    kelvin = np.asarray(temperature_k, float)
    scale = 2.0 * BOLTZMANN**4 / (PLANCK**3 * LIGHT**2) * kelvin**4
    low, high = (
        -(x**4) * np.exp(-x) / np.expm1(-x)
        for x in (_exponent(edge_um, kelvin) for edge_um in (low_um, high_um))
    )
    return (4.0 * band_radiance(low_um, high_um, kelvin) + scale * (high - low)) / kelvin


def _exponent(wavelength_um: ArrayLike, kelvin: Array) -> Array:
    """h c / (wavelength k T)."""
    return PLANCK * LIGHT / (np.asarray(wavelength_um, float) * 1e-6 * BOLTZMANN * kelvin)


def _series(x: Array, power: int) -> Array:
    """Integral of t^power / (e^t - 1) from x to infinity, of power 2 or 3."""
    n = np.arange(1.0, TERMS + 1.0).reshape(-1, *(1,) * x.ndim)
    poly = x**2 / n + 2.0 * x / n**2 + 2.0 / n**3
    if power == 3:
        poly = x**3 / n + 3.0 / n * poly
    return np.sum(np.exp(-n * x) * poly, axis=0)


LUMENS_PER_WATT = 683.0


def luminous_efficiency(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return V(lambda), dimensionless, linear between 10 nm steps and zero outside 380..770 nm."""
    return np.interp(
        np.asarray(wavelength_nm, float),
        *table("luminous_efficiency").values(),
        left=0.0,
        right=0.0,
    )


def planck(wavelength_nm: ArrayLike, temperature_k: float) -> NDArray[np.float64]:
    """Return the spectral radiance of a black body, W m-2 sr-1 nm-1.

    Notes
    -----
    2 h c^2 / l^5 / (exp(h c / (l k T)) - 1).
    """
    metre = np.asarray(wavelength_nm, float) * 1e-9
    exponent = PLANCK * LIGHT / (metre * BOLTZMANN * temperature_k)
    return 2.0 * PLANCK * LIGHT**2 / metre**5 / np.expm1(exponent) * 1e-9


Table = tuple[ArrayLike, ArrayLike]


@dataclass(frozen=True, kw_only=True, eq=False)
class SourceSpectrum:
    """Power of a source over wavelength, in W, W m-2 or W m-2 sr-1 as the user states."""

    wavelength_nm: Array  # wavelengths of the continuum, ascending, shape (sample,), nm
    density: Array  # power per nm at them, linear between and zero outside, shape (sample,)
    line_nm: tuple[
        float, ...
    ] = ()  # wavelengths of lines too narrow for any grid, ascending, shape (line,), nm
    line_power: tuple[float, ...] = ()  # power of each, shape (line,)

    def __post_init__(self) -> None:
        wavelength, density = np.asarray(self.wavelength_nm, float), np.asarray(self.density, float)
        if wavelength.ndim != 1 or wavelength.shape != density.shape or wavelength.size < 2:
            raise BadInput(
                "a spectrum must have one density per wavelength and at least two, got shapes "
                f"{wavelength.shape} and {density.shape}"
            )
        if not (np.diff(wavelength) > 0.0).all() or not wavelength[0] > 0.0:
            raise BadInput("the wavelengths of a spectrum must be positive and ascend")
        if len(self.line_nm) != len(self.line_power):
            raise BadInput(
                f"each line must have a power, got {len(self.line_nm)} lines, "
                f"{len(self.line_power)} powers"
            )
        if (
            not np.isfinite(density).all()
            or density.min() < 0.0
            or min(self.line_power, default=0.0) < 0.0
        ):
            raise BadInput("the power of a spectrum must be finite and not negative")
        object.__setattr__(self, "wavelength_nm", read_only(wavelength))
        object.__setattr__(self, "density", read_only(density))

    def on(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the power per nm in the bands of a complete grid, shape (band,); widths depend on
        neighbours.

        Raises BadInput if the grid does not ascend, or has fewer than two bands.

        Notes
        -----
        A band's value is int hat S dl / int hat dl, hat linear from 1 at the band to 0 at its
        neighbours; a line of power P at a band of width w adds P / w. So the sum of value times
        band width (`cube.band_widths`) times any function that is linear between the bands is its
        exact integral over the spectrum, on every grid.
        """
        grid = require_grid(wavelength_nm)
        power = hat_integrals(grid, (self.wavelength_nm, self.density))
        for line, strength in zip(self.line_nm, self.line_power, strict=True):
            # Each band's hat at the line; zero for one outside the grid.
            power += strength * np.array(
                [np.interp(line, grid, unit, left=0.0, right=0.0) for unit in np.eye(grid.size)]
            )
        return power / band_widths(grid)

    def scale(self, factor: float) -> "SourceSpectrum":
        """Return the spectrum multiplied by a number."""
        powers = tuple(factor * power for power in self.line_power)
        return replace(self, density=factor * self.density, line_power=powers)

    def multiply(self, factor: Callable[[Array], Array]) -> "SourceSpectrum":
        """Return the spectrum multiplied by a function of wavelength, nm, such as a filter or a
        reflectance.
        """
        line_factors = factor(np.asarray(self.line_nm, float)) if self.line_nm else np.empty(0)
        powers = tuple(
            float(line_factor * power)
            for line_factor, power in zip(line_factors, self.line_power, strict=True)
        )
        return replace(self, density=self.density * factor(self.wavelength_nm), line_power=powers)

    def total(self, low_nm: float = 0.0, high_nm: float = np.inf) -> float:
        """Return the power between two wavelengths, nm."""
        low, high = max(low_nm, self.wavelength_nm[0]), min(high_nm, self.wavelength_nm[-1])
        lines = sum(
            p
            for nm, p in zip(self.line_nm, self.line_power, strict=True)
            if low_nm <= nm <= high_nm
        )
        if not high > low:
            return float(lines)
        inner_nm = self.wavelength_nm[(self.wavelength_nm > low) & (self.wavelength_nm < high)]
        edges = np.concatenate([[low], inner_nm, [high]])
        return float(
            np.trapezoid(np.interp(edges, self.wavelength_nm, self.density), edges) + lines
        )

    def through(self, table_nm: ArrayLike, table_values: ArrayLike) -> float:
        """Return the integral of the power times a table, linear between its wavelengths and zero
        outside: exact.
        """
        nm = np.asarray(table_nm, float)
        smooth = hat_integrals(
            nm[[0, -1]], (self.wavelength_nm, self.density), (nm, table_values)
        ).sum()
        lines = (
            np.interp(self.line_nm, nm, np.asarray(table_values, float), left=0.0, right=0.0)
            * self.line_power
        )
        return float(smooth + lines.sum())

    @property
    def lumens(self) -> float:
        """683 int V S dl: lm of W, lux of W m-2, cd m-2 of W m-2 sr-1."""
        return LUMENS_PER_WATT * self.through(*table("luminous_efficiency").values())


def sum_spectra(spectra: list[SourceSpectrum]) -> SourceSpectrum:
    """Return the sum of spectra, all lines kept."""
    fine = np.unique(np.concatenate([spectrum.wavelength_nm for spectrum in spectra]))
    density = sum(
        np.interp(fine, spectrum.wavelength_nm, spectrum.density, left=0.0, right=0.0)
        for spectrum in spectra
    )
    lines = sorted(
        (nm, p)
        for spectrum in spectra
        for nm, p in zip(spectrum.line_nm, spectrum.line_power, strict=True)
    )
    return SourceSpectrum(
        wavelength_nm=fine,
        density=np.asarray(density),
        line_nm=tuple(nm for nm, _ in lines),
        line_power=tuple(power for _, power in lines),
    )


def require_grid(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return a grid of wavelengths as an array; raise BadInput if it does not ascend or has fewer
    than two bands.
    """
    grid = np.atleast_1d(np.asarray(wavelength_nm, float))
    if grid.ndim != 1 or grid.size < 2:
        raise BadInput(
            f"a spectral grid must be a row of at least two bands, got shape {grid.shape}"
        )
    if not (np.diff(grid) > 0.0).all() or not grid[0] > 0.0:
        raise BadInput("the wavelengths of a spectral grid must be positive and ascend")
    return grid


def hat_integrals(grid: ArrayLike, *tables: Table) -> NDArray[np.float64]:
    """Return int hat_b f g dl of each band of a grid, shape (band,): hats are 1 at their band and 0
    at its neighbours.

    f and g are tables of ascending wavelengths, nm, and values, linear between and zero outside; at
    most two.

    Notes
    -----
    Simpson's rule between all knots, of the grid and of the tables, is exact: the product there is
    a cubic at most.
    """
    bands = np.asarray(grid, float)
    arrays = [(np.asarray(nm, float), np.asarray(value, float)) for nm, value in tables]
    low, high = (
        max(bands[0], *(nm[0] for nm, _ in arrays)),
        min(bands[-1], *(nm[-1] for nm, _ in arrays)),
    )
    total = np.zeros(bands.size)
    if not high > low:
        return total
    knots = np.unique(np.concatenate([bands, *(nm for nm, _ in arrays)]))
    knots = np.concatenate([[low], knots[(knots > low) & (knots < high)], [high]])
    centre = 0.5 * (knots[1:] + knots[:-1])
    lower_band = np.clip(np.searchsorted(bands, centre) - 1, 0, bands.size - 2)
    for position, weight in ((knots[:-1], 1.0), (centre, 4.0), (knots[1:], 1.0)):
        width = weight / 6.0 * np.diff(knots)
        for nm, value in arrays:
            width = width * np.interp(position, nm, value)
        rise = (position - bands[lower_band]) / (bands[lower_band + 1] - bands[lower_band])
        np.add.at(total, lower_band, (1.0 - rise) * width)
        np.add.at(total, lower_band + 1, rise * width)
    return total


def spectral_grid(
    sources: Sequence[SourceSpectrum],
    response_nm: ArrayLike,
    response: ArrayLike,
    *,
    tolerance: float = 0.003,
    spectra: Sequence[tuple[ArrayLike, ArrayLike]] = (),
) -> Array:
    """Return the bands for sources and a sensor, ascending, shape (band,), nm.

    They are both ends of the response, each line between them, and bands where response or spectra
    are most curved.

    Parameters
    ----------
    sources, spectra
        Spectra of the lights; reflectances and transmittances that multiply them, as wavelengths
        and values.
    response_nm, response
        The sensor's response per W at wavelengths, ascending, linear between them; the grid covers
        where it is above 0.
    tolerance
        Largest error of any source's detected light, as a sum over |error| between bands, as a
        fraction of it.
    """
    if not tolerance > 0.0:
        raise BadInput(f"the tolerance of a spectral grid must be positive, got {tolerance:g}")
    sensor_nm, sensor_response = np.asarray(response_nm, float), np.asarray(response, float)
    low, high = _span(sensor_nm, sensor_response)
    grid = _start(low, high, [nm for source in sources for nm in source.line_nm if low < nm < high])
    knots = [
        sensor_nm,
        *(np.asarray(nm, float) for nm, _ in spectra),
        *(source.wavelength_nm for source in sources),
    ]
    fine = np.unique(np.concatenate([np.arange(low, high, 1.0), grid, *knots]))
    fine = fine[(fine >= low) & (fine <= high)]
    sensor = np.interp(fine, sensor_nm, sensor_response, left=0.0, right=0.0)
    factors = [
        sensor,
        *(
            sensor * np.interp(fine, np.asarray(nm, float), np.asarray(v, float))
            for nm, v in spectra
        ),
    ]
    while True:
        error, next_nm = _largest_error(grid, fine, factors, sources)
        if error <= tolerance:
            return grid
        grid = np.union1d(grid, next_nm)


def _span(wavelength_nm: Array, response: Array) -> tuple[float, float]:
    positive = np.flatnonzero(response > 0.0)
    if positive.size == 0:
        raise BadInput(
            "a sensor must respond at some wavelength, got a response that is nowhere positive"
        )
    first, last = max(positive[0] - 1, 0), min(positive[-1] + 1, len(response) - 1)
    if first == last:
        raise BadInput("a sensor's response must have at least two wavelengths, got one")
    return float(wavelength_nm[first]), float(wavelength_nm[last])


def _start(
    low: float, high: float, lines: list[float], widest_nm: float = 50.0, foot_nm: float = 4.0
) -> Array:
    """Return an equidistant grid with every line, and a neighbour on both sides of it where no
    other band is close.
    """
    grid = np.linspace(low, high, max(2, int(np.ceil((high - low) / widest_nm)) + 1))
    grid = np.union1d(grid, lines)
    for line in lines:
        for foot in (line - foot_nm, line + foot_nm):
            in_between = (grid > min(foot, line)) & (grid < max(foot, line))
            if low < foot < high and not in_between.any():
                grid = np.union1d(grid, foot)
    return grid


def _largest_error(
    grid: Array, fine: Array, factors: Sequence[Array], sources: Sequence[SourceSpectrum]
) -> tuple[float, float]:
    """Return the largest relative error of any source seen through any factor, and the wavelength
    of the next band.

    That is where the factor is farthest from the line between bands, in the interval that adds most
    to the error. A source is averaged over bands (`SourceSpectrum.on`), so that only the bending of
    a factor between bands is an error.
    """
    max_error, max_error_nm = 0.0, 0.0
    interval = np.clip(np.searchsorted(grid, fine, side="right") - 1, 0, grid.size - 2)
    width = band_widths(fine)
    curves = [
        np.abs(factor - np.interp(fine, grid, np.interp(grid, fine, factor))) for factor in factors
    ]
    for source in sources:
        density = np.interp(fine, source.wavelength_nm, source.density, left=0.0, right=0.0) * width
        lines = np.asarray(source.line_nm, float)
        for factor, curve in zip(factors, curves, strict=True):
            signal = np.sum(factor * density)
            signal += np.sum(
                np.interp(lines, fine, factor, left=0.0, right=0.0) * np.asarray(source.line_power)
            )
            product = curve * density
            if signal > 0.0 and product.sum() / signal > max_error:
                max_error = float(product.sum() / signal)
                worst_interval = int(
                    np.argmax(np.bincount(interval, weights=product, minlength=grid.size - 1))
                )
                max_error_nm = float(
                    fine[np.argmax(np.where(interval == worst_interval, curve, 0.0))]
                )
    return max_error, max_error_nm


@cache
def table(name: str) -> dict[str, Array]:
    """Return the columns of `tables/name.csv` by their headings."""
    text = (resources.files("simulate.radiance") / "tables" / f"{name}.csv").read_text(
        encoding="utf-8"
    )
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    return {
        heading: read_only(column)
        for heading, column in zip(lines[0].split(","), values.T, strict=True)
    }
