"""Draws of known posteriors, curved and of two modes, and chains that do not converge."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from charact.fitting import (
    Model,
    Observation,
    description_from_posterior,
    draw_posterior,
    fit_sensor,
    posterior_draws,
    posterior_of,
    prior_of,
    slice_sampling,
)
from charact.fitting.model import convergence_findings
from charact.fitting.modes import Slope
from charact.fitting.thresholds import SAMPLING
from charact.observables import DarkNoise
from charact.observables.readout import NeighbourCovariance
from charact.session_measurement import measure
from labdata import load_camera
from tests.truth.specimens import CAMERAS, session_of

ION_RATE = "microchannel_plate.ion_event_rate_per_s_cm2"


def test_a_curved_ridge_keeps_its_width(seed: int) -> None:
    """x normal, y = x^2 + 0.05 of noise in six dimensions: mean of y is 1, its variance 2."""

    def log_probability(points):
        ridge = (points[:, 1] - points[:, 0] ** 2) / 0.05
        return -0.5 * (points[:, 0] ** 2 + ridge**2 + (points[:, 2:] ** 2).sum(axis=1))

    found = draw_posterior(
        log_probability,
        names=tuple("abcdef"),
        point=np.zeros(6),
        covariance=np.diag([1.0, 2.0, 1, 1, 1, 1]),
        seed=seed,
    )
    x, y = found.draws[:, 0], found.draws[:, 1]
    assert abs(x.mean()) < 4.5 / np.sqrt(x.size)
    assert (y - x**2).std() == pytest.approx(0.05, rel=4.5 / np.sqrt(2.0 * y.size))


def test_normal_scores_have_the_law_of_the_prior(seed: int) -> None:
    """Of ranges that begin at zero, too; Kolmogorov's distance of two samples of n is below 1.95
    sqrt(2/n) in 99.9 %, and of 40 parameters below 2.4 sqrt(2/n).
    """
    sheet, rng, count = load_camera("gen3-digital-iccd"), np.random.default_rng(seed), 4000
    prior = prior_of(sheet, tuple(sheet.parameters()))
    scores = rng.standard_normal((count, len(prior.names)))
    drawn, scored = prior.draw(rng, count), prior.of_scores(scores)
    for name, first, second in zip(prior.names, drawn.T, scored.T, strict=True):
        ordered = np.sort(np.concatenate([first, second]))
        ranks = (np.searchsorted(np.sort(part), ordered, side="right") for part in (first, second))
        distance = np.abs(np.subtract(*ranks)).max() / count
        assert distance < 2.4 * np.sqrt(2.0 / count), name
    far = prior.of_scores(np.full((1, len(prior.names)), 30.0) * [[-1.0], [1.0]])
    assert np.isfinite(far).all()
    assert (far[0] < prior.centre).all() and (far[1] > prior.centre).all()


@pytest.mark.parametrize("name", CAMERAS)
def test_bounds_of_a_prior_contain_the_range_of_the_description(name: str) -> None:
    known = load_camera(name).parameters()
    prior = prior_of(load_camera(name), tuple(known))
    ends = np.array([[known[path].low, known[path].high] for path in prior.names])
    with np.errstate(divide="ignore"):
        low, high = prior.coordinates(ends.T)
    assert (prior.bounds[:, 0] <= low).all() and (high <= prior.bounds[:, 1]).all()


def funnel_of(charge_e: float, ratio: float) -> Model:
    """Return the model of darks of 2 e- of read noise and a dark charge, known to 1 %, and of the
    covariance of their neighbours.
    """
    sheet, gain, exposure_s = load_camera("machine-vision"), 0.5, 0.02
    names = ("ccd.read_noise_e", "readout.fine_noise_ratio", "ccd.dark_current_e_per_s")
    laws = {
        DarkNoise: lambda v: gain**2 * (v[names[0]] ** 2 + exposure_s * v[names[2]]),
        NeighbourCovariance: lambda v: (
            gain**2 * v[names[0]] ** 2 * (1.0 - v[names[1]]) / (1.0 + v[names[1]]) / 2.0
        ),
    }
    truth = dict(zip(names, np.array([2.0, ratio, charge_e / exposure_s])[:, None], strict=True))
    sd = 0.01 * laws[DarkNoise](truth)
    observed = tuple(
        Observation(
            name=statistic.name,
            value=law(truth),
            covariance=np.diag(sd**2),
            predict=lambda values, law=law: law(values)[:, None],
            parameters=names,
            given_others=statistic.given_others,
        )
        for statistic, law in laws.items()
    )
    return Model(sensor=sheet, prior=prior_of(sheet, names), observed=observed)


@pytest.mark.parametrize(("charge_e", "ratio"), [(0.1, 1.8), (4.0, 1.3), (40.0, 0.6)])
def test_a_funnel_is_drawn_as_wide_as_its_integral(
    charge_e: float, ratio: float, seed: int
) -> None:
    """Noise hidden by dark charge shows no ratio; moments by sums over a grid."""
    model = funnel_of(charge_e, ratio)
    posterior = posterior_of(model, seed=seed)
    assert posterior.flags == ()
    prior, (noise, neighbours) = model.prior, model.observed
    margin = 2.0 * posterior.draws.std(axis=0)
    low, high = posterior.draws.min(axis=0) - margin, posterior.draws.max(axis=0) + margin
    axes = np.linspace(*np.clip([low, high], *prior.bounds.T), 600)

    def plane(part: Observation, index: int) -> np.ndarray:
        """Return probability by a part and prior of a coordinate, over read noise and that one."""
        grid = np.tile(prior.centre, (len(axes) ** 2, 1))
        grid[:, 0], grid[:, index] = np.repeat(axes[:, 0], 600), np.tile(axes[:, index], 600)
        squares = part.chi_squared(model.values(grid)) + prior.residuals(grid)[:, index] ** 2
        return np.exp(-0.5 * squares).reshape(600, 600)

    # Given the read noise, ratio and dark charge do not depend on each other.
    by_ratio, by_charge = plane(neighbours, 1), plane(noise, 2)
    by_noise = np.exp(-0.5 * prior.residuals(axes)[:, 0] ** 2)
    ratios, charges = by_ratio.sum(axis=1) * by_noise, by_charge.sum(axis=1) * by_noise
    marginals = np.stack([ratios * by_charge.sum(axis=1), charges @ by_ratio, ratios @ by_charge])
    marginals = marginals.T / marginals.sum(axis=1)
    mean = np.sum(marginals * axes, axis=0)
    sd = np.sqrt(np.sum(marginals * (axes - mean) ** 2, axis=0))
    count = len(posterior.draws)
    pulls = (posterior.draws.mean(axis=0) - mean) / sd * np.sqrt(count)
    assert np.abs(pulls).max() < 4.5
    # Of the kurtosis k a variance has the relative error sqrt((k - 1)/n).
    kurtosis = np.sum(marginals * ((axes - mean) / sd) ** 4, axis=0)
    spread = posterior.draws.var(axis=0) / sd**2
    assert (np.abs(spread - 1.0) < 4.5 * np.sqrt((kurtosis - 1.0) / count)).all()


def two_modes(points: np.ndarray) -> np.ndarray:
    """Residuals with a mode at 2, of log-probability 0, and one near -2, of -2."""
    return np.hstack([(points**2 - 4.0) / 0.2, 0.5 * (points - 2.0)])


def test_of_several_starts_the_best_mode_comes_first_and_the_other_has_its_weight() -> None:
    """Both modes are equally wide, so that the lower one has exp(-2) of the higher one's weight."""
    slope = Slope(residuals=two_modes, bounds=np.array([[-np.inf, np.inf]]), width=np.ones(1))
    assert slope.ascend(np.array([-3.0])).point == pytest.approx(-2.0, abs=0.02)
    best, other = slope.modes([np.array([start]) for start in (-3.0, -1.0, 1.0, 3.0, -4.0)])
    assert best.point == pytest.approx(2.0, abs=1e-4)
    assert other.point == pytest.approx(-2.0, abs=0.02)
    assert best.log_evidence - other.log_evidence == pytest.approx(2.0, abs=0.02)
    # d r / dx at 2 is 20 and 1/2.
    assert best.covariance.item() == pytest.approx(1.0 / (20.0**2 + 0.25), rel=1e-3)


def test_a_mode_of_a_thousandth_of_the_posterior_is_left_out() -> None:
    def residuals(points):
        return np.hstack([(points**2 - 4.0) / 0.2, (points - 2.0)])

    slope = Slope(residuals=residuals, bounds=np.array([[-np.inf, np.inf]]), width=np.ones(1))
    (mode,) = slope.modes([np.array([start]) for start in (-3.0, 3.0)])
    assert mode.point == pytest.approx(2.0, abs=1e-4)


def test_chains_far_below_the_mode_say_so(seed: int) -> None:
    """A normal law of two parameters lies 1 below its mode on average; here a narrow spike of no
    volume stands 20 higher.
    """

    def density(points):
        squares = np.sum(points**2, axis=1)
        return np.maximum(-0.5 * squares, 20.0 - 1e12 * squares)

    draws = draw_posterior(
        density, names=("a", "b"), point=np.zeros(2), covariance=np.eye(2), seed=seed
    )
    assert draws.flags == ("not-converged",)


def test_of_chains_that_did_not_converge_nothing_is_fitted(
    told_of: Callable, seed: int, monkeypatch
) -> None:
    """Chains of few steps, of either sampler."""
    few = replace(SAMPLING, steps=(4,), walkers_burn_in_steps=(4,), walkers_steps=(4,))
    for module in (posterior_draws, slice_sampling):
        monkeypatch.setattr(module, "SAMPLING", few)
    model = told_of(seed).model
    posterior = posterior_of(model, seed=seed)
    assert "not-converged" in posterior.flags
    (finding,) = convergence_findings(model, posterior)
    assert finding.flag == "not-converged" and "no parameter is fitted" in finding.effect
    sensor = description_from_posterior(model, posterior, illuminance_relative_sd=0.0, seed=seed)
    described = model.sensor.parameters()
    for path, parameter in sensor.parameters().items():
        assert parameter.standing != "fitted"
        if parameter.standing == "not-converged":
            assert parameter.low <= described[path].low
            assert parameter.high >= described[path].high
    assert sensor.photocathode.gap_mm.standing == "not-converged"


def test_ions_of_a_specimen_whose_data_have_two_modes_are_found(seed: int) -> None:
    """Another camera, of one ion event in ten seconds, explains the frames 13 worse in
    log-probability: half of all searches and then all chains end there.
    """
    session, truth = session_of("gen3-digital-iccd", 3, uniform=True)
    fitted = fit_sensor(session, measure(session, quick=True), seed=seed)
    rate = fitted.parameters()[ION_RATE]
    assert rate.standing == "fitted"
    assert rate.low < truth[ION_RATE] < rate.high
    assert not any(note.startswith("not-converged") for note in fitted.notes)
