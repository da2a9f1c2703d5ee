"""Transfer functions of the stages."""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import j1, sici

from simulate.arrays import Array
from simulate.camera.grid import ACCURACY, Grid

# Replicas of the lattice that are taken together, first and last.
REPLICA_GROUPS = ((1, 1), (2, 2), (3, 4), (5, 8), (9, 16), (17, 32))


class StageBlur(Protocol):
    """Linear, shift-invariant blur; hashable, so that products of transfers can be cached."""

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        """Transfer at frequencies along rows and along columns, cycles/mm at the photocathode; 1 at
        zero.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Aberration-limited lens.

    Notes
    -----
    exp(-2 (pi f s)^2) times the diffraction transfer (2/pi)(acos x - x sqrt(1 - x^2)), x = f lambda
    N (Goodman, Introduction to Fourier Optics, 6.4).
    """

    aberration_blur_um: float
    f_number: float
    wavelength_um: float = 0.7

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        frequency = np.hypot(fx_per_mm, fy_per_mm)
        x = np.minimum(frequency * self.wavelength_um * 1e-3 * self.f_number, 1.0)
        diffraction = (np.arccos(x) - x * np.sqrt(1.0 - x * x)) * 2.0 / np.pi
        return diffraction * np.exp(
            -2.0 * (np.pi * frequency * self.aberration_blur_um * 1e-3) ** 2
        )


@dataclass(frozen=True, kw_only=True)
class Defocus:
    """Defocused lens: a point becomes a uniform disc.

    Notes
    -----
    2 J1(x)/x, x = pi f D: geometrical optics, negative beyond the first zero (Goodman, Introduction
    to Fourier Optics, 6.4). It holds where the disc is wider than the diffraction pattern.
    """

    shift_um: float  # distance of the focus from the photocathode, um
    f_number: float  # dimensionless; the disc's diameter is D = shift / f_number

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        argument = (
            np.pi * np.hypot(fx_per_mm, fy_per_mm) * abs(self.shift_um) * 1e-3 / self.f_number
        )
        return np.divide(
            2.0 * j1(argument), argument, out=np.ones_like(argument), where=argument > 0
        )


@dataclass(frozen=True, kw_only=True)
class GapSpread:
    """Gaussian spread, as in the proximity gap: exp(-(pi f rho)^2), rho its 1/e radius in um."""

    radius_um: float

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        return np.exp(-((np.pi * self.radius_um * 1e-3) ** 2) * (fx_per_mm**2 + fy_per_mm**2))


@dataclass(frozen=True, kw_only=True)
class TubeShare:
    """Part of the tube's blur before or after the gain: exp(-share (f/fc)^n) (Johnson's form)."""

    share: float
    frequency_lp_per_mm: float
    exponent: float

    @classmethod
    def of(cls, tube: Any, share: float) -> "TubeShare":
        """Return a share of the blur of a described tube."""
        return cls(
            share=share,
            frequency_lp_per_mm=float(tube.mtf_frequency_lp_per_mm),
            exponent=float(tube.mtf_exponent),
        )

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        frequency = np.hypot(fx_per_mm, fy_per_mm)
        return np.exp(-self.share * (frequency / self.frequency_lp_per_mm) ** self.exponent)


@dataclass(frozen=True, kw_only=True)
class HaloBlur:
    """Halo of photoelectrons backscattered from the MCP, which land up to twice the gap away.

    Notes
    -----
    An electron that leaves the MCP at angle t with the fraction e of the gap's energy lands at r =
    2 e d sin(2t). For cosine emission r/(2 e d) = x has the density x/sqrt(1 - x^2), whose plane
    transform is sin(a)/a, a = 4 pi e d f. Elastic electrons have e = 1; energies uniform in 0..1
    give Si(a)/a at e = 1.
    """

    fraction: float
    gap_mm: float
    elastic_share: float

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        argument = 4.0 * np.pi * self.gap_mm * np.hypot(fx_per_mm, fy_per_mm)
        rim = np.sinc(argument / np.pi)
        peaked = np.divide(
            sici(argument)[0], argument, out=np.ones_like(argument), where=argument > 0
        )
        disc = self.elastic_share * rim + (1.0 - self.elastic_share) * peaked
        return 1.0 - self.fraction + self.fraction * disc


@dataclass(frozen=True, kw_only=True)
class FibreTaper:
    """Fibres and interfaces: |2 J1(u)/u| exp(-(f/f0)^2), u = pi p f, f at the detector."""

    fibre_pitch_um: float
    interface_lp_per_mm: float
    demagnification: float

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        at_detector = np.hypot(fx_per_mm, fy_per_mm) * self.demagnification
        argument = np.pi * self.fibre_pitch_um * 1e-3 * at_detector
        fibre = np.divide(
            2.0 * j1(argument), argument, out=np.ones_like(argument), where=argument > 0
        )
        return np.abs(fibre) * np.exp(-((at_detector / self.interface_lp_per_mm) ** 2))


@dataclass(frozen=True, kw_only=True)
class PixelAperture:
    """Rectangle over which a pixel collects: sinc(w f) along rows and columns; sizes at the
    photocathode.
    """

    width_mm: float
    height_mm: float

    @classmethod
    def of(cls, grid: Grid, height: int) -> "PixelAperture":
        """Return the aperture of a pixel as read, so many rows high."""
        return cls(width_mm=grid.pitch_x_mm, height_mm=height * grid.pitch_y_mm)

    def transfer(self, fx_per_mm: Array, fy_per_mm: Array) -> Array:
        return np.sinc(fx_per_mm * self.width_mm) * np.sinc(fy_per_mm * self.height_mm)


def product(blurs: tuple[StageBlur, ...], fx: Array, fy: Array) -> NDArray[np.float64]:
    """Return the product of the transfers of consecutive blurs, at frequencies of one shape,
    cycles/mm.
    """
    transfer = np.ones(fx.shape)
    for blur in blurs:
        transfer = transfer * blur.transfer(fx, fy)
    return transfer


def fold_transfer(
    blurs: tuple[StageBlur, ...],
    aperture: PixelAperture,
    fx: Array,
    fy: Array,
    *,
    cell_x_mm: float,
    cell_y_mm: float,
) -> NDArray[np.float64]:
    """Transfer from cells to pixels that gives lattice events the noise of continuously placed
    events.

    Parameters
    ----------
    blurs, aperture
        Blurs before the rectangle over which a pixel collects.
    fx, fy
        Frequencies of the lattice along a row, shape (col,), and along a column, shape (row,),
        cycles/mm, up to half a cycle per cell.
    cell_x_mm, cell_y_mm
        Pitch of the cells.

    Returns
    -------
    NDArray
        sqrt(sum over all m, n of |H(fx + m / cell_x, fy + n / cell_y)|^2), H = blurs x aperture,
        with the sign of the term (0, 0), shape (row, col). Independent cells then have, on the
        pixels, the covariance of continuous events.

    Notes
    -----
    The aperture falls as 1/f only: without a blur, 5 % of its power lies beyond four cycles per
    pixel. Its part of the sum is closed, sum_m sinc^2(w (f + m / c)) = (c / w)^2 sin^2(pi w f) /
    sin^2(pi c f) where w is a whole number of c (Lighthill 1958, cotangent series). Far replicas
    are taken in groups, with the blur of one in the middle.
    """
    columns, rows = np.asarray(fx, float), np.asarray(fy, float)
    x, column_power = _aperture_power(columns, aperture.width_mm, cell_x_mm)
    y, row_power = _aperture_power(rows, aperture.height_mm, cell_y_mm)
    power = np.zeros((rows.size, columns.size))
    for shifted_y, of_rows in zip(y, row_power, strict=True):
        for shifted_x, of_columns in zip(x, column_power, strict=True):
            central = shifted_y is y[0] and shifted_x is x[0]
            if central or _largest(blurs, shifted_x, shifted_y) > ACCURACY.min_replica_transfer:
                blurred = product(
                    blurs, *np.broadcast_arrays(shifted_x[None, :], shifted_y[:, None])
                )
                power += blurred**2 * of_columns[None, :] * of_rows[:, None]
    fx2, fy2 = np.broadcast_arrays(columns[None, :], rows[:, None])
    return np.copysign(np.sqrt(power), product((*blurs, aperture), fx2, fy2))


def _aperture_power(
    frequency: Array, width_mm: float, cell_mm: float
) -> tuple[list[Array], list[Array]]:
    """Frequencies of the replicas of an axis, the central one first, and their power; the last
    include all beyond.
    """
    cells = width_mm / cell_mm
    if abs(cells - round(cells)) > 1e-9:
        raise ValueError(f"a pixel must be a whole number of cells wide, got {cells:g}")
    total_power = (np.sinc(width_mm * frequency) / np.sinc(cell_mm * frequency)) ** 2
    replicas, powers = [frequency], [np.sinc(width_mm * frequency) ** 2]
    for side in (-1, 1):
        for first, last in REPLICA_GROUPS:
            replicas.append(frequency + side * 0.5 * (first + last) / cell_mm)
            group = frequency + side * np.arange(first, last + 1)[:, None] / cell_mm
            powers.append(np.sum(np.sinc(width_mm * group) ** 2, axis=0))
    remainder = 0.5 * np.maximum(total_power - sum(powers), 0.0)
    powers[len(REPLICA_GROUPS)], powers[-1] = (
        powers[len(REPLICA_GROUPS)] + remainder,
        powers[-1] + remainder,
    )
    return replicas, powers


def _largest(blurs: tuple[StageBlur, ...], fx: Array, fy: Array) -> float:
    """Largest transfer of blurs on a few of the frequencies."""
    few_x, few_y = (
        np.append(f[:: max(1, f.size // 16)], f[np.argmin(np.abs(f))]) for f in (fx, fy)
    )
    return float(np.abs(product(blurs, *np.broadcast_arrays(few_x[None, :], few_y[:, None]))).max())
