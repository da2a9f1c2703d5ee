"""Chains and their moves sample the law that they are given, or say that they do not."""

import numpy as np
import pytest

from charact.inference import (
    DifferentialEvolution,
    Ensembles,
    IndependentDraws,
    NormalScores,
    ProbitTransform,
    chain,
    diagnostics,
    ensembles,
    sample,
)
from labdata import BadInput

# The chain draws known posteriors rightly, says of itself what is known, and each way in which
# walkers deceive ends in a flag; its healthy twin ends in none.
#
# Reference: physics reference, section 5.4. Correct sampling of a wrong model, which no chain can
# tell, is in test_predictive.py.


def draw(log_probability, dimensions, *, seed, start=None, covariance=None, **options):
    return sample(
        log_probability,
        names=tuple(f"p{index}" for index in range(dimensions)),
        units=("1",) * dimensions,
        start=np.zeros(dimensions) if start is None else start,
        covariance=np.eye(dimensions) if covariance is None else covariance,
        seed=seed,
        **options,
    )


def test_a_gaussian_of_known_covariance_is_recovered(seed):
    covariance = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, 0.2], [0.0, 0.2, 0.25]])
    mean, inverse = np.array([1.0, -2.0, 5.0]), np.linalg.inv(covariance)

    def gaussian(points):
        return -0.5 * np.einsum("ni,ij,nj->n", points - mean, inverse, points - mean)

    posterior = draw(gaussian, 3, seed=seed, start=mean, covariance=covariance, draws=2000)
    assert posterior.flags == ()
    assert posterior.sampler == "emcee"
    assert np.all(posterior.effective_sample_size > 3000)
    assert np.all(posterior.r_hat < 1.01)
    sd, count = np.sqrt(np.diag(covariance)), len(posterior.draws)
    assert np.all(np.abs(posterior.draws.mean(0) - mean) < 4.5 * sd / np.sqrt(count))
    # The standard error of a covariance of N draws is sqrt((s_ii s_jj + s_ij^2) / N).
    error = np.sqrt((np.outer(sd**2, sd**2) + covariance**2) / count)
    assert np.all(np.abs(np.cov(posterior.draws.T) - covariance) < 4.5 * error)


def test_same_seed_gives_the_same_draws_and_leaves_global_randomness_alone():
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one, two, other = (draw(lambda p: -0.5 * (p**2).sum(1), 2, seed=s).draws for s in (5, 5, 6))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_kept_draws_scatter_as_independent_ones_do():
    """Their spread errs by 1/sqrt(2 N) from seed to seed, not by that of a few walkers followed
    step by step.
    """
    errors = []
    for seed in range(5):
        posterior = draw(lambda points: -0.5 * (points**2).sum(1), 10, seed=seed, draws=1000)
        errors.append((posterior.draws.std(0) - 1.0) * np.sqrt(2000))
    # 50 errors of variance 1, and of 1/5 more since the chains hold five times as many independent
    # draws.
    assert np.mean(np.square(errors)) < 1.2 * (1.0 + 4.5 * np.sqrt(2 / 50))


def test_autocorrelation_time_of_an_autoregressive_series_is_its_closed_form(seed):
    """AR(1) with coefficient a has tau = (1 + a) / (1 - a)."""
    rng, a = np.random.default_rng(seed), 0.8
    series = np.zeros((4000, 40, 1))
    series[0, :, 0] = rng.standard_normal(40) / np.sqrt(1 - a**2)
    for step in range(1, 4000):
        series[step, :, 0] = a * series[step - 1, :, 0] + rng.standard_normal(40)
    # Relative error of tau with window M = 5 tau: sqrt(2 (2 M + 1) / N), Sokal 1996.
    assert diagnostics.autocorrelation_time(series)[0] == pytest.approx(
        9.0, rel=4.5 * np.sqrt(2 * 91 / 160000) + 0.01
    )


def test_r_hat_is_one_where_chains_agree_and_large_where_one_is_elsewhere():
    chains = np.random.default_rng(2).standard_normal((2, 1000, 8, 1))
    assert diagnostics.ensemble_r_hat(chains)[0] < 1.005
    chains[1] += 1.0
    assert diagnostics.ensemble_r_hat(chains)[0] > 1.05
    drifting = np.linspace(0, 3, 1000)[None, :, None, None] + chains * 0.3
    assert diagnostics.ensemble_r_hat(drifting)[0] > 1.1


@pytest.mark.parametrize("apart", [0.0, 1.0, 6.0])
def test_second_peaks_are_seen_where_a_valley_parts_them(apart, seed):
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((2000, 2))
    draws[:400] += apart * np.array([0.7, 0.7])
    assert diagnostics.has_several_peaks(draws) == (apart > 5)


def test_walls_far_from_the_draws_are_not_leant_on():
    draws = np.random.default_rng(4).normal(10.0, 1.0, (1000, 1))
    assert not diagnostics.crowds_at_bound(draws, np.array([[0.0, 1e6]])).any()
    assert diagnostics.crowds_at_bound(np.abs(draws - 10.0), np.array([[0.0, 1e6]])).all()
    uniform = np.random.default_rng(5).uniform(0, 1, (4000, 1))
    assert not diagnostics.crowds_at_bound(uniform, np.array([[0.0, 1.0]])).any()


def test_stuck_walkers_and_odd_acceptance_are_told_from_shares():
    healthy = np.full(64, 0.4)
    assert diagnostics.mixes_well(healthy, 0.4)
    assert not diagnostics.mixes_well(np.where(np.arange(64) == 7, 0.01, healthy), 0.4)
    assert not diagnostics.mixes_well(healthy / 5, 0.08)
    assert not diagnostics.mixes_well(healthy, 0.9)
    assert not diagnostics.mixes_well(np.zeros(64), 0.0)


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


# A posterior that chains do not fill, and its healthy twin.


def ring(width):
    """A ring of radius 10: the thinner, the fewer proposals land on it."""
    return lambda points: -0.5 * ((np.hypot(*points.T) - 10.0) / width) ** 2


ON_THE_RING = {"start": [10.0, 0.0], "covariance": 50.0 * np.eye(2), "max_steps": 1500}


@pytest.mark.parametrize(
    ("log_probability", "dimensions", "options", "flags"),
    [
        (normal, 2, {"covariance": np.diag([1.0, 0.0]), "max_steps": 1000}, {"not-converged"}),
        (normal, 2, {"covariance": np.eye(2), "max_steps": 1000}, set()),
        (
            normal,
            20,
            {"covariance": 1e-30 * np.eye(20), "max_steps": 100},
            {"not-converged", "several-modes"},
        ),
        (normal, 20, {"draws": 100}, set()),
        (ring(1e-3), 2, ON_THE_RING, {"not-converged"}),
        (
            lambda points: ring(2.0)(points) + normal(points - [10.0, 0.0]),
            2,
            {"start": [10.0, 0.0]},
            set(),
        ),
    ],
    ids=[
        "a parameter that never moves",
        "its twin",
        "steps that are nearly all taken",
        "their twin",
        "hardly any proposal is taken",
        "its twin",
    ],
)
def test_a_posterior_that_is_not_filled_is_flagged(log_probability, dimensions, options, flags):
    assert (
        flags
        <= set(draw(log_probability, dimensions, seed=1, **options).flags)
        <= flags | ({"several-modes"} if options is ON_THE_RING else set())
    )


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


# Regions of probability zero.


def test_walkers_are_born_inside_a_linked_prior():
    """Two parameters within a hundredth of each other: most of a round start lies outside."""

    def linked(points):
        inside = np.abs(points[:, 0] - points[:, 1]) < 0.01
        return np.where(inside, normal(points), -np.inf)

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


# Walkers fewer than twice the parameters.


@pytest.mark.parametrize(
    ("make", "error", "rule"),
    [
        (lambda: draw(normal, 13, seed=1, walkers=25), BadInput, "got 25"),
        (lambda: draw(normal, 2, seed=1, walkers=7), BadInput, "got 7"),
        (
            lambda: draw(lambda points: np.full(len(points), -np.inf), 2, seed=1),
            ValueError,
            "no point near the start",
        ),
    ],
)
def test_walkers_fewer_than_twice_the_parameters_or_without_a_start_are_refused(make, error, rule):
    with pytest.raises(error, match=rule):
        make()


def test_twice_the_parameters_are_enough():
    posterior = draw(normal, 6, seed=1, walkers=12, draws=1000)
    assert posterior.flags == ()
    assert np.allclose(posterior.draws.std(0), 1.0, atol=4.5 / np.sqrt(2 * 1000))


# Every move by itself leaves the posterior as it is, and ensembles side by side know nothing of
# each other.


WIDTHS = np.array([0.1, 1.0, 10.0])
MEAN = np.array([1.0, -2.0, 30.0])


# Margins learnt from draws as skewed as a wall makes them, of another place and width than the
# posterior.
SKEWED = NormalScores(MEAN + WIDTHS * (np.random.default_rng(5).exponential(1.0, (2000, 3)) - 0.5))


def gaussian(points):
    return -0.5 * (((points - MEAN) / WIDTHS) ** 2).sum(1)


def drawn(move, seed, *, steps=1500, ensembles=2, walkers=16):
    """Chains that begin in the posterior: a move that leaves it as it is keeps them there."""
    first = MEAN + WIDTHS * np.random.default_rng(seed).standard_normal((ensembles, walkers, 3))
    running = Ensembles(gaussian, [(move, 1.0)], first, seed)
    running.advance(steps)
    return running, (running.chains() - MEAN) / WIDTHS


@pytest.mark.parametrize(
    "move",
    [
        DifferentialEvolution(40),
        IndependentDraws(MEAN[None] + WIDTHS, 2.0 * np.diag(WIDTHS**2)),
        IndependentDraws(np.zeros((1, 3)), np.eye(3), SKEWED),
    ],
    ids=[
        "differential evolution",
        "independent draws about a place beside the peak",
        "independent draws of scores",
    ],
)
def test_a_move_leaves_mean_variance_and_fourth_moment_of_a_gaussian_as_they_are(move, seed):
    """By the scatter of ensembles side by side: a chain that missed its tails underrates its
    error.
    """
    _, chain = drawn(move, seed, steps=600, ensembles=40)
    for power, moment in ((1, 0.0), (2, 1.0), (4, 3.0)):
        means = (chain**power).mean((1, 2))
        error = means.std(0, ddof=1) / np.sqrt(len(means))
        assert np.all(np.abs(means.mean(0) - moment) < 4.5 * error)


def test_an_ensemble_learns_nothing_from_the_one_beside_it(seed):
    """With the second ensemble nowhere near, the first one's walkers stay on differences of their
    own.
    """
    first = np.random.default_rng(seed).standard_normal((2, 16, 3)) * WIDTHS + MEAN
    first[1] *= 1e6
    running = Ensembles(
        lambda points: np.zeros(len(points)), [(DifferentialEvolution(2), 1.0)], first, seed
    )
    running.advance(5)
    assert np.abs(running.chains()[0] / first[0].max(axis=0)).max() < 1e4


def test_acceptance_of_local_moves_is_that_of_the_steps_counted_by_hand(seed):
    running, chain = drawn(DifferentialEvolution(2), seed, steps=200)
    moved = np.any(np.diff(chain, axis=1) != 0, axis=-1).mean()
    assert running.local_acceptance == pytest.approx(moved, abs=0.01)
    assert running.acceptance.mean() == pytest.approx(running.local_acceptance, abs=1e-12)


def test_scores_of_draws_are_normal_and_carry_a_point_there_and_back_with_their_slope(seed):
    rng = np.random.default_rng(seed)
    scores = NormalScores(rng.exponential(1.0, (4000, 3)) * WIDTHS)
    mapped, _ = scores.of(rng.exponential(1.0, (4000, 3)) * WIDTHS)
    # Two samples of 4000 each; the pieces are straight where the margin bends, and longer beyond
    # two scores.
    assert np.allclose(mapped.mean(axis=0), 0.0, atol=4.5 * np.sqrt(2.0 / 4000) + 0.02)
    assert np.allclose(np.quantile(mapped, 0.84134, axis=0), 1.0, atol=0.12)
    points = (rng.exponential(1.0, (50, 3)) * 4.0 - 2.0) * WIDTHS
    mapped, slope = scores.of(points)
    assert np.allclose(scores.points(mapped)[0], points, rtol=1e-12, atol=1e-12)
    assert np.allclose(scores.points(mapped)[1], slope)
    ahead, _ = scores.of(points + 1e-7 * WIDTHS)
    by_difference = np.log((ahead - mapped) / (1e-7 * WIDTHS)).sum(axis=1)
    assert np.median(np.abs(by_difference - slope)) < 1e-6


def test_a_density_cut_at_walls_keeps_its_mass_in_the_space_without_them():
    """Uniform between the walls: standard normal there, and the slope is that of the map."""
    space = ProbitTransform(np.array([[-1.0, 3.0], [0.0, np.inf]]))
    z = np.stack([np.linspace(-4.0, 4.0, 801), np.full(801, 0.5)], axis=1)
    x = space.inside(z)
    assert np.allclose(space.outside(x), z, atol=1e-9)
    slope = np.gradient(x[:, 0], z[:, 0])
    ratio = slope / np.exp(space.log_volume(z))
    assert np.allclose(ratio[1:-1], 4.0 / np.sqrt(2.0 * np.pi), rtol=1e-3)
    assert np.allclose(space.stretch(x[400]), [1.0 / slope[400], 1.0], rtol=1e-3)
