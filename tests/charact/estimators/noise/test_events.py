"""Single photoelectrons: rate, heights and spread of heights are found again in darks made pulse by
pulse.
"""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.studies.dark_events_coverage import DarkScene
from charact.estimators.noise import measure_events, pulses_of_darks, read_levels
from charact.estimators.noise.events.event_distribution import PulseDecay
from labdata import Conditions
from tests.truth.counted_pulses import QUICK, one

# What a scene of these holds can be told to a few percent; cheap enough for a test run.
BRIGHT = DarkScene(height_dn=150.0)


def measured(scene: DarkScene, seed: int):
    session = scene.session_drawn(np.random.default_rng(seed))
    return measure_events(session.stacks[0], context=replace(QUICK, interlaced=scene.interlaced))


def test_glow_hands_all_light_on_and_none_twice():
    light, chance = PulseDecay(glow=0.6, glow_exposures=1.5, fast_exposures=0.1).by_exposure()
    np.testing.assert_allclose(light.sum(axis=1), 1.0, atol=0.002)
    # A steady light that goes out leaves the glow of one exposure in the next: the shares of all
    # later ones.
    later = 0.6 * 1.5 * (1 - np.exp(-1 / 1.5)) + 0.4 * 0.1 * (1 - np.exp(-1 / 0.1))
    assert chance @ light[:, 1:].sum(axis=1) == pytest.approx(later, rel=0.01)


def test_rate_height_and_spread_are_found_again(seed):
    scene = replace(BRIGHT, relative_variance=0.6)
    result = measured(scene, seed)
    height, rate = one(result, "detected_photoelectron_gain"), one(result, "ebi")
    assert height.status == "ok" and rate.status == "ok"
    found = height.posterior
    for name, truth in (("density", 0.01), ("height_dn", 150.0), ("relative_variance", 0.6)):
        draws = found[name]
        assert abs(np.median(draws) - truth) < 4.5 * np.std(draws), name
        assert np.std(draws) < 0.1 * truth, name
    # Without a sensor p is anywhere from 0.45 to 1, and the interval says so.
    assert rate.interval95[0] < 0.01 / 0.7 / 0.02 < rate.interval95[1]


def test_ion_events_are_told_apart(seed):
    scene = replace(BRIGHT, ions=1e-5, ion_height_dn=6000.0, full_scale_dn=65535.0)
    result = measured(scene, seed)
    seen = result.evidence["pulse-heights"]
    drawn = scene.ions * scene.frames * scene.rows * scene.cols
    assert abs(seen["ion_events"] - drawn) < 4.5 * np.sqrt(drawn) + 1
    assert seen["ion_mean_height_dn"] == pytest.approx(6000.0, rel=0.35)
    height = one(result, "detected_photoelectron_gain")
    assert abs(height.value - 150.0) < 4.5 * 0.255 * (height.interval95[1] - height.interval95[0])


def test_pixels_that_flicker_are_no_pulses(seed):
    """The same darks with and without them tell the same."""
    calm, hot = (
        one(measured(replace(BRIGHT, hot=share), seed), "detected_photoelectron_gain")
        for share in (0.0, 1e-3)
    )
    low, high = calm.interval95
    assert abs(hot.value - calm.value) < 0.25 * (high - low)


@pytest.mark.parametrize("interlaced", [False, True])
def test_light_that_lingers_is_added_up(seed, interlaced):
    """A screen like P20: its slow light lasts for two fields, its fast light for a tenth of one."""
    scene = replace(
        BRIGHT,
        glow=0.5,
        glow_exposures=2.0,
        fast_exposures=0.08,
        interlaced=interlaced,
        rows=192 if interlaced else 128,
    )
    found = one(measured(scene, seed), "detected_photoelectron_gain").posterior
    for name in ("density", "height_dn", "relative_variance", "glow", "glow_exposures"):
        draws = found[name]
        assert abs(np.median(draws) - getattr(scene, name)) < 4.5 * np.std(draws), name
    assert np.std(found["height_dn"]) < 0.12 * scene.height_dn


def test_what_spills_from_field_to_field_is_refused_where_no_screen_is_known(seed):
    scene = replace(BRIGHT, fast_exposures=0.12, interlaced=True, rows=192)
    height = one(measured(scene, seed), "detected_photoelectron_gain")
    assert height.status == "refused" and "next field" in height.reason


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"height_dn": 1.0}, "detected"),
        ({"density": 0.0}, "detected"),
        ({"frames": 4}, "frames"),
        ({"rows": 40}, "too small"),
    ],
)
def test_what_cannot_be_measured_is_refused_in_a_sentence(seed, changes, word):
    result = measured(replace(BRIGHT, **changes), seed)
    for quantity in ("detected_photoelectron_gain", "ebi"):
        refused = one(result, quantity)
        assert refused.status == "refused" and word in refused.reason


@pytest.mark.parametrize(
    "changes", [{"height_dn": 8.0}, {"density": 0.3}, {"read_noise_dn": 0.2, "height_dn": 6.0}]
)
def test_past_breaking_nothing_is_wrong_and_unflagged(seed, changes):
    scene = replace(BRIGHT, **changes)
    height = one(measured(scene, seed), "detected_photoelectron_gain")
    if height.status == "ok":
        low, high = height.interval95
        half = (high - height.value) if scene.height_dn > height.value else (height.value - low)
        assert abs(scene.height_dn - height.value) < 2.0 * half


def test_darks_are_asked_where_an_intensifier_is_known_of_and_at_the_gain_of_the_flats(seed):
    session = replace(BRIGHT, density=0.0, frames=8, rows=64, cols=72).session_drawn(
        np.random.default_rng(seed)
    )
    (dark,) = session.stacks
    names = {"same": 700.0, "other": 800.0, "flat": 700.0}
    stacks = tuple(
        replace(
            dark,
            label=label,
            kind="flat" if label == "flat" else "dark",
            conditions=Conditions(mcp_v=volt),
        )
        for label, volt in names.items()
    )
    asked = replace(session, stacks=stacks)
    darks, *_ = read_levels(asked, context=QUICK, spectra=False, cubes=False)
    found = pulses_of_darks(asked, darks, context=QUICK).measurements
    assert {one.stack for one in found} == {"same"} and len(found) == 2
    plain = [replace(dark, conditions=Conditions()) for dark in darks]
    assert pulses_of_darks(asked, plain, context=QUICK).measurements == ()
