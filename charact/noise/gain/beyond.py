"""The light's noise beyond the band in which its spectrum is kept: what pixels and their neighbours still tell of it.

The autocovariance at no separation, one column and one row is the integral of the power over all frequencies times
1, cos(2 pi x) and cos(2 pi y). Less what lies inside the band, it is the part beyond: a white floor shows in the first
and hardly in the other two, blurred pulses show in all three.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.snr.area import BINNING, shares_of
from charact.noise.stack.spectrum import BAND_CY_PER_PX, ROW_LIMIT_CY
from charact.noise.stack.stack_statistics import StackStatistics

Array = NDArray[np.float64]

# Points along each axis of the quarter plane at which power is summed, and parts of the step between them that the
# rim of the band cuts off.
POINTS, PARTS = 8, 12


@dataclass(frozen=True, kw_only=True)
class Beyond:
    """Integrals of the power of the light's noise over the signal beyond the band.

    Parameters
    ----------
    value_dn
        Integrals with 1, cos(2 pi x) and cos(2 pi y), shape (3,), DN.
    inside_dn
        The same inside the band, which was taken away from the whole, shape (3,), DN.
    noise
        Factors of 1, P and P^2 in the variance density of the power P, DN^2, DN and 1.
    column_cy_per_px, row_cy_per_px
        Frequencies beyond the band, cycles per column pitch, shape (point,).
    cosines
        Weights of their power in the integrals, shape (3, point).
    share
        Part of all modes that each stands for, shape (point,).
    """

    value_dn: Array
    inside_dn: Array
    noise: tuple[float, float, float]
    column_cy_per_px: Array
    row_cy_per_px: Array
    cosines: Array
    share: Array

    def covariance(self, power: Array) -> Array:
        """Return the covariance of the integrals under a power (point,), DN, shape (3, 3), DN^2.

        N pixels have N/2 independent complex modes, whose power P is known to P; steps between the bins leave
        `BINNING` of what lies inside.
        """
        none, once, twice = self.noise
        density = (none + once * power + twice * power**2) / self.share
        return self.cosines * density @ self.cosines.T + np.diag((BINNING * self.inside_dn) ** 2)


def beyond_of(flats: Sequence[StackStatistics], darks: Sequence[StackStatistics], weight: Array, signal: Array, known: Array, name: str
              ) -> Beyond:  # fmt: skip
    """Return what pixels and their neighbours tell of the light's noise beyond the band.

    Parameters
    ----------
    flats, darks
        Pooled levels, each with its dark.
    weight
        Weight of what each has above its dark, shape (flat,), 1/DN; of sum 1 times the signal.
    signal
        Signal of each, DN.
    known
        Independent exposures of each.
    name
        "few" or "many": the lags in time that are allowed for.
    """
    bins = flats[0].bins
    shares = shares_of(bins).modes
    turned = 2.0 * np.pi * np.stack([bins.column_cy_per_px, bins.row_cy_per_px * bins.row_pitch])
    cosines = np.concatenate([np.ones((1, turned.shape[1])), np.cos(turned)]) * shares

    def of(level: StackStatistics) -> tuple[Array, Array]:
        spectrum = getattr(level, name)
        whole = spectrum.variance_dn2 * np.array([1.0, level.neighbour_correlation, level.below_correlation])
        return whole, cosines @ spectrum.power_dn2[:, 0]

    above = [np.subtract(of(flat), of(dark)) for flat, dark in zip(flats, darks, strict=True)]
    whole, inside = np.tensordot(weight, np.array(above), 1)
    pixels = flats[0].pixels / len(np.unique(flats[0].parity))
    none, once, twice = 0.0, 0.0, 0.0
    for w, dark, light, count in zip(weight, darks, signal, known, strict=True):
        each = w**2 * 2.0 / (pixels * count)
        none += each * dark.variance_dn2**2
        once += each * 2.0 * light * dark.variance_dn2
        twice += each * light**2
    for dark in {dark.label: dark for dark in darks}.values():
        shared = sum(w for w, own in zip(weight, darks, strict=True) if own.label == dark.label)
        none += (shared * dark.variance_sd_dn2) ** 2
    column, row, share = points_beyond(bins.row_pitch)
    waves = np.stack([np.ones_like(column), np.cos(2.0 * np.pi * column), np.cos(2.0 * np.pi * row * bins.row_pitch)])
    return Beyond(value_dn=whole - inside, inside_dn=inside, noise=(float(none), float(once), float(twice)),
                  column_cy_per_px=column, row_cy_per_px=row, cosines=waves * share, share=share)  # fmt: skip


def points_beyond(row_pitch: float) -> tuple[Array, Array, Array]:
    """Return frequencies beyond the band, along rows and columns, cycles per column pitch, and the part of each."""
    fine = (np.arange(POINTS * PARTS) + 0.5) / (2 * POINTS * PARTS)
    y, x = np.meshgrid(fine, fine, indexing="ij")
    out = (np.hypot(x, y / row_pitch) >= BAND_CY_PER_PX) | (y > ROW_LIMIT_CY)

    def block_sum(values: Array) -> Array:
        return (values * out).reshape(POINTS, PARTS, POINTS, PARTS).sum(axis=(1, 3)).ravel()

    count = block_sum(np.ones_like(x))
    some = count > 0
    return block_sum(x)[some] / count[some], block_sum(y)[some] / count[some] / row_pitch, count[some] / fine.size**2


def integrals(beyond: Beyond, power: Callable[[Array, Array], Array]) -> Array:
    """Return the integrals of a power, of frequencies along rows and columns -> (draw, point), shape (draw, 3), DN."""
    return power(beyond.column_cy_per_px, beyond.row_cy_per_px) @ beyond.cosines.T
