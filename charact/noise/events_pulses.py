"""From dark frames to the law of their pulses: filters as wide as the spot, ion events apart, a fit in two rounds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.events_filters import Filter, boxes
from charact.noise.events_fit import PRIORS, Peak, Priors, Problem, climbed, drawn, started
from charact.noise.events_found import Events, find_events
from charact.noise.events_frames import DarkFrames, lingers, recentred, spread, usable_without
from charact.noise.events_law import REFERENCE_CY_PER_PX, Observed, Pulses, responses
from charact.noise.events_scatter import blended, covariance
from charact.noise.events_statistics import Gathered, cropped, inside, scale_of
from labdata.measurement import Posterior

Array = NDArray[np.float64]

# Index of the filter that suits the spot.
MIDDLE = 3
# Half widths of it, px, from the first guess of the spot's.
STEPS = ((1.0, 1), (1.8, 2), (np.inf, 3))
ROUNDS = 2
# The law of the pulses makes none above the limit beyond which events are ions' in so many stacks of a hundred.
RARE = 0.01
# An ion event stands out of the filtered noise at least so many times.
LEAST_ION = 15.0
# Exposures that the light of an ion event spoils where light lingers.
SPOILT_AFTER = 6
# A guess of a glow to start from: its share, and its time in exposures of the same rows.
GLOW = (0.4, 1.0)
# Exposures of a block where light lingers.
DEPTH = 4
# Smallest images: what is left inside the filters' reach, px.
LEAST_INSIDE = 24
# How well a sensor's description knows the spot's wings: standard deviations of the exponent, and of the strength as a
# share of it.
EXPONENT_SD, WINGS_SHARE = 0.05, 0.25


@dataclass(frozen=True, kw_only=True)
class PulseFit:
    """The law of the pulses of dark frames.

    Parameters
    ----------
    peak, posterior
        Best pulses and draws.
    observed
        What they were fitted to.
    lag
        Whether light lingers from exposure to exposure.
    signal_to_noise
        Response of the filter that suits the spot to a mean pulse in its own exposure, over its noise.
    crowding
        Events on the area of one spot, 1/sum h^2, and exposure.
    ion_height_dn
        Heights of the ion events, shape (event,), DN: all light together.
    spoilt
        Share of the values left out around them.
    gain_of_pulses
        By how much chi2 falls as pulses are put to noise.
    events
        Events found one by one.
    """

    peak: Peak
    posterior: Posterior
    observed: Observed
    lag: bool
    signal_to_noise: float
    crowding: float
    ion_height_dn: Array
    spoilt: float
    gain_of_pulses: float
    events: Events


def large_enough(frames: DarkFrames) -> bool:
    """Return whether images leave enough inside the reach of the filters."""
    where = inside(frames.changes[0].shape, boxes(3, stride=1, exposures=2, lag=False))
    return all(part.stop - (part.start or 0) >= LEAST_INSIDE for part in where[1:])


def light_lingers(frames: DarkFrames) -> bool:
    """Tell whether pulses are seen again in the next exposure."""
    return any(lingers(change, _filters(frames, 1, lag=False)[MIDDLE]) for change in frames.changes)


def fit_pulses(frames: DarkFrames, context: Context) -> PulseFit:
    """Fit the law of the pulses of dark frames."""
    priors = spot_priors(context)
    lag = light_lingers(frames)
    usable, heights = [np.ones(change.shape, bool) for change in frames.changes], np.empty(0)
    step = 1
    for _ in range(3):
        filters = _filters(frames, step, lag=lag)
        observed = _observed(frames, filters, usable, lag)
        problem, guess = _begun(observed, frames, lag, priors)
        if _step(guess) != step:
            step = _step(guess)
            filters = _filters(frames, step, lag=lag)
            observed = _observed(frames, filters, usable, lag)
            problem, guess = _begun(observed, frames, lag, priors)
        peak = climbed(problem, guess)
        usable, fresh = _without_ions(frames, filters[MIDDLE], peak.pulses, lag)
        if len(fresh) == len(heights):
            break
        heights = fresh
        changes = tuple(recentred(change, good) for change, good in zip(frames.changes, usable, strict=True))
        frames = replace(frames, changes=changes)
    for _ in range(ROUNDS):
        counted = blended(covariance(peak.pulses, observed), observed.covariance)
        problem = Problem(observed, counted, lag=lag, priors=priors, row_pitch=frames.row_pitch)
        peak = climbed(problem, peak.pulses)
    without = problem.without_pulses()
    response = _response(filters[MIDDLE], peak.pulses)
    noise = np.sqrt(filters[MIDDLE].noise(peak.pulses.line) * peak.pulses.noise_dn2)
    return PulseFit(
        peak=peak,
        posterior=drawn(problem, peak, seed=context.seed, quick=context.quick),
        observed=observed,
        lag=lag,
        signal_to_noise=float(response * peak.pulses.height_dn / noise),
        crowding=float(peak.pulses.density * peak.pulses.spot.area_px()),
        ion_height_dn=heights / response,
        gain_of_pulses=without - peak.chi2,
        spoilt=1.0 - float(np.mean([part.mean() for part in usable])),
        events=find_events(frames.changes, filters[MIDDLE]),
    )


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


def _filters(frames: DarkFrames, step: int, *, lag: bool) -> tuple[Filter, ...]:
    return boxes(step, stride=frames.stride, exposures=len(frames.changes[0]), lag=lag)


def _step(guess: Pulses) -> int:
    width = max(guess.column_px, guess.row_px)
    return next(step for most, step in STEPS if width < most)


def _observed(frames: DarkFrames, filters: tuple[Filter, ...], usable: list[NDArray[np.bool_]], lag: bool) -> Observed:
    """Characteristic functions of all exposures."""
    scales = tuple(scale_of(cropped(one, frames.changes[0], filters)) for one in filters)
    gathered = Gathered(filters, scales, DEPTH if lag else 1)
    for change, good in zip(frames.changes, usable, strict=True):
        gathered.add(change, good)
    return gathered.observed()


def _begun(observed: Observed, frames: DarkFrames, lag: bool, priors: Priors) -> tuple[Problem, Pulses]:
    """The problem with a counted covariance, held loosely, and a guess."""
    loose = observed.covariance + np.diag((3e-3 * observed.value) ** 2)
    problem = Problem(observed, loose, lag=lag, priors=priors, row_pitch=frames.row_pitch)
    glow = (GLOW[0], GLOW[1] * frames.stride) if lag else (0.0, 1.0)
    return problem, started(problem, spread(frames.changes[0]), glow)


def _response(one: Filter, pulses: Pulses) -> float:
    """Response to a pulse of unit light amid its pixel, in its own exposure."""
    amplitude, _ = responses(one, pulses.spot, pulses.line)
    return float(amplitude.max() * pulses.light_shares()[:, 0].mean())


def _without_ions(frames: DarkFrames, one: Filter, pulses: Pulses, lag: bool):
    """Values far from pulses that the law cannot make, and the response to each of those."""
    from scipy.special import gammainccinv

    shape = 1.0 / pulses.relative_variance
    events = max(pulses.density * sum(change.size for change in frames.changes), 10.0)
    limit = float(gammainccinv(shape, RARE / events)) / shape * pulses.height_dn * _response(one, pulses)
    # Without pulses to speak of the law knows no limit, and the noise sets one.
    limit = max(limit, LEAST_ION * spread(one.of(frames.changes[0])))
    reach = (len(one.rows) * 2, len(one.columns))
    parts = [usable_without(change, one, limit, reach, SPOILT_AFTER if lag else 0) for change in frames.changes]
    return [good for good, _ in parts], np.concatenate([height for _, height in parts])
