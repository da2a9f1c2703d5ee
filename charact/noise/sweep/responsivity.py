"""Responsivity at every setting of a gain sweep: gain law and MCP saturation.

MCP gain falls with output current, G = G0 / (1 + j0 / (a j_s)), j0 the unsaturated output current and j_s the strip
current. The signal is proportional to the output current, so S = S0 (1 - S / S_s): the relative gain loss is the
measured signal over S_s at any setting.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.findings import Finding
from charact.noise.sweep.gain_law import LOG_DEPARTURE, departure_prior, draw_posterior, line_fit, without_bound_flag
from charact.noise.sweep.settings import SweepSetting
from charact.noise.thresholds import SWEEP
from labdata.measurement import Posterior

Array = NDArray[np.float64]
NAMES = ("log_response", "rise", "lost", "log_scatter", "log_departure")
UNITS = ("log DN/light", "1", "1", "1", "1")


@dataclass(frozen=True, kw_only=True)
class SweepResponsivity:
    """Posterior of the responsivity of every setting."""

    # draws of `NAMES`: ln responsivity at the centre of the axis and its slope, relative gain loss at the brightest
    # level, ln scatter of levels and ln departure of settings
    posterior: Posterior
    # draws of the small-signal responsivity of every setting, shape (draw, setting), DN per unit of light
    settings: Array
    # own, own_sd: ln responsivity of each setting without the law, and its standard error, shape (setting,)
    own: Array
    own_sd: Array
    brightest_dn: float  # brightest level, DN above the dark
    bendable: bool  # whether the lights of some setting differ enough to measure the gain loss

    @property
    def lost_per_dn(self) -> Array:
        """Draws of 1/S_s, shape (draw,), 1/DN."""
        return self.posterior["lost"] / self.brightest_dn


def response_of(settings: tuple[SweepSetting, ...], x: Array, *, seed: int, quick: bool) -> SweepResponsivity:
    """Fit signal against light jointly at all settings.

    `settings`: settings with known light at every level; `x`: their positions on the axis of the sweep.

    ln(S/E) = a + b x_i + d_i + ln(1 - S/S_s) + e_ij, with normal deviations d of settings and e of levels of unknown
    standard deviations. Levels of one setting have d in common.
    """
    levels = ResponsivityLevels.of(settings, x)
    bendable = any(s.light is not None and s.light.max() > SWEEP.min_light_ratio * s.light.min() for s in settings)

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, start)
        value = levels.log_likelihood(safe) + departure_prior(safe[:, 4])
        value = value + safe[:, 3] - 0.5 * (np.exp(safe[:, 3]) / SWEEP.light_sd) ** 2
        if not bendable:
            value = value - 0.5 * (safe[:, 2] / SWEEP.loss_sd_single_light) ** 2
        return np.where(inside, value, -np.inf)

    free = [-np.inf, np.inf]
    bounds = np.array([free, free, SWEEP.loss_bounds, LOG_DEPARTURE, LOG_DEPARTURE])
    line = line_fit(levels.x, levels.log_ratio, np.hypot(levels.sd, SWEEP.light_sd))
    start = np.array([*line, 0.05, np.log(0.01), np.log(0.02)])
    drawn = draw_posterior(log_probability, start, bounds, names=NAMES, units=UNITS, seed=seed, quick=quick)
    posterior = without_bound_flag(drawn)
    responses, own, own_sd = levels.settings(posterior, np.random.default_rng([seed, 8]))
    return SweepResponsivity(posterior=posterior, settings=responses, own=own, own_sd=own_sd,
                    brightest_dn=levels.brightest_dn, bendable=bendable)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ResponsivityLevels:
    """All levels of a sweep: position, ln(signal over light) and its error, fraction of the brightest signal, shape
    (level,); `member` is 1 for the setting of each level, shape (level, setting)."""

    x: Array
    log_ratio: Array
    sd: Array
    share: Array
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
            share=signal / signal.max(),
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
        square = (residual**2 / variance).sum(axis=1) - (departure * together**2 / spread).sum(axis=1)
        return -0.5 * (square + np.log(variance).sum(axis=1) + np.log(spread).sum(axis=1))

    def _residuals(self, points: Array) -> Array:
        """Return the residual of ln(S/E) without law and gain loss, shape (point, level)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        return self.log_ratio - law - np.log1p(-points[:, 2:3] * self.share)

    def settings(self, posterior: Posterior, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Return draws of every responsivity, and ln responsivities without the law with their errors."""
        points = posterior.draws
        variance = self.sd**2 + np.exp(2.0 * points[:, 3:4])
        weight = (1.0 / variance) @ self.member
        away = (self._residuals(points) / variance) @ self.member / weight
        total = weight + np.exp(-2.0 * points[:, 4:5])
        departure = away * weight / total + rng.standard_normal(away.shape) / np.sqrt(total)
        places = (self.x @ self.member) / self.member.sum(axis=0)
        law = points[:, :1] + points[:, 1:2] * places
        return np.exp(law + departure), np.median(law + away, axis=0), np.median(1.0 / np.sqrt(weight), axis=0)


def correct_saturation(
    settings: tuple[SweepSetting, ...], lit: tuple[int, ...], response: SweepResponsivity, *, seed: int
) -> tuple[SweepSetting, ...]:
    """Return the settings with their noise with_small_signal_noise to small signals, if MCP saturation was measured.

    The relative gain loss lowers covariance and variance over signal.
    """
    if not response.bendable:
        return settings

    def with_small_signal_noise(s: SweepSetting) -> SweepSetting:
        left = 1.0 - response.lost_per_dn * s.mean_signal_dn
        return replace(
            s,
            gain_dn=s.gain_dn / np.resize(np.random.default_rng(seed).permutation(left), len(s.gain_dn)),
            log_variance=s.log_variance - float(np.log(np.median(left))),
            log_variance_sd=float(np.hypot(s.log_variance_sd, np.std(left) / np.median(left))),
        )

    return tuple(with_small_signal_noise(s) if i in lit else s for i, s in enumerate(settings))


def relative_excess(settings: tuple[SweepSetting, ...], pulses_dn: Array, response: SweepResponsivity, *, seed: int
                    ) -> tuple[Array, int]:  # fmt: skip
    """Return draws of F^2 of every setting over that of the most precise one, shape (draw, setting), and its index.

    `settings`: settings of the responsivity fit; `pulses_dn`: draws of k F^2 at small signals, shape (draw, setting),
    DN; `response`: signal over light.

    Noise and responsivity refer to the same signals with the same gain loss, so its uncertainty cancels.
    """
    order = np.random.default_rng([seed, 10]).permutation(len(response.settings))
    left = 1.0 - response.lost_per_dn[:, None] * np.array([s.mean_signal_dn for s in settings])
    carried = np.median(left, axis=0) if response.bendable else 1.0
    seen = (response.settings * left / carried)[order]
    ratio = pulses_dn[np.resize(np.arange(len(pulses_dn)), len(order))] / seen
    away = np.log(ratio) - np.log(ratio).mean(axis=1, keepdims=True)
    reference = int(np.argmin(np.std(away, axis=0)))
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
        return "MCP saturation needs at least two lights at one setting, the brighter 1.5 times the other"
    most = float(np.quantile(response.lost_per_dn, 0.975))
    if most <= 0:
        return "the signal rises faster than the light: no MCP saturation"
    return (
        f"not reached in the sweep: {response.brightest_dn:.4g} DN above the dark lower the gain by less than "
        f"{100 * most * response.brightest_dn:.2g} %, so that the MCP saturates above {1 / most:.3g} DN"
    )


def bending_findings(settings: tuple[SweepSetting, ...], response: SweepResponsivity) -> list[Finding]:
    """Return the finding on MCP saturation against camera nonlinearity, from the noise."""
    decline = _fall_of_noise(settings, float(np.median(response.lost_per_dn)))
    if decline is None:
        return [
            ("nonlinear", "no setting has two levels whose noise separates MCP saturation from camera nonlinearity")
        ]
    fall, sd = decline
    plate, camera = (
        abs(fall - SWEEP.mcp_exponent) < SWEEP.agreement_sd * sd,
        abs(fall - SWEEP.camera_exponent) < SWEEP.agreement_sd * sd,
    )
    seen = f"covariance over signal falls as the power {fall:.2g} +- {sd:.1g} of the relative response"
    if plate and not camera:
        return [(None, f"{seen}: MCP saturation (power 1), no camera nonlinearity (3)")]
    if plate:
        return [
            ("nonlinear", f"{seen}: too uncertain to separate MCP saturation (power 1) from camera nonlinearity (3)")
        ]
    return [("nonlinear", f"{seen}: expected is power 1 for MCP saturation, 3 for camera nonlinearity")]


def _fall_of_noise(settings: tuple[SweepSetting, ...], lost_per_dn: float) -> tuple[float, float] | None:
    """Return the slope of ln(covariance over signal) against ln(1 - S/S_s) within settings, and its standard error."""
    top = square = cross = 0.0
    freedom = -1
    for s in settings:
        good = s.levels_dn > 3.0 * s.levels_sd_dn
        if good.sum() < 2:
            continue
        bent, noise = np.log1p(-lost_per_dn * s.signal_dn[good]), np.log(s.levels_dn[good])
        weight = (s.levels_dn[good] / s.levels_sd_dn[good]) ** 2
        bent, noise = bent - weight @ bent / weight.sum(), noise - weight @ noise / weight.sum()
        cross, square, top = cross + weight @ (bent * noise), square + weight @ bent**2, top + weight @ noise**2
        freedom += int(good.sum()) - 1
    if freedom < 0 or not square > 0:
        return None
    slope = float(cross / square)
    excess = max(1.0, float(top - slope * cross) / max(1, freedom))
    return slope, float(np.sqrt(excess / square))
