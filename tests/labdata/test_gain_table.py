"""Gain by calibration is monotone, goes there and back, and says nothing outside what was
calibrated.
"""

import pytest

from labdata import BadInput, GainTable

# A plate whose gain goes as the fifteenth power of its voltage.
VOLTS = (600.0, 700.0, 800.0, 900.0)
TABLE = GainTable(
    source="integrating sphere",
    mcp_v=VOLTS,
    luminous_gain=tuple(1e4 * (volts / 800.0) ** 15 for volts in VOLTS),
    relative_sd=(0.05, 0.04, 0.03, 0.03),
)


def test_a_power_law_is_met_between_the_points_with_the_uncertainty_of_the_calibration():
    gain, relative_sd = TABLE.gain_at(750.0)
    assert gain == pytest.approx(1e4 * (750 / 800) ** 15, rel=1e-9)
    assert 0.03 < relative_sd < 0.04


def test_volts_lead_to_the_gain_and_back():
    for volts in (600.0, 655.0, 777.7, 900.0):
        assert TABLE.volts_for(TABLE.gain_at(volts)[0]) == pytest.approx(volts, rel=1e-9)


def test_where_the_power_changes_the_gain_between_points_is_less_certain():
    bent = GainTable(
        source="x", mcp_v=VOLTS, luminous_gain=(1e3, 1e4, 2e4, 3e4), relative_sd=(0.01,) * 4
    )
    assert bent.gain_at(700.0)[1] == pytest.approx(0.01)
    assert bent.gain_at(750.0)[1] > 0.1


@pytest.mark.parametrize("volts", [599.9, 900.1, float("nan")])
def test_outside_the_table_nothing_is_said(volts):
    with pytest.raises(BadInput, match="must lie within the gain table, 600 to 900"):
        TABLE.gain_at(volts)


@pytest.mark.parametrize(
    "gains", [(1.0, 3.0, 2.0, 4.0), (0.0, 1.0, 2.0, 3.0), (1.0, 1.0, 2.0, 3.0), (1.0, 2.0)]
)
def test_a_table_that_does_not_rise_is_none(gains):
    with pytest.raises(BadInput):
        GainTable(source="x", mcp_v=VOLTS, luminous_gain=gains, relative_sd=(0.01,) * len(gains))
