"""Halos of any profile under any core and wings: the edge is as wide as drawn, or there is none."""

import shutil
from pathlib import Path

import pytest

from charact.estimators import bloom
from charact.session_measurement import method_context
from labdata import open_session

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"


def test_the_disc_under_wings_of_the_case_is_57_px_wide(tmp_path):
    name = "kk1-disc-halo-under-wings"
    if not (CASES / name).is_dir():
        pytest.skip(f"the shared case {name} is not here")
    shutil.copytree(CASES / name, tmp_path / name)
    session = open_session(tmp_path / name)
    context = method_context(session, quick=True, seed=0)
    (halo,) = bloom.measure(session, context=context).find("halo_diameter")
    assert halo.status == "ok"
    assert halo.interval95[0] < 56.99 < halo.interval95[1]
    assert halo.value == pytest.approx(56.99, abs=0.3)
