"""The posterior of the covariance gain under the forms of the blur: which of them the noise spectrum asks for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.data import BEGIN, SpectrumData
from charact.noise.gain.forms import EXPONENT_PRIOR, NONE, SPREAD_SEEN, GainBlurModel
from charact.noise.gain.model import NAMES, UNITS, leakage_ratio, spectrum_at
from charact.noise.gain.pooled_noise import PooledNoise
from charact.posterior import find_maximum, importance_sample, laplace
from charact.posterior.importance import ENOUGH, FIRST_DRAWS
from labdata.measurement import Posterior

Array = NDArray[np.float64]

DERIVED = ("covariance_gain", "blur_factor", "lag_factor")
DERIVED_UNITS = ("DN", "1", "1")
# The spectrum is fitted up to one of these radii, the widest that the model describes.
REACHES_CY_PER_PX = (0.25, 0.21, 0.18, 0.15, 0.12, 0.1)
# Least probability of the residuals by chance for the model to pass.
LEAST_CHANCE = 0.05
# None of the forms is the blur itself: they are weighed by the root of their evidence, for the same reason as those of
# `charact.mtf.noise_spectrum.model`.
EVIDENCE_POWER = 0.5
# Share of the whole below which a form has no say.
LEAST_WEIGHT = 0.01
# Draws of all forms together.
DRAWS = 1000
# Effective number of weighted draws below which a posterior is not trusted.
LEAST_EFFECTIVE = 1000.0


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Posterior of the noise model with what it was fitted to.

    Parameters
    ----------
    posterior
        Draws of `NAMES`.
    used
        Bins fitted, shape (bin,).
    model_dn
        Power of the best fit in every bin, shape (bin,), DN.
    chi2, freedom, chance
        Squared residuals over their variance, degrees of freedom, and the probability of more by chance.
    """

    posterior: Posterior
    used: NDArray[np.bool_]
    model_dn: Array
    chi2: float
    freedom: int
    chance: float


@dataclass(frozen=True, kw_only=True)
class GainSpectrumOptimum:
    """The best fit of a form over a range of frequency.

    Parameters
    ----------
    form, point, covariance, log_probability
        The form, its free parameters at the peak, their covariance, and ln of the posterior density.
    log_evidence
        Laplace's approximation of the evidence, up to a constant that all forms share.
    chi2, freedom, chance
        Squared residuals over their variance, degrees of freedom, and the probability of more by chance.
    """

    form: GainBlurModel
    point: Array
    covariance: Array
    log_probability: Callable[[Array], Array]
    log_evidence: float
    chi2: float
    freedom: int
    chance: float


def form_optima(data: SpectrumData, forms: Sequence[GainBlurModel]) -> list[GainSpectrumOptimum]:
    """Find the peak of every form; the errors of the data are those of the power fitted by the first."""
    first, begin = forms[0], data.start(EXPONENT_PRIOR[0])
    for _ in range(2):
        data.weigh(first.whole(first.part(begin)[None]))
        peak = _form_optimum(data, first, begin)
        begin = first.whole(peak.point[None])[0]
    peaks = [peak]
    begin = data.start(NONE["exponent"])
    for form in forms[1:]:
        peaks.append(_form_optimum(data, form, begin))
        begin = peaks[1].form.whole(peaks[1].point[None])[0]
        # Half of the blur, wider than the other half, for what has both.
        begin[3], begin[6:] = max(0.25 * float(begin[1] + begin[2]), 0.05), BEGIN
    at = int(np.argmax([peak.log_evidence for peak in peaks]))
    best = peaks[at]
    if "spread_share" in best.form.names:
        place = best.form.names.index("spread_share")
        if best.point[place] > SPREAD_SEEN * np.sqrt(best.covariance[place, place]):
            peaks[at] = _form_optimum(data, best.form.freed, best.form.whole(best.point[None])[0])
    return peaks


def _form_optimum(data: SpectrumData, form: GainBlurModel, begin: Array) -> GainSpectrumOptimum:
    """Climb from all parameters of the model."""
    from scipy.stats import chi2 as chi_squared

    log_probability = _log_probability(data, form)
    point, covariance = find_maximum(log_probability, form.part(begin), form.bounds)
    rest = (data.measured - data.expected(form.whole(point[None]))[0]) @ data.whitened
    chi2, freedom = float(rest @ rest), len(rest) - len(point)
    height = float(log_probability(point[None])[0])
    _, volume = np.linalg.slogdet(2.0 * np.pi * covariance)
    return GainSpectrumOptimum(form=form, point=point, covariance=covariance, log_probability=log_probability,
                log_evidence=height + 0.5 * float(volume), chi2=chi2, freedom=freedom,
                chance=float(chi_squared.sf(chi2, freedom)))  # fmt: skip


def _log_probability(data: SpectrumData, form: GainBlurModel) -> Callable[[Array], Array]:
    """Gaussian likelihood of the data as they are weighed now, and the priors."""
    bounds, measured, root, volume = form.bounds, data.measured, data.root, data.log_volume
    centre = np.where(np.isfinite(bounds[:, 1]), bounds.mean(axis=1), 1.0)

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, centre)
        residual = (measured - data.expected(form.whole(safe))) @ root
        return np.where(inside, volume - 0.5 * (residual**2).sum(axis=1) + form.log_prior(safe), -np.inf)

    return log_probability


def fit_spectrum(summary: PooledNoise, *, seed: int, quick: bool, forms: tuple[GainBlurModel, ...]) -> Fit:
    """Fit the model to the pooled spectrum, the variance and the correlation in time.

    Parameters
    ----------
    summary
        The statistics.
    seed, quick
        Seed of the draws; draws from the curvature at the peak.
    forms
        Forms of the blur that are thought possible, weighed by their evidence; see `charact.noise.gain.forms`.
    """
    radius = np.hypot(summary.column_cy_per_px, summary.row_cy_per_px)
    for reach in REACHES_CY_PER_PX:
        used = radius <= reach
        peaks = form_optima(SpectrumData(summary, used), forms)
        if max(peak.chance for peak in peaks) > LEAST_CHANCE or used.sum() < 24:
            break
    best = max(peaks, key=lambda peak: peak.log_evidence)
    posterior = _with_gain(_mixture_draws(peaks, seed, quick), summary, np.random.default_rng([seed, 1]))
    everywhere = summary.column_cy_per_px, summary.row_cy_per_px, summary.reading
    point = best.form.whole(best.point[None])
    model = spectrum_at(point, *everywhere)[0] * leakage_ratio(point, *everywhere, summary.leak_cy2_per_px2)
    return Fit(posterior=posterior, used=used, model_dn=model, chi2=best.chi2, freedom=best.freedom, chance=best.chance)


def _mixture_draws(peaks: Sequence[GainSpectrumOptimum], seed: int, quick: bool) -> Posterior:
    """Draw from the posteriors of all forms, each its share of the root of the evidence."""
    height = np.array([peak.log_evidence for peak in peaks])
    share = np.exp(EVIDENCE_POWER * (height - height.max()))
    share = np.where(share < LEAST_WEIGHT * share.sum(), 0.0, share) / share.sum()
    # Shares rounded one by one would not always add up to all draws.
    numbers = np.diff(np.rint(np.cumsum(share / share.sum()) * DRAWS).astype(int), prepend=0)
    own = [(peak, _form_draws(peak, int(n), seed, quick)) for peak, n in zip(peaks, numbers, strict=True) if n]
    draws = np.concatenate([peak.form.whole(drawn.draws) for peak, drawn in own])
    # What a form needs no more of, such as a tail, leans on its bound and harms nothing where another goes without.
    harmless = {"prior-bound"} if len(peaks) > 1 else set()
    known = [drawn.effective_sample_size[0] for _, drawn in own if len(drawn.effective_sample_size)]
    return replace(
        own[0][1], names=NAMES, units=UNITS, draws=draws,
        effective_sample_size=np.full(len(NAMES), min(known)) if known else np.empty(0),
        flags=tuple({flag for _, drawn in own for flag in drawn.flags} - harmless),
    )  # fmt: skip


def _form_draws(peak: GainSpectrumOptimum, number: int, seed: int, quick: bool) -> Posterior:
    """Draw a form's part of all draws.

    By importance where there is time: strength, falls and exponent lie on a curved ridge along which a chain is slow.
    """
    form, part = peak.form, number / DRAWS
    told: dict[str, Any] = {
        "names": form.names, "units": ("1",) * len(form.names), "start": peak.point, "covariance": peak.covariance,
        "seed": seed, "bounds": form.bounds, "draws": number,
    }  # fmt: skip
    if quick:
        return laplace(peak.log_probability, **told)
    drawn = importance_sample(
        peak.log_probability, **told, enough=part * ENOUGH, first_draws=max(500, round(part * FIRST_DRAWS))
    )
    few = drawn.effective_sample_size[0] < part * LEAST_EFFECTIVE
    return replace(drawn, flags=(*drawn.flags, "not-converged")) if few else drawn


def _with_gain(drawn: Posterior, summary: PooledNoise, rng: np.random.Generator) -> Posterior:
    """Put the gain, the blur factor and the lag factor before the draws of the spectrum.

    The variance and the correlation in time are measured apart from the spectrum's height: their errors are drawn
    independently.
    """
    power, count = drawn["power"], len(drawn.draws)
    few = rng.standard_normal(count) if np.isinf(summary.lag.freedom) else rng.standard_t(summary.lag.freedom, count)
    factor = summary.lag.factor + summary.lag.factor_sd * few
    variance = summary.variance_dn + summary.variance_sd_dn * rng.standard_normal(count)
    derived = np.stack([power * factor, variance / power, factor], axis=1)

    def first_thrice(of: Array) -> Array:
        return np.concatenate([np.repeat(of[:1], len(DERIVED)), of])

    return replace(
        drawn,
        names=(*DERIVED, *NAMES),
        units=(*DERIVED_UNITS, *UNITS),
        draws=np.concatenate([derived, drawn.draws], axis=1),
        autocorrelation_time=first_thrice(drawn.autocorrelation_time),
        r_hat=first_thrice(drawn.r_hat),
        effective_sample_size=first_thrice(drawn.effective_sample_size),
    )
