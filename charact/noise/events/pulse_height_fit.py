"""From dark frames to the law of their pulses: filters as wide as the spot, ion events apart, a fit in two rounds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.events.characteristic_function_covariance import blend_covariances, scatter
from charact.noise.events.characteristic_functions import observe
from charact.noise.events.event_distribution import CharacteristicFunctionData, PulsePopulation
from charact.noise.events.filters import MIDDLE, Filter
from charact.noise.events.fit import (
    FAST,
    PRIORS,
    SLOW,
    UNITS,
    Priors,
    PulseLikelihood,
    PulseOptimum,
    best_guess,
    laplace_draws,
    noise_only_chi2,
    optimise_pulses,
)
from charact.noise.events.frames import DarkFrames, ImageLagCorrelation, image_lag_correlation, spread, usable_values
from charact.noise.events.spot import REFERENCE_CY_PER_PX, responses
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Half widths of the filter that suits the spot, px, from the first guess of the spot's.
STEPS = ((1.0, 1), (1.8, 2), (np.inf, 3))
ROUNDS = 2
# The law of the pulses makes none above the limit beyond which events are ions' in so many stacks of a hundred.
RARE = 0.01
# An ion event stands out of the filtered noise at least so many times.
LEAST_ION = 15.0
# Exposures of the same rows that the light of an ion event spoils where light lingers.
SPOILT_AFTER = 6
# A guess of a glow to start from: its share, and its time in exposures of the same rows.
GLOW, GLOW_TIME = 0.4, 1.0
# A fit that leaves more than chance does in so many cases is begun again from these shares.
UNLIKELY, GLOWS = 1e-3, (0.2, 0.6)
# How well a sensor's description knows the spot's wings: standard deviations of the exponent, and of the strength as a
# share of it; and the screen's fast time, as a share of that.
EXPONENT_SD, WINGS_SHARE, FAST_SHARE = 0.05, 0.25, 0.2
# That time where no sensor is known, exposures: mean and standard deviation, of fields and of whole frames.
FAST_OF_FIELDS, FAST_OF_FRAMES = (0.06, 0.04), (0.03, 0.1)


@dataclass(frozen=True, kw_only=True)
class PulseFit:
    """The law of the pulses of dark frames.

    Parameters
    ----------
    peak, posterior
        Best pulses and draws.
    observed
        What they were fitted to.
    usable
        Values far from ion events, for each set of rows, shape (exposure, row, col).
    frames
        The exposures, each pixel's mean taken over those values.
    signal_to_noise
        Response of the filter that suits the spot to a mean pulse in its own exposure, over its noise.
    ion_height_dn
        Heights of the ion events, shape (event,), DN: all light together.
    gain_of_pulses
        By how much chi2 falls as pulses are put to noise.
    """

    peak: PulseOptimum
    posterior: Posterior
    observed: CharacteristicFunctionData
    usable: list[NDArray[np.bool_]]
    frames: DarkFrames
    signal_to_noise: float
    ion_height_dn: Array
    gain_of_pulses: float

    @property
    def spoilt(self) -> float:
        """Share of the values left out around ion events."""
        return 1.0 - float(np.mean([part.mean() for part in self.usable]))


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """A fit to frames of which some values are left out."""

    problem: PulseLikelihood
    covariance: Array
    peak: PulseOptimum
    step: int
    frames: DarkFrames
    usable: list[NDArray[np.bool_]]
    ions_dn: Array

    @property
    def middle(self) -> Filter:
        """The filter that suits the spot."""
        return self.problem.observed.filters[MIDDLE]


@dataclass(frozen=True, kw_only=True)
class _Setup:
    """What a fit is told: priors, pulses whose other parameters hold, and what of the screen's decay is to be found."""

    priors: Priors
    fixed: PulsePopulation
    screen: tuple[str, ...]

    @property
    def lag(self) -> bool:
        return bool(self.screen)

    def problem(self, observed: CharacteristicFunctionData) -> PulseLikelihood:
        names = tuple(name for name in UNITS if name in self.screen or name not in (*SLOW, *FAST))
        return PulseLikelihood(observed=observed, names=names, priors=self.priors, fixed=self.fixed)


def fit_pulses(look: DarkFrames, frames: DarkFrames, context: Context, *, period_s: float | None = None,
               open_share: float = 1.0) -> PulseFit | str:  # fmt: skip
    """Fit the law of the pulses of dark frames, or say why that cannot be.

    Parameters
    ----------
    look, frames
        A part of the exposures, by which the fit begins, and all that are to be used.
    period_s
        From one exposure to the next, s; None: unknown.
    open_share
        Share of it, from its start, in which photoelectrons come.
    """
    seen, fast = image_lag_correlation(frames), fast_prior(context, period_s, frames.stride)
    known = context.sensor is not None and period_s is not None
    if seen.across and not seen.later and not known:
        return (
            "the screen's light spills into the next field, and the rows of one field alone do not show how much: "
            "name the sensor, whose screen has a known decay, and the exposure_s of the darks"
        )
    screen = _screen(seen, frames.stride)
    priors = spot_priors(context) | fast
    setup = _Setup(priors=priors, fixed=_guess(frames, priors, open_share=open_share, screen=screen), screen=screen)
    first = _without_ions(look, _from_scratch(look, setup), setup, 0)
    fit = _without_ions(frames, first, setup, -1)
    if "glow" in screen and fit.peak.chance < UNLIKELY:
        fit = _without_ions(frames, replace(fit, peak=_from_elsewhere(fit, frames.stride)), setup, -1)
    pulses = fit.peak.pulses
    response, noise = _response(fit.middle, pulses), np.sqrt(fit.middle.noise(pulses.line) * pulses.noise_dn2)
    return PulseFit(
        peak=fit.peak,
        posterior=laplace_draws(fit.problem, fit.peak, seed=context.seed),
        observed=fit.problem.observed,
        usable=fit.usable,
        frames=fit.frames,
        signal_to_noise=float(response * pulses.height_dn / noise),
        ion_height_dn=fit.ions_dn / response,
        gain_of_pulses=noise_only_chi2(fit.problem, fit.covariance) - fit.peak.chi2,
    )


def _screen(seen: ImageLagCorrelation, stride: int) -> tuple[str, ...]:
    """What of the screen's decay is to be found.

    Whole frames always show what little spills into the next one; fields only tell whether any does.
    """
    if seen.later:
        return (*SLOW, *FAST)
    return FAST if seen.across or stride == 1 else ()


def _from_elsewhere(fit: _Fit, stride: int) -> PulseOptimum:
    """The best peak of those near a fit's and near other screens: a glow that few frames show can be taken amiss."""
    near = [replace(fit.peak.pulses, glow=share, glow_exposures=GLOW_TIME * stride) for share in GLOWS]
    return min([fit.peak, *(optimise_pulses(fit.problem, fit.covariance, one, rough=False) for one in near)],
               key=lambda peak: peak.chi2)  # fmt: skip


def _all(frames: DarkFrames) -> list[NDArray[np.bool_]]:
    return [np.ones(change.shape, bool) for change in frames.changes]


def _from_scratch(frames: DarkFrames, setup: _Setup) -> _Fit:
    """A fit that begins with a guess; the scatter is counted, and held loosely."""
    usable, step = _all(frames), 1
    while True:
        problem = setup.problem(observe(frames.changes, usable, frames.filters(step, lag=setup.lag)))
        observed = problem.observed
        covariance = observed.covariance + np.diag((3e-3 * observed.value) ** 2)
        guess = best_guess(problem, covariance, spread(frames.changes[0]))
        if _step(guess) <= step:
            break
        step = _step(guess)
    return _Fit(problem=problem, covariance=covariance, peak=optimise_pulses(problem, covariance, guess, rough=True), step=step,
                frames=frames, usable=usable, ions_dn=np.empty(0))  # fmt: skip


def _again(frames: DarkFrames, usable: list[NDArray[np.bool_]], ions_dn: Array, near: _Fit, setup: _Setup) -> _Fit:
    """A fit that begins with another; the scatter is that of the pulses found so far."""
    problem = setup.problem(observe(frames.changes, usable, frames.filters(near.step, lag=setup.lag)))
    peak, covariance = near.peak, near.covariance
    for left in reversed(range(ROUNDS)):
        covariance = blend_covariances(scatter(peak.pulses, problem.observed), problem.observed.covariance)
        peak = optimise_pulses(problem, covariance, peak.pulses, peak.derivative, rough=left > 0)
    return _Fit(problem=problem, covariance=covariance, peak=peak, step=near.step, frames=frames, usable=usable,
                ions_dn=ions_dn)  # fmt: skip


def _without_ions(frames: DarkFrames, fit: _Fit, setup: _Setup, known: int) -> _Fit:
    """A fit to frames from which every pulse that its law cannot make is left out; so many of them it knows.

    As long as more of those come to light, it begins again.
    """
    while True:
        limit, after = _ion_limit(frames, fit), SPOILT_AFTER if setup.lag else 0
        parts = [usable_values(change, fit.middle, limit, after) for change in frames.changes]
        heights, usable = np.concatenate([height for _, height in parts]), [good for good, _ in parts]
        if len(heights) <= known:
            return fit
        known = len(heights)
        frames = frames.without_mean(usable) if known else frames
        fit = _again(frames, usable, heights, fit, setup)


def spot_priors(context: Context) -> Priors:
    """Return what the sensor, where known, says of the wings of a spot: mean and standard deviation by name.

    The tube's transfer is exp(-(f/fc)^n) at the cathode, of which the share behind the gain spreads pulses.
    """
    if context.sensor is None:
        return PRIORS
    tube, pitch_um = context.sensor.tube, float(context.sensor.ccd.pitch_x_um)
    at_cathode = REFERENCE_CY_PER_PX / (pitch_um * 1e-3 * float(context.sensor.taper.demagnification))
    exponent = float(tube.mtf_exponent)
    wings = float(tube.post_gain_share) * (at_cathode / float(tube.mtf_frequency_lp_per_mm)) ** exponent
    return PRIORS | {"exponent": (exponent, EXPONENT_SD), "wings": (wings, WINGS_SHARE * wings)}


def fast_prior(context: Context, period_s: float | None, stride: int) -> Priors:
    """Return what is known of the time of the screen's fast light, in exposures: more where the sensor is known.

    Frames show it themselves, but fields of the same rows come too late for it.
    """
    if context.sensor is None or period_s is None:
        return {"fast_exposures": FAST_OF_FIELDS if stride > 1 else FAST_OF_FRAMES}
    fast = 1e-3 * float(context.sensor.phosphor.fast_decay_ms) / period_s
    return {"fast_exposures": (fast, FAST_SHARE * fast)}


def _guess(frames: DarkFrames, priors: Priors, *, open_share: float, screen: tuple[str, ...]) -> PulsePopulation:
    """Pulses to start from, and what is not fitted."""
    fast = priors["fast_exposures"][0] if screen else 0.0
    return PulsePopulation(density=1.0, height_dn=1.0, relative_variance=1.0, noise_dn2=1.0, line_1=0.0, line_2=0.0,
                  column_px=1.0, row_px=1.0, wings=0.0, exponent=priors["exponent"][0],
                  glow=GLOW if "glow" in screen else 0.0, glow_exposures=GLOW_TIME * frames.stride,
                  fast_exposures=fast, row_pitch=frames.row_pitch, open_share=open_share)  # fmt: skip


def _step(guess: PulsePopulation) -> int:
    width = max(guess.column_px, guess.row_px)
    return next(step for most, step in STEPS if width < most)


def _response(one: Filter, pulses: PulsePopulation) -> float:
    """Response to a pulse of unit light amid its pixel, in its own exposure."""
    amplitude, _ = responses(one, pulses.spot, pulses.line)
    light, weight = pulses.screen.by_exposure()
    return float(amplitude.max() * (weight @ light[:, 0]))


def _ion_limit(frames: DarkFrames, fit: _Fit) -> float:
    """Output of the filter that suits the spot, DN, that the law of the pulses hardly ever makes."""
    from scipy.special import gammainccinv

    pulses, changes = fit.peak.pulses, frames.changes
    shape = 1.0 / pulses.relative_variance
    events = max(pulses.density * sum(change.size for change in changes), 10.0)
    limit = float(gammainccinv(shape, RARE / events)) / shape * pulses.height_dn * _response(fit.middle, pulses)
    # Without pulses to speak of the law knows no limit, and the noise sets one.
    return max(limit, LEAST_ION * spread(fit.middle.within(changes[0], fit.middle.reach)))
