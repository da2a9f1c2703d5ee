"""Lamps and their intensity distributions, in the lamp's frame with the axis as z."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labdata.errors import BadInput
from labdata.frames import read_only
from simulate.radiance.spectrum import SourceSpectrum


class Distribution(Protocol):
    """Fraction of a lamp's light per solid angle."""

    def per_sr(self, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the fraction of the flux per sr in directions (ray, 3), shape (ray,); its integral is 1."""
        ...


@dataclass(frozen=True, kw_only=True)
class Isotropic:
    """The same in all directions."""

    def per_sr(self, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return 1/(4 pi), sr-1."""
        return np.full(len(direction), 0.25 / np.pi)


@dataclass(frozen=True, kw_only=True)
class Cosine:
    """A Lambertian emitter: the cosine of the angle from the axis."""

    def per_sr(self, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return cos/pi, sr-1, zero behind."""
        return np.maximum(direction[:, 2], 0.0) / np.pi


@dataclass(frozen=True, kw_only=True)
class SpotBeam:
    """A beam, cos^m of the angle from the axis.

    Parameters
    ----------
    half_angle_deg
        Angle from the axis at half intensity, degrees.
    """

    half_angle_deg: float

    def __post_init__(self) -> None:
        if not 0.1 <= self.half_angle_deg < 90.0:
            raise BadInput(f"half_angle_deg must lie in [0.1, 90), got {self.half_angle_deg:g}")

    @property
    def power(self) -> float:
        """m of cos^m, dimensionless."""
        return float(np.log(0.5) / np.log(np.cos(np.deg2rad(self.half_angle_deg))))

    def per_sr(self, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return (m + 1)/(2 pi) cos^m, sr-1, zero behind."""
        return (self.power + 1.0) / (2.0 * np.pi) * np.maximum(direction[:, 2], 0.0) ** self.power


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredDistribution:
    """Measured intensities, as in goniophotometer and IES files.

    Parameters
    ----------
    polar_deg
        Angles from the axis, ascending from 0 or more to at most 180, shape (polar,), degrees; dark outside.
    azimuth_deg
        Angles around it from the frame's x towards its y, ascending from 0, shape (azimuth,), degrees: one angle for a
        lamp that is the same all around, else up to 90 or 180 (mirrored) or 360.
    candela
        Intensities in any unit, shape (azimuth, polar).
    """

    polar_deg: NDArray[np.floating]
    azimuth_deg: NDArray[np.floating]
    candela: NDArray[np.floating]
    _total: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        polar, azimuth = np.asarray(self.polar_deg, float), np.asarray(self.azimuth_deg, float)
        candela = np.asarray(self.candela, float)
        if candela.shape != (azimuth.size, polar.size):
            raise BadInput(
                f"candela must have the shape (azimuth, polar) = ({azimuth.size}, {polar.size}), got {candela.shape}"
            )
        if polar.size < 2 or not (np.diff(polar) > 0.0).all() or polar[0] < 0.0 or polar[-1] > 180.0:
            raise BadInput("polar_deg must ascend within [0, 180] and have at least two angles")
        if not (np.diff(azimuth) > 0.0).all() or azimuth[0] != 0.0 or azimuth[-1] not in (0.0, 90.0, 180.0, 360.0):
            raise BadInput(f"azimuth_deg must ascend from 0 to 0, 90, 180 or 360, got {azimuth.tolist()}")
        if not np.isfinite(candela).all() or candela.min() < 0.0 or not candela.max() > 0.0:
            raise BadInput("candela must be finite, not negative, and somewhere positive")
        for name, values in (("polar_deg", polar), ("azimuth_deg", azimuth), ("candela", candela)):
            object.__setattr__(self, name, read_only(values))
        object.__setattr__(self, "_total", self._integral())

    @property
    def integral(self) -> float:
        """Integral of the intensities over all directions: lumens where they are candela."""
        return self._total

    def per_sr(self, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the fraction of the flux per sr, linear in both angles between the table's."""
        polar = np.rad2deg(np.arccos(np.clip(direction[:, 2], -1.0, 1.0)))
        azimuth = np.rad2deg(np.arctan2(direction[:, 1], direction[:, 0])) % 360.0
        return self._candela(polar, azimuth) / self._total

    def _candela(self, polar: NDArray[np.floating], azimuth: NDArray[np.floating]) -> NDArray[np.float64]:
        column = np.clip(np.searchsorted(self.polar_deg, polar, side="right") - 1, 0, self.polar_deg.size - 2)
        along = (polar - self.polar_deg[column]) / np.diff(self.polar_deg)[column]
        inside = (polar >= self.polar_deg[0]) & (polar <= self.polar_deg[-1])
        row, across = self._row(azimuth)
        following = np.minimum(row + 1, self.azimuth_deg.size - 1)
        near = self.candela[row, column] * (1.0 - along) + self.candela[row, column + 1] * along
        far = self.candela[following, column] * (1.0 - along) + self.candela[following, column + 1] * along
        return np.where(inside, near * (1.0 - across) + far * across, 0.0)

    def _row(self, azimuth: NDArray[np.floating]) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        last = self.azimuth_deg[-1]
        if last == 0.0:
            return np.zeros(azimuth.shape, np.intp), np.zeros(azimuth.shape)
        folded = azimuth
        if last <= 180.0:
            folded = np.where(folded > 180.0, 360.0 - folded, folded)
        if last <= 90.0:
            folded = np.where(folded > 90.0, 180.0 - folded, folded)
        row = np.clip(np.searchsorted(self.azimuth_deg, folded, side="right") - 1, 0, self.azimuth_deg.size - 2)
        return row, (folded - self.azimuth_deg[row]) / np.diff(self.azimuth_deg)[row]

    def _integral(self) -> float:
        """Return the integral over all directions: exact in azimuth, by midpoints in the polar angle."""
        edges = np.linspace(self.polar_deg[0], self.polar_deg[-1], 3600)
        middle = 0.5 * (edges[1:] + edges[:-1])
        ring = np.cos(np.deg2rad(edges[:-1])) - np.cos(np.deg2rad(edges[1:]))
        if self.azimuth_deg.size == 1:
            around = self.candela[0]
        else:
            around = np.trapezoid(self.candela, self.azimuth_deg, axis=0) / self.azimuth_deg[-1]
        return float(2.0 * np.pi * np.sum(np.interp(middle, self.polar_deg, around) * ring))


@dataclass(frozen=True, kw_only=True, eq=False)
class Lamp:
    """Spectrum and intensity distribution of a lamp, without a position.

    Parameters
    ----------
    flux
        Radiant flux, W over wavelength (`spectrum`).
    distribution
        Intensity distribution in the lamp's frame, z along its axis.
    """

    flux: SourceSpectrum
    distribution: Distribution = field(default_factory=Isotropic)

    def intensity(self, direction: NDArray[np.floating], wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return the spectral radiant intensity, W sr-1 nm-1, shape (band, ray).

        Parameters
        ----------
        direction
            Unit vectors away from the lamp in its frame, shape (ray, 3).
        wavelength_nm
            The whole spectral grid, shape (band,), nm; a line's power lies in the bands around it
            (`SourceSpectrum.on`).
        """
        return self.flux.on(wavelength_nm)[:, None] * self.distribution.per_sr(direction)

    def exitance(self, area_m2: float, wavelength_nm: ArrayLike) -> NDArray[np.float64]:
        """Return what a surface of an area gives off when it is this lamp, W m-2 nm-1, shape (band,)."""
        return self.flux.on(wavelength_nm) / area_m2
