"""A real CCD, measured by others: EMVA 1288 reference set 001 (Basler AG, M. Grimm 2011, CC BY-SA
3.0).
"""

import pytest

from charact.estimators import noise
from charact.method import Context
from labdata.session_import import import_emva1288

# The standard's reference implementation on this subset; see the README beside the images.
REFERENCE = {
    ("system_gain", "DN/e-"): (0.2804, 0.001),
    ("quantum_efficiency", "%"): (45.22, 0.001),
    ("read_noise", "e-"): (10.91, 0.001),
    ("read_noise", "DN"): (3.073, 0.001),
    ("snr_max", "1"): (118.3, 0.001),
    ("dynamic_range", "1"): (1221.0, 0.001),
    ("dsnu", "e-"): (0.50, 0.02),
    ("prnu", "%"): (0.433, 0.02),
}


@pytest.fixture(scope="module")
def session(shared_data, tmp_path_factory):
    data = shared_data / "emva001_basler_ccd12" / "EMVA1288_Data.txt"
    return import_emva1288(data, tmp_path_factory.mktemp("emva") / "session")


@pytest.mark.parametrize("method", ["covariance-sum", "variance"])
def test_a_real_camera_reads_as_the_standards_own_program_reads_it(session, method):
    result = noise.measure(
        session, method=method, context=Context(seed=3, quick=True, full_scale_dn=4095.0)
    )
    found = {(m.quantity, m.unit): m for m in result.measurements}
    for key, (truth, tolerance) in REFERENCE.items():
        assert found[key].value == pytest.approx(truth, rel=tolerance), key
        assert found[key].status == "ok", key
        low, high = found[key].interval95
        assert low < truth < high, key
    gain = found["system_gain", "DN/e-"]
    assert gain.interval95[1] - gain.interval95[0] < 0.03 * gain.value
    # The reference's variances, 0.2904 DN at no signal and 0.2738 at the brightest flat of the fit.
    assert found["gain_curvature", "%"].value == pytest.approx(-5.9, abs=0.5)
    if method == "covariance-sum":
        # Its noise is nearly white: the covariance gain is the system gain.
        assert found["covariance_gain", "DN"].value == pytest.approx(0.2804, rel=0.02)
        low, high = found["blur_factor", "1"].interval95
        assert low - 0.01 < 1.0 < high + 0.01
