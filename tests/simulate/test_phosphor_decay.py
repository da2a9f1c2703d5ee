"""Screens other than P20, and gates shorter than a decay: shares of later fields and what they do
to the noise.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import load_phosphor
from simulate.camera import PhosphorDecay, decay_components, grid


def _glow(name: str, field_s: float, gate_s: float | None = None) -> PhosphorDecay:
    components = decay_components(load_phosphor(name))
    return PhosphorDecay(components=components, gate_s=gate_s or field_s, field_s=field_s)


@pytest.mark.parametrize(
    ("name", "high_ms", "low_ms"),
    [("P20", 4.0, 55.0), ("P43", 1.0, 1.6), ("P46", 3e-4, 0.09), ("P47", 1e-4, 2.9e-3)],
)
def test_screens_decay_in_their_catalogue_times(name, high_ms, low_ms):
    """90 to 10 per cent, and 10 to 1 per cent, of the light of a screen switched off after a long
    pulse of current.
    """
    phosphor = load_phosphor(name)
    share = float(phosphor.fast_fraction)
    fast, slow = float(phosphor.fast_decay_ms), float(phosphor.slow_decay_ms)
    time_ms = np.geomspace(1e-7, 1e3, 200_001)
    light = share * np.exp(-time_ms / fast) + (1.0 - share) * np.exp(-time_ms / slow)
    at = [float(np.interp(-level, -light, time_ms)) for level in (0.9, 0.1, 0.01)]
    assert at[1] - at[0] == pytest.approx(high_ms, rel=0.03)
    assert at[2] - at[1] == pytest.approx(low_ms, rel=0.03)


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


def test_p43_leaves_video_fields_almost_free_and_p20_not():
    residual = {
        name: _glow(name, 1 / 59.94).residuals(1)[0] for name in ("P20", "P43", "P46", "P47")
    }
    assert residual["P20"] == pytest.approx(0.48, abs=0.02)
    assert 0.02 < residual["P43"] < 0.06
    assert residual["P46"] < 5e-3 and residual["P47"] < 1e-3


def test_a_fast_camera_remembers_slow_fields_beyond_any_fixed_number():
    """P20 at a thousand exposures per second glows for a fifth of a second."""
    glow = _glow("P20", 1e-3)
    assert glow.n_lag_fields > 150
    assert glow.residuals(100)[63] == pytest.approx(_late(glow, 64), rel=2e-2)
    assert replace(glow, components=glow.components[:1]).n_lag_fields < glow.n_lag_fields
