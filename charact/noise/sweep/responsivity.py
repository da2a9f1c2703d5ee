"""Signal against light at every setting of a gain sweep: the law of the gain, and the plate that tires.

A channel plate's gain falls with the current it delivers, G = G0 / (1 + j0 / (a j_s)), j0 the current it would deliver
untired and j_s that of its strips. The signal is that current seen by the chip, so that S = S0 / (1 + S0 / S_s), or
S = S0 (1 - S / S_s): the share of gain lost is the measured signal over S_s, whatever the setting.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.noise.sweep.gain_law import (
    LOG_DEPARTURE,
    departure_prior,
    draw_posterior,
    weighted_line,
    without_bound_flag,
)
from charact.noise.sweep.settings import SweepSetting
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Departure of one level from the response beyond its noise, for lamps and filters repeat to some percent: half-normal
# prior of this width, on the logarithm.
LIGHT = 0.03
# Share of the gain lost at the brightest level: flat between these bounds where one setting was seen at several lights,
# else normal about none, for a law of the gain bends the response along the sweep as well.
LOST = (-0.3, 0.95)
LOST_UNSEEN = 0.1
# Lights of one setting tell a bent response from this ratio on.
SPAN = 1.5
NAMES = ("log_response", "rise", "lost", "log_scatter", "log_departure")
UNITS = ("log DN/light", "1", "1", "1", "1")


@dataclass(frozen=True, kw_only=True)
class SweepResponsivity:
    """Posterior of the signal over light of every setting.

    Parameters
    ----------
    posterior
        Draws of `NAMES`: response in the middle of the axis and its rise along it, share of gain lost at the
        brightest level, scatter of levels and departure of settings (logarithms of both).
    settings
        Draws of the response of every setting at small signals, shape (draw, setting), DN per unit of light.
    own, own_sd
        Logarithm of each setting's own response without the law, and its standard error, shape (setting,).
    brightest_dn
        The brightest level, DN above the dark.
    bendable
        Whether some setting was seen at lights far enough apart to show a bent response.
    """

    posterior: Posterior
    settings: Array
    own: Array
    own_sd: Array
    brightest_dn: float
    bendable: bool

    @property
    def lost_per_dn(self) -> Array:
        """Draws of 1/S_s, shape (draw,), 1/DN."""
        return self.posterior["lost"] / self.brightest_dn


def response_of(settings: tuple[SweepSetting, ...], x: Array, *, seed: int, quick: bool) -> SweepResponsivity:
    """Fit signal against light at all settings together.

    Parameters
    ----------
    settings
        Settings whose light is known at every level.
    x
        Their places along the axis of the sweep.
    seed, quick
        Seed of the draws; without a Markov chain.

    Notes
    -----
    ln(S/E) = a + b x_i + d_i + ln(1 - S/S_s) + e_ij: departures d of settings and e of levels are normal, of unknown
    size. The covariance of one setting's levels is that of e, and d's in common.
    """
    levels = ResponsivityLevels.of(settings, x)
    bendable = any(s.light is not None and s.light.max() > SPAN * s.light.min() for s in settings)

    def log_probability(points: Array) -> Array:
        inside = np.all((points >= bounds[:, 0]) & (points <= bounds[:, 1]), axis=1)
        safe = np.where(inside[:, None], points, start)
        value = levels.log_likelihood(safe) + departure_prior(safe[:, 4])
        value = value + safe[:, 3] - 0.5 * (np.exp(safe[:, 3]) / LIGHT) ** 2
        if not bendable:
            value = value - 0.5 * (safe[:, 2] / LOST_UNSEEN) ** 2
        return np.where(inside, value, -np.inf)

    free = [-np.inf, np.inf]
    bounds = np.array([free, free, LOST, LOG_DEPARTURE, LOG_DEPARTURE])
    line = weighted_line(levels.x, levels.log_ratio, np.hypot(levels.sd, LIGHT))
    start = np.array([*line, 0.05, np.log(0.01), np.log(0.02)])
    drawn = draw_posterior(log_probability, start, bounds, names=NAMES, units=UNITS, seed=seed, quick=quick)
    posterior = without_bound_flag(drawn)
    responses, own, own_sd = levels.settings(posterior, np.random.default_rng([seed, 8]))
    return SweepResponsivity(posterior=posterior, settings=responses, own=own, own_sd=own_sd,
                    brightest_dn=levels.brightest_dn, bendable=bendable)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ResponsivityLevels:
    """All levels of a sweep: place and logarithm of signal over light, its error, share of the brightest signal, and
    which setting each belongs to, shape (level,); `member` is 1 there, shape (level, setting)."""

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
        """Return the logarithm of the likelihood, shape (point,): block by block, one setting's levels each."""
        residual, variance = self._left(points), self.sd**2 + np.exp(2.0 * points[:, 3:4])
        departure = np.exp(2.0 * points[:, 4:5])
        weight = (1.0 / variance) @ self.member
        together = (residual / variance) @ self.member
        spread = 1.0 + departure * weight
        square = (residual**2 / variance).sum(axis=1) - (departure * together**2 / spread).sum(axis=1)
        return -0.5 * (square + np.log(variance).sum(axis=1) + np.log(spread).sum(axis=1))

    def _left(self, points: Array) -> Array:
        """What is left of ln(S/E) once law and loss are taken off, shape (point, level)."""
        law = points[:, :1] + points[:, 1:2] * self.x
        return self.log_ratio - law - np.log1p(-points[:, 2:3] * self.share)

    def settings(self, posterior: Posterior, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Draw every setting's response; and return the logarithms of their own, without the law, with their errors."""
        points = posterior.draws
        variance = self.sd**2 + np.exp(2.0 * points[:, 3:4])
        weight = (1.0 / variance) @ self.member
        away = (self._left(points) / variance) @ self.member / weight
        total = weight + np.exp(-2.0 * points[:, 4:5])
        departure = away * weight / total + rng.standard_normal(away.shape) / np.sqrt(total)
        places = (self.x @ self.member) / self.member.sum(axis=0)
        law = points[:, :1] + points[:, 1:2] * places
        return np.exp(law + departure), np.median(law + away, axis=0), np.median(1.0 / np.sqrt(weight), axis=0)
