"""White-noise floor of the scintillation noise: K, the gain per electron of the CCD.

Shot noise of CCD electrons adds K mu to the power at every frequency, blurred photoelectron pulses
add k F^2 mu |H|^2. The fit of both gives K if little of the pulses lies beyond the spectral band.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from charact.estimators.noise.gain.model import NAMES, PixelReadoutModel, transfer
from charact.estimators.noise.gain.series import FlatSeries, dark_shares
from charact.estimators.noise.illumination import lognormal_draws
from charact.estimators.noise.thresholds import GAIN
from charact.frames.spectrum import BAND_CY_PER_PX, ROW_LIMIT_CY
from charact.frames.stack_statistics import StackStatistics, shares_of
from charact.frames.thresholds import STACK
from charact.method import Context
from labdata import Array, Posterior, has_tube


@dataclass(frozen=True, kw_only=True)
class OuterBand:
    """Integrals beyond the band of noise power over signal."""

    value_dn: Array  # integrals with 1, cos(2 pi x) and cos(2 pi y), shape (3,), DN
    inside_dn: Array  # integrals inside the band, already subtracted, shape (3,), DN
    noise: tuple[
        float, float, float
    ]  # factors of 1, P and P^2 in the variance density of the power P, DN^2, DN and 1
    # column_cy_per_px, row_cy_per_px: frequencies beyond the band, cycles per column pitch, shape
    # (point,)
    column_cy_per_px: Array
    row_cy_per_px: Array
    cosines: Array  # weights of their power in the integrals, shape (3, point)
    mode_fraction: Array  # fraction of all modes per point, shape (point,)

    def covariance(self, power: Array) -> Array:
        """Return the covariance of the integrals under a power (point,), DN, shape (3, 3), DN^2.

        N pixels have N/2 independent complex modes of power P with standard deviation P; binning
        adds the relative error `STACK.binning_sd` of the part inside.
        """
        none, once, twice = self.noise
        density = (none + once * power + twice * power**2) / self.mode_fraction
        return self.cosines * density @ self.cosines.T + np.diag(
            (STACK.binning_sd * self.inside_dn) ** 2
        )


def outer_band_of(
    pairs: Sequence[tuple[StackStatistics, StackStatistics]],
    weight: Array,
    signal: Array,
    known: Array,
    name: str,
) -> OuterBand:
    """Return the integrals beyond the band from variance and neighbour covariances.

    `pairs`: pooled levels with their darks. `weight`: of each flat above its dark, shape (flat,),
    1/DN; weights times signals sum to 1. `signal`: of each, DN. `known`: independent exposures of
    each flat. `name`: "few_lags" or "many_lags": the spectra with few or many temporal lags.
    """
    flats, darks = zip(*pairs, strict=True)
    bins = flats[0].bins
    shares = shares_of(bins).modes
    turned = 2.0 * np.pi * np.stack([bins.column_cy_per_px, bins.row_cy_per_px * bins.row_pitch])
    cosines = np.concatenate([np.ones((1, turned.shape[1])), np.cos(turned)]) * shares

    def of(level: StackStatistics) -> tuple[Array, Array]:
        spectrum = getattr(level, name)
        total_power = spectrum.variance_dn2 * np.array(
            [1.0, level.neighbour_correlation, level.below_correlation]
        )
        return total_power, cosines @ spectrum.power_dn2[:, 0]

    excess = [np.subtract(of(flat), of(dark)) for flat, dark in pairs]
    total, in_band = np.tensordot(weight, np.array(excess), 1)
    pixels = flats[0].pixels / len(np.unique(flats[0].parity))
    none, once, twice = 0.0, 0.0, 0.0
    for w, dark, light, count in zip(weight, darks, signal, known, strict=True):
        variance_factor = w**2 * 2.0 / (pixels * count)
        none += variance_factor * dark.variance_dn2**2
        once += variance_factor * 2.0 * light * dark.variance_dn2
        twice += variance_factor * light**2
    none += sum((shared * dark.variance_sd_dn2) ** 2 for dark, shared in dark_shares(darks, weight))
    column, row, mode_fraction = outer_points(bins.row_pitch)
    waves = np.stack(
        [
            np.ones_like(column),
            np.cos(2.0 * np.pi * column),
            np.cos(2.0 * np.pi * row * bins.row_pitch),
        ]
    )
    return OuterBand(
        value_dn=total - in_band,
        inside_dn=in_band,
        noise=(float(none), float(once), float(twice)),
        column_cy_per_px=column,
        row_cy_per_px=row,
        cosines=waves * mode_fraction,
        mode_fraction=mode_fraction,
    )


def outer_points(row_pitch: float) -> tuple[Array, Array, Array]:
    """Return frequencies beyond the band along rows and columns, cycles per column pitch, and the
    fraction of modes of each.
    """
    fine = (np.arange(GAIN.points * GAIN.subdivisions) + 0.5) / (
        2 * GAIN.points * GAIN.subdivisions
    )
    y, x = np.meshgrid(fine, fine, indexing="ij")
    out = (np.hypot(x, y / row_pitch) >= BAND_CY_PER_PX) | (y > ROW_LIMIT_CY)

    def block_sum(values: Array) -> Array:
        return (values * out).reshape(2 * (GAIN.points, GAIN.subdivisions)).sum(axis=(1, 3)).ravel()

    count = block_sum(np.ones_like(x))
    some = count > 0
    return (
        block_sum(x)[some] / count[some],
        block_sum(y)[some] / count[some] / row_pitch,
        count[some] / fine.size**2,
    )


def integrals(outer: OuterBand, power: Callable[[Array, Array], Array]) -> Array:
    """Return the integrals of a power, of frequencies along rows and columns -> (draw, point),
    shape (draw, 3), DN.
    """
    return power(outer.column_cy_per_px, outer.row_cy_per_px) @ outer.cosines.T


HIDDEN = (
    "no white-noise floor detected beneath the scintillation noise; take flats at low tube "
    "gain to measure K"
)
FILTERED = (
    "a low-pass filter of the readout correlates all noise, so that the white part, whose slope "
    "is K, cannot be separated; K needs a readout without such a filter"
)


@dataclass(frozen=True, kw_only=True)
class Floor:
    """Estimate of K."""

    draws: Array  # draws of K, shape (draw,), DN per electron
    is_detected: bool  # whether the white floor is detected
    source: str  # source of the draws, in words
    refusal_reason: str = ""  # why the floor is not detected


def floor_of(series: FlatSeries, posterior: Posterior, *, context: Context) -> Floor:
    """Return K from the detected floor, else from the sensor, else the range allowed by the
    spectrum.

    `series`: the flats of one setting; `posterior`: draws of covariance gain, blur and electron
    fraction, see `charact.estimators.noise.gain.model`.
    """
    rng = np.random.default_rng([context.seed, 31])
    white = not has_electronic_smoothing(series, context)
    draws = posterior["power"] * posterior["electron_share"]
    if white:
        pulses = float(np.median(posterior["power"] - draws)) * _outer_transfer(
            series, posterior, context
        )
        draws = draws + GAIN.beyond_band_sd * pulses * rng.standard_normal(len(draws))
        middle = float(np.median(draws))
        if middle > GAIN.floor_sd * float(np.std(draws)) and pulses < GAIN.max_pulse_ratio * middle:
            return Floor(
                draws=np.maximum(draws, 0.0),
                is_detected=True,
                source="the white floor of the noise",
            )
    why = HIDDEN if white else FILTERED
    if has_tube(context.camera):
        draws = lognormal_draws(context.camera.video.conversion_gain_dn_per_e, rng, len(draws))
        return Floor(
            draws=draws,
            is_detected=False,
            source="the sensor's conversion gain",
            refusal_reason=why,
        )
    if not white:
        # A negative covariance gain leaves no room for K.
        draws = rng.uniform(
            0.0, max(float(np.median(posterior["covariance_gain"])), 0.0), len(draws)
        )
    draws = np.maximum(draws, 0.0)
    source = f"anything up to {float(np.quantile(draws, 0.975)):.2g} DN, as allowed by the spectrum"
    return Floor(draws=draws, is_detected=False, source=source, refusal_reason=why)


def _outer_transfer(series: FlatSeries, posterior: Posterior, context: Context) -> float:
    """Return the mean of |H|^2 of the fitted blur over the modes beyond the band."""
    row_pitch = series.flats[0].bins.row_pitch
    column, row, mode_fraction = outer_points(row_pitch)
    step = max(1, len(posterior.draws) // GAIN.floor_draws)
    some = np.column_stack([posterior[name][::step] for name in NAMES])
    passed = np.minimum(
        transfer(some, column, row, PixelReadoutModel.of(row_pitch, context.camera)), 1.0
    )
    return float(np.median(passed @ mode_fraction)) / float(mode_fraction.sum())


def has_analogue_chain(context: Context) -> bool:
    """Return whether analog electronics behind the CCD may filter along the rows."""
    return context.interlaced or (has_tube(context.camera) and not context.camera.video.digital)


def has_electronic_smoothing(series: FlatSeries, context: Context) -> bool:
    """Return whether electronics smooth the noise, so that it cannot be white."""
    return has_analogue_chain(context) or any(
        dark.variance_dn2 > 0
        and dark.neighbour_correlation
        > GAIN.smoothed_correlation + GAIN.floor_sd * dark.neighbour_sd
        for dark in series.darks
    )
