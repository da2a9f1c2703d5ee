"""Ranks of true blurs among posterior draws of edges: even where the posterior is right, and told
where it is not.
"""

import json

import numpy as np
import pytest

from benchmarks.studies import edge_ranks
from benchmarks.studies.edge_ranks import (
    EXPONENT,
    HALF_FREQUENCY,
    NAMES,
    SAMPLERS,
    TABLE,
    blur_of,
    summarise_ranks,
    truth,
)
from charact.estimators.mtf.edge.fit.model_fit import EdgeFitter

TRIALS = 30


def test_truths_come_from_the_prior_that_the_posterior_is_told(seed):
    rng = np.random.default_rng(seed)
    half, exponent, mtf50 = np.array([truth(rng) for _ in range(300)]).T
    low, high = np.log(HALF_FREQUENCY)
    assert np.all((half > low) & (half < high))
    # Even: mean in the middle, within 4.5 standard errors of a uniform density.
    assert half.mean() == pytest.approx(
        (low + high) / 2, abs=4.5 * (high - low) / np.sqrt(12 * 300)
    )
    assert np.all((exponent > EXPONENT[0]) & (exponent < EXPONENT[1]))
    assert np.all(mtf50 < np.exp(half))


def test_a_blur_falls_to_one_half_at_its_half_frequency():
    for half, exponent in ((np.log(0.2), 1.2), (np.log(0.1), 2.0)):
        blur = blur_of(half, exponent)
        assert np.exp(
            -((np.exp(half) / blur.frequency_cy_per_px) ** blur.exponent)
        ) == pytest.approx(0.5)


@pytest.fixture(scope="module")
def right(seed):
    return edge_ranks.ranks("importance", TRIALS, seed)


def test_ranks_of_edges_are_even_and_those_of_a_posterior_too_narrow_are_not(
    right, seed, monkeypatch
):
    assert right.probability > 1e-4
    cover = right.coverage(0.68)
    assert np.all(np.abs(cover - 0.68) < 4.5 * np.sqrt(0.68 * 0.32 / TRIALS))
    honest = EdgeFitter.log_probability

    def surer(self, family, slope):
        known = honest(self, family, slope)
        return lambda theta: 9.0 * known(theta)

    monkeypatch.setattr(EdgeFitter, "log_probability", surer)
    assert edge_ranks.ranks("importance", TRIALS, seed).coverage(0.68).max() < 0.55


def test_the_committed_ranks_are_even_for_both_samplers():
    """600 truths each: unevenness as large has a chance over one in a thousand, and intervals hold
    as they say.
    """
    table = json.loads(TABLE.read_text())
    assert [row["sampler"] for row in table["samplers"]] == list(SAMPLERS)
    for row in table["samplers"]:
        kept = row["trials"] - row["flagged"]
        assert kept >= 0.95 * row["trials"] >= 550
        assert row["probability"] > 1e-3
        for name in NAMES:
            assert sum(row["histograms"][name]) == kept
            assert abs(row["cover68"][name] - 0.68) < 3.5 * np.sqrt(0.68 * 0.32 / kept)
            assert abs(row["cover95"][name] - 0.95) < 3.5 * np.sqrt(0.95 * 0.05 / kept)


def test_what_is_told_counts_the_truths(right):
    row = summarise_ranks("importance", right)
    assert row.trials == TRIALS
    assert all(sum(counts) == TRIALS - row.flagged for counts in row.histograms.values())
