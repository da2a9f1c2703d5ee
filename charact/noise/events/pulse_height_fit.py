"""Pulse-height fit of dark frames: matched filters, exclusion of ion feedback, fit in two rounds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.events.characteristic_functions import blend_covariances, observe, scatter
from charact.noise.events.event_distribution import CharacteristicFunctionData, PulsePopulation
from charact.noise.events.filters import MIDDLE, REFERENCE_CY_PER_PX, Filter, responses
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
from charact.noise.thresholds import EVENTS
from labdata.measurement import Posterior

Array = NDArray[np.float64]
# Half width of the matched filter, px, below each spot width.
STEPS = ((1.0, 1), (1.8, 2), (np.inf, 3))


@dataclass(frozen=True, kw_only=True)
class PulseFit:
    """Pulse-height fit of dark frames."""

    # peak, posterior: optimum and draws
    peak: PulseOptimum
    posterior: Posterior
    observed: CharacteristicFunctionData  # data of the fit
    usable: list[NDArray[np.bool_]]  # values far from ion feedback, for each parity, shape (exposure, row, col)
    frames: DarkFrames  # exposures, centred on the mean of those values
    signal_to_noise: float  # output of the matched filter for a mean pulse in its own exposure, over its noise
    ion_height_dn: Array  # heights of the ion feedback events, total light, shape (event,), DN
    gain_of_pulses: float  # decrease of chi2 by pulses in addition to noise

    @property
    def fraction_contaminated(self) -> float:
        """Fraction of the values excluded around ion feedback."""
        return 1.0 - float(np.mean([part.mean() for part in self.usable]))


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """A fit to frames with some values excluded."""

    problem: PulseLikelihood
    covariance: Array
    peak: PulseOptimum
    step: int
    frames: DarkFrames
    usable: list[NDArray[np.bool_]]
    ions_dn: Array

    @property
    def middle(self) -> Filter:
        """The matched filter."""
        return self.problem.observed.filters[MIDDLE]


@dataclass(frozen=True, kw_only=True)
class _Setup:
    """Settings of a fit: priors, fixed parameters, and free parameters of the phosphor decay."""

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
    """Fit the pulses of dark frames, or return the reason for refusal.

    `look`, `frames`: a part of the exposures for the start of the fit, and all used exposures; `period_s`: exposure
    period, s; None: unknown; `open_share`: fraction of the period, from its start, in which photoelectrons arrive.
    """
    seen, fast = image_lag_correlation(frames), fast_prior(context, period_s, frames.stride)
    known = context.sensor is not None and period_s is not None
    if seen.across and not seen.later and not known:
        return (
            "image lag reaches the next field, whose amount is not measurable from one field alone: "
            "name the sensor, with its phosphor decay, and state the exposure_s of the darks"
        )
    screen = _screen(seen, frames.stride)
    priors = spot_priors(context) | fast
    setup = _Setup(priors=priors, fixed=_guess(frames, priors, open_share=open_share, screen=screen), screen=screen)
    first = _without_ions(look, _from_scratch(look, setup), setup, 0)
    fit = _without_ions(frames, first, setup, -1)
    if "glow" in screen and fit.peak.chance < EVENTS.restart_p_value:
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
    """Return the free parameters of the phosphor decay.

    Frames always measure light in the next frame; fields only detect it.
    """
    if seen.later:
        return (*SLOW, *FAST)
    return FAST if seen.across or stride == 1 else ()


def _from_elsewhere(fit: _Fit, stride: int) -> PulseOptimum:
    """Return the best optimum from several decay start values, because few frames constrain it poorly."""
    near = [
        replace(fit.peak.pulses, glow=share, glow_exposures=EVENTS.start_decay * stride)
        for share in EVENTS.restart_fractions
    ]
    return min([fit.peak, *(optimise_pulses(fit.problem, fit.covariance, one, rough=False) for one in near)],
               key=lambda peak: peak.chi2)  # fmt: skip


def _all(frames: DarkFrames) -> list[NDArray[np.bool_]]:
    return [np.ones(change.shape, bool) for change in frames.changes]


def _from_scratch(frames: DarkFrames, setup: _Setup) -> _Fit:
    """Return a fit from start values, with the empirical covariance."""
    usable, step = _all(frames), 1
    while True:
        problem = setup.problem(observe(frames.changes, usable, frames.filters(step, lag=setup.lag)))
        observed = problem.observed
        covariance = observed.covariance + np.diag((3e-3 * observed.value) ** 2)
        guess = best_guess(problem, covariance, spread(frames.changes[0]))
        if _step(guess) <= step:
            break
        step = _step(guess)
    return _Fit(
        problem=problem,
        covariance=covariance,
        peak=optimise_pulses(problem, covariance, guess, rough=True),
        step=step,
        frames=frames,
        usable=usable,
        ions_dn=np.empty(0),
    )


def _again(frames: DarkFrames, usable: list[NDArray[np.bool_]], ions_dn: Array, near: _Fit, setup: _Setup) -> _Fit:
    """Return a fit that starts from another, with the covariance of its pulses."""
    problem = setup.problem(observe(frames.changes, usable, frames.filters(near.step, lag=setup.lag)))
    peak, covariance = near.peak, near.covariance
    for left in reversed(range(EVENTS.rounds)):
        covariance = blend_covariances(scatter(peak.pulses, problem.observed), problem.observed.covariance)
        peak = optimise_pulses(problem, covariance, peak.pulses, peak.derivative, rough=left > 0)
    return _Fit(problem=problem, covariance=covariance, peak=peak, step=near.step, frames=frames, usable=usable,
                ions_dn=ions_dn)  # fmt: skip


def _without_ions(frames: DarkFrames, fit: _Fit, setup: _Setup, known: int) -> _Fit:
    """Return a fit without pulses beyond its own distribution (ion feedback), repeated until no more are found."""
    while True:
        limit, after = _ion_limit(frames, fit), EVENTS.ion_exposures if setup.lag else 0
        parts = [usable_values(change, fit.middle, limit, after) for change in frames.changes]
        heights, usable = np.concatenate([height for _, height in parts]), [good for good, _ in parts]
        if len(heights) <= known:
            return fit
        known = len(heights)
        frames = frames.without_mean(usable) if known else frames
        fit = _again(frames, usable, heights, fit, setup)


def spot_priors(context: Context) -> Priors:
    """Return the priors of the wings of a spot from the sensor: mean and standard deviation by name.

    The tube's transfer is exp(-(f/fc)^n) at the photocathode; its post-gain fraction spreads pulses.
    """
    if context.sensor is None:
        return PRIORS
    tube, pitch_um = context.sensor.tube, float(context.sensor.ccd.pitch_x_um)
    at_cathode = REFERENCE_CY_PER_PX / (pitch_um * 1e-3 * float(context.sensor.taper.demagnification))
    exponent = float(tube.mtf_exponent)
    wings = float(tube.post_gain_share) * (at_cathode / float(tube.mtf_frequency_lp_per_mm)) ** exponent
    return PRIORS | {"exponent": (exponent, EVENTS.exponent_sd), "wings": (wings, EVENTS.wings_relative_sd * wings)}


def fast_prior(context: Context, period_s: float | None, stride: int) -> Priors:
    """Return the prior of the fast phosphor decay, exposures.

    Frames measure it, fields of one parity do not.
    """
    if context.sensor is None or period_s is None:
        return {"fast_exposures": EVENTS.fast_of_fields if stride > 1 else EVENTS.fast_of_frames}
    fast = 1e-3 * float(context.sensor.phosphor.fast_decay_ms) / period_s
    return {"fast_exposures": (fast, EVENTS.fast_relative_sd * fast)}


def _guess(frames: DarkFrames, priors: Priors, *, open_share: float, screen: tuple[str, ...]) -> PulsePopulation:
    """Return start values and fixed parameters."""
    fast = priors["fast_exposures"][0] if screen else 0.0
    return PulsePopulation(
        density=1.0,
        height_dn=1.0,
        relative_variance=1.0,
        noise_dn2=1.0,
        line_1=0.0,
        line_2=0.0,
        column_px=1.0,
        row_px=1.0,
        wings=0.0,
        exponent=priors["exponent"][0],
        glow=EVENTS.start_slow_fraction if "glow" in screen else 0.0,
        glow_exposures=EVENTS.start_decay * frames.stride,
        fast_exposures=fast,
        row_pitch=frames.row_pitch,
        open_share=open_share,
    )


def _step(guess: PulsePopulation) -> int:
    width = max(guess.column_px, guess.row_px)
    return next(step for most, step in STEPS if width < most)


def _response(one: Filter, pulses: PulsePopulation) -> float:
    """Return the output for a pulse of unit light at a pixel centre, in its own exposure."""
    amplitude, _ = responses(one, pulses.spot, pulses.line)
    light, weight = pulses.screen.by_exposure()
    return float(amplitude.max() * (weight @ light[:, 0]))


def _ion_limit(frames: DarkFrames, fit: _Fit) -> float:
    """Return the output of the matched filter, DN, that pulses hardly ever exceed."""
    from scipy.special import gammainccinv

    pulses, changes = fit.peak.pulses, frames.changes
    shape = 1.0 / pulses.relative_variance
    events = max(pulses.density * sum(change.size for change in changes), 10.0)
    limit = (
        float(gammainccinv(shape, EVENTS.rare_pulses / events))
        / shape
        * pulses.height_dn
        * _response(fit.middle, pulses)
    )
    # Without pulses the noise sets the limit.
    return max(limit, EVENTS.min_ion_sd * spread(fit.middle.within(changes[0], fit.middle.reach)))
