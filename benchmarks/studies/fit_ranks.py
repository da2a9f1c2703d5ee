"""Ranks of true parameters among the draws of fits of observations drawn at them.

`python -m benchmarks.studies run fit-ranks machine-vision --count 200`. A session of each of a few
specimens tells which numbers are observed and how large their errors are, relative to the numbers;
cameras are then drawn uniformly over the ranges of their description, their numbers predicted and
given normal errors, and fitted. No frames are drawn, so that a fit costs what its search and its
chains cost.

Of cameras drawn from the prior (`--prior`) ranks are uniform wherever chains are right. Uniform
cameras lie farther out than the half-Gaussians of the prior: of a parameter that hangs on other
parameters' ranges 68 % intervals hold some 55 %.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from charact.fitting import (
    Model,
    inflate_errors,
    levels_of,
    model_of,
    observations_of,
    posterior_of,
    stacks_of,
)
from charact.fitting.thresholds import LIMITS
from charact.session_measurement import measure
from labdata import Array, load_camera
from tests.truth.specimens import session_of

# Specimens whose frames tell which numbers are observed.
TEMPLATES = 4
NEIGHBOURS, NOISE = "covariance of neighbours in a row", "dark-noise"
# Errors shrink with the numbers down to this factor.
LEAST_SCALED = 1e-4


@dataclass(frozen=True, kw_only=True)
class Fit:
    """What a fit says of the parameters that its data identify, by name."""

    ranks: dict[str, float]  # fraction of the draws below the truth
    departures_sd: dict[str, float]  # truth less mean of the draws
    flags: tuple[str, ...]
    seconds: float  # processor time
    sampler: str


def template_of(name: str, number: int) -> Model:
    """Return the model of a session of frames of a specimen."""
    session, _ = session_of(name, number)
    camera = load_camera(name)
    levels = levels_of(session)
    stacks = stacks_of(session, camera, measure(session, quick=True), levels)
    return model_of(camera, observations_of(stacks))


def draw_truth(model: Model, rng: np.random.Generator, *, from_prior: bool) -> Array:
    """Return coordinates drawn from the prior, or uniformly between the ends of the ranges, shape
    (parameter,).
    """
    if from_prior:
        return model.prior.draw(rng, 1)[0]
    known = model.sensor.parameters()
    low, high = (
        model.prior.coordinates(np.array([[end(known[path]) for path in model.prior.names]]))[0]
        for end in (lambda p: max(p.low, 1e-12) if p.low >= 0.0 else p.low, lambda p: p.high)
    )
    return low + (high - low) * rng.random(low.size)


def told_of(template: Model, truth: Array, rng: np.random.Generator) -> Model:
    """Return the model with numbers of a camera of these coordinates and errors as large, relative
    to the numbers, as those of the template; bounds stay out.

    Errors of a transfer stay as they are; covariances of neighbours have errors of the noise.
    """
    values = template.values(truth[None])
    parts = [part for part in template.observed if not part.is_bound]
    exact = [np.broadcast_to(part.predict(values), (1, part.value.size))[0] for part in parts]
    factors = {
        part.name: float(np.abs(numbers).max() / np.abs(part.value).max())
        for part, numbers in zip(parts, exact, strict=True)
    }
    observed = []
    for part, numbers in zip(parts, exact, strict=True):
        of_noise = NOISE if part.name == NEIGHBOURS and NOISE in factors else part.name
        factor = 1.0 if part.name.startswith("mtf") else factors[of_noise]
        covariance = part.covariance * max(factor, LEAST_SCALED) ** 2
        number = numbers + np.linalg.cholesky(covariance) @ rng.standard_normal(numbers.size)
        observed.append(replace(part, value=number, covariance=covariance))
    return replace(template, observed=tuple(observed))


def fit_of(template: Model, rng: np.random.Generator, seed: int, *, from_prior: bool) -> Fit:
    """Fit the numbers of a camera."""
    truth = draw_truth(template, rng, from_prior=from_prior)
    told = told_of(template, truth, rng)
    began = time.process_time()
    model, _ = inflate_errors(told)
    posterior = posterior_of(model, seed=seed)
    seconds = time.process_time() - began
    sd = posterior.draws.std(axis=0)
    is_identified = sd / model.prior.sd < LIMITS.identified
    below = (posterior.draws < truth).mean(axis=0)
    departures = (truth - posterior.draws.mean(axis=0)) / sd
    names = np.array(posterior.names)[is_identified]
    return Fit(
        ranks=dict(zip(names, below[is_identified], strict=True)),
        departures_sd=dict(zip(names, departures[is_identified], strict=True)),
        flags=posterior.flags,
        seconds=seconds,
        sampler=posterior.sampler,
    )


def fits_of(name: str, count: int, seed: int, *, from_prior: bool = False) -> Iterator[Fit]:
    """Yield fits of so many cameras of a description."""
    templates = [template_of(name, seed + number) for number in range(TEMPLATES)]
    for number in range(count):
        rng = np.random.default_rng([seed, 59, number])
        yield fit_of(templates[number % TEMPLATES], rng, number, from_prior=from_prior)


def ranks_of(fits: list[Fit]) -> dict[str, Array]:
    """Return the ranks of each parameter in those fits that identify it."""
    names = dict.fromkeys(name for fit in fits for name in fit.ranks)
    return {
        name: np.array([fit.ranks[name] for fit in fits if name in fit.ranks]) for name in names
    }


def summary_of(fits: list[Fit]) -> dict[str, float]:
    """Return coverage of the intervals, the least p of uniform ranks over the parameters times
    their number, the largest departure of a fit without the flag `not-converged`, and costs; p of
    each parameter.
    """
    from scipy.stats import kstest

    converged = [fit for fit in fits if "not-converged" not in fit.flags]
    by_name, unconverged = ranks_of(converged), [fit for fit in fits if fit not in converged]
    ranks = np.concatenate(list(by_name.values()))
    unsure = np.concatenate([np.empty(0), *ranks_of(unconverged).values()])
    p_values = {name: kstest(values, "uniform").pvalue for name, values in by_name.items()}
    return {
        "fits": len(fits),
        "not converged": len(fits) - len(converged),
        "several modes": sum("several-modes" in fit.flags for fit in fits),
        "by emcee": sum(fit.sampler == "emcee" for fit in converged),
        "intervals": ranks.size,
        "held of 95 %": float(np.mean((ranks > 0.025) & (ranks < 0.975))),
        "held of 68 %": float(np.mean((ranks > 0.16) & (ranks < 0.84))),
        "of not converged, 95 %": float(
            np.sum((unsure > 0.025) & (unsure < 0.975)) / max(unsure.size, 1)
        ),
        "p of uniform ranks": min(1.0, min(p_values.values()) * len(p_values)),
        "largest departure, sd": max(
            abs(departure) for fit in converged for departure in fit.departures_sd.values()
        ),
        "median seconds": float(np.median([fit.seconds for fit in fits])),
        "95 % of seconds": float(np.quantile([fit.seconds for fit in fits], 0.95)),
        **{f"p of {name}": p for name, p in p_values.items()},
    }


def main(arguments: list[str] | None = None) -> None:
    """Print the summary of fits of one description."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="?", default="machine-vision", help="camera description")
    parser.add_argument("--count", type=int, default=200, help="cameras")
    parser.add_argument("--seed", type=int, default=1, help="seed of cameras and errors")
    parser.add_argument("--prior", action="store_true", help="cameras drawn from the prior")
    options = parser.parse_args(arguments)
    fits = list(fits_of(options.name, options.count, options.seed, from_prior=options.prior))
    for title, number in summary_of(fits).items():
        print(f"{title:32} {number:.4g}")


if __name__ == "__main__":
    main()
