"""From draws of a noise spectrum's forms to the transfer after the gain: quantities, curves and what a report draws."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency, curve_of
from charact.mtf.noise_spectrum.model import SpectrumOptimum
from charact.mtf.noise_spectrum.pooled_spectrum import PooledSpectrum
from labdata.measurement import Curve, Measurement, Posterior, Result, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

DRAWS = 1000
# Relative half width of the 68 % interval beyond which more frames are asked for.
WIDEST_SHARE = 0.25
# Beyond the sampling limit the form alone speaks.
SAMPLING_LIMIT = 0.5
DIRECTIONS = (("mtf_post_gain", False), ("mtf_post_gain_vertical", True))


@dataclass(frozen=True, kw_only=True)
class SpectrumDraws:
    """Draws of the forms that the evidence admits, with their shares of it, the likeliest first."""

    peaks: tuple[SpectrumOptimum, ...]
    posteriors: tuple[Posterior, ...]
    shares: Array

    def mixture_of(self, of: Callable[[SpectrumOptimum, Array], Array]) -> Array:
        """Return draws of a function of (peak, draws), each form giving its share of them."""
        counts = np.maximum(np.round(self.shares * DRAWS).astype(int), 1)
        parts = [
            of(peak, posterior.draws[:count])
            for peak, posterior, count in zip(self.peaks, self.posteriors, counts, strict=True)
        ]
        return np.concatenate(parts)

    def transfer(self, spectrum: PooledSpectrum, frequency: Array, *, vertical: bool) -> Array:
        """Return draws of |H| after the gain, shape (draw, frequency)."""
        ratio = spectrum.pitch_ratio
        return self.mixture_of(
            lambda peak, draws: transfer_of(peak, draws, frequency, vertical=vertical, pitch_ratio=ratio)
        )


def transfer_of(peak: SpectrumOptimum, draws: Array, frequency: Array, *, vertical: bool, pitch_ratio: float) -> Array:
    """Return |H| after the gain along one direction, pixel and video included, shape (draw, frequency).

    Parameters
    ----------
    peak, draws
        A form, and draws of its parameters, shape (draw, parameter).
    frequency
        Cycles per pixel: per column pitch along rows, per row pitch along columns.
    vertical
        Along columns.
    pitch_ratio
        Row pitch over column pitch.
    """
    problem, none = peak.problem, np.zeros_like(frequency)
    shape = problem.blur_parameters(draws)
    if vertical:
        along = frequency / pitch_ratio
        stretched = along * np.exp(-draws[:, problem.names.index("ln_anisotropy"), None])
        return problem.shape.modulus(shape, stretched) * problem.known.aperture(none, along)
    core = problem.shape.modulus(shape, np.broadcast_to(frequency, (len(draws), len(frequency))))
    described = problem.known.aperture(frequency, none) * problem.known.electronics(frequency)
    return core * described * problem.passed(draws, problem.known.bend(frequency))


def quantities(spectrum: PooledSpectrum, found: SpectrumDraws, own: dict[str, Any]) -> Result:
    """Return everything measured of the transfer after the gain, with its curves."""
    measurements: list[Measurement] = []
    for _, vertical in DIRECTIONS:
        along = {**own, "orientation_deg": 90.0 if vertical else 0.0}
        half = crossing_frequency(FINE, found.transfer(spectrum, FINE, vertical=vertical), 0.5)
        measurements.append(_mtf50_measurement(half, along))
        pinned = found.transfer(spectrum, np.array(PINNED), vertical=vertical)
        measurements += [
            measurement_from_draws("post_gain_mtf", "1", values, frequency_cy_per_px=frequency, **along)
            for frequency, values in zip(PINNED, pinned.T, strict=True)
        ]
    white = found.mixture_of(lambda peak, draws: _white_fraction(spectrum, draws))
    measurements.append(measurement_from_draws("white_noise_share", "1", white, **own))
    return Result(measurements=tuple(measurements), curves=curves(spectrum, found))


def _mtf50_measurement(half: Array, own: dict[str, Any]) -> Measurement:
    """`post_gain_mtf50`, or why there is none."""
    known = half[np.isfinite(half)]
    if len(known) < 0.975 * len(half):
        return make_refusal(
            "post_gain_mtf50",
            "cy/px",
            "the transfer after the gain may not fall to one half at any frequency seen",
            **{key: value for key, value in own.items() if key not in ("flags", "posterior")},
        )
    flags = set(own["flags"])
    low, middle, high = np.quantile(known, [0.16, 0.5, 0.84])
    if 0.5 * (high - low) > WIDEST_SHARE * middle:
        flags.add("too-few-frames")
    if middle > SAMPLING_LIMIT:
        flags.add("aliased")
    return measurement_from_draws("post_gain_mtf50", "cy/px", known, **{**own, "flags": tuple(flags)})


def _white_fraction(spectrum: PooledSpectrum, draws: Array) -> Array:
    """White floor over all noise at frequency 0, the dark's part left aside, shape (draw,)."""
    white = draws[:, 1] * float(np.mean(spectrum.power_dn2 - spectrum.dark_dn2))
    return white / (white + np.exp(draws[:, 0]))


def curves(spectrum: PooledSpectrum, found: SpectrumDraws) -> dict[str, Curve]:
    """Return the curves along rows and along columns."""
    frequency = np.maximum(REPORTED, 1e-6)
    return {
        name: curve_of(REPORTED, found.transfer(spectrum, frequency, vertical=vertical))
        for name, vertical in DIRECTIONS
    }


def figure_data(spectrum: PooledSpectrum, found: SpectrumDraws) -> dict[str, Any]:
    """Return measured power and model over the band, for a report."""
    peak = found.peaks[0]
    white, pulses = peak.problem.parts(peak.point[None])
    return {
        "figure": "post-gain-noise",
        "column_cy_per_px": spectrum.column_cy_per_px.tolist(),
        "row_cy_per_px": spectrum.row_cy_per_px.tolist(),
        "power_dn2": spectrum.power_dn2.tolist(),
        "dark_dn2": spectrum.dark_dn2.tolist(),
        "white_dn2": white[0].tolist(),
        "pulses_dn2": pulses[0].tolist(),
        "looks": peak.problem.looks.tolist(),
        "lag_correlation": spectrum.lag.tolist(),
        "forms": {p.problem.shape.name: float(s) for p, s in zip(found.peaks, found.shares, strict=True)},
    }
