"""The EMVA 1288 summary stands for a camera of white noise, and says for any other why it does not."""

from charact.report import fragment
from charact.report.tables import NAMES, emva_summary
from labdata.measurement import Result, make_refusal, measurement_from_sd
from labdata.quantity import QUANTITIES

PLAIN = {"method": "variance"}


def white(**more):
    return (
        measurement_from_sd("system_gain", "DN/e-", 0.28, 0.001, **PLAIN, **more),
        measurement_from_sd("quantum_efficiency", "%", 45.2, 0.3, **PLAIN),
        measurement_from_sd("read_noise", "DN", 3.1, 0.01, **PLAIN),
        make_refusal("snr_max", "1", "no flat reaches saturation", **PLAIN),
    )


def test_every_line_is_a_quantity_of_the_vocabulary():
    assert all(unit in QUANTITIES[name].units for name, unit, _, _ in NAMES)


def test_figures_stand_under_the_standards_names_and_what_is_missing_is_named():
    found = emva_summary(Result(measurements=white()))
    assert found is not None and not found["reason"]
    assert [(name.split(" ")[0], section) for name, section, _ in found["rows"]] == [
        ("Quantum", "2.1"), ("Overall", "2.2"), ("Temporal", "2.2"),
    ]  # fmt: skip
    assert found["rows"][1][2]["plus_minus"].startswith("0.28")
    assert any("SNR_max" in name for name in found["left_out"])


def test_an_intensified_camera_gets_a_reason_and_no_figure():
    """Either method: the variance's gain with its flag, or only the covariance gain."""
    gain = measurement_from_sd("covariance_gain", "DN", 40.0, 0.3, method="covariance-sum")
    for measurements in (white(flags=("correlated-noise",)), (gain,)):
        found = emva_summary(Result(measurements=measurements))
        assert found is not None and "rows" not in found and "blur factor" in found["reason"]


def test_without_a_gain_there_is_nothing_to_say():
    assert emva_summary(Result(measurements=(make_refusal("system_gain", "DN/e-", "no flats", **PLAIN),))) is None
    assert "EMVA" not in fragment(Result(measurements=white()))
