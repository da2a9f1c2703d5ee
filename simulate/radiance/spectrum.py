"""A spectrum of a source: a continuum and lines, averaged over the bands of a grid so that no line is lost."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from labdata.frames import read_only
from simulate.radiance.cube import band_widths
from simulate.radiance.photometry import EYE_NM, EYE_SHARE, LUMENS_PER_WATT

Table = tuple[ArrayLike, ArrayLike]


@dataclass(frozen=True, kw_only=True, eq=False)
class SourceSpectrum:
    """Power of a source over wavelength; of what kind (W, W m-2, W m-2 sr-1) its owner says.

    Parameters
    ----------
    wavelength_nm
        Wavelengths of the continuum, ascending, shape (sample,), nm.
    density
        Power per nm at them, linear between and zero outside, shape (sample,).
    line_nm
        Wavelengths of lines too narrow for any grid, ascending, shape (line,), nm.
    line_power
        Power of each, shape (line,).
    """

    wavelength_nm: NDArray[np.floating]
    density: NDArray[np.floating]
    line_nm: tuple[float, ...] = ()
    line_power: tuple[float, ...] = ()

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
            raise BadInput(f"each line must have a power, got {len(self.line_nm)} lines, {len(self.line_power)} powers")
        if not np.isfinite(density).all() or density.min() < 0.0 or min(self.line_power, default=0.0) < 0.0:
            raise BadInput("the power of a spectrum must be finite and not negative")
        object.__setattr__(self, "wavelength_nm", read_only(wavelength))
        object.__setattr__(self, "density", read_only(density))

    def on(self, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the power per nm in the bands of a grid, shape (band,).

        Parameters
        ----------
        wavelength_nm
            The grid, ascending, shape (band,), nm; always the whole grid, for a band's width is set by its neighbours.

        Raises
        ------
        BadInput
            If the grid does not ascend, or has fewer than two bands.

        Notes
        -----
        A band's value is int hat S dl / int hat dl, hat linear from 1 at the band to 0 at its neighbours; a line of
        power P at a band of width w adds P / w. So the sum of value times band width (`cube.band_widths`) times any
        function that is linear between the bands is its exact integral over the spectrum, on every grid.
        """
        grid = require_grid(wavelength_nm)
        power = hat_integrals(grid, (self.wavelength_nm, self.density))
        for line, strength in zip(self.line_nm, self.line_power, strict=True):
            power += strength * _hats_at(grid, line)
        return power / band_widths(grid)

    def scaled(self, factor: float) -> "SourceSpectrum":
        """Return the spectrum with all powers times a factor."""
        powers = tuple(factor * power for power in self.line_power)
        return replace(self, density=factor * self.density, line_power=powers)

    def filtered(self, factor: Callable[[NDArray[np.floating]], NDArray[np.floating]]) -> "SourceSpectrum":
        """Return the spectrum times a function of wavelength, nm: a filter, a reflectance."""
        shares = factor(np.asarray(self.line_nm, float)) if self.line_nm else np.empty(0)
        powers = tuple(float(share * power) for share, power in zip(shares, self.line_power, strict=True))
        return replace(self, density=self.density * factor(self.wavelength_nm), line_power=powers)

    def total(self, low_nm: float = 0.0, high_nm: float = np.inf) -> float:
        """Return the power between two wavelengths, nm."""
        low, high = max(low_nm, self.wavelength_nm[0]), min(high_nm, self.wavelength_nm[-1])
        lines = sum(p for nm, p in zip(self.line_nm, self.line_power, strict=True) if low_nm <= nm <= high_nm)
        if not high > low:
            return float(lines)
        inside = self.wavelength_nm[(self.wavelength_nm > low) & (self.wavelength_nm < high)]
        edges = np.concatenate([[low], inside, [high]])
        return float(np.trapezoid(np.interp(edges, self.wavelength_nm, self.density), edges) + lines)

    def through(self, table_nm: ArrayLike, share: ArrayLike) -> float:
        """Return the integral of the power times a table, linear between its wavelengths and zero outside: exact."""
        nm = np.asarray(table_nm, float)
        smooth = hat_integrals(nm[[0, -1]], (self.wavelength_nm, self.density), (nm, share)).sum()
        lines = np.interp(self.line_nm, nm, np.asarray(share, float), left=0.0, right=0.0) * self.line_power
        return float(smooth + lines.sum())

    @property
    def lumens(self) -> float:
        """683 int V S dl: lm of W, lux of W m-2, cd m-2 of W m-2 sr-1."""
        return LUMENS_PER_WATT * self.through(EYE_NM, EYE_SHARE)


def sum_spectra(parts: list[SourceSpectrum]) -> SourceSpectrum:
    """Return the sum of spectra, all lines kept."""
    fine = np.unique(np.concatenate([part.wavelength_nm for part in parts]))
    density = sum(np.interp(fine, part.wavelength_nm, part.density, left=0.0, right=0.0) for part in parts)
    lines = sorted((nm, p) for part in parts for nm, p in zip(part.line_nm, part.line_power, strict=True))
    return SourceSpectrum(
        wavelength_nm=fine,
        density=np.asarray(density),
        line_nm=tuple(nm for nm, _ in lines),
        line_power=tuple(power for _, power in lines),
    )


def require_grid(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return a grid of wavelengths as an array, or refuse one that does not ascend or has fewer than two bands."""
    grid = np.atleast_1d(np.asarray(wavelength_nm, float))
    if grid.ndim != 1 or grid.size < 2:
        raise BadInput(f"a spectral grid must be a row of at least two bands, got shape {grid.shape}")
    if not (np.diff(grid) > 0.0).all() or not grid[0] > 0.0:
        raise BadInput("the wavelengths of a spectral grid must be positive and ascend")
    return grid


def hat_integrals(grid: ArrayLike, *tables: Table) -> NDArray[np.float64]:
    """Return int hat_b f g dl of each band of a grid, shape (band,): hats are 1 at their band and 0 at its neighbours.

    Parameters
    ----------
    grid
        Bands, ascending, at least two, shape (band,), nm.
    tables
        At most two pairs of ascending wavelengths, nm, and values, linear between and zero outside.

    Notes
    -----
    Simpson's rule between all knots, of the grid and of the tables, is exact: the product there is a cubic at most.
    """
    bands = np.asarray(grid, float)
    known = [(np.asarray(nm, float), np.asarray(value, float)) for nm, value in tables]
    low, high = max(bands[0], *(nm[0] for nm, _ in known)), min(bands[-1], *(nm[-1] for nm, _ in known))
    total = np.zeros(bands.size)
    if not high > low:
        return total
    knots = np.unique(np.concatenate([bands, *(nm for nm, _ in known)]))
    knots = np.concatenate([[low], knots[(knots > low) & (knots < high)], [high]])
    middle = 0.5 * (knots[1:] + knots[:-1])
    left = np.clip(np.searchsorted(bands, middle) - 1, 0, bands.size - 2)
    for at, weight in ((knots[:-1], 1.0), (middle, 4.0), (knots[1:], 1.0)):
        part = weight / 6.0 * np.diff(knots)
        for nm, value in known:
            part = part * np.interp(at, nm, value)
        rise = (at - bands[left]) / (bands[left + 1] - bands[left])
        np.add.at(total, left, (1.0 - rise) * part)
        np.add.at(total, left + 1, rise * part)
    return total


def _hats_at(grid: NDArray[np.float64], wavelength_nm: float) -> NDArray[np.float64]:
    """Return each band's hat at one wavelength; zero for one outside the grid."""
    return np.array([np.interp(wavelength_nm, grid, unit, left=0.0, right=0.0) for unit in np.eye(grid.size)])
