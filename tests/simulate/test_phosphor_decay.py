"""Screens other than P20, and gates shorter than a decay: shares of later fields and what they do
to the noise.
"""

import numpy as np
import pytest

from labdata import load_phosphor
from simulate.camera import PhosphorDecay, decay_components, grid


def _glow(name: str, field_s: float, gate_s: float | None = None) -> PhosphorDecay:
    components = decay_components(load_phosphor(name))
    return PhosphorDecay(components=components, gate_s=gate_s or field_s, field_s=field_s)


@pytest.mark.parametrize("name", ["P20", "P43", "P46", "P47"])
@pytest.mark.parametrize("field_s", [1 / 25, 1 / 60, 1e-3])
def test_every_screen_gives_all_its_light_at_any_rate(name, field_s):
    glow = _glow(name, field_s)
    assert glow.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert glow.weights.min() >= 0.0
    # What is remembered reaches as far as the slow component does.
    exact = _late(glow, glow.n_lag_fields + 1)
    assert exact < grid.ACCURACY.max_lag_fraction


def _late(glow: PhosphorDecay, fields: int) -> float:
    """Share of light later than so many fields, of pulses spread over the gate, by the closed
    integral.
    """
    weight, tau = np.array(glow.components).T
    share = weight * tau
    left = (
        np.exp(-(fields * glow.field_s - glow.gate_s) / tau)
        * -np.expm1(-glow.gate_s / tau)
        * tau
        / glow.gate_s
    )
    return float(left @ (share / share.sum()))


@pytest.mark.parametrize("name", ["P20", "P43", "P46", "P47"])
@pytest.mark.parametrize("gate_s", [1e-9, 1e-6, 1e-4, 1e-2])
def test_gates_shorter_than_a_decay_leave_what_the_closed_integral_says(name, gate_s):
    glow = _glow(name, 0.01668, gate_s)
    for fields in range(1, min(glow.n_lag_fields, 5) + 1):
        assert glow.residuals(5)[fields - 1] == pytest.approx(
            _late(glow, fields), abs=1e-4 + grid.ACCURACY.max_lag_fraction
        )
