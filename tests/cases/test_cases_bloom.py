"""Halos and blooms of the textbook: flat and rimmed discs through a core's Gaussian, drawn by plain
numpy.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from charact.estimators import bloom
from charact.method import Context
from labdata import Conditions, FrameStack, open_session
from tests.truth.sessions import session_in_memory, stack_in_memory

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"
QUICK = Context(seed=1, quick=True)
SIDE, FINE = 160, 5


def light_of(diameter_px, fraction, core_px, *, rise=1.0, wing=0.0, row=79.3, col=80.2):
    """Light of a source at pixels, its highest 1: a disc that rises evenly to its edge, a core, an
    exponential.
    """
    count = FINE * SIDE
    at = np.fft.fftfreq(count, 1.0 / count) / FINE
    far = np.hypot(at[:, None], at[None, :])
    core = (1.0 - wing) * np.exp(-0.5 * (far / core_px) ** 2) / (2.0 * np.pi * core_px**2)
    core += wing * np.exp(-far / 3.0) / (2.0 * np.pi * 9.0)
    rows, cols = ((np.arange(count) - FINE // 2) / FINE - place for place in (row, col))
    x = np.hypot(rows[:, None], cols[None, :])
    disc = (1.0 + 2.0 * (rise - 1.0) * x / diameter_px) * np.clip(
        0.5 + FINE * (0.5 * diameter_px - x), 0.0, 1.0
    )
    point = np.zeros_like(disc)
    point[round(FINE * row) + FINE // 2, round(FINE * col) + FINE // 2] = 1.0
    blur = np.fft.rfft2(core / core.sum())
    source = (1.0 - fraction) * point + fraction * disc / disc.sum()
    seen = np.fft.irfft2(np.fft.rfft2(source) * blur, (count, count))
    return (seen / seen.max())[FINE // 2 :: FINE, FINE // 2 :: FINE]


def session_of(light, rng, *, bits=12, dark_dn=20.0, electrons_per_dn=8.0, frames=2):
    """Five levels from 0.3 to 3,000 times what fills the core, and a dark."""
    full = 2.0**bits - 1.0
    stacks = []
    for index, times in enumerate([0.0, *np.geomspace(0.3, 3000.0, 5)]):
        electrons = np.maximum(times * (full - dark_dn) * electrons_per_dn * light, 0.0)
        signal = rng.poisson(np.broadcast_to(electrons, (frames, *light.shape))) / electrons_per_dn
        data = np.clip(
            np.rint(dark_dn + signal + 2.0 * rng.standard_normal(signal.shape)), 0, full
        ).astype(np.uint16)
        kind = "point" if times else "dark"
        conditions = Conditions(exposure_s=0.02, illuminance_lux=1e-5 * times if times else None)
        held = FrameStack(data=data, full_scale_dn=full)
        stacks.append(stack_in_memory(kind, held, conditions, label=f"{kind}-{index}"))
    return session_in_memory(stacks)


def test_the_flat_disc_of_the_case_is_44_px_wide_and_holds_12_percent():
    if not (CASES / "o1-flat-disc-halo").is_dir():
        pytest.skip("the shared case o1-flat-disc-halo is not here")
    result = bloom.measure(open_session(CASES / "o1-flat-disc-halo"), context=Context(seed=1))
    (halo,), (share,) = result.find("halo_diameter"), result.find("halo_fraction")
    assert halo.status == share.status == "ok"
    assert halo.value == pytest.approx(44.0, abs=1.0)
    assert halo.interval95[0] < 44.0 < halo.interval95[1]
    assert share.value == pytest.approx(0.12, abs=0.006)
    assert not result.find("mcp_saturation_density")
    assert "tube" not in str(result.evidence) and "plate" not in str(result.evidence["bloom-forms"])


@pytest.mark.parametrize(
    "diameter_px, fraction, core_px, rise, wing, bits",
    [
        (32.0, 0.05, 1.0, 1.0, 0.0, 8),
        (64.0, 0.15, 1.8, 1.0, 0.1, 12),
        (50.0, 0.1, 1.3, 1.8, 0.0, 12),
    ],
)
def test_flat_and_rimmed_discs_are_as_wide_as_drawn(
    diameter_px, fraction, core_px, rise, wing, bits, seed
):
    rng = np.random.default_rng(seed)
    light = light_of(diameter_px, fraction, core_px, rise=rise, wing=wing)
    session = session_of(light, rng, bits=bits, electrons_per_dn=8.0 if bits == 12 else 40.0)
    (halo,) = bloom.measure(session, context=QUICK).find("halo_diameter")
    assert halo.status == "ok"
    assert abs(halo.value - diameter_px) < max(1.0, 0.02 * diameter_px)
    half = 0.5 * (halo.interval95[1] - halo.interval95[0])
    assert abs(halo.value - diameter_px) < 2.0 * half


def with_bad_pixels(session, rng, fraction, hits):
    """The session with stuck pixels, the same in all stacks, and hits of single frames."""
    shape = session.stacks[0].kept.data.shape[1:]
    stuck = rng.random(shape) < fraction
    code = rng.choice([0, int(session.stacks[0].kept.full_scale_dn)], shape)
    stacks = []
    for one in session.stacks:
        data = one.kept.data.copy()
        data[:, stuck] = code[stuck]
        data[rng.random(data.shape) < hits] = one.kept.full_scale_dn
        stacks.append(replace(one, kept=replace(one.kept, data=data)))
    return replace(session, stacks=tuple(stacks)), int(stuck.sum())


def test_stuck_pixels_and_hits_are_no_blooms_and_are_counted(seed):
    rng = np.random.default_rng(seed)
    session = session_of(light_of(44.0, 0.12, 1.3), rng)
    spoilt, stuck = with_bad_pixels(session, rng, 0.004, 1e-4)
    clean, found = (bloom.measure(one, context=QUICK) for one in (session, spoilt))
    (halo,) = found.find("halo_diameter")
    assert halo.status == "ok" and abs(halo.value - 44.0) < 1.0
    for quantity in ("bloom_diameter", "saturated_area"):
        for before, after in zip(clean.find(quantity), found.find(quantity), strict=True):
            assert (before.status, before.flags) == (after.status, after.flags)
            assert before.value is None or after.value == pytest.approx(before.value, rel=0.02)
    # Those under the saturated halo cannot be seen, nor can they do harm.
    counted = int(halo.notes[-1].split()[0])
    assert 0.7 * stuck < counted < 1.7 * stuck


def test_a_mask_that_leaks_has_no_veiling_glare(seed):
    """A ring of light about the pinhole holds four fifths of all: what does not fill the frame is
    no glare.
    """
    rng = np.random.default_rng(seed)
    light = light_of(44.0, 0.12, 1.3)
    x = np.hypot(*np.ogrid[-79.3 : SIDE - 79.3, -80.2 : SIDE - 80.2])
    ring = ((x > 5.0) & (x < 68.0)).astype(float)
    (glare,) = bloom.measure(
        session_of(light + 4.0 * light.sum() / ring.sum() * ring, rng), context=QUICK
    ).find("veiling_glare")
    assert glare.status != "ok"


def test_every_flag_says_its_effect_and_its_remedy(seed):
    rng = np.random.default_rng(seed)
    light = light_of(44.0, 0.12, 1.3)
    two = light + 0.6 * np.roll(light, 30, axis=1)
    found = [
        one for one in bloom.measure(session_of(two, rng), context=QUICK).measurements if one.flags
    ]
    assert found
    for one in found:
        for flag in one.flags:
            assert any(
                note.startswith(f"{flag}: ") and "what settles it" in note for note in one.notes
            )
