"""Posterior of the covariance gain, averaged over blur models by evidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.gain.model import (
    NAMES,
    NONE,
    UNITS,
    GainBlurModel,
    leakage_ratio,
    spectrum_at,
)
from charact.estimators.noise.gain.pooled_noise import PooledNoise
from charact.estimators.noise.gain.white_floor import integrals
from charact.estimators.noise.thresholds import GAIN, GAIN_PRIORS
from charact.inference import find_maximum, importance_sample, laplace
from charact.inference.gauss_newton import ln_evidence, weigh_by_evidence
from charact.inference.importance import ENOUGH, FIRST_DRAWS
from labdata.measurement import Posterior

Array = NDArray[np.float64]
# Start values of tail and spread fraction.
BEGIN = (GAIN_PRIORS.tail[0], 0.2)


class SpectrumData:
    """Data of the fit: power in the used bins, and integrals beyond the band if available.

    Attributes
    ----------
    measured
        Shape (datum,), DN.
    root
        Inverse root of their covariance, shape (datum, datum), 1/DN, including the common error by
        pulse heights.
    whitened
        The same without the common error.
    log_volume
        ln of the determinant of the root.
    """

    def __init__(self, summary: PooledNoise, in_band: NDArray[np.bool_]) -> None:
        self.summary, self.in_band = summary, in_band
        self.column, self.row = summary.column_cy_per_px[in_band], summary.row_cy_per_px[in_band]
        self.measured = summary.power_dn[in_band]
        if summary.outer is not None:
            self.measured = np.concatenate([self.measured, summary.outer.value_dn])
        self.leak = np.ones(len(self.column))

    def start(self, exponent: float) -> Array:
        """Return start values of all parameters by a linear fit of the logarithm above the
        floor.
        """
        summary, in_band, outer = self.summary, self.in_band, self.summary.outer
        highest = summary.power_dn[in_band].max()
        floor = (
            0.0
            if outer is None
            else 0.8 * float(np.clip(outer.value_dn[0] / outer.mode_fraction.sum(), 0.0, highest))
        )
        x, y = (f / GAIN_PRIORS.reference_cy_per_px for f in (self.column, self.row))
        power = np.maximum(summary.power_dn[in_band] - floor, 1e-3 * highest)
        design = np.stack([np.ones_like(x), -(np.hypot(x, y) ** exponent), -(x**2), -(y**2)])
        root = np.sqrt(summary.modes[in_band])
        level, strength, columns, rows = np.linalg.lstsq(
            (design * root).T, np.log(power) * root, rcond=None
        )[0]
        falls = np.clip([columns + strength, rows + strength, strength], -0.8, 5.0)
        zero_power = np.exp(level) + floor
        return np.array(
            [
                zero_power,
                *falls,
                exponent,
                floor / zero_power if floor else GAIN_PRIORS.few_electrons[0],
                *BEGIN,
            ]
        )

    def model_values(self, points: Array) -> Array:
        """Return the model of the data, shape (draw, datum), DN."""
        reading, outer = self.summary.reading, self.summary.outer
        band_power = self.leak * spectrum_at(points, self.column, self.row, reading)
        if outer is None:
            return band_power
        return np.concatenate(
            [band_power, integrals(outer, partial(spectrum_at, points, reading=reading))], axis=1
        )

    def weigh(self, point: Array) -> None:
        """Compute leakage and errors at the parameters (1, parameter)."""
        summary, outer = self.summary, self.summary.outer
        self.leak = leakage_ratio(
            point, self.column, self.row, summary.reading, summary.leak_cy2_per_px2
        )
        model, bins = self.model_values(point)[0], len(self.column)
        covariance = np.zeros((len(model), len(model)))
        bin_sd = (
            summary.power_sd_dn[self.in_band]
            * model[:bins]
            / np.maximum(self.measured[:bins], 0.2 * model[:bins])
        )
        covariance[np.arange(bins), np.arange(bins)] = bin_sd**2
        if outer is not None:
            power = spectrum_at(
                point, outer.column_cy_per_px, outer.row_cy_per_px, summary.reading
            )[0]
            covariance[bins:, bins:] = outer.covariance(power)
        self.whitened = _inverse_root(covariance)
        self.root = _inverse_root(covariance + summary.height_sd**2 * np.outer(model, model))
        self.log_volume = float(np.linalg.slogdet(self.root)[1])


def _inverse_root(covariance: Array) -> Array:
    """Return a matrix that whitens data of this covariance."""
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)).T, np.float64)


DERIVED = ("covariance_gain", "blur_factor", "lag_factor")
DERIVED_UNITS = ("DN", "1", "1")


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Posterior of the noise model and its fit."""

    posterior: Posterior  # draws of `NAMES`
    in_band: NDArray[np.bool_]  # bins fitted, shape (bin,)
    model_dn: Array  # power of the best model in every bin, shape (bin,), DN
    best: "GainSpectrumOptimum"  # optimum of that model


@dataclass(frozen=True, kw_only=True)
class GainSpectrumOptimum:
    """Optimum of a blur model."""

    # form, point, covariance, log_probability: the blur model, its free parameters at the optimum,
    # their covariance, and ln of the posterior density
    form: GainBlurModel
    point: Array
    covariance: Array
    log_probability: Callable[[Array], Array]
    # laplace approximation of the evidence, up to a constant common to all models
    log_evidence: float
    # chi2, freedom, chance: squared residuals over their variance, degrees of freedom, and p-value
    chi2: float
    freedom: int
    chance: float


def form_optima(data: SpectrumData, forms: Sequence[GainBlurModel]) -> list[GainSpectrumOptimum]:
    """Return the optimum of every blur model; the errors of the data follow from the first one."""
    first, begin = forms[0], data.start(GAIN_PRIORS.exponent[0])
    for _ in range(2):
        data.weigh(first.whole(first.part(begin)[None]))
        peak = _form_optimum(data, first, begin)
        begin = first.whole(peak.point[None])[0]
    peaks = [peak]
    begin = data.start(NONE["exponent"])
    for form in forms[1:]:
        peaks.append(_form_optimum(data, form, begin))
        begin = peaks[1].form.whole(peaks[1].point[None])[0]
        # Start with half of the blur in the extended part.
        begin[3], begin[6:] = max(0.25 * float(begin[1] + begin[2]), 0.05), BEGIN
    at = int(np.argmax([peak.log_evidence for peak in peaks]))
    best = peaks[at]
    if "spread_share" in best.form.names:
        parameter = best.form.names.index("spread_share")
        if best.point[parameter] > GAIN_PRIORS.spread_sd * np.sqrt(
            best.covariance[parameter, parameter]
        ):
            peaks[at] = _form_optimum(
                data, best.form.with_free_spread, best.form.whole(best.point[None])[0]
            )
    return peaks


def _form_optimum(data: SpectrumData, form: GainBlurModel, begin: Array) -> GainSpectrumOptimum:
    """Optimise one blur model from start values of all parameters."""
    from scipy.special import chdtrc

    log_probability = _log_probability(data, form)
    point, covariance = find_maximum(log_probability, form.part(begin), form.bounds)
    residual = (data.measured - data.model_values(form.whole(point[None]))[0]) @ data.whitened
    chi2, freedom = float(residual @ residual), len(residual) - len(point)
    evidence = ln_evidence(float(log_probability(point[None])[0]), covariance)
    return GainSpectrumOptimum(
        form=form,
        point=point,
        covariance=covariance,
        log_probability=log_probability,
        log_evidence=evidence,
        chi2=chi2,
        freedom=freedom,
        chance=float(chdtrc(freedom, chi2)) if freedom > 0 else np.nan,
    )


def _log_probability(data: SpectrumData, form: GainBlurModel) -> Callable[[Array], Array]:
    """Return the normal log-likelihood with the current errors, plus the priors."""
    bounds, measured, root, volume = form.bounds, data.measured, data.root, data.log_volume
    centre = np.where(np.isfinite(bounds[:, 1]), bounds.mean(axis=1), 1.0)

    def log_probability(points: Array) -> Array:
        is_inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        safe = np.where(is_inside[:, None], points, centre)
        residual = (measured - data.model_values(form.whole(safe))) @ root
        return np.where(
            is_inside, volume - 0.5 * (residual**2).sum(axis=1) + form.log_prior(safe), -np.inf
        )

    return log_probability


def fit_spectrum(
    summary: PooledNoise, *, seed: int, quick: bool, forms: tuple[GainBlurModel, ...]
) -> Fit:
    """Fit the blur models to the pooled spectrum, variance and temporal correlation."""
    radius = np.hypot(summary.column_cy_per_px, summary.row_cy_per_px)
    for limit_cy_per_px in GAIN.band_limits_cy_per_px:
        in_band = radius <= limit_cy_per_px
        peaks = form_optima(SpectrumData(summary, in_band), forms)
        if max(peak.chance for peak in peaks) > GAIN.min_p_value or in_band.sum() < 24:
            break
    best = max(peaks, key=lambda peak: peak.log_evidence)
    posterior = _with_gain(
        _mixture_draws(peaks, seed, quick), summary, np.random.default_rng([seed, 1])
    )
    everywhere = summary.column_cy_per_px, summary.row_cy_per_px, summary.reading
    point = best.form.whole(best.point[None])
    model = spectrum_at(point, *everywhere)[0] * leakage_ratio(
        point, *everywhere, summary.leak_cy2_per_px2
    )
    return Fit(posterior=posterior, in_band=in_band, model_dn=model, best=best)


def _mixture_draws(peaks: Sequence[GainSpectrumOptimum], seed: int, quick: bool) -> Posterior:
    """Return draws from the posteriors of all blur models, weighted by the root of the evidence."""
    weights = sorted(
        weigh_by_evidence(
            [peak.log_evidence for peak in peaks],
            power=GAIN.evidence_power,
            min_weight=GAIN.min_weight,
        )
    )
    # Rounding cumulative sums keeps the total number of draws.
    total = np.cumsum([weight for _, weight in weights])
    numbers = np.diff(np.rint(total / total[-1] * GAIN.draws).astype(int), prepend=0)
    drawn_forms = [
        (peaks[i], _form_draws(peaks[i], int(n), seed, quick))
        for (i, _), n in zip(weights, numbers, strict=True)
        if n
    ]
    draws = np.concatenate([peak.form.whole(drawn.draws) for peak, drawn in drawn_forms])
    # A parameter that a model does not need, such as a tail, may lie at its bound if another model
    # omits it.
    harmless = {"prior-bound"} if len(peaks) > 1 else set()
    known = [
        drawn.effective_sample_size[0]
        for _, drawn in drawn_forms
        if len(drawn.effective_sample_size)
    ]
    return replace(
        drawn_forms[0][1],
        names=NAMES,
        units=UNITS,
        draws=draws,
        effective_sample_size=np.full(len(NAMES), min(known)) if known else np.empty(0),
        flags=tuple({flag for _, drawn in drawn_forms for flag in drawn.flags} - harmless),
    )


def _form_draws(peak: GainSpectrumOptimum, number: int, seed: int, quick: bool) -> Posterior:
    """Return the draws of one blur model.

    Importance sampling, because a chain moves slowly along the curved ridge of strength, falls and
    exponent.
    """
    form, part = peak.form, number / GAIN.draws
    settings: dict[str, Any] = {
        "names": form.names,
        "units": ("1",) * len(form.names),
        "start": peak.point,
        "covariance": peak.covariance,
        "seed": seed,
        "bounds": form.bounds,
        "draws": number,
    }
    if quick:
        return laplace(peak.log_probability, **settings)
    drawn = importance_sample(
        peak.log_probability,
        **settings,
        enough=part * ENOUGH,
        first_draws=max(500, round(part * FIRST_DRAWS)),
    )
    few = drawn.effective_sample_size[0] < part * GAIN.min_effective_samples
    return replace(drawn, flags=(*drawn.flags, "not-converged")) if few else drawn


def _with_gain(drawn: Posterior, summary: PooledNoise, rng: np.random.Generator) -> Posterior:
    """Prepend draws of gain, blur factor and lag factor.

    Errors of variance and temporal correlation are independent of the spectrum's level.
    """
    power, count = drawn["power"], len(drawn.draws)
    few = (
        rng.standard_normal(count)
        if np.isinf(summary.lag.freedom)
        else rng.standard_t(summary.lag.freedom, count)
    )
    factor = summary.lag.factor + summary.lag.factor_sd * few
    variance = summary.variance_dn + summary.variance_sd_dn * rng.standard_normal(count)
    derived = np.stack([power * factor, variance / power, factor], axis=1)

    diagnostics = {
        name: np.concatenate(
            [np.repeat(getattr(drawn, name)[:1], len(DERIVED)), getattr(drawn, name)]
        )
        for name in ("autocorrelation_time", "r_hat", "effective_sample_size")
    }
    return replace(
        drawn,
        names=(*DERIVED, *NAMES),
        units=(*DERIVED_UNITS, *UNITS),
        draws=np.concatenate([derived, drawn.draws], axis=1),
        **diagnostics,
    )
