"""What the noise of bars says of a response, level by level: pulses of light, one frame of it, read-out besides."""

from dataclasses import replace

import numpy as np
import pytest

from charact.method import Context
from charact.mtf import measure
from charact.mtf.bars import found, response
from charact.study.bars.pulses import PulsedBars
from charact.study.edge.scene import Blur

FINE = PulsedBars(
    blur=Blur(form="exponential", frequency_cy_per_px=0.32, exponent=1.3), pulse_px=0.6, photoelectrons=12.0,
    bright_dn=120.0, dark_share=0.1, gain_spread=0.7, frames=4, frequency_cy_per_px=0.25, rows=90, cols=100,
)  # fmt: skip


def powers(scene, rng, monkeypatch):
    """Return the flags of bars, and the powers of the light with which their noise grows."""
    seen = []
    powers_of = response.noise_powers
    monkeypatch.setattr(response, "noise_powers", lambda *args: seen.append(powers_of(*args)) or seen[-1])
    told = {"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px}
    context = Context(quick=True, full_scale_dn=scene.full_scale_dn)
    one = measure("bars", scene.frames_drawn(rng), method="bars-forward", context=context, **told).measurements[0]
    return one.flags, *seen[-1]


@pytest.mark.parametrize("exponent", [0.48, 1.0, 1.9])
def test_bars_too_fine_to_be_bright_tell_a_response_by_their_noise(exponent, seed, monkeypatch):
    """Few pixels are as bright as a wide bar would be, and exponents of 0.5 and 1.9 made the MTF 25 to 75 % wrong, ok.

    The covariance of neighbours grows with the power 2 - 1/g of the level: within 4 errors and 0.05.
    """
    flags, shared, own = powers(replace(FINE, gamma=exponent), np.random.default_rng(seed), monkeypatch)
    assert ("gamma" in flags) == (exponent != 1.0)
    assert shared.exponent == pytest.approx(2.0 - 1.0 / exponent, abs=4.0 * shared.sd + 0.05)
    assert exponent != 1.0 or -0.05 < own.exponent < 1.0 + 4.0 * own.sd


def test_one_frame_tells_a_response_that_steepens(seed, monkeypatch):
    """Ground that the response has made dark shows hardly more than read noise."""
    scene = replace(FINE, frames=1)
    rng = np.random.default_rng(seed)
    assert "gamma" in powers(replace(scene, gamma=1.9), rng, monkeypatch)[0]
    assert "gamma" not in powers(scene, rng, monkeypatch)[0]


@pytest.mark.parametrize("more", [{"flicker": 0.1}, {"row_noise_dn": 6.0}, {"read_dn": 8.0}, {"lag": 0.3}])
def test_what_else_is_in_the_noise_is_no_response(more, seed, monkeypatch):
    """Light that flickers, rows with an offset of their own, read noise and lag of a straight camera."""
    flags, shared, _ = powers(replace(FINE, **more), np.random.default_rng(seed), monkeypatch)
    assert "gamma" not in flags and abs(shared.exponent - 1.0) < 3.0 * shared.sd + 0.05


def test_errors_of_the_power_are_those_it_scatters_by(seed, monkeypatch):
    """40 targets: the scatter over the stated errors lies within 0.6 and 1.2; a fifth too large is known."""
    rng = np.random.default_rng(seed)
    shared = [powers(replace(FINE, col_px=float(rng.uniform(-1, 1))), rng, monkeypatch)[1] for _ in range(40)]
    away = np.array([(one.exponent - 1.0) / one.sd for one in shared])
    assert 0.6 < np.sqrt(np.mean(away**2)) < 1.2 and abs(away.mean()) < 0.4


def test_nothing_is_told_where_black_is_not_known(seed):
    used = replace(FINE.frames_drawn(np.random.default_rng(seed)), black_level_dn=None)
    assert found.response_flags(used, None) == ()
