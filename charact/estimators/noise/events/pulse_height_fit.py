"""Pulse-height fit of dark frames: matched filters, exclusion of ion feedback, fit in two
rounds.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.events.event_distribution import (
    CharacteristicFunctionData,
    PulsePopulation,
    blend_covariances,
    observe,
    scatter,
)
from charact.estimators.noise.events.frames import (
    MIDDLE,
    REFERENCE_CY_PER_PX,
    DarkFrames,
    Filter,
    image_lag_reach,
    responses,
    spread,
    usable_values,
)
from charact.estimators.noise.events.pulse_likelihood import (
    PRIORS,
    UNITS,
    Priors,
    PulseLikelihood,
    PulseOptimum,
    best_guess,
    laplace_draws,
    noise_only_chi2,
    optimise_pulses,
)
from charact.estimators.noise.findings import Unmeasurable
from charact.estimators.noise.thresholds import EVENTS
from charact.method import Context
from labdata import Array, Posterior, has_tube

SLOW, FAST = ("glow", "glow_exposures"), ("fast_exposures",)
# Half width of the matched filter, px, below each spot width.
STEPS = ((1.0, 1), (1.8, 2), (np.inf, 3))


@dataclass(frozen=True, kw_only=True)
class PulseFit:
    """Pulse-height fit of dark frames with some values excluded."""

    problem: PulseLikelihood
    covariance: Array
    peak: PulseOptimum
    step: int  # half width of the matched filter, px
    frames: DarkFrames  # exposures, centred on the mean of the usable values
    usable: list[NDArray[np.bool_]]  # far from ion feedback, by parity, (exposure, row, col)
    ions_dn: Array  # outputs of the matched filter for ion feedback events, shape (event,)
    seed: int

    @property
    def observed(self) -> CharacteristicFunctionData:
        """Data of the fit."""
        return self.problem.observed

    @property
    def middle(self) -> Filter:
        """The matched filter."""
        return self.observed.filters[MIDDLE]

    @cached_property
    def posterior(self) -> Posterior:
        """Draws of the pulses."""
        return laplace_draws(self.problem, self.peak, seed=self.seed)

    @property
    def response(self) -> float:
        """Output of the matched filter for a pulse of unit light at a pixel centre, in its own
        exposure.
        """
        pulses = self.peak.pulses
        amplitude, _ = responses(self.middle, pulses.spot, pulses.line)
        light, weight = pulses.screen.by_exposure()
        return float(amplitude.max() * (weight @ light[:, 0]))

    @property
    def signal_to_noise(self) -> float:
        """Output of the matched filter for a mean pulse in its own exposure, over its noise."""
        pulses = self.peak.pulses
        noise = np.sqrt(self.middle.noise(pulses.line) * pulses.noise_dn2)
        return float(self.response * pulses.height_dn / noise)

    @property
    def ion_height_dn(self) -> Array:
        """Heights of the ion feedback events, total light, shape (event,), DN."""
        return self.ions_dn / self.response

    @property
    def gain_of_pulses(self) -> float:
        """Decrease of chi2 by pulses in addition to noise."""
        return noise_only_chi2(self.problem, self.covariance) - self.peak.chi2

    @property
    def fraction_contaminated(self) -> float:
        """Fraction of the values excluded around ion feedback."""
        return 1.0 - float(np.mean([part.mean() for part in self.usable]))

    def ion_limit_dn(self, frames: DarkFrames) -> float:
        """Return the output of the matched filter that pulses of frames hardly ever exceed."""
        from scipy.special import gammainccinv

        pulses, changes = self.peak.pulses, frames.changes
        shape = 1.0 / pulses.relative_variance
        events = max(pulses.density * sum(change.size for change in changes), 10.0)
        rare = float(gammainccinv(shape, EVENTS.rare_pulses / events)) / shape
        # Without pulses the noise sets the limit.
        noise = spread(self.middle.within(changes[0], self.middle.reach))
        return max(rare * pulses.height_dn * self.response, EVENTS.min_ion_sd * noise)


def fit_pulses(
    look: DarkFrames,
    frames: DarkFrames,
    context: Context,
    *,
    period_s: float | None = None,
    open_share: float = 1.0,
) -> PulseFit:
    """Fit the pulses of dark frames; Unmeasurable if image lag hides their light.

    `look`, `frames`: a part of the exposures for the start of the fit, and all used exposures;
    `period_s`: exposure period, s; None: unknown; `open_share`: fraction of the period, from its
    start, in which photoelectrons arrive.
    """
    reaches_next, reaches_later = image_lag_reach(frames)
    known = has_tube(context.camera) and period_s is not None
    if reaches_next and not reaches_later and not known:
        raise Unmeasurable(
            "image lag reaches the next field, whose amount is not measurable from one field "
            "alone: name the sensor, with its phosphor decay, and state the exposure_s of the "
            "darks"
        )
    # Free parameters of the decay. Frames always measure light in the next frame; fields only
    # detect it.
    screen: tuple[str, ...] = ()
    if reaches_later:
        screen = (*SLOW, *FAST)
    elif reaches_next or frames.stride == 1:
        screen = FAST
    priors = spot_priors(context) | fast_prior(context, period_s, frames.stride)
    likelihood = partial(
        PulseLikelihood,
        names=tuple(name for name in UNITS if name in screen or name not in (*SLOW, *FAST)),
        priors=priors,
        fixed=_guess(frames, priors, open_share=open_share, screen=screen),
    )
    start = _from_scratch(look, likelihood, lag=bool(screen), seed=context.seed)
    first = _without_ions(look, start, likelihood, 0)
    fit = _without_ions(frames, first, likelihood, -1)
    if "glow" in screen and fit.peak.chance < EVENTS.restart_p_value:
        elsewhere = replace(fit, peak=_from_elsewhere(fit, frames.stride))
        fit = _without_ions(frames, elsewhere, likelihood, -1)
    return fit


def _from_elsewhere(fit: PulseFit, stride: int) -> PulseOptimum:
    """Return the best optimum from several decay start values, because few frames constrain it
    poorly.
    """
    starts = [
        replace(fit.peak.pulses, glow=glow, glow_exposures=EVENTS.start_decay * stride)
        for glow in EVENTS.restart_fractions
    ]
    again = (optimise_pulses(fit.problem, fit.covariance, start, rough=False) for start in starts)
    return min([fit.peak, *again], key=lambda peak: peak.chi2)


def _from_scratch(
    frames: DarkFrames, likelihood: Callable[..., PulseLikelihood], *, lag: bool, seed: int
) -> PulseFit:
    """Return a fit from start values, with the empirical covariance."""
    usable, step = [np.ones(change.shape, bool) for change in frames.changes], 1
    while True:
        observed = observe(frames.changes, usable, frames.filters(step, lag=lag))
        problem = likelihood(observed=observed)
        covariance = observed.covariance + np.diag((3e-3 * observed.value) ** 2)
        guess = best_guess(problem, covariance, spread(frames.changes[0]))
        if _filter_step(guess) <= step:
            break
        step = _filter_step(guess)
    return PulseFit(
        problem=problem,
        covariance=covariance,
        peak=optimise_pulses(problem, covariance, guess, rough=True),
        step=step,
        frames=frames,
        usable=usable,
        ions_dn=np.empty(0),
        seed=seed,
    )


def _again(fit: PulseFit, likelihood: Callable[..., PulseLikelihood], *, lag: bool) -> PulseFit:
    """Return a fit of the usable values that starts from its pulses, with their covariance."""
    filters = fit.frames.filters(fit.step, lag=lag)
    problem = likelihood(observed=observe(fit.frames.changes, fit.usable, filters))
    peak, covariance = fit.peak, fit.covariance
    for round_left in reversed(range(EVENTS.rounds)):
        covariance = blend_covariances(
            scatter(peak.pulses, problem.observed), problem.observed.covariance
        )
        peak = optimise_pulses(
            problem, covariance, peak.pulses, peak.derivative, rough=round_left > 0
        )
    return replace(fit, problem=problem, covariance=covariance, peak=peak)


def _without_ions(
    frames: DarkFrames, fit: PulseFit, likelihood: Callable[..., PulseLikelihood], known: int
) -> PulseFit:
    """Return a fit without pulses beyond its own distribution (ion feedback), repeated until no
    more are found.
    """
    lag = "fast_exposures" in fit.problem.names
    while True:
        limit, after = fit.ion_limit_dn(frames), EVENTS.ion_exposures if lag else 0
        parts = [usable_values(change, fit.middle, limit, after) for change in frames.changes]
        usable, heights = [mask for mask, _ in parts], np.concatenate([dn for _, dn in parts])
        if len(heights) <= known:
            return fit
        known = len(heights)
        frames = frames.without_mean(usable) if known else frames
        fit = _again(
            replace(fit, frames=frames, usable=usable, ions_dn=heights), likelihood, lag=lag
        )


def spot_priors(context: Context) -> Priors:
    """Return the priors of the wings of a spot from the sensor: mean and standard deviation by
    name.

    The tube's transfer is exp(-(f/fc)^n) at the photocathode; its post-gain fraction spreads
    pulses.
    """
    if not has_tube(context.camera):
        return PRIORS
    tube, pitch_um = context.camera.tube, float(context.camera.ccd.pitch_x_um)
    at_cathode = REFERENCE_CY_PER_PX / (
        pitch_um * 1e-3 * float(context.camera.taper.demagnification)
    )
    exponent = float(tube.mtf_exponent)
    wings = (
        float(tube.post_gain_share) * (at_cathode / float(tube.mtf_frequency_lp_per_mm)) ** exponent
    )
    return PRIORS | {
        "exponent": (exponent, EVENTS.exponent_sd),
        "wings": (wings, EVENTS.wings_relative_sd * wings),
    }


def fast_prior(context: Context, period_s: float | None, stride: int) -> Priors:
    """Return the prior of the fast phosphor decay, exposures.

    Frames measure it, fields of one parity do not.
    """
    if not has_tube(context.camera) or period_s is None:
        return {"fast_exposures": EVENTS.fast_of_fields if stride > 1 else EVENTS.fast_of_frames}
    fast = 1e-3 * float(context.camera.phosphor.fast_decay_ms) / period_s
    return {"fast_exposures": (fast, EVENTS.fast_relative_sd * fast)}


def _guess(
    frames: DarkFrames, priors: Priors, *, open_share: float, screen: tuple[str, ...]
) -> PulsePopulation:
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


def _filter_step(guess: PulsePopulation) -> int:
    width = max(guess.column_px, guess.row_px)
    return next(step for limit_px, step in STEPS if width < limit_px)
