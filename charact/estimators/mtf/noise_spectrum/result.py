"""From draws of a noise spectrum's forms to the transfer after the gain: quantities, curves and
what a report draws.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from charact.estimators.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency, curve_of
from charact.estimators.mtf.noise_spectrum.model import (
    SCATTER_FRACTION,
    SCATTER_PX,
    SCATTER_SHARE,
    PostGainBlur,
    SpectrumOptimum,
)
from charact.estimators.mtf.noise_spectrum.pooled_spectrum import PooledSpectrum
from charact.estimators.mtf.noise_spectrum.thresholds import ACCURACY, THRESHOLDS
from charact.transfer.extended import ScatterComponent
from charact.verdict import Finding, judge
from labdata import Array
from labdata.measurement import (
    Curve,
    Measurement,
    Posterior,
    Result,
    make_refusal,
    measurement_from_draws,
)

DRAWS = 1000
DIRECTIONS = (("mtf_post_gain", False), ("mtf_post_gain_vertical", True))
REMEDIES = {
    "clipped": "light and black level at which no pixel reaches an end of the scale",
    "lag": "a longer frame interval, or more frames",
    "flicker": "a steady lamp",
    "gamma": "frames with a linear response (gamma 1)",
    "quantised": "more gain or a higher bit depth",
    "no-darks": "darks at the same settings",
    "too-few-frames": "more frames and levels of light",
    "aliased": "`method` of edges or bars, which see beyond the Nyquist frequency",
    "model-misfit": "the non-parametric curves of the result",
    "not-converged": "another `seed`",
    "prior-bound": "more frames",
    "several-modes": "more frames",
}


@dataclass(frozen=True, kw_only=True)
class SpectrumDraws:
    """Draws of the forms that the evidence admits, with their shares of it, the likeliest first."""

    peaks: tuple[SpectrumOptimum, ...]
    posteriors: tuple[Posterior, ...]
    shares: Array

    def mixture_of(self, of: Callable[[SpectrumOptimum, Array], Array]) -> Array:
        """Return draws of a function of (peak, draws), each form giving its share of them."""
        counts = np.maximum(np.round(self.shares * DRAWS).astype(int), 1)
        models = zip(self.peaks, self.posteriors, counts, strict=True)
        return np.concatenate(
            [of(peak, posterior.draws[:count]) for peak, posterior, count in models]
        )

    def transfer(self, spectrum: PooledSpectrum, frequency: Array, *, vertical: bool) -> Array:
        """Return draws of |H| after the gain, shape (draw, frequency)."""
        ratio = spectrum.pitch_ratio
        return self.mixture_of(
            lambda peak, draws: transfer_of(
                peak, draws, frequency, vertical=vertical, pitch_ratio=ratio
            )
        )


def transfer_of(
    peak: SpectrumOptimum, draws: Array, frequency: Array, *, vertical: bool, pitch_ratio: float
) -> Array:
    """Return |H| after the gain along rows or columns, pixel and video included, shape (draw,
    frequency).

    `frequency`: cycles per column pitch along rows, per row pitch along columns.
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


def finding(flag: str, effect: str) -> Finding:
    """Return the finding of a flag with its effect and remedy."""
    return Finding(flag=flag, effect=effect, remedy=REMEDIES[flag])


def quantities(
    spectrum: PooledSpectrum,
    drawn: SpectrumDraws,
    common: dict[str, Any],
    findings: Sequence[Finding],
) -> Result:
    """Return everything measured of the transfer after the gain, judged, with its curves."""
    measurements: list[Measurement] = []
    for _, vertical in DIRECTIONS:
        along = {**common, "orientation_deg": 90.0 if vertical else 0.0}
        half = crossing_frequency(FINE, drawn.transfer(spectrum, FINE, vertical=vertical), 0.5)
        known, of_half = half[np.isfinite(half)], list(findings)
        if len(known) < 0.975 * len(half):
            reason = "the transfer after the gain may not fall to one half at any frequency seen"
            fields = {key: value for key, value in along.items() if key != "posterior"}
            measurements.append(make_refusal("post_gain_mtf50", "cy/px", reason, **fields))
        else:
            low, middle, high = np.quantile(known, [0.16, 0.5, 0.84])
            if 0.5 * (high - low) > THRESHOLDS.max_relative_sd * middle:
                percent = 50.0 * (high - low) / middle
                of_half.append(finding("too-few-frames", f"an interval of ±{percent:.0f} % (68 %)"))
            if middle > THRESHOLDS.nyquist_cy_per_px:
                of_half.append(finding("aliased", "MTF50 lies above the Nyquist frequency"))
            number = measurement_from_draws("post_gain_mtf50", "cy/px", known, **along)
            measurements.append(judge(number, of_half))
        pinned = drawn.transfer(spectrum, np.array(PINNED), vertical=vertical)
        measurements += [
            judge(
                measurement_from_draws(
                    "post_gain_mtf", "1", values, frequency_cy_per_px=frequency, **along
                ),
                findings,
            )
            for frequency, values in zip(PINNED, pinned.T, strict=True)
        ]
    # White floor over all noise at frequency 0, without the dark's part.
    mean = float(np.mean(spectrum.power_dn2 - spectrum.dark_dn2))
    white = drawn.mixture_of(
        lambda peak, draws: draws[:, 1] * mean / (draws[:, 1] * mean + np.exp(draws[:, 0]))
    )
    fraction = measurement_from_draws("white_noise_fraction", "1", white, **common)
    measurements.append(judge(fraction, findings))
    return Result(measurements=tuple(measurements), curves=curves(spectrum, drawn))


def curves(spectrum: PooledSpectrum, drawn: SpectrumDraws) -> dict[str, Curve]:
    """Return the curves along rows and along columns."""
    frequency = np.maximum(REPORTED, 1e-6)
    return {
        name: curve_of(REPORTED, drawn.transfer(spectrum, frequency, vertical=vertical))
        for name, vertical in DIRECTIONS
    }


def noise_power(spectrum: PooledSpectrum) -> dict[str, Any]:
    """Return the noise power of the flats per DN of signal, darks included, for NEQ."""
    return {
        "column_cy_per_px": spectrum.column_cy_per_px.tolist(),
        "row_cy_per_px": spectrum.row_cy_per_px.tolist(),
        "power_dn2": spectrum.power_dn2.tolist(),
        "looks": spectrum.looks_lagged.tolist(),
        "signal_dn": spectrum.signal_dn,
        "flats": [level.label for level in spectrum.levels],
    }


def figure_data(spectrum: PooledSpectrum, drawn: SpectrumDraws) -> dict[str, Any]:
    """Return measured power and model over the band, for a report."""
    peak = drawn.peaks[0]
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
        "forms": {
            p.problem.shape.name: float(s) for p, s in zip(drawn.peaks, drawn.shares, strict=True)
        },
    }


# Gain in ln likelihood at which scattered light is certainly detected: the threshold is 5 and the
# gain scatters by 5.
SURE = 12.0


@dataclass(frozen=True, kw_only=True)
class UndetectedComponent:
    """A form of the transfer of which a share of the light is scattered over a length, px."""

    shape: PostGainBlur
    fraction: float
    length_px: float

    @property
    def bounds(self) -> Array:
        """Bounds of the form's own parameters."""
        return self.shape.bounds

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,) or (n, f) -> (n, f)."""
        scatter = ScatterComponent(size_px=(self.length_px, self.length_px))
        veil = scatter.transfer(frequency, np.array([[self.length_px]]))
        return self.shape.modulus(theta, frequency) * (1.0 - self.fraction + self.fraction * veil)


@dataclass(frozen=True, kw_only=True)
class UndetectedScatter:
    """Largest amount of scattered light that may stay undetected."""

    length_px: float  # how far it is scattered, px
    fraction: float  # largest share of all light
    lower_percent: float  # by how much MTF50 along rows would be lower if it were counted, percent


def note(peak: SpectrumOptimum) -> str:
    """Return the sentence that says what would go unseen."""
    narrow, broad = scatter_limits(peak)
    return (
        "normalised without light that is scattered far after the gain: up to "
        f"{100 * narrow.fraction:.2g} % over {narrow.length_px:.2g} px, or "
        f"{100 * broad.fraction:.2g} % over {broad.length_px:.2g} px, are not detectable; with it "
        f"MTF50 is {narrow.lower_percent:.2g} % or {broad.lower_percent:.2g} % lower"
    )


def scatter_limits(peak: SpectrumOptimum) -> tuple[UndetectedScatter, UndetectedScatter]:
    """Return the undetected scattered light of the smallest and the largest length considered.

    A share q of scattered light changes ln of the power by q d, part of which the parameters of the
    form absorb. The remaining part has the information I about q, so that q = sqrt(2 S / I) gains S
    in ln likelihood. MTF50 is wrong by the slope of the true one with q less that of the fitted
    one.
    """
    problem, at = peak.problem, peak.point[None]
    looks, step, (low, high) = problem.looks, ACCURACY.fraction_step, problem.bounds.T
    sd = np.minimum(np.sqrt(np.maximum(np.diag(peak.covariance), 1e-30)), 0.2 * (high - low))
    up = np.minimum(peak.point + np.diag(ACCURACY.derivative_step_sd * sd), high)
    down = np.maximum(peak.point - np.diag(ACCURACY.derivative_step_sd * sd), low)
    change = np.diag(up - down)
    power, half = problem.model(at)[0], _mtf50(peak, at)
    # Slopes of ln of the power and of MTF50 with the parameters, which lie within their bounds
    # whatever the data.
    of_power = (np.log(problem.model(up)) - np.log(problem.model(down))) / change[:, None]
    of_half = (_mtf50(peak, up) - _mtf50(peak, down)) / change
    normal = (of_power * looks) @ of_power.T + np.diag(12.0 / (high - low) ** 2)

    def limit_at(length_px: float) -> UndetectedScatter:
        shape: Any = UndetectedComponent(shape=problem.shape, fraction=step, length_px=length_px)
        scattered = replace(peak, problem=replace(problem, shape=shape))
        relative_change = (scattered.problem.model(at)[0] / power - 1.0) / step
        pull = of_power @ (looks * relative_change)
        absorbed = np.linalg.solve(normal, pull)
        information = max(float(looks @ relative_change**2 - pull @ absorbed), 1e-9)
        fraction = min(float(np.sqrt(2.0 * SURE / information)), SCATTER_FRACTION[1])
        lower = float((((half - _mtf50(scattered, at)) / step + of_half @ absorbed) / half)[0])
        return UndetectedScatter(
            length_px=length_px, fraction=fraction, lower_percent=max(100.0 * fraction * lower, 0.0)
        )

    longest = max(SCATTER_SHARE * problem.spectrum.shorter_px, 2.0 * SCATTER_PX)
    return limit_at(SCATTER_PX), limit_at(longest)


def _mtf50(peak: SpectrumOptimum, points: Array) -> Array:
    """Return MTF50 along rows at points (n, parameter), cy/px, shape (n,)."""
    ratio = peak.problem.spectrum.pitch_ratio
    return crossing_frequency(
        FINE, transfer_of(peak, points, FINE, vertical=False, pitch_ratio=ratio), 0.5
    )
