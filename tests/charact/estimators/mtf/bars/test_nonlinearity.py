"""What the noise of bars says of a response, level by level: pulses of light, one frame of it,
read-out besides.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.estimators.mtf import measure
from charact.estimators.mtf.bars import bar_measurement, nonlinearity
from charact.method import Context
from labdata import FrameStack
from tests.truth import BarScene, PulsedBars, TrueBlur

FINE = PulsedBars(
    blur=TrueBlur(form="exponential", frequency_cy_per_px=0.32, exponent=1.3),
    pulse_px=0.6,
    photoelectrons=12.0,
    bright_dn=120.0,
    dark_share=0.1,
    gain_spread=0.7,
    frames=4,
    frequency_cy_per_px=0.25,
    rows=90,
    cols=100,
)


def told(stack, scene, monkeypatch):
    """Return the measured MTF of bars, and what they tell of the response."""
    seen = []
    response_of = nonlinearity.response_of
    monkeypatch.setattr(
        bar_measurement, "response_of", lambda *args: seen.append(response_of(*args)) or seen[-1]
    )
    asked = {"bars": scene.bars, "frequency_cy_per_px": scene.frequency_cy_per_px}
    context = Context(quick=True, full_scale_dn=scene.full_scale_dn)
    return measure("bars", stack, method="bars-forward", context=context, **asked).measurements[
        0
    ], seen[-1]


def powers(scene, rng, monkeypatch):
    """Return the flags of bars, and the powers of the light with which their noise grows."""
    one, of_response = told(scene.frames_drawn(rng), scene, monkeypatch)
    return one.flags, of_response.shared, of_response.per_pixel


def bent_frames(scene, curvature, rng):
    """Return frames of white noise behind a response y = u + c u (1 - u), u the light of a wide bar
    being one.
    """
    light = (scene.mean() - scene.pedestal_dn) / scene.level_dn
    mean = scene.pedestal_dn + scene.level_dn * (light + curvature * light * (1.0 - light))
    noise = rng.normal(0.0, scene.level_dn / scene.snr, (scene.frames, *mean.shape))
    return FrameStack(data=mean + noise, full_scale_dn=scene.full_scale_dn)


@pytest.mark.parametrize("exponent", [0.48, 1.0, 1.9])
def test_bars_too_fine_to_be_bright_tell_a_response_by_their_noise(exponent, seed, monkeypatch):
    """Few pixels are as bright as a wide bar would be, and exponents of 0.5 and 1.9 made the MTF 25
    to 75 % wrong, ok.

    The covariance of neighbours grows with the power 2 - 1/g of the level: within 4 errors and
    0.05.
    """
    flags, shared, own = powers(
        replace(FINE, gamma=exponent), np.random.default_rng(seed), monkeypatch
    )
    assert ("gamma" in flags) == (exponent != 1.0)
    assert shared.exponent == pytest.approx(2.0 - 1.0 / exponent, abs=4.0 * shared.sd + 0.05)
    assert exponent != 1.0 or -0.05 < own.exponent < 1.0 + 4.0 * own.sd


def test_one_frame_tells_a_response_that_steepens(seed, monkeypatch):
    """Ground that the response has made dark shows hardly more than read noise: told in one of two
    drawings or both.
    """
    scene = replace(FINE, frames=1)
    rng = np.random.default_rng(seed)
    assert any("gamma" in powers(replace(scene, gamma=1.9), rng, monkeypatch)[0] for _ in range(2))
    assert "gamma" not in powers(scene, rng, monkeypatch)[0]


@pytest.mark.parametrize(
    "more", [{"flicker": 0.1}, {"row_noise_dn": 6.0}, {"read_dn": 8.0}, {"lag": 0.3}]
)
def test_what_else_is_in_the_noise_is_no_response(more, seed, monkeypatch):
    """Light that flickers, rows with an offset of their own, read noise and lag of a straight
    camera.
    """
    flags, shared, _ = powers(replace(FINE, **more), np.random.default_rng(seed), monkeypatch)
    assert "gamma" not in flags and abs(shared.exponent - 1.0) < 3.0 * shared.sd + 0.05


def test_errors_of_the_power_are_those_it_scatters_by(seed, monkeypatch):
    """Five targets: the scatter over the stated errors lies within 0.2 and 1.9, chi squared at
    0.002 of chance.
    """
    rng = np.random.default_rng(seed)
    shared = [
        powers(replace(FINE, col_px=float(rng.uniform(-1, 1))), rng, monkeypatch)[1]
        for _ in range(5)
    ]
    away = np.array([(one.exponent - 1.0) / one.sd for one in shared])
    assert 0.2 < np.sqrt(np.mean(away**2)) < 1.9 and abs(away.mean()) < 3.1 / np.sqrt(5)


PLAIN = BarScene(
    blur=TrueBlur(sigma_px=1.0),
    frequency_cy_per_px=0.15,
    frames=8,
    snr=30.0,
    pedestal_dn=500.0,
    level_dn=1000.0,
    full_scale_dn=4095.0,
    rows=130,
    cols=140,
)


@pytest.mark.parametrize("curvature", [-0.3, 0.0, 0.25])
def test_the_picture_tells_its_curvature_and_what_it_does(curvature, seed, monkeypatch):
    """No black is known and noise tells nothing. Within 4 errors, and a seventh of itself: a series
    of first order.
    """
    rng = np.random.default_rng(seed)
    one, of = told(bent_frames(PLAIN, curvature, rng), PLAIN, monkeypatch)
    assert of.shared is None and of.per_pixel is None
    assert of.curvature == pytest.approx(curvature, abs=4.0 * of.sd + 0.15 * abs(curvature))
    assert any(note.startswith("gamma: the image") for note in one.notes) == (curvature != 0.0)
    # What is told has its lift taken off: what is left of it is of second order.
    assert one.value == pytest.approx(PLAIN.truth_mtf, rel=0.25 * abs(of.lifts * curvature) + 0.01)
    assert curvature == 0.0 or abs(of.lifts * curvature) > 0.03


@pytest.mark.parametrize("gamma", [0.6, 1.6])
def test_a_curved_response_of_fine_bars_is_told_without_any_harmonic(gamma, seed, monkeypatch):
    """Cells of the map whose MTF was 5 to 13 % off, ok: white noise, few pixels, hardly a second
    harmonic.
    """
    scene = replace(
        PLAIN,
        frequency_cy_per_px=0.22,
        gamma=gamma,
        shot_share=0.0,
        black_dn=300.0,
        full_scale_dn=1700.0,
    )
    stack = replace(scene.frames_drawn(np.random.default_rng(seed)), black_level_dn=None)
    found = told(stack, scene, monkeypatch)[0]
    assert any(note.startswith("gamma: the image") for note in found.notes)
    assert found.interval95[0] < scene.truth_mtf < found.interval95[1] or "gamma" in found.flags


def test_a_black_above_the_ground_is_not_believed(seed, monkeypatch):
    """Light below none grows with no power; the picture's own curvature is told as before."""
    stack = FINE.frames_drawn(np.random.default_rng(seed))
    _, right = told(stack, FINE, monkeypatch)
    _, wrong = told(replace(stack, black_level_dn=80.0), FINE, monkeypatch)
    assert right.shared is not None
    assert wrong.shared is None and wrong.curvature == pytest.approx(right.curvature)
