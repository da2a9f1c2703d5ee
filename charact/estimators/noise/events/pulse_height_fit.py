"""Pulse-height fit of dark frames: matched filters, exclusion of ion feedback, fit in two
rounds.
"""

from dataclasses import dataclass, replace
from functools import cached_property

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
    image_lag_correlation,
    responses,
    spread,
    usable_values,
)
from charact.estimators.noise.findings import Unmeasurable
from charact.estimators.noise.thresholds import EVENT_ACCURACY, EVENTS
from charact.inference import laplace
from charact.method import Context
from labdata import Array, Posterior, has_tube

UNITS = {
    "density": "1/px",
    "height_dn": "DN",
    "relative_variance": "1",
    "noise_dn2": "DN2",
    "line_1": "1",
    "line_2": "1",
    "column_px": "px",
    "row_px": "px",
    "wings": "1",
    "exponent": "1",
    "glow": "1",
    "glow_exposures": "exposures",
    "fast_exposures": "exposures",
}
SLOW, FAST = ("glow", "glow_exposures"), ("fast_exposures",)
# Positive parameters, fitted as logarithms.
LOGARITHMIC = ("density", "height_dn", "noise_dn2", "column_px", "row_px", "glow_exposures")
BOUNDS = {
    "relative_variance": (0.01, 6.0),
    "line_1": (-0.3, 0.45),
    "line_2": (-0.3, 0.3),
    "column_px": (0.05, 6.0),
    "row_px": (0.05, 6.0),
    "wings": (-0.5, 4.0),
    "exponent": (0.7, 2.5),
    "glow": (0.0, 0.98),
    "glow_exposures": (0.3, 15.0),
    "fast_exposures": (0.0, 0.6),
}
Priors = dict[str, tuple[float, float]]
# Normal priors of weakly constrained parameters: mean and standard deviation.
PRIORS: Priors = {
    "line_1": (0.0, 0.2),
    "line_2": (0.0, 0.1),
    "exponent": (1.3, 0.2),
    "wings": (0.0, 1.0),
}


@dataclass(frozen=True, kw_only=True)
class PulseOptimum:
    """Optimum of the pulse likelihood."""

    pulses: PulsePopulation  # them
    point: Array  # parameter vector, with logarithms of positive parameters, shape (parameter,)
    # predicted, derivative: model and its derivative by the parameters, shapes (value,) and (value,
    # parameter)
    predicted: Array
    derivative: Array
    covariance: Array  # covariance of the parameters, shape (parameter, parameter)
    # chi2, freedom: squared residuals over their variance, and degrees of freedom
    chi2: float
    freedom: int

    @property
    def chance(self) -> float:
        """p-value of chi2."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.freedom, 0.5 * self.chi2))


@dataclass(frozen=True, kw_only=True)
class PulseLikelihood:
    """Likelihood of pulse parameters."""

    observed: CharacteristicFunctionData  # the data
    names: tuple[str, ...]  # free parameters
    priors: Priors  # priors of some of them
    fixed: PulsePopulation  # values of the other parameters

    @cached_property
    def walls(self) -> Array:
        """Bounds of every parameter, shape (parameter, 2)."""
        limits = [(name, *BOUNDS.get(name, (1e-12, 1e12))) for name in self.names]
        return np.array([np.log(pair) if name in LOGARITHMIC else pair for name, *pair in limits])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Prior means and inverse standard deviations, 0 without a prior."""
        prior = [self.priors.get(name, (0.0, np.inf)) for name in self.names]
        return np.array([mean for mean, _ in prior]), np.array([1.0 / sd for _, sd in prior])

    def pulses(self, point: Array) -> PulsePopulation:
        """Return the pulses of a parameter vector."""
        value = {
            name: float(np.exp(x)) if name in LOGARITHMIC else float(x)
            for name, x in zip(self.names, point, strict=True)
        }
        return replace(self.fixed, **value)

    def point(self, pulses: PulsePopulation) -> Array:
        """Return the parameter vector of pulses, inside the bounds."""
        value = [getattr(pulses, name) for name in self.names]
        point = [
            np.log(x) if name in LOGARITHMIC else x
            for name, x in zip(self.names, value, strict=True)
        ]
        return np.clip(np.array(point), self.walls[:, 0], self.walls[:, 1])

    def model(self, point: Array) -> Array:
        """Return the model at a parameter vector, shape (value,)."""
        return self.observed.model(self.pulses(point))

    def derivative(self, point: Array, at: Array) -> Array:
        """Return the derivatives of the model by inward steps, shape (value, parameter)."""
        columns = []
        for index in range(len(point)):
            size = EVENT_ACCURACY.derivative_step
            step = size if point[index] + size < self.walls[index, 1] else -size
            stepped = point.copy()
            stepped[index] += step
            columns.append((self.model(stepped) - at) / step)
        return np.stack(columns, axis=1)

    def noise_alone(self) -> Array:
        """Return the model of noise of unit variance without pulses."""
        return self.observed.model(replace(self.fixed, density=0.0, noise_dn2=1.0))


def whitening(observed: CharacteristicFunctionData, covariance: Array) -> Array:
    """Return the whitening matrix of the residuals.

    A difference of exposures is symmetric except at the ends of the stack, so its imaginary part
    has no weight.
    """
    count, times = observed.frequency.shape
    real, imaginary = np.abs(observed.value).reshape(2, count, times)
    balanced = np.array([abs(sum(matched.times)) < 1e-9 for matched in observed.filters])[:, None]
    model_sd = EVENT_ACCURACY.model_relative_sd
    unknown = np.stack([model_sd * real, np.where(balanced, real, model_sd * imaginary)])
    covariance = covariance + np.diag(unknown.ravel() ** 2 + 1e-24)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def noise_only_chi2(problem: PulseLikelihood, covariance: Array) -> float:
    """Return the smallest chi2 of noise alone."""
    root = whitening(problem.observed, covariance)
    white, target = root @ problem.noise_alone(), root @ problem.observed.value
    residual = target - max(float(white @ target / (white @ white)), 0.0) * white
    return float(residual @ residual)


def best_guess(
    problem: PulseLikelihood, covariance: Array, pixel_noise_dn: float
) -> PulsePopulation:
    """Return the best of a grid of start values; density and noise are linear and solved for
    each.
    """
    root, best = whitening(problem.observed, covariance), None
    target, noise = root @ problem.observed.value, root @ problem.noise_alone()
    for width in EVENT_ACCURACY.start_widths_px:
        for height in EVENT_ACCURACY.start_heights:
            guess = replace(
                problem.fixed,
                density=1.0,
                noise_dn2=0.0,
                height_dn=height * pixel_noise_dn,
                column_px=width,
                row_px=max(width / problem.fixed.row_pitch, 0.1),
            )
            design = np.stack([root @ problem.observed.model(guess), noise], axis=1)
            density, white = np.maximum(np.linalg.lstsq(design, target, rcond=None)[0], 0.0)
            density, white = max(density, 1e-9), max(white, 1e-3 * pixel_noise_dn**2)
            misfit = float(np.sum((target - design @ [density, white]) ** 2))
            if best is None or misfit < best[0]:
                best = misfit, replace(guess, density=density, noise_dn2=white)
    assert best is not None
    return best[1]


def optimise_pulses(
    problem: PulseLikelihood,
    covariance: Array,
    start: PulsePopulation,
    derivative: Array | None = None,
    *,
    rough: bool,
) -> PulseOptimum:
    """Return the optimum near a start by damped Gauss-Newton steps.

    Derivatives, optionally given from nearby, are updated after each step (Broyden) and recomputed
    when progress stops, unless `rough`.
    """
    root, (mean, precision) = whitening(problem.observed, covariance), problem.prior

    def residual(point: Array, predicted: Array) -> Array:
        return np.concatenate(
            [root @ (predicted - problem.observed.value), (point - mean) * precision]
        )

    point, damping = problem.point(start), 1e-3
    enough = EVENT_ACCURACY.rough_chi2_tolerance if rough else EVENT_ACCURACY.chi2_tolerance
    predicted = problem.model(point)
    fresh = derivative is None
    derivative = problem.derivative(point, predicted) if derivative is None else derivative
    at = residual(point, predicted)
    for _ in range(EVENT_ACCURACY.max_iterations):
        slope = np.concatenate([root @ derivative, np.diag(precision)])
        step = _step(slope, at, damping, point, problem.walls)
        trial = np.clip(point + np.clip(step, -1.0, 1.0), problem.walls[:, 0], problem.walls[:, 1])
        reached, way = problem.model(trial), trial - point
        trial_residual = residual(trial, reached)
        gain = float(at @ at - trial_residual @ trial_residual)
        if gain > EVENT_ACCURACY.chi2_tolerance:
            derivative = derivative + np.outer(reached - predicted - derivative @ way, way) / (
                way @ way
            )
            point, predicted, at, damping, fresh = (
                trial,
                reached,
                trial_residual,
                damping / 5.0,
                False,
            )
        elif not fresh and not (rough and abs(gain) < enough):
            derivative, fresh = problem.derivative(point, predicted), True
        elif abs(gain) <= enough or damping > 1e4:
            break
        else:
            damping *= 10.0
    slope = np.concatenate([root @ derivative, np.diag(precision)])
    data = at[: len(predicted)]
    return PulseOptimum(
        pulses=problem.pulses(point),
        point=point,
        predicted=predicted,
        derivative=derivative,
        covariance=np.asarray(np.linalg.pinv(slope.T @ slope), np.float64),
        chi2=float(data @ data),
        freedom=len(data) - len(point) + int(np.count_nonzero(precision)),
    )


def _step(slope: Array, at: Array, damping: float, point: Array, walls: Array) -> Array:
    """Return a damped step that keeps parameters inside their bounds."""
    free = np.ones(len(point), bool)
    while True:
        step, free_slope = np.zeros(len(point)), slope[:, free]
        curvature = free_slope.T @ free_slope
        step[free] = np.linalg.solve(
            curvature + damping * np.diag(np.diag(curvature) + 1e-12), -free_slope.T @ at
        )
        blocked = free & (
            ((point <= walls[:, 0]) & (step < 0.0)) | ((point >= walls[:, 1]) & (step > 0.0))
        )
        if not blocked.any():
            return step
        free &= ~blocked


def laplace_draws(problem: PulseLikelihood, peak: PulseOptimum, *, seed: int) -> Posterior:
    """Return draws of the Laplace approximation, in logarithms for positive parameters.

    For the coverage of its intervals see `benchmarks.studies.dark_events_coverage`.
    """
    units = tuple(UNITS[name] for name in problem.names)
    posterior = laplace(
        None,  # pyright: ignore[reportArgumentType]
        names=problem.names,
        units=units,
        start=peak.point,
        covariance=peak.covariance,
        seed=seed,
        bounds=problem.walls,
    )
    draws = posterior.draws.copy()
    for index, name in enumerate(problem.names):
        if name in LOGARITHMIC:
            draws[:, index] = np.exp(draws[:, index])
    # Absent wings and an unmeasurable phosphor decay lie at their bounds and are harmless.
    flags = tuple(flag for flag in posterior.flags if flag != "prior-bound")
    return replace(posterior, draws=draws, flags=flags)


# Half width of the matched filter, px, below each spot width.
STEPS = ((1.0, 1), (1.8, 2), (np.inf, 3))


@dataclass(frozen=True, kw_only=True)
class PulseFit:
    """Pulse-height fit of dark frames."""

    # peak, posterior: optimum and draws
    peak: PulseOptimum
    posterior: Posterior
    observed: CharacteristicFunctionData  # data of the fit
    usable: list[
        NDArray[np.bool_]
    ]  # values far from ion feedback, for each parity, shape (exposure, row, col)
    frames: DarkFrames  # exposures, centred on the mean of those values
    # output of the matched filter for a mean pulse in its own exposure, over its noise
    signal_to_noise: float
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
    correlation, fast = image_lag_correlation(frames), fast_prior(context, period_s, frames.stride)
    known = has_tube(context.camera) and period_s is not None
    if correlation.across and not correlation.later and not known:
        raise Unmeasurable(
            "image lag reaches the next field, whose amount is not measurable from one field "
            "alone: name the sensor, with its phosphor decay, and state the exposure_s of the "
            "darks"
        )
    # Free parameters of the decay. Frames always measure light in the next frame; fields only
    # detect it.
    screen = (
        (*SLOW, *FAST)
        if correlation.later
        else FAST
        if correlation.across or frames.stride == 1
        else ()
    )
    priors = spot_priors(context) | fast
    setup = _Setup(
        priors=priors,
        fixed=_guess(frames, priors, open_share=open_share, screen=screen),
        screen=screen,
    )
    first = _without_ions(look, _from_scratch(look, setup), setup, 0)
    fit = _without_ions(frames, first, setup, -1)
    if "glow" in screen and fit.peak.chance < EVENTS.restart_p_value:
        fit = _without_ions(
            frames, replace(fit, peak=_from_elsewhere(fit, frames.stride)), setup, -1
        )
    pulses = fit.peak.pulses
    response, noise = (
        _response(fit.middle, pulses),
        np.sqrt(fit.middle.noise(pulses.line) * pulses.noise_dn2),
    )
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


def _from_elsewhere(fit: _Fit, stride: int) -> PulseOptimum:
    """Return the best optimum from several decay start values, because few frames constrain it
    poorly.
    """
    starts = [
        replace(fit.peak.pulses, glow=glow, glow_exposures=EVENTS.start_decay * stride)
        for glow in EVENTS.restart_fractions
    ]
    return min(
        [
            fit.peak,
            *(optimise_pulses(fit.problem, fit.covariance, start, rough=False) for start in starts),
        ],
        key=lambda peak: peak.chi2,
    )


def _from_scratch(frames: DarkFrames, setup: _Setup) -> _Fit:
    """Return a fit from start values, with the empirical covariance."""
    usable, step = [np.ones(change.shape, bool) for change in frames.changes], 1
    while True:
        problem = setup.problem(
            observe(frames.changes, usable, frames.filters(step, lag=setup.lag))
        )
        observed = problem.observed
        covariance = observed.covariance + np.diag((3e-3 * observed.value) ** 2)
        guess = best_guess(problem, covariance, spread(frames.changes[0]))
        if _filter_step(guess) <= step:
            break
        step = _filter_step(guess)
    return _Fit(
        problem=problem,
        covariance=covariance,
        peak=optimise_pulses(problem, covariance, guess, rough=True),
        step=step,
        frames=frames,
        usable=usable,
        ions_dn=np.empty(0),
    )


def _again(
    frames: DarkFrames,
    usable: list[NDArray[np.bool_]],
    ions_dn: Array,
    last_fit: _Fit,
    setup: _Setup,
) -> _Fit:
    """Return a fit that starts from another, with the covariance of its pulses."""
    problem = setup.problem(
        observe(frames.changes, usable, frames.filters(last_fit.step, lag=setup.lag))
    )
    peak, covariance = last_fit.peak, last_fit.covariance
    for round_left in reversed(range(EVENTS.rounds)):
        covariance = blend_covariances(
            scatter(peak.pulses, problem.observed), problem.observed.covariance
        )
        peak = optimise_pulses(
            problem, covariance, peak.pulses, peak.derivative, rough=round_left > 0
        )
    return _Fit(
        problem=problem,
        covariance=covariance,
        peak=peak,
        step=last_fit.step,
        frames=frames,
        usable=usable,
        ions_dn=ions_dn,
    )


def _without_ions(frames: DarkFrames, fit: _Fit, setup: _Setup, known: int) -> _Fit:
    """Return a fit without pulses beyond its own distribution (ion feedback), repeated until no
    more are found.
    """
    while True:
        limit, after = _ion_limit(frames, fit), EVENTS.ion_exposures if setup.lag else 0
        parts = [usable_values(change, fit.middle, limit, after) for change in frames.changes]
        heights, usable = (
            np.concatenate([height for _, height in parts]),
            [mask for mask, _ in parts],
        )
        if len(heights) <= known:
            return fit
        known = len(heights)
        frames = frames.without_mean(usable) if known else frames
        fit = _again(frames, usable, heights, fit, setup)


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


def _response(matched: Filter, pulses: PulsePopulation) -> float:
    """Return the output for a pulse of unit light at a pixel centre, in its own exposure."""
    amplitude, _ = responses(matched, pulses.spot, pulses.line)
    light, weight = pulses.screen.by_exposure()
    return float(amplitude.max() * (weight @ light[:, 0]))


def _ion_limit(frames: DarkFrames, fit: _Fit) -> float:
    """Return the output of the matched filter, DN, that pulses hardly ever exceed."""
    from scipy.special import gammainccinv

    pulses, changes = fit.peak.pulses, frames.changes
    shape = 1.0 / pulses.relative_variance
    events = max(pulses.density * sum(change.size for change in changes), 10.0)
    rare = float(gammainccinv(shape, EVENTS.rare_pulses / events)) / shape
    limit = rare * pulses.height_dn * _response(fit.middle, pulses)
    # Without pulses the noise sets the limit.
    return max(limit, EVENTS.min_ion_sd * spread(fit.middle.within(changes[0], fit.middle.reach)))
