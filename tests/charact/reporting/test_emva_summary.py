"""The EMVA 1288 summary stands for a camera of white noise, and says for any other why it does
not.
"""

from xml.etree import ElementTree

import numpy as np

from charact.reporting import emva_summary, emva_xml, fragment, in_standard_unit, sheet_rows
from labdata import Result, make_refusal, measurement_from_sd

PLAIN = {"method": "variance"}


def white(**more):
    return (
        measurement_from_sd("system_gain", "DN/e-", 0.28, 0.001, **PLAIN, **more),
        measurement_from_sd("quantum_efficiency", "%", 45.2, 0.3, **PLAIN),
        measurement_from_sd("read_noise", "DN", 3.1, 0.01, **PLAIN),
        make_refusal("snr_max", "1", "no flat reaches saturation", **PLAIN),
    )


def test_figures_stand_under_the_standards_names_and_what_is_missing_is_named():
    found = emva_summary(Result(measurements=white()))
    assert found is not None and not found["reason"]
    assert [(entry.symbol, entry.clause) for entry, *_ in found["rows"]] == [
        ("η", "eq. 52"),
        ("K", "eq. 50"),
        ("1/K", "eq. 50"),
        ("σ_y.dark", "eq. 53"),
    ]
    assert found["rows"][1][1].startswith("0.28")
    assert "Largest signal-to-noise ratio" in found["left_out"]


def test_a_ratio_in_decibels_and_the_inverse_gain_carry_their_intervals():
    entries = {entry.symbol: entry for entry in sheet_rows()}
    ratio = measurement_from_sd("snr_max", "1", 100.0, 5.0, **PLAIN)
    shown = in_standard_unit(entries["SNR_max.dB"], ratio)
    assert shown.value == 40.0 and shown.unit == "dB"
    assert np.allclose(shown.interval95, 20 * np.log10(ratio.interval95))
    gain = measurement_from_sd("system_gain", "DN/e-", 0.25, 0.01, **PLAIN)
    inverse = in_standard_unit(entries["1/K"], gain)
    assert inverse.value == 4.0
    assert np.allclose(sorted(1.0 / np.array(gain.interval95)), inverse.interval95)


def test_the_xml_states_symbol_clause_and_what_is_not_to_standard():
    measurements = (*white(), measurement_from_sd("prnu", "%", 1.0, 0.01, **PLAIN))
    sheet = ElementTree.fromstring(emva_xml(Result(measurements=measurements), "day"))
    assert sheet.attrib["release"] == "4.0 Linear"
    assert sheet.find("sensitivity/K").attrib["symbol"] == "K"
    assert "high-pass" in sheet.find("spatial/PRNU1288").attrib["not_to_standard"]
    assert "not_to_standard" not in sheet.find("sensitivity/QE").attrib


def test_an_intensified_camera_gets_a_reason_and_no_figure():
    """Either method: the variance's gain with its flag, or only the covariance gain."""
    gain = measurement_from_sd("covariance_gain", "DN", 40.0, 0.3, method="covariance-sum")
    for measurements in (white(flags=("correlated-noise",)), (gain,)):
        found = emva_summary(Result(measurements=measurements))
        assert found is not None and "rows" not in found and "blur factor" in found["reason"]


def test_without_a_gain_there_is_nothing_to_say():
    assert (
        emva_summary(
            Result(measurements=(make_refusal("system_gain", "DN/e-", "no flats", **PLAIN),))
        )
        is None
    )
    assert "EMVA" not in fragment(Result(measurements=white()))
