"""Every move by itself leaves the posterior as it is, and ensembles side by side know nothing of
each other.
"""

import numpy as np
import pytest

from charact.inference import (
    DifferentialEvolution,
    Ensembles,
    IndependentDraws,
    NormalScores,
    ProbitTransform,
)

SCALES = np.array([0.1, 1.0, 10.0])
MEAN = np.array([1.0, -2.0, 30.0])


# Margins learnt from draws as skewed as a wall makes them, of another place and width than the
# posterior.
SKEWED = NormalScores(MEAN + SCALES * (np.random.default_rng(5).exponential(1.0, (2000, 3)) - 0.5))


def gaussian(points):
    return -0.5 * (((points - MEAN) / SCALES) ** 2).sum(1)


def drawn(move, seed, *, steps=1500, ensembles=2, walkers=16):
    """Chains that begin in the posterior: a move that leaves it as it is keeps them there."""
    first = MEAN + SCALES * np.random.default_rng(seed).standard_normal((ensembles, walkers, 3))
    running = Ensembles(gaussian, [(move, 1.0)], first, seed)
    running.advance(steps)
    return running, (running.chains() - MEAN) / SCALES


@pytest.mark.parametrize(
    "move",
    [
        DifferentialEvolution(40),
        IndependentDraws(MEAN[None] + SCALES, 2.0 * np.diag(SCALES**2)),
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
    first = np.random.default_rng(seed).standard_normal((2, 16, 3)) * SCALES + MEAN
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
    scores = NormalScores(rng.exponential(1.0, (4000, 3)) * SCALES)
    mapped, _ = scores.of(rng.exponential(1.0, (4000, 3)) * SCALES)
    # Two samples of 4000 each; the pieces are straight where the margin bends, and longer beyond
    # two scores.
    assert np.allclose(mapped.mean(axis=0), 0.0, atol=4.5 * np.sqrt(2.0 / 4000) + 0.02)
    assert np.allclose(np.quantile(mapped, 0.84134, axis=0), 1.0, atol=0.12)
    points = (rng.exponential(1.0, (50, 3)) * 4.0 - 2.0) * SCALES
    mapped, slope = scores.of(points)
    assert np.allclose(scores.points(mapped)[0], points, rtol=1e-12, atol=1e-12)
    assert np.allclose(scores.points(mapped)[1], slope)
    ahead, _ = scores.of(points + 1e-7 * SCALES)
    by_difference = np.log((ahead - mapped) / (1e-7 * SCALES)).sum(axis=1)
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
