"""Signal against light along a gain control, and saturation of the microchannel plate.

    ln(S/E) = a + b x + d + ln(1 - S/S_s) + e

S: signal; E: light; x: position of the setting; d, e: normal deviations of settings and levels;
S_s: asymptotic signal of the plate.
"""

from dataclasses import dataclass, replace

import numpy as np

from charact.estimators.noise.findings import Remarks, finding
from charact.estimators.noise.linear_fit import draw_posterior, linear_fit
from charact.estimators.noise.sweep.gain_law import (
    LOG_DEPARTURE,
    departure_prior,
    line_fit,
    sampler_of,
)
from charact.estimators.noise.sweep.settings import SweepSetting
from charact.estimators.noise.thresholds import SWEEP
from labdata import Array
from labdata.measurement import Posterior

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
        log_probability,
        start,
        bounds,
        names=NAMES,
        units=UNITS,
        seed=seed,
        method=sampler_of(quick),
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
