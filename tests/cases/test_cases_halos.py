"""Halos of any profile under any core and wings: the edge is as wide as drawn, or there is none."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import j1

from charact.estimators import bloom
from charact.method import Context
from charact.session_measurement import method_context
from labdata import open_session
from tests.cases.test_cases_bloom import session_of

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"
SIDE, FINE = 160, 4


def light_of(profile, diameter_px, fraction, core_px, wing=0.0, beta=2.4, pupil=0.0):
    """Light of a source in pixels, its highest 1: a halo of any profile of the radius over that of
    the edge, a Gaussian core with a Moffat wing of 3 px, both blurring it; or the core of a clear
    pupil whose transfer ends at `pupil` cycles per pixel, and a Gaussian blur of the halo.
    """
    count = FINE * SIDE
    at = np.fft.fftfreq(count, 1.0 / count) / FINE
    far = np.hypot(at[:, None], at[None, :])
    core = (1.0 - wing) * np.exp(-0.5 * (far / core_px) ** 2) / (2.0 * np.pi * core_px**2)
    core += wing * (beta - 1.0) / (np.pi * 9.0) * (1.0 + (far / 3.0) ** 2) ** -beta
    places = (np.arange(count) - 0.5 * (FINE - 1)) / FINE
    x = np.hypot(places[:, None] - 79.375, places[None, :] - 80.125)
    halo = profile(2.0 * x / diameter_px, np.clip(0.5 + FINE * (0.5 * diameter_px - x), 0.0, 1.0))
    source = fraction * halo / halo.sum()
    if pupil:
        z = np.pi * pupil * np.maximum(x, 1e-6)
        airy = (2.0 * j1(z) / z) ** 2 * (x < 38.0)
        seen = np.fft.irfft2(np.fft.rfft2(source) * np.fft.rfft2(core / core.sum()), (count, count))
        seen += (1.0 - fraction) * airy / airy.sum()
        light = seen.reshape(SIDE, FINE, SIDE, FINE).sum(axis=(1, 3))
        return light / light.max()
    source[round(FINE * 79.375 + 1.5), round(FINE * 80.125 + 1.5)] += 1.0 - fraction
    seen = np.fft.irfft2(np.fft.rfft2(source) * np.fft.rfft2(core / core.sum()), (count, count))
    light = seen.reshape(SIDE, FINE, SIDE, FINE).sum(axis=(1, 3))
    return light / light.max()


def halo_of(session):
    (halo,) = bloom.measure(session, context=Context(seed=1, quick=True)).find("halo_diameter")
    return halo


def test_the_disc_under_wings_of_the_case_is_57_px_wide(tmp_path):
    name = "kk1-disc-halo-under-wings"
    if not (CASES / name).is_dir():
        pytest.skip(f"the shared case {name} is not here")
    shutil.copytree(CASES / name, tmp_path / name)
    session = open_session(tmp_path / name)
    context = method_context(session, quick=True, seed=0)
    (halo,) = bloom.measure(session, context=context).find("halo_diameter")
    assert halo.status == "ok"
    assert halo.interval95[0] < 56.99 < halo.interval95[1]
    assert halo.value == pytest.approx(56.99, abs=0.3)


@pytest.mark.parametrize(
    "profile, diameter_px, fraction, core_px, wing, beta",
    [
        (lambda x, disc: disc, 38.0, 0.05, 1.0, 0.08, 1.9),
        (lambda x, disc: disc * (1.0 - 0.5 * x), 70.0, 0.15, 1.7, 0.02, 3.0),
        (lambda x, disc: disc * (1.0 + x), 52.0, 0.1, 1.3, 0.04, 2.4),
    ],
    ids=["flat", "falling", "rising"],
)
def test_a_disc_under_any_wing_is_as_wide_as_drawn(
    profile, diameter_px, fraction, core_px, wing, beta, seed
):
    light = light_of(profile, diameter_px, fraction, core_px, wing, beta)
    halo = halo_of(session_of(light, np.random.default_rng(seed)))
    assert halo.status == "ok"
    low, high = halo.interval95
    # Twice the half width at 95 %: 4 standard errors.
    assert abs(halo.value - diameter_px) < high - low
    assert high - low < 0.05 * diameter_px


@pytest.mark.parametrize(
    "profile, diameter_px, core_px, pupil",
    [
        (lambda x, disc: disc, 15.0, 1.2, 0.0),
        (lambda x, disc: disc * (x > 0.45), 46.0, 1.1, 0.0),
        (lambda x, disc: disc * (1.0 + (x > 0.78)), 37.0, 1.4, 0.0),
        (lambda x, disc: disc, 42.0, 1.2, 0.45),
    ],
    ids=["small disc", "annulus", "ring", "clear pupil"],
)
def test_small_discs_holes_rims_and_the_rings_of_a_pupil_hide_no_edge(
    profile, diameter_px, core_px, pupil, seed
):
    light = light_of(profile, diameter_px, 0.1, core_px, pupil=pupil)
    halo = halo_of(session_of(light, np.random.default_rng(seed)))
    assert halo.status == "ok"
    low, high = halo.interval95
    assert abs(halo.value - diameter_px) < high - low
    assert high - low < 1.0 + 0.03 * diameter_px


@pytest.mark.parametrize(
    "profile",
    [
        lambda x, disc: np.exp(-0.5 * (1.5 * x) ** 2),
        lambda x, disc: np.exp(-3.0 * x),
        lambda x, disc: (1.0 + (2.0 * x) ** 2) ** -1.6,
    ],
    ids=["Gaussian", "exponential", "Moffat"],
)
def test_a_halo_without_an_edge_has_no_diameter(profile, seed):
    light = light_of(profile, 50.0, 0.12, 1.3, 0.02)
    halo = halo_of(session_of(light, np.random.default_rng(seed)))
    assert halo.status == "refused"
    assert halo.reason.startswith("no halo with an edge")


def test_stacks_that_disagree_widen_the_interval_over_both(seed):
    """Every other stack has a halo 2 px wider than the rest: no noise of theirs explains it."""
    rng = np.random.default_rng(seed)
    narrow, wide = (
        session_of(light_of(lambda x, disc: disc, width, 0.1, 1.3), rng) for width in (44.0, 46.0)
    )
    mixed = tuple(
        (narrow if index % 2 else wide).stacks[index] for index in range(len(narrow.stacks))
    )
    low, high = halo_of(replace(narrow, stacks=mixed)).interval95
    assert low < 44.2 and high > 45.8
