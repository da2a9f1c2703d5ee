"""Each way in which walkers are known to deceive is provoked and ends in a flag; its healthy twin
ends in none.

Reference: physics reference, section 5.4. Where it is instructive emcee's own stretch move shows
the failure first. Correct sampling of a wrong model, which no chain can tell, is in
test_predictive.py.
"""

import numpy as np
import pytest

from charact.inference import chain, diagnostics, ensembles
from labdata import BadInput
from tests.charact.inference.test_chain import draw


def stretched(log_probability, first, steps, seed):
    """emcee as it comes: the stretch move from given places."""
    import emcee

    sampler = emcee.EnsembleSampler(*first.shape, log_probability, vectorize=True)
    state = emcee.State(first, random_state=np.random.RandomState(seed).get_state())
    sampler.run_mcmc(state, steps, skip_initial_state_check=True)
    return sampler


def normal(points):
    return -0.5 * (points**2).sum(1)


# Two equal modes 3 apart with a standard deviation of 0.1.


def two_modes(points):
    return np.logaddexp(-0.5 * (points[:, 0] / 0.1) ** 2, -0.5 * ((points[:, 0] - 3.0) / 0.1) ** 2)


@pytest.mark.parametrize("walkers", [8, 32])
def test_two_modes_are_flagged_and_shared_rightly_by_however_few_walkers(walkers):
    for seed in range(2):
        posterior = draw(two_modes, 1, seed=seed, covariance=[[0.01]], walkers=walkers, draws=1000)
        assert posterior.flags == ("several-modes",)
        # Standard error with as many independent draws as the chain says it holds.
        error = 0.5 / np.sqrt(min(posterior.effective_sample_size[0], 1000))
        assert (posterior["p0"] > 1.5).mean() == pytest.approx(0.5, abs=4.5 * error)
    assert (
        draw(lambda p: normal(p / 0.1), 1, seed=0, covariance=[[0.01]], walkers=walkers).flags == ()
    )


def test_modes_of_which_walkers_hold_their_own_for_ever_are_no_converged_chain():
    """Needles 300 apart, known from the start but seldom left: the shares are those of the start,
    not of the modes.
    """

    def needles(points):
        squares = (points**2).sum(1), ((points - 300.0) ** 2).sum(1)
        return np.logaddexp(-0.5 * squares[0] / 0.1**2, -0.5 * squares[1] / 0.1**2)

    places = [np.zeros(6), np.full(6, 300.0)]
    posterior = draw(needles, 6, seed=1, start=places, covariance=0.01 * np.eye(6), max_steps=800)
    assert posterior.flags == ("not-converged", "several-modes")
    assert posterior.sampler == "laplace"


# Unconverged: ten dimensions of scales 1 to 100 from a tight start.

SCALES = np.logspace(0, 2, 10)


def unequal(points):
    return -0.5 * ((points / SCALES) ** 2).sum(1)


def test_the_autocorrelation_time_of_a_chain_that_is_too_short_grows_with_it():
    first = 1e-2 * np.random.default_rng(0).standard_normal((64, 10))
    walk = stretched(unequal, first, 3000, 0).get_chain()
    tau = [float(diagnostics.autocorrelation_time(walk[:steps])[-1]) for steps in (100, 500, 3000)]
    assert tau[0] < tau[1] / 2 < tau[2] / 2
    assert walk[50:100, :, -1].std() < 0.5 * SCALES[-1]
    # Neither length would have been taken for a measurement.
    assert not any(steps > 50 * one for steps, one in zip((100, 500), tau, strict=False))


def test_a_tight_start_is_outgrown_given_steps_and_flagged_without():
    given_up = draw(unequal, 10, seed=1, covariance=1e-4 * np.eye(10), max_steps=150)
    assert given_up.flags == ("not-converged",)
    patient = draw(unequal, 10, seed=1, covariance=1e-4 * np.eye(10), draws=1000)
    assert patient.flags == ()
    assert np.allclose(patient.draws.std(0) / SCALES, 1.0, atol=4.5 / np.sqrt(2 * 1000))


# A hard wall.


@pytest.mark.parametrize("peak", [-0.5, 4.0])
def test_mass_next_to_a_hard_wall_is_flagged(peak):
    """Peak at -0.5, wall at 0: mean and standard deviation are those of the truncated normal, 0.64
    and 0.49.
    """

    def walled(points):
        return np.where(points[:, 0] < 0, -np.inf, -0.5 * (points[:, 0] - peak) ** 2)

    posterior = draw(walled, 1, seed=3, start=[max(peak, 0.05)], bounds=[[0.0, np.inf]], draws=2000)
    if peak > 0:
        assert posterior.flags == ()
        return
    assert posterior.flags == ("prior-bound",)
    assert posterior["p0"].mean() == pytest.approx(0.641, abs=4.5 * 0.485 / np.sqrt(2000))
    assert posterior["p0"].min() >= 0.0


# A parameter that never moves.


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_parameter_that_never_moves_is_no_converged_chain():
    """emcee: walkers in a plane stay in it, and the autocorrelation time there is not a number."""
    import emcee

    first = np.random.default_rng(1).standard_normal((32, 2)) * [1.0, 0.0]
    sampler = stretched(normal, first, 500, 1)
    assert np.isnan(emcee.autocorr.integrated_time(sampler.get_chain(), quiet=True)[1])
    flat = draw(normal, 2, seed=1, covariance=np.diag([1.0, 0.0]), max_steps=1000)
    assert flat.flags == ("not-converged",)
    assert draw(normal, 2, seed=1, covariance=np.eye(2), max_steps=1000).flags == ()


# Stuck walkers.


def with_needle(points):
    """A needle with a millionth of the mass, which no proposal hits twice: a walker born in it is
    stuck for ever.
    """
    needle = -0.5 * ((points - 3.0) ** 2).sum(1) / 1e-16 + np.log(1e-6 / 1e-16)
    return np.logaddexp(normal(points), needle)


@pytest.mark.parametrize("born_in_the_needle", [True, False])
def test_one_stuck_walker_holds_up_the_verdict(born_in_the_needle, monkeypatch):
    def first_places(*arguments):
        first = ensembles.first_places(*arguments)
        if born_in_the_needle:
            first[0] = 3.0
        return first

    monkeypatch.setattr(chain, "first_places", first_places)
    posterior = draw(with_needle, 2, seed=1, max_steps=1500)
    assert ("not-converged" in posterior.flags) == born_in_the_needle
    assert bool(posterior.flags) == born_in_the_needle


def test_stuck_walkers_and_odd_acceptance_are_told_from_shares():
    healthy = np.full(64, 0.4)
    assert diagnostics.mixes_well(healthy, 0.4)
    assert not diagnostics.mixes_well(np.where(np.arange(64) == 7, 0.01, healthy), 0.4)
    assert not diagnostics.mixes_well(healthy / 5, 0.08)
    assert not diagnostics.mixes_well(healthy, 0.9)
    assert not diagnostics.mixes_well(np.zeros(64), 0.0)


# Acceptance.


def ring(width):
    """A ring of radius 10: the thinner, the fewer proposals land on it."""
    return lambda points: -0.5 * ((np.hypot(*points.T) - 10.0) / width) ** 2


def test_a_posterior_that_takes_hardly_any_proposal_is_flagged():
    angle = np.random.default_rng(1).uniform(0.0, 2 * np.pi, 32)
    first = 10.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert stretched(ring(1e-3), first, 500, 1).acceptance_fraction.mean() < 0.1
    thin = draw(
        ring(1e-3), 2, seed=1, start=[10.0, 0.0], covariance=50.0 * np.eye(2), max_steps=1500
    )
    assert "not-converged" in thin.flags
    thick = draw(
        lambda points: ring(2.0)(points) + normal(points - [10.0, 0.0]),
        2,
        seed=1,
        start=[10.0, 0.0],
    )
    assert thick.flags == ()


def test_walkers_whose_steps_are_nearly_all_taken_have_not_filled_the_posterior():
    close = draw(normal, 20, seed=1, covariance=1e-30 * np.eye(20), max_steps=100)
    assert close.flags == ("not-converged", "several-modes")
    assert draw(normal, 20, seed=1, draws=100).flags == ()


# Regions of probability zero.


def test_walkers_born_outside_a_linked_prior_stay_there_but_ours_are_born_inside():
    """Two parameters within a hundredth of each other: most of a round start lies outside."""

    def linked(points):
        inside = np.abs(points[:, 0] - points[:, 1]) < 0.01
        return np.where(inside, normal(points), -np.inf)

    rng = np.random.default_rng(2)
    # Several groups far out, whose proposals all have probability zero.
    first = rng.standard_normal((32, 2)) * 1e-3 + np.array([1.0, -1.0])
    first[:16] = rng.standard_normal((16, 1)) + 1e-3 * rng.standard_normal((16, 2))
    with np.errstate(invalid="ignore"):
        sampler = stretched(linked, first, 300, 2)
    assert (sampler.acceptance_fraction < 0.01).any()

    posterior = draw(linked, 2, seed=2, draws=1000)
    assert posterior.flags == ()
    assert np.all(np.abs(np.diff(posterior.draws, axis=1)) < 0.01)
    # On the diagonal the density is that of two normals multiplied: a standard deviation of
    # 1/sqrt(2).
    spread = posterior["p0"].std()
    assert spread == pytest.approx(np.sqrt(0.5), abs=4.5 * np.sqrt(0.5) / np.sqrt(2 * 1000))


def test_a_hole_in_the_posterior_is_sampled_around():
    def holed(points):
        return np.where((points**2).sum(1) < 0.25, -np.inf, normal(points))

    posterior = draw(holed, 2, seed=1, start=[1.0, 0.0], draws=2000)
    assert "not-converged" not in posterior.flags
    # Squared radius: exponential of mean 2 beyond 1/4.
    squares = (posterior.draws**2).sum(1)
    assert squares.min() >= 0.25
    assert squares.mean() == pytest.approx(2.25, abs=4.5 * 2.0 / np.sqrt(2000))


def test_a_start_where_nothing_is_possible_is_refused():
    with pytest.raises(ValueError, match="no point near the start"):
        draw(lambda points: np.full(len(points), -np.inf), 2, seed=1)


# Walkers fewer than twice the parameters.


@pytest.mark.parametrize(("dimensions", "walkers"), [(13, 25), (2, 7)])
def test_walkers_fewer_than_twice_the_parameters_are_refused(dimensions, walkers):
    with pytest.raises(BadInput, match=f"got {walkers}"):
        draw(normal, dimensions, seed=1, walkers=walkers)


def test_twice_the_parameters_are_enough():
    posterior = draw(normal, 6, seed=1, walkers=12, draws=1000)
    assert posterior.flags == ()
    assert np.allclose(posterior.draws.std(0), 1.0, atol=4.5 / np.sqrt(2 * 1000))
