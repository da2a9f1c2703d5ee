"""A lamp makes the light that is asked for, through the filter that is asked for, or says that it
cannot.
"""

import math

import pytest

from labdata import BadInput, LampCalibration

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


@pytest.mark.parametrize(
    ("lux", "density", "rule"),
    [
        (2.0, None, "within the range of the lamp, 1e-07 to 1, got 2"),
        (1e-8, None, "within the range of the lamp, 1e-07 to 1, got 1e-08"),
        (1e-1, 3.0, "within the range of the lamp, 1e-05 to 0.001, got 0.1"),
        (1e-4, 2.5, "filter_density must be one of the wheel's 0, 1, 2, 3, 4, 5, got 2.5"),
    ],
)
def test_what_the_lamp_cannot_make_is_refused(lux, density, rule):
    with pytest.raises(BadInput, match=rule):
        LAMP.setting(lux, density)


@pytest.mark.parametrize(
    "changes", [{"source": " "}, {"filter_density": ()}, {"filter_density": (1.0, 1.0)}]
)
def test_a_calibration_that_cannot_be_is_refused(changes):
    with pytest.raises(BadInput):
        LampCalibration(**{**vars(LAMP), **changes})
