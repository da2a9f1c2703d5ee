"""Gain law along a control: ln gain is linear, with normal deviations of settings.

Settings are exchangeable: their deviations have one unknown standard deviation, so an imprecise
setting shrinks towards the law (Gelman et al., Bayesian Data Analysis, ch. 5).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from charact.estimators.noise.findings import Remarks, finding
from charact.estimators.noise.linear_fit import draw_posterior, linear_fit
from charact.estimators.noise.sweep.settings import SweepSetting
from charact.estimators.noise.thresholds import SWEEP
from charact.inference import importance_sample, sample
from labdata import Array
from labdata.measurement import Posterior

LOG_DEPARTURE = np.log([1e-4, 0.3])


Values = tuple[Array, Array]


def _method(quick: bool) -> Callable[..., Posterior]:
    """Return the sampler; importance sampling for speed, as few settings leave a skewed
    departure.
    """
    return importance_sample if quick else sample


class Axis(NamedTuple):
    """Positions of settings along a control, scaled to unit span about the centre."""

    middle: float
    span: float
    x: Array  # shape (setting,), within -1/2 and 1/2

    @classmethod
    def of(cls, position: Array) -> "Axis":
        """Return the axis of positions."""
        middle, span = 0.5 * float(position.min() + position.max()), float(np.ptp(position))
        return cls(middle, span, (position - middle) / span)


@dataclass(frozen=True, kw_only=True)
class GainLaw:
    """Posterior of the pulse part of the covariance gain, ln P = log_gain + rise x, x along the
    axis.
    """

    # draws of `log_gain` (in the middle of the axis), `rise` (from the first setting to the last),
    # `log_departure`; `log_blur`, ln of the blur factor of pulses, if noise is not white; and
    # `electron_share` for the noise of electrons
    posterior: Posterior
    # draws of the pulse part of every covariance gain from its own noise, shape (draw, setting), DN
    pulses: Array
    settings: Array  # draws of every covariance gain from its noise and the law, same shape, DN
    # draws of the electron part of every covariance gain, shape (draw,), DN
    electron_gain_dn: Array

    @property
    def blur(self) -> Array:
        """Draws of the blur factor of pulses, 1 of white noise, shape (draw,)."""
        if "log_blur" in self.posterior.names:
            return np.exp(self.posterior["log_blur"])
        return np.ones(len(self.pulses))


def departure_prior(log_departure: Array) -> Array:
    """Return ln of the prior density of ln departure, shape (point,)."""
    return -0.5 * ((log_departure - np.log(SWEEP.departure)) / SWEEP.departure_spread) ** 2


def law_of(
    x: Array,
    covariance: Values,
    variance: Values | None,
    *,
    electron_share: tuple[float, float] | None,
    seed: int,
    quick: bool,
) -> GainLaw:
    """Fit the gain law to the gains of settings.

    `x`: positions on the axis, shape (setting,). `covariance`: ln of the covariance gain in DN, and
    its standard error. `variance`: the same of a pixel's variance over signal; None for white
    noise, where both agree. `electron_share`: normal prior of the electron gain over the smallest
    covariance gain, mean and standard deviation; None if the control changes it.

    Covariance gain is K + P and variance over signal K + S P, P the pulse part k F^2 and S the blur
    factor of pulses. At equal blur, variances give gain ratios ten times more precisely than
    covariance sums. S may differ between settings by `SWEEP.blur_relative_sd`. ln P = log_gain +
    rise x + departure.
    """
    likelihood = _GainLikelihood(covariance, variance, x, electron_share is not None)

    def log_probability(points: Array) -> Array:
        value = likelihood.log_likelihood(points) + departure_prior(points[:, 2])
        return (
            value
            if electron_share is None
            else value - 0.5 * ((points[:, -1] - electron_share[0]) / electron_share[1]) ** 2
        )

    names, units, free = (
        ["log_gain", "rise", "log_departure"],
        ["log DN", "1", "1"],
        (-np.inf, np.inf),
    )
    limits = [free, free, tuple(LOG_DEPARTURE)]
    first = [*line_fit(x, covariance[0], np.hypot(covariance[1], 0.02)), np.log(0.02)]
    if variance is not None:
        names, units, limits = [*names, "log_blur"], [*units, "1"], [*limits, free]
        first.append(float(np.median(variance[0] - covariance[0])))
    if electron_share is not None:
        names, units, limits = (
            [*names, "electron_share"],
            [*units, "1"],
            [*limits, (0.0, likelihood.most_share)],
        )
        first.append(
            min(max(electron_share[0], 0.2 * electron_share[1]), 0.5 * likelihood.most_share)
        )
    posterior = draw_posterior(
        log_probability,
        np.array(first, float),
        np.array(limits, float),
        names=tuple(names),
        units=tuple(units),
        seed=seed,
        method=_method(quick),
    )
    rng = np.random.default_rng([seed, 7])
    electrons = likelihood.electrons(posterior.draws)[:, 0]
    pulses, settings = likelihood.settings(posterior.draws, rng)
    if variance is not None:
        # All spectra are extrapolated with one blur model, whose error is common: the mean level is
        # no more precise than the best setting. Ratios and variances are unaffected.
        level_sd = float(np.std(np.log(settings).mean(axis=1)))
        common_sd = np.sqrt(max(0.0, float(covariance[1].min()) ** 2 - level_sd**2))
        common = common_sd * rng.standard_normal((len(settings), 1))
        draws = posterior.draws.copy()
        for name, sign in (("log_gain", 1.0), ("log_blur", -1.0)):
            draws[:, posterior.names.index(name)] += sign * common[:, 0]
        posterior = replace(posterior, draws=draws)
        pulses, settings = pulses * np.exp(common), settings * np.exp(common)
    return GainLaw(
        posterior=posterior,
        pulses=pulses,
        settings=electrons[:, None] + settings,
        electron_gain_dn=electrons,
    )


class _GainLikelihood:
    """Likelihood of covariances and variances over signal, which have the departure of each setting
    in common.
    """

    def __init__(
        self, covariance: Values, variance: Values | None, x: Array, electrons: bool
    ) -> None:
        self.x, self.has_electrons, self.observations = x, electrons, [covariance]
        if variance is not None:
            self.observations.append((variance[0], np.hypot(variance[1], SWEEP.blur_relative_sd)))
        self.smallest = float(np.exp(covariance[0].min()))
        # Electron noise is white: no variance is smaller.
        smallest_ratio = float(np.exp(self.observations[-1][0].min())) / self.smallest
        self.most_share = SWEEP.max_electron_fraction * min(1.0, smallest_ratio)

    def electrons(self, points: Array) -> Array:
        """Return the electron gain, shape (point, 1), DN."""
        return self.smallest * points[:, -1:] if self.has_electrons else np.zeros((len(points), 1))

    def _factors(self, points: Array) -> list[Array]:
        """Return ln of the pulse fraction in covariance and variance, shape (point, 1) each."""
        return [np.zeros((len(points), 1)), points[:, 3:4]][: len(self.observations)]

    def log_likelihood(self, points: Array) -> Array:
        """Return the log-likelihood, shape (point,)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        log_electrons = np.log(np.maximum(self.electrons(points), 1e-300))
        square, weight, together = np.zeros_like(law), np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.observations, self._factors(points), strict=True):
            total = np.logaddexp(law + factor, log_electrons)
            # Derivative of the total by the departure of the pulses.
            follows, deviation = np.exp(law + factor - total), (value - total) / sd
            square, weight, together = (
                square + deviation**2,
                weight + (follows / sd) ** 2,
                together + follows * deviation / sd,
            )
        departure = np.exp(2.0 * points[:, 2:3])
        spread = 1.0 + departure * weight
        return -0.5 * (square - departure * together**2 / spread + np.log(spread)).sum(axis=1)

    def settings(self, points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return draws of the pulse part of every gain: from its own noise, and combined with the
        law.
        """
        law = points[:, :1] + points[:, 1:2] * self.x
        electrons = self.electrons(points)
        weight, log_pulses = np.zeros_like(law), np.zeros_like(law)
        for (value, sd), factor in zip(self.observations, self._factors(points), strict=True):
            total_gain = np.exp(value)
            part = np.maximum(total_gain - electrons, 1e-3 * total_gain)
            surety = (part / (total_gain * np.maximum(sd, 1e-9))) ** 2
            weight, log_pulses = weight + surety, log_pulses + surety * (np.log(part) - factor)
        log_pulses, chance = log_pulses / weight, rng.standard_normal(law.shape)
        law_weight = np.exp(-2.0 * points[:, 2:3])
        total = weight + law_weight
        return np.exp(log_pulses + chance / np.sqrt(weight)), np.exp(
            (log_pulses * weight + law * law_weight) / total + chance / np.sqrt(total)
        )


def line_fit(x: Array, y: Array, sd: Array) -> Array:
    """Return intercept and slope of a weighted line fit."""
    return linear_fit([np.ones_like(x), x], y, sd).best


def line_departure(x: Array, y: Array, sd: Array) -> tuple[float, float] | None:
    """Return the largest deviation of the best parabola from its best line, and its standard error;
    None for two settings.
    """
    if len(x) < 3:
        return None
    fit = linear_fit([np.ones_like(x), x, x**2], y, sd)
    stretch = fit.stretch(len(x)) if len(x) > 3 else 1.0
    # A parabola q x^2 over unit span deviates from its best line by q/8.
    return float(fit.best[2]) / 8.0, stretch * float(np.sqrt(fit.covariance[2, 2])) / 8.0


NAMES = ("log_response", "rise", "lost", "log_scatter", "log_departure")
UNITS = ("log DN/light", "1", "1", "1", "1")


@dataclass(frozen=True, kw_only=True)
class SweepResponsivity:
    """Posterior of the responsivity of every setting."""

    # draws of `NAMES`: ln responsivity at the centre of the axis and its slope, relative gain loss
    # at the brightest level, ln scatter of levels and ln departure of settings
    posterior: Posterior
    # draws of the small-signal responsivity of every setting, shape (draw, setting), DN per unit of
    # light
    settings: Array
    # log_responses, log_responses_sd: ln responsivity of each setting without the law, and its
    # standard error, shape (setting,)
    log_responses: Array
    log_responses_sd: Array
    brightest_dn: float  # brightest level, DN above the dark
    bendable: bool  # whether the lights of some setting differ enough to measure the gain loss

    @property
    def lost_per_dn(self) -> Array:
        """Draws of 1/S_s, shape (draw,), 1/DN."""
        return self.posterior["lost"] / self.brightest_dn


def response_of(
    settings: tuple[SweepSetting, ...], x: Array, *, seed: int, quick: bool
) -> SweepResponsivity:
    """Fit signal against light jointly at all settings.

    ln(S/E) = a + b x_i + d_i + ln(1 - S/S_s) + e_ij, with normal deviations d of settings and e of
    levels of unknown standard deviations. Levels of one setting have d in common.
    """
    levels = ResponsivityLevels.of(settings, x)
    bendable = any(
        s.light is not None and s.light.max() > SWEEP.min_light_ratio * s.light.min()
        for s in settings
    )

    def log_probability(points: Array) -> Array:
        value = levels.log_likelihood(points) + departure_prior(points[:, 4])
        value = value + points[:, 3] - 0.5 * (np.exp(points[:, 3]) / SWEEP.light_sd) ** 2
        return value if bendable else value - 0.5 * (points[:, 2] / SWEEP.loss_sd_single_light) ** 2

    free = [-np.inf, np.inf]
    bounds = np.array([free, free, SWEEP.loss_bounds, LOG_DEPARTURE, LOG_DEPARTURE])
    line = line_fit(levels.x, levels.log_ratio, np.hypot(levels.sd, SWEEP.light_sd))
    start = np.array([*line, 0.05, np.log(0.01), np.log(0.02)])
    posterior = draw_posterior(
        log_probability, start, bounds, names=NAMES, units=UNITS, seed=seed, method=_method(quick)
    )
    responses, log_responses, log_responses_sd = levels.settings(
        posterior, np.random.default_rng([seed, 8])
    )
    return SweepResponsivity(
        posterior=posterior,
        settings=responses,
        log_responses=log_responses,
        log_responses_sd=log_responses_sd,
        brightest_dn=levels.brightest_dn,
        bendable=bendable,
    )


@dataclass(frozen=True, kw_only=True)
class ResponsivityLevels:
    """All levels of a sweep: position, ln(signal over light) and its error, fraction of the
    brightest signal, shape (level,); `member` is 1 for the setting of each level, shape (level,
    setting).
    """

    x: Array
    log_ratio: Array
    sd: Array
    of_brightest: Array
    member: Array
    brightest_dn: float

    @classmethod
    def of(cls, settings: tuple[SweepSetting, ...], x: Array) -> "ResponsivityLevels":
        """Return the levels of settings."""
        number = np.concatenate([np.full(len(s.signal_dn), i) for i, s in enumerate(settings)])
        signal = np.concatenate([s.signal_dn for s in settings])
        light = np.concatenate([s.light for s in settings if s.light is not None])
        error = np.concatenate([s.signal_sd_dn for s in settings])
        return cls(
            x=x[number],
            log_ratio=np.log(signal / light),
            sd=error / signal,
            of_brightest=signal / signal.max(),
            member=(number[:, None] == np.arange(len(settings))).astype(float),
            brightest_dn=float(signal.max()),
        )

    def log_likelihood(self, points: Array) -> Array:
        """Return the log-likelihood, shape (point,), with the levels of each setting as a block."""
        residual, variance = self._residuals(points), self.sd**2 + np.exp(2.0 * points[:, 3:4])
        departure = np.exp(2.0 * points[:, 4:5])
        weight = (1.0 / variance) @ self.member
        together = (residual / variance) @ self.member
        spread = 1.0 + departure * weight
        square = (residual**2 / variance).sum(axis=1) - (departure * together**2 / spread).sum(
            axis=1
        )
        return -0.5 * (square + np.log(variance).sum(axis=1) + np.log(spread).sum(axis=1))

    def _residuals(self, points: Array) -> Array:
        """Return the residual of ln(S/E) without law and gain loss, shape (point, level)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        return self.log_ratio - law - np.log1p(-points[:, 2:3] * self.of_brightest)

    def settings(
        self, posterior: Posterior, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Return draws of every responsivity, and ln responsivities without the law with their
        errors.
        """
        points = posterior.draws
        variance = self.sd**2 + np.exp(2.0 * points[:, 3:4])
        weight = (1.0 / variance) @ self.member
        residual = (self._residuals(points) / variance) @ self.member / weight
        total = weight + np.exp(-2.0 * points[:, 4:5])
        departure = residual * weight / total + rng.standard_normal(residual.shape) / np.sqrt(total)
        positions = (self.x @ self.member) / self.member.sum(axis=0)
        law = points[:, :1] + points[:, 1:2] * positions
        return (
            np.exp(law + departure),
            np.median(law + residual, axis=0),
            np.median(1.0 / np.sqrt(weight), axis=0),
        )


def correct_saturation(
    settings: tuple[SweepSetting, ...],
    lit: tuple[int, ...],
    response: SweepResponsivity,
    *,
    seed: int,
) -> tuple[SweepSetting, ...]:
    """Return the settings with their noise with_small_signal_noise to small signals, if MCP
    saturation was measured.

    The relative gain loss lowers covariance and variance over signal.
    """
    if not response.bendable:
        return settings

    def with_small_signal_noise(s: SweepSetting) -> SweepSetting:
        remaining = 1.0 - response.lost_per_dn * s.mean_signal_dn
        return replace(
            s,
            gain_dn=s.gain_dn
            / np.resize(np.random.default_rng(seed).permutation(remaining), len(s.gain_dn)),
            log_variance=s.log_variance - float(np.log(np.median(remaining))),
            log_variance_sd=float(
                np.hypot(s.log_variance_sd, np.std(remaining) / np.median(remaining))
            ),
        )

    return tuple(with_small_signal_noise(s) if i in lit else s for i, s in enumerate(settings))


def relative_excess(
    settings: tuple[SweepSetting, ...], pulses_dn: Array, response: SweepResponsivity, *, seed: int
) -> tuple[Array, int]:
    """Return draws of F^2 of every setting over that of the most precise one, shape (draw,
    setting), and its index.

    `settings`: settings of the responsivity fit; `pulses_dn`: draws of k F^2 at small signals,
    shape (draw, setting), DN; `response`: signal over light.

    Noise and responsivity refer to the same signals with the same gain loss, so its uncertainty
    cancels.
    """
    order = np.random.default_rng([seed, 10]).permutation(len(response.settings))
    remaining = 1.0 - response.lost_per_dn[:, None] * np.array([s.mean_signal_dn for s in settings])
    carried = np.median(remaining, axis=0) if response.bendable else 1.0
    effective = (response.settings * remaining / carried)[order]
    ratio = pulses_dn[np.resize(np.arange(len(pulses_dn)), len(order))] / effective
    log_ratio = np.log(ratio) - np.log(ratio).mean(axis=1, keepdims=True)
    reference = int(np.argmin(np.std(log_ratio, axis=0)))
    return ratio / ratio[:, reference : reference + 1], reference


def reaches_saturation(response: SweepResponsivity) -> bool:
    """Return whether the sweep reaches MCP saturation."""
    lost = response.posterior["lost"]
    return bool(
        response.bendable
        and np.quantile(lost, 0.025) > SWEEP.min_loss
        and np.median(lost) > SWEEP.loss_sd * np.std(lost)
    )


def saturation_limit(response: SweepResponsivity) -> str:
    """Return the refusal of MCP saturation, with its limit."""
    if not response.bendable:
        return (
            "MCP saturation needs at least two lights at one setting, the brighter 1.5 times "
            "the other"
        )
    lost_per_dn = float(np.quantile(response.lost_per_dn, 0.975))
    if lost_per_dn <= 0:
        return "the signal rises faster than the light: no MCP saturation"
    return (
        f"not reached in the sweep: {response.brightest_dn:.4g} DN above the dark lower the gain "
        f"by less than {100 * lost_per_dn * response.brightest_dn:.2g} %, so that the MCP "
        "saturates "
        f"above {1 / lost_per_dn:.3g} DN"
    )


def bending_remarks(settings: tuple[SweepSetting, ...], response: SweepResponsivity) -> Remarks:
    """Return what the noise says of MCP saturation against camera nonlinearity."""
    fall, sd = _fall_of_noise(settings, float(np.median(response.lost_per_dn)))
    remedy = "two levels at each setting, of more frames"
    if not np.isfinite(sd):
        effect = (
            "no setting has two levels whose noise separates MCP saturation from camera "
            "nonlinearity"
        )
        return [finding("nonlinear", effect, remedy)]
    plate, camera = (
        abs(fall - exponent) < SWEEP.agreement_sd * sd
        for exponent in (SWEEP.mcp_exponent, SWEEP.camera_exponent)
    )
    observation = (
        f"covariance over signal falls as the power {fall:.2g} +- {sd:.1g} of the relative response"
    )
    if plate and not camera:
        return [f"{observation}: MCP saturation (power 1), no camera nonlinearity (3)"]
    meaning = (
        "too uncertain to separate MCP saturation (power 1) from camera nonlinearity (3)"
        if plate
        else "expected is power 1 for MCP saturation, 3 for camera nonlinearity"
    )
    return [finding("nonlinear", f"{observation}: {meaning}", remedy)]


def _fall_of_noise(settings: tuple[SweepSetting, ...], lost_per_dn: float) -> tuple[float, float]:
    """Return the slope of ln(covariance over signal) against ln(1 - S/S_s) within settings, and its
    standard error.

    The error is infinite if no setting has two levels.
    """
    bent, noise, sd = [], [], []
    for s in settings:
        is_significant = s.levels_dn > 3.0 * s.levels_sd_dn
        if is_significant.sum() < 2:
            continue
        log_remaining, level = (
            np.log1p(-lost_per_dn * s.signal_dn[is_significant]),
            np.log(s.levels_dn[is_significant]),
        )
        error = s.levels_sd_dn[is_significant] / s.levels_dn[is_significant]
        bent.append(log_remaining - np.average(log_remaining, weights=error**-2))
        noise.append(level - np.average(level, weights=error**-2))
        sd.append(error)
    if not bent or not np.any(np.concatenate(bent)):
        return 0.0, np.inf
    fit = linear_fit([np.concatenate(bent)], np.concatenate(noise), np.concatenate(sd))
    # Each setting has its own mean.
    freedom = sum(len(part) - 1 for part in bent) - 1
    excess = max(1.0, fit.chi2 / max(1, freedom))
    return float(fit.best[0]), float(np.sqrt(excess * fit.covariance[0, 0]))
