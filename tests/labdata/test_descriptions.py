"""Descriptions: phosphors, cameras without a tube, tables of gain, and calibrated lamps."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from labdata import (
    BadInput,
    Camera,
    GainTable,
    LampCalibration,
    load_camera,
    load_phosphor,
    load_sensor,
    open_session,
    phosphor_names,
    to_toml,
)
from labdata.camera import Draws, Parameter, Phosphor

# Screens: decays pass the two times of the makers' tables; a tube keeps its photons when its
# screen changes.


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


def test_a_phosphor_of_ones_own_is_read(tmp_path):
    own = replace(load_phosphor("p46"), name="mine")
    (tmp_path / "mine.toml").write_text(to_toml(own))
    assert load_phosphor(tmp_path / "mine.toml") == own


# A camera without a tube: described, told apart from intensified ones, and kept out of where a
# tube is needed.


@pytest.fixture
def camera() -> Camera:
    return load_camera("emccd-512")


def test_the_register_fills_the_scale_and_its_dark_current_is_gone_when_cooled(camera):
    video = camera.video
    span = 2**video.bit_depth - 1 - float(video.black_level_dn)
    assert span / float(video.conversion_gain_dn_per_e) == pytest.approx(8e5, rel=1e-3)
    colder = 2.0 ** ((-70.0 - 25.0) / float(camera.ccd.dark_current_doubling_k))
    assert float(camera.ccd.dark_current_e_per_s) * colder < 0.02


def test_a_session_of_such_a_camera_is_that_of_any_camera(camera, tmp_path):
    np.save(tmp_path / "f.npy", np.zeros((2, 8, 8), np.uint16))
    (tmp_path / "camera.toml").write_text(to_toml(camera))
    (tmp_path / "session.toml").write_text(
        'name = "s"\nsensor = "camera.toml"\n[[stack]]\nlabel = "a"\nkind = "dark"\nframes = '
        '"f.npy"\nem_gain = 300.0\n'
    )
    session = open_session(tmp_path)
    assert session.camera == camera and not session.is_interlaced
    assert session.stacks[0].conditions.em_gain == 300.0


# Gain by calibration is monotone, goes there and back, and says nothing outside what was
# calibrated.


# A plate whose gain goes as the fifteenth power of its voltage.
VOLTS = (600.0, 700.0, 800.0, 900.0)
GAINS = GainTable(
    source="integrating sphere",
    mcp_v=VOLTS,
    luminous_gain=tuple(1e4 * (volts / 800.0) ** 15 for volts in VOLTS),
    relative_sd=(0.05, 0.04, 0.03, 0.03),
)


def test_a_power_law_is_met_between_the_points_with_the_uncertainty_of_the_calibration():
    gain, relative_sd = GAINS.gain_at(750.0)
    assert gain == pytest.approx(1e4 * (750 / 800) ** 15, rel=1e-9)
    assert 0.03 < relative_sd < 0.04


def test_volts_lead_to_the_gain_and_back():
    for volts in (600.0, 655.0, 777.7, 900.0):
        assert GAINS.volts_for(GAINS.gain_at(volts)[0]) == pytest.approx(volts, rel=1e-9)


def test_where_the_power_changes_the_gain_between_points_is_less_certain():
    bent = GainTable(
        source="x", mcp_v=VOLTS, luminous_gain=(1e3, 1e4, 2e4, 3e4), relative_sd=(0.01,) * 4
    )
    assert bent.gain_at(700.0)[1] == pytest.approx(0.01)
    assert bent.gain_at(750.0)[1] > 0.1


# A lamp makes the light that is asked for, through the filter that is asked for, or says that it
# cannot.


# A diode whose light is as its current, 0.1 lux for 0.1 A, behind a wheel of whole densities.
LAMP = LampCalibration(
    source="photometer",
    current_a=(0.01, 0.1, 1.0),
    illuminance_lux=(1e-2, 1e-1, 1.0),
    relative_sd=(0.03, 0.03, 0.03),
    filter_density=(0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
    filter_density_sd=0.01,
)


@pytest.mark.parametrize("lux", [1e-6, 3.3e-6, 1e-5, 4.7e-4, 2e-2, 0.7])
def test_the_light_is_that_of_the_current_through_the_filter(lux):
    setting = LAMP.setting(lux)
    density = LAMP.filter_density[setting.position - 1]
    assert setting.read.illuminance_lux == pytest.approx(
        setting.current_a * 10.0**-density, rel=1e-9
    )
    # Half a milliampere of a current of at least 10 mA.
    assert setting.read.illuminance_lux == pytest.approx(lux, rel=0.05)
    assert setting.current_a == pytest.approx(round(setting.current_a, 3), abs=1e-12)


def test_the_densest_filter_that_lets_enough_light_pass_is_chosen():
    assert LAMP.setting(1e-5).position == 6
    assert LAMP.setting(2e-5).position == 5
    assert LAMP.setting(1e-5, 4.0).position == 5


def test_the_filters_uncertainty_is_added_to_the_lamps():
    bare, filtered = LAMP.setting(0.1, 0.0).read, LAMP.setting(1e-3, 2.0).read
    assert bare.illuminance_relative_sd == pytest.approx(0.03)
    assert filtered.illuminance_relative_sd == pytest.approx(
        math.hypot(0.03, 0.01 * math.log(10.0))
    )


EMCCD = load_camera("emccd-512")
GAIN_RANGE = "must lie within the gain table, 600 to 900"


def gains_of(gains: tuple[float, ...]) -> GainTable:
    return GainTable(source="x", mcp_v=VOLTS, luminous_gain=gains, relative_sd=(0.01,) * len(gains))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (
            lambda: load_phosphor("p11"),
            "one of p20, p43, p46, p47 or the path of a TOML file, got 'p11'",
        ),
        (
            lambda: load_sensor("emccd-512"),
            r"must be an intensified camera, got 'EMCCD 512', which has no \[tube\]",
        ),
        (
            lambda: replace(EMCCD, ccd=replace(EMCCD.ccd, quantum_efficiency=Parameter(value=0.5))),
            r"must be the silicon's highest, 0\.92, got 0\.5",
        ),
        (
            lambda: replace(EMCCD, video=replace(EMCCD.video, interlaced=True)),
            "progressive and digital",
        ),
        (
            lambda: EMCCD.with_values({"register.em_gain": 0.5}),
            r"^em_gain must be at least 1, got 0\.5$",
        ),
        (
            lambda: EMCCD.with_values({"register.clock_induced_e": -1.0}),
            "^clock_induced_e must not be negative, got -1$",
        ),
        (
            lambda: EMCCD.with_values({"optics.focal_length_mm": 0.0}),
            "^focal_length_mm must be positive, got 0$",
        ),
        *((lambda v=volts: GAINS.gain_at(v), GAIN_RANGE) for volts in (599.9, 900.1, math.nan)),
        (lambda: gains_of((1.0, 3.0, 2.0, 4.0)), "luminous_gain"),
        (lambda: gains_of((0.0, 1.0, 2.0, 3.0)), "luminous_gain"),
        (lambda: gains_of((1.0, 1.0, 2.0, 3.0)), "luminous_gain"),
        (lambda: gains_of((1.0, 2.0)), "at least two whole rows"),
        (lambda: LAMP.setting(2.0), "within the range of the lamp, 1e-07 to 1, got 2"),
        (lambda: LAMP.setting(1e-8), "within the range of the lamp, 1e-07 to 1, got 1e-08"),
        (lambda: LAMP.setting(0.1, 3.0), "within the range of the lamp, 1e-05 to 0.001, got 0.1"),
        (
            lambda: LAMP.setting(1e-4, 2.5),
            "filter_density must be one of the wheel's 0, 1, 2, 3, 4, 5, got 2.5",
        ),
        (lambda: replace(LAMP, source=" "), "source"),
        (lambda: replace(LAMP, filter_density=()), "filter"),
        (lambda: replace(LAMP, filter_density=(1.0, 1.0)), "filter"),
    ],
)
def test_what_no_description_can_say_is_refused(make, words):
    with pytest.raises(BadInput, match=words):
        make()
