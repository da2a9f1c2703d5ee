"""The compiled forms: the same transfers as the forms for many points, and slopes that are
theirs.
"""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import gamma, j1, kv, sici

from charact.estimators.mtf.edge.fit.model_fit import _flat, _linearise, _shift_derivatives
from charact.transfer import (
    MOFFAT,
    BlurModel,
    DiscComponent,
    HaloComponent,
    ScatterComponent,
    UnresolvedGlareComponent,
    disc,
    halo,
)

FREQUENCY = np.concatenate([[1e-5, 1e-3], np.linspace(0.01, 4.3, 60)])
WIDES = (
    None,
    HaloComponent(size_px=(6.0, 90.0)),
    DiscComponent(size_px=(6.0, 200.0)),
    ScatterComponent(size_px=(2.0, 12.0)),
    UnresolvedGlareComponent(size_px=(20.0, 200.0)),
)
FAMILIES = [
    BlurModel(core=core, wide=wide)
    for core in ("gaussian", "exponential", "moffat")
    for wide in WIDES
]


@pytest.mark.parametrize("family", FAMILIES, ids=[family.name for family in FAMILIES])
def test_a_prior_is_flat_but_for_its_gaussian_part(family, seed):
    rng, bounds = np.random.default_rng(seed), family.bounds
    theta = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * rng.random((7, len(bounds)))
    mean, precision = family.prior_precision
    pull = 0.5 * (theta - mean) ** 2 @ precision
    assert family.log_prior(theta) == pytest.approx(_flat(family) - pull)


@pytest.mark.parametrize("family", FAMILIES, ids=[family.name for family in FAMILIES])
def test_a_form_alone_is_the_form_of_many_points_and_its_slopes_are_differences(family, seed):
    """Tables are linear between places: where a difference meets a kink it is off by some of the
    table's bend.
    """
    rng, bounds = np.random.default_rng(seed), family.bounds
    for _ in range(5):
        theta = bounds[:, 0] + (bounds[:, 1] - bounds[:, 0]) * rng.uniform(0.05, 0.95, len(bounds))
        value, *slopes = family.derivatives(theta, FREQUENCY)
        assert value == pytest.approx(family.modulus(theta[None], FREQUENCY)[0], abs=1e-12)
        for slope, move in zip(slopes, np.diag(1e-6 * (bounds[:, 1] - bounds[:, 0])), strict=True):
            ahead, behind = family.modulus(np.stack([theta + move, theta - move]), FREQUENCY)
            difference = (ahead - behind) / (2.0 * move.sum())
            assert slope == pytest.approx(difference, abs=0.02 * np.abs(difference).max() + 1e-9)


def test_halo_and_disc_are_made_of_scipys_sines_and_bessel_functions():
    x, share = (
        np.concatenate([np.linspace(1e-6, 399.9, 3000), np.linspace(400.1, 3000.0, 500)]),
        0.3,
    )
    expected = share * np.sin(x) / x + (1.0 - share) * sici(x)[0] / x
    assert halo(x, share) == pytest.approx(expected, abs=1e-8)
    assert disc(x)[0] == pytest.approx(2.0 * j1(x) / x, abs=1e-8)


@pytest.mark.parametrize("exponent", [1.3, 1.5, 2.5, 6.0])
def test_a_moffat_spread_has_scipys_bessel_function_for_a_transfer(exponent):
    """2^(2-b) / Gamma(b-1) x^(b-1) K_(b-1)(x), one half at the half frequency."""

    def transfer(x):
        return (
            2.0 ** (2.0 - exponent)
            / gamma(exponent - 1.0)
            * x ** (exponent - 1.0)
            * kv(exponent - 1.0, x)
        )

    half_x = brentq(lambda x: transfer(x) - 0.5, 1e-6, 30.0)
    frequency = np.array([0.003, 0.02, 0.1, 0.2, 0.3, 0.5, 1.0])
    found = MOFFAT.transfer(np.array([[np.log(0.2), exponent]]), frequency)[0]
    assert found == pytest.approx(transfer(half_x * frequency / 0.2), abs=1e-3)
    assert found[3] == pytest.approx(0.5, abs=1e-3)


def test_the_model_made_linear_moves_as_the_model_itself(seed):
    """Residuals of a small step are those the design foretells, up to the square of the step."""
    rng = np.random.default_rng(seed)
    grid, family = np.linspace(0.01, 1.0, 40), BlurModel(core="exponential")
    fixed = np.stack([np.sinc(grid), 0.1 * grid])
    white, levels = rng.standard_normal((80, 60)), rng.standard_normal((3, 60))
    point, move = np.array([0.1, np.log(0.2), 1.4]), np.array([1e-4, -1e-4, 2e-4])
    data = 30.0 * (
        _shift_derivatives(family.derivatives(point[1:], grid), point[0], grid, fixed)[0] @ white
    ) + rng.standard_normal(60)
    prior = np.zeros(7), np.full(7, 1e-9)

    def at(where):
        return _linearise(
            _shift_derivatives(family.derivatives(where[1:], grid), where[0], grid, fixed),
            where,
            white,
            levels,
            data,
            *prior,
        )

    _, _, _, residual, design, amplitude, _ = at(point)
    _, _, _, moved, _, other, _ = at(point + move)
    foretold = residual - np.concatenate([move, other - amplitude]) @ design
    assert np.abs(moved - foretold).max() < 1e-3 * np.abs(moved - residual).max()
