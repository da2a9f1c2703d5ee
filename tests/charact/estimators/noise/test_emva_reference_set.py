"""A real CCD, measured by others: EMVA 1288 reference set 001 (Basler AG, M. Grimm 2011, CC BY-SA
3.0).
"""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from charact.estimators import noise
from charact.method import Context
from charact.reporting import emva_summary, emva_xml
from charact.reporting.emva_page import sheet_page
from labdata.session_import import import_emva1288

# Printed of this subset by the standard's reference implementation, `emva1288` 1.0.2 of PyPI with
# NumPy 1.26: element, value, and a unit of the last digit that its report prints, or of the fourth
# one. It takes the threshold as s_d/K + 1/2 in place of eq. 26, some .1 %.
PRINTED = {
    "sensitivity/QE": (45.22134, 0.01),
    "sensitivity/R": (0.1267784, 1e-4),
    "sensitivity/K": (0.2803508, 0.001),
    "sensitivity/inverse_K": (3.566959, 0.001),
    "sensitivity/sigma_d": (10.91348, 0.01),
    "sensitivity/sigma_y_dark": (3.073193, 0.001),
    "sensitivity/u_p_min": (25.34633, 0.05),
    "sensitivity/u_e_min": (11.46195, 0.02),
    "sensitivity/u_e_sat": (13999.17, 1.0),
    "sensitivity/u_p_sat": (30957.0, 1e-6),
    "sensitivity/SNR_max": (118.3181, 0.01),
    "sensitivity/SNR_max_dB": (41.46102, 0.01),
    "sensitivity/SNR_max_bit": (6.886527, 0.001),
    "sensitivity/DR": (1221.36, 2.0),
    "sensitivity/DR_dB": (61.73687, 0.02),
    "linearity/LE_min": (-0.6048097, 1e-6),
    "linearity/LE_max": (0.4546718, 1e-6),
    "spatial/DSNU1288": (0.4970724, 0.001),
    "spatial/DSNU1288_DN": (0.1393547, 1e-4),
    "spatial/DSNU1288_row": (0.4513593, 0.001),
    "spatial/DSNU1288_col": (0.5374811, 0.001),
    "spatial/PRNU1288": (0.4327842, 1e-5),
    "spatial/PRNU1288_row": (0.3236215, 1e-5),
    "spatial/PRNU1288_col": (0.1112811, 1e-5),
    "spatial/PRNU1288_pixel": (0.2649298, 1e-5),
}


@pytest.fixture(scope="module")
def session(shared_data, tmp_path_factory):
    data = shared_data / "emva001_basler_ccd12" / "EMVA1288_Data.txt"
    return import_emva1288(data, tmp_path_factory.mktemp("emva") / "session")


@pytest.mark.parametrize("method", ["covariance-sum", "variance"])
def test_a_real_camera_reads_as_the_standards_own_program_reads_it(session, method):
    context = Context(seed=3, quick=True, full_scale_dn=4095.0)
    result = noise.measure(session, method=method, context=context)
    rows = {"/".join(row.entry.element): row for row in emva_summary(result)["rows"]}
    sheet = ElementTree.fromstring(emva_xml(result, "ccd"))
    for name, (printed, digit) in PRINTED.items():
        row, element = rows[name], sheet.find(name)
        # The program reads the value of an element of that name in a part of that name.
        assert float(element.find("value").text) == pytest.approx(printed, abs=1.5 * digit), name
        assert row.status == element.find("status").text == "ok", (name, row.flags)
        low, high = (float(element.find(end).text) for end in ("low95", "high95"))
        assert low <= printed + digit and printed - digit <= high, name
    # Its variance of single pixels is negative, of which it prints no root.
    assert sheet.find("spatial/DSNU1288_pixel/value").text == "nan"
    assert "more frames" in sheet.find("spatial/DSNU1288_pixel/not_to_standard").text
    bins, values = (
        sheet.find(f"defect_pixel/histogram_DSNU/data/{tag}").text.split()
        for tag in ("bins", "values")
    )
    assert len(bins) == len(values) and sum(map(float, values)) == 640 * 480
    # What is not to the standard lacks frames, and says which to add.
    for name, row in rows.items():
        assert not row.departure or any(word in row.departure for word in ("add", "more", "needs"))
        assert bool(row.departure) == (name.split("/")[0] in ("sensitivity", "linearity")) or (
            row.m is None
        )
    # Pixels reach full scale above the peak of the variance, within a step of the levels.
    full, peak = (rows[f"sensitivity/u_p_sat{end}"].m for end in ("_full_scale", ""))
    assert peak.value < full.value < peak.value + 1800.0
    # Without its shading less is left of PRNU, and next to nothing of rows and columns.
    flat, filtered = (rows[f"spatial/PRNU1288{end}"].m.value for end in ("", "_filtered"))
    assert 0.5 * flat < filtered < flat
    assert rows["spatial/PRNU1288_row_filtered"].m.value < 0.02
    gain = rows["sensitivity/K"].m
    assert gain.interval95[1] - gain.interval95[0] < 0.03 * gain.value
    # The reference's variances, 0.2904 DN at no signal and 0.2738 at the brightest flat of the fit.
    (bend,) = result.find("gain_curvature")
    assert bend.value == pytest.approx(-5.9, abs=0.5)
    if method == "covariance-sum":
        # Its noise is nearly white: the covariance gain is the system gain.
        (covariance,), (blur,) = result.find("covariance_gain"), result.find("blur_factor")
        assert covariance.value == pytest.approx(0.2804, rel=0.02)
        low, high = blur.interval95
        assert low - 0.01 < 1.0 < high + 0.01
    page = sheet_page(session, result)
    assert page.count("<figure>") == 7 and "Not plotted" not in page
    bare = replace(result, evidence={})
    assert "<figure>" not in sheet_page(session, bare)
