"""The transfer of a circular pupil, against closed forms and against prysm's propagation of a
sampled pupil.
"""

import numpy as np
import pytest
from scipy.special import j0, j1

from charact.transfer import pupil

RATIO = np.linspace(0.0, 1.2, 61)


def sampled(obscuration, defocus, samples=512, padding=4):
    """Return ratios to the cut-off and prysm's transfer at them, the pupil sampled on a grid."""
    otf = pytest.importorskip("prysm.otf")
    propagation = pytest.importorskip("prysm.propagation")
    step = 2.0 / samples
    x = (np.arange(samples) - samples // 2 + 0.5) * step
    # A border pixel counts by the share of it inside.
    sub = (np.arange(8) - 3.5) / 8 * step
    radius = np.hypot((x[:, None] + sub)[:, None, :, None], (x[:, None] + sub)[None, :, None, :])
    amplitude = ((radius <= 1.0) & (radius >= obscuration)).mean(axis=(2, 3))
    phase = 2.0 * np.pi * defocus * (x[:, None] ** 2 + x**2)
    # Wavelength 1 um, pupil 2 mm across, focal length 2 mm: f/1, so that the cut-off is 1 / um,
    # 1000 cycles / mm.
    wave = propagation.Wavefront(amplitude * np.exp(1j * phase), 1.0, step)
    psf = wave.focus(2.0, Q=padding).intensity
    found = otf.otf_from_psf(psf.data, psf.dx).data.real
    middle = found.shape[0] // 2
    line = found[middle, middle:] / found[middle, middle]
    frequency = np.arange(line.size) / (found.shape[0] * psf.dx) * 1000.0
    return frequency / 1000.0, line


def test_a_clear_pupil_in_focus_has_the_closed_form():
    v = np.minimum(RATIO, 1.0)
    assert np.allclose(
        pupil(0.45 * RATIO, 0.45)[0], 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)), atol=1e-12
    )


def test_a_pupil_with_a_hole_has_the_transform_of_its_spread():
    """The spread is ((2 J1(u)/u - e^2 2 J1(eu)/(eu)) / (1 - e^2))^2; its volume over that of the
    clear one is known.
    """
    hole, u = 0.4, np.maximum(np.linspace(0.0, 4000.0, 400001), 1e-9)
    spread = ((2 * j1(u) / u - hole**2 * 2 * j1(hole * u) / (hole * u)) / (1 - hole**2)) ** 2

    for ratio in (0.1, 0.3, 0.55, 0.9):
        # Frequency v of the cut-off is 2 v in units of u; the tail of spread x u falls as 1/u^2.
        at = np.trapezoid(spread * u * j0(2 * ratio * u), u) / np.trapezoid(spread * u, u)
        assert pupil(np.array([ratio]), 1.0, hole)[0, 0] == pytest.approx(at, abs=2e-3)


@pytest.mark.parametrize("obscuration", [0.0, 0.35])
@pytest.mark.parametrize("defocus", [0.0, 0.9])
def test_it_is_what_prysm_propagates(obscuration, defocus):
    ratio, line = sampled(obscuration, defocus)
    assert np.abs(pupil(ratio, 1.0, obscuration, defocus)[0] - line).max() < 2e-3


def test_far_out_of_focus_it_is_the_transform_of_an_even_disc():
    """Geometrical optics: 2 J1(a)/a with a = 8 pi W v near frequency 0 (Hopkins)."""
    v = np.array([0.01, 0.02, 0.03])
    a = 8 * np.pi * 3.0 * v
    assert np.allclose(pupil(v, 1.0, 0.0, 3.0)[0], 2 * j1(a) / a, atol=0.06)


def test_it_is_one_at_zero_and_nothing_beyond_the_cut_off():
    every = pupil(
        np.array([0.0, 0.5, 1.0, 1.3]),
        np.full(5, 1.0),
        np.linspace(0.0, 0.8, 5),
        np.linspace(0.0, 3.0, 5),
    )
    assert np.allclose(every[:, 0], 1.0) and np.all(every[:, 2:] == 0.0)
