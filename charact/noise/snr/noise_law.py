"""How noise grows with the signal at one gain, and the light at which the signal is so many times the noise.

One exposure above a dark of many: v(mu) = r^2 + a mu + b mu^2, read noise, shot noise and what bends it (a plate that
tires); unequal pixels add p mu^2 where no flat field is divided out. The signal over the noise rises as mu, then as
its square root, then stays. For a pixel a is (K + k F^2) times the blur factor, for an area K + k F^2 over its pixels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.measurement import Posterior

Array = NDArray[np.float64]

NAMES = ("read_variance", "shot_gain", "bend", "pattern_variance")
UNITS = ("DN2", "DN", "1", "1")
# Normal prior, mean 0, of the share by which shot noise departs from a straight line at the brightest level.
BEND_SHARE_SD = 0.1
# Departures from the law that make a misfit: probability, and share of the variance.
LEAST_CHANCE = 1e-4
MISFIT_SHARE = 0.03
# Signal over its own error from which a level counts as lit.
LIT = 5.0
DRAWS = 2000


@dataclass(frozen=True, kw_only=True)
class SignalNoiseSeries:
    """Signal and temporal noise of one exposure at every level of one gain, in a pixel or the mean of an area.

    Parameters
    ----------
    signal_dn, signal_sd_dn
        Signal above the dark and its standard error, shape (flat,), DN.
    variance_dn2, variance_sd_dn2
        Variance and its standard error, shape (flat,), DN^2.
    dark
        Which dark each flat is counted from, shape (flat,).
    dark_variance_dn2, dark_variance_sd_dn2
        The same of every dark, shape (dark,), DN^2.
    fitted
        Levels of the linear range, shape (flat,).
    pattern, pattern_sd
        Squared relative non-uniformity of the pixels and its standard error, dimensionless; 0 and 0 for none.
    """

    signal_dn: Array
    signal_sd_dn: Array
    variance_dn2: Array
    variance_sd_dn2: Array
    dark: NDArray[np.int64]
    dark_variance_dn2: Array
    dark_variance_sd_dn2: Array
    fitted: NDArray[np.bool_]
    pattern: float = 0.0
    pattern_sd: float = 0.0

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Which levels are brighter than their dark beyond doubt, shape (flat,)."""
        return self.signal_dn > LIT * self.signal_sd_dn

    @property
    def snr(self) -> Array:
        """Signal over temporal noise at each level, shape (flat,)."""
        return self.signal_dn / self._noise_dn

    @property
    def snr_sd(self) -> Array:
        """Standard error of that, shape (flat,)."""
        relative = 0.5 * self.variance_sd_dn2 / self._noise_dn**2
        return np.hypot(self.signal_sd_dn / self._noise_dn, self.snr * relative)

    @property
    def _noise_dn(self) -> Array:
        return np.sqrt(np.maximum(self.variance_dn2, 1e-12))


@dataclass(frozen=True, kw_only=True)
class NoiseLaw:
    """Posterior of the law.

    Parameters
    ----------
    posterior
        Draws of `NAMES`.
    misfit
        Sentence on how the levels depart from the law, or None.
    """

    posterior: Posterior
    misfit: str | None

    def snr(self, signal: Array, *, pattern: bool = False) -> Array:
        """Return signal over noise, shape (draw, signal), with or without unequal pixels."""
        read, shot, bend, fixed = (self.posterior[name][:, None] for name in NAMES)
        return signal / np.sqrt(np.maximum(read + shot * signal + (bend + fixed * pattern) * signal**2, 1e-300))

    def signal_at(self, snr: float) -> Array:
        """Return draws of the signal at which signal over noise, unequal pixels included, is given; inf where never."""
        read, shot, bend, fixed = (self.posterior[name] for name in NAMES)
        square = 1.0 - snr**2 * (fixed + bend)
        root = np.sqrt(snr**4 * shot**2 + 4.0 * np.maximum(square, 0.0) * snr**2 * read)
        return np.where(square > 0, (snr**2 * shot + root) / np.maximum(2.0 * square, 1e-12), np.inf)


def noise_law(levels: SignalNoiseSeries, rng: np.random.Generator, *, reference: int) -> NoiseLaw:
    """Fit the law to the levels of the linear range.

    Parameters
    ----------
    levels
        The levels; at least one is fitted.
    reference
        The dark whose noise is the law's read noise.

    Notes
    -----
    Linear in its parameters, so that the posterior is normal but for read and shot noise being positive. Where the
    levels scatter about the law by more than their errors, errors are stretched to that scatter (Birge, Phys. Rev. 40,
    207 (1932)).
    """
    design, data, sd = _equations(levels)
    covariance = np.linalg.inv((design / sd[:, None] ** 2).T @ design).astype(float)
    best = covariance @ (design / sd[:, None] ** 2).T @ data
    rest = data - design @ best
    freedom = int(levels.fitted.sum()) - 1
    chi2 = float(np.sum((rest / sd) ** 2))
    stretch = max(1.0, chi2 / freedom) if freedom else 1.0
    drawn = _positive(rng, best, covariance * stretch, (reference, len(best) - 2))
    pattern = _above_zero(rng, levels.pattern, levels.pattern_sd)
    brightest = float(levels.signal_dn[levels.fitted].max())
    draws = np.stack([drawn[:, reference], drawn[:, -2], drawn[:, -1] / brightest**2, pattern], axis=1)
    posterior = Posterior(names=NAMES, units=UNITS, draws=draws, sampler="laplace")
    return NoiseLaw(posterior=posterior, misfit=_misfit(rest, levels, chi2, freedom))


def _equations(levels: SignalNoiseSeries) -> tuple[Array, Array, Array]:
    """Design, data and errors: the darks, the fitted flats, and the prior of the bend at the brightest of them."""
    chosen = np.flatnonzero(levels.fitted)
    darks, signal = len(levels.dark_variance_dn2), levels.signal_dn[chosen]
    own = np.eye(darks)[levels.dark[chosen]]
    bend = (signal / signal.max()) ** 2
    shot = levels.variance_dn2[chosen] - levels.dark_variance_dn2[levels.dark[chosen]]
    brightest = max(float(shot[signal.argmax()]), float(levels.variance_sd_dn2[chosen][signal.argmax()]))
    design = np.vstack(
        [np.hstack([np.eye(darks), np.zeros((darks, 2))]), np.column_stack([own, signal, bend]), np.eye(darks + 2)[-1:]]
    )
    data = np.concatenate([levels.dark_variance_dn2, levels.variance_dn2[chosen], [0.0]])
    sd = [levels.dark_variance_sd_dn2, levels.variance_sd_dn2[chosen], [BEND_SHARE_SD * brightest]]
    return design, data, np.maximum(np.concatenate(sd), 1e-12)


def _misfit(rest: Array, levels: SignalNoiseSeries, chi2: float, freedom: int) -> str | None:
    """How far the levels depart from the law, if that is neither chance nor little."""
    from scipy.stats import chi2 as chi_squared

    flats = rest[len(levels.dark_variance_dn2) : -1] / levels.variance_dn2[levels.fitted]
    if freedom < 1 or chi_squared.sf(chi2, freedom) > LEAST_CHANCE or np.abs(flats).max() < MISFIT_SHARE:
        return None
    return f"the noise departs from read and shot noise by up to {100 * np.abs(flats).max():.2g} % of its variance"


def _positive(rng: np.random.Generator, mean: Array, covariance: Array, which: tuple[int, int]) -> Array:
    """Normal draws of which some parameters must not be negative."""
    drawn = rng.multivariate_normal(mean, covariance, 4 * DRAWS, method="eigh")
    good = drawn[(drawn[:, which] >= 0).all(axis=1)]
    if len(good) >= DRAWS:
        return good[:DRAWS]
    drawn[:, which] = np.abs(drawn[:, which])
    return drawn[:DRAWS]


def _above_zero(rng: np.random.Generator, mean: float, sd: float) -> Array:
    """Draws of a normal cut off at zero."""
    from scipy.special import ndtr, ndtri

    if sd <= 0:
        return np.full(DRAWS, max(mean, 0.0))
    low = ndtr(-mean / sd)
    return np.maximum(mean + sd * ndtri(low + (1.0 - low) * rng.uniform(1e-9, 1.0 - 1e-9, DRAWS)), 0.0)
