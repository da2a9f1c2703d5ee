"""Screens: decays pass the two times of the makers' tables; a tube keeps its photons when its
screen changes.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from labdata import BadInput, Camera, load_phosphor, load_sensor, phosphor_names, to_toml
from labdata.camera import Draws, Phosphor

# 90 to 10 % and 10 to 1 % of the light, ms.
TABLE = {"p20": (4.0, 55.0), "p43": (1.0, 1.6), "p46": (3e-4, 0.09), "p47": (1e-4, 2.9e-3)}


@pytest.fixture(scope="module")
def sensor() -> Camera:
    return load_sensor("pulnix-ag5745ef3")


def left(phosphor: Phosphor, time_ms: float) -> float:
    fast = float(phosphor.fast_fraction)
    return fast * np.exp(-time_ms / float(phosphor.fast_decay_ms)) + (1 - fast) * np.exp(
        -time_ms / float(phosphor.slow_decay_ms)
    )


def photons_per_photoelectron(sensor: Camera) -> float:
    screen = sensor.phosphor
    lumens = float(screen.luminous_efficacy_lm_per_w) * float(screen.photon_energy_ev)
    return (
        float(sensor.tube.luminous_gain)
        / lumens
        / float(sensor.photocathode.luminous_sensitivity_ua_per_lm)
        * 1e6
    )


def test_every_shipped_phosphor_is_of_the_table():
    assert phosphor_names() == tuple(TABLE)


@pytest.mark.parametrize("name", TABLE)
def test_the_decay_passes_90_10_and_1_percent_when_the_makers_say(name):
    phosphor = load_phosphor(name)
    reached = [
        brentq(
            lambda t, level=level: left(phosphor, t) - level,
            0.0,
            20.0 * float(phosphor.slow_decay_ms),
        )
        for level in (0.9, 0.1, 0.01)
    ]
    assert np.diff(reached) == pytest.approx(TABLE[name], rel=2e-4)


def test_numbers_of_a_phosphor_have_a_source_and_the_case_of_its_name_is_free():
    for name in phosphor_names():
        phosphor = load_phosphor(name.upper())
        assert phosphor.name == name.upper()
        numbers = [value for value in vars(phosphor).values() if not isinstance(value, str)]
        assert all(one.source and one.low is not None for one in numbers), name


def test_the_sheets_own_screen_lies_within_the_shipped_one(sensor):
    shipped = load_phosphor("p20")
    for name in ("fast_fraction", "fast_decay_ms", "slow_decay_ms", "luminous_efficacy_lm_per_w"):
        one = getattr(shipped, name)
        assert one.low <= float(getattr(sensor.phosphor, name)) <= one.high


@pytest.mark.parametrize("name", TABLE)
def test_a_changed_screen_keeps_the_photons_of_a_photoelectron(sensor, name):
    changed = sensor.with_phosphor(load_phosphor(name))
    assert photons_per_photoelectron(changed) == pytest.approx(
        photons_per_photoelectron(sensor), rel=1e-12
    )
    electrons = float(changed.microchannel_plate.electron_gain) * float(
        changed.phosphor.photons_per_electron
    )
    before = float(sensor.microchannel_plate.electron_gain) * float(
        sensor.phosphor.photons_per_electron
    )
    assert electrons == pytest.approx(before, rel=1e-12)
    assert changed.tube.luminous_gain.standing == "derived"
    assert changed.phosphor.name in changed.notes[-1]


def test_a_measured_screen_keeps_the_plates_gain_and_takes_the_light_with_it(sensor):
    bright = load_phosphor("p43")
    bright = replace(
        bright,
        photons_per_electron=replace(
            bright.photons_per_electron, value=410.0, low=400.0, high=420.0, standing="sheet"
        ),
    )
    changed = sensor.with_phosphor(bright)
    assert photons_per_photoelectron(changed) == pytest.approx(
        2.0 * photons_per_photoelectron(sensor), rel=1e-12
    )
    assert float(changed.microchannel_plate.electron_gain) == float(
        sensor.microchannel_plate.electron_gain
    )


def test_draws_of_a_fitted_tube_follow_its_screen(sensor):
    draws = Draws(
        names=("phosphor.slow_decay_ms", "tube.luminous_gain"),
        values=((30.0, 15000.0), (40.0, 12000.0)),
    )
    changed = replace(sensor, draws=draws).with_phosphor(load_phosphor("p47"))
    factor = float(changed.tube.luminous_gain) / 15000.0
    assert changed.draws.names == ("tube.luminous_gain",)
    assert changed.draws.values == ((15000.0 * factor,), (12000.0 * factor,))


def test_a_missing_phosphor_is_refused_with_the_shipped_ones_and_one_of_ones_own_is_read(tmp_path):
    with pytest.raises(
        BadInput, match="one of p20, p43, p46, p47 or the path of a TOML file, got 'p11'"
    ):
        load_phosphor("p11")
    own = replace(load_phosphor("p46"), name="mine")
    (tmp_path / "mine.toml").write_text(to_toml(own))
    assert load_phosphor(tmp_path / "mine.toml") == own
