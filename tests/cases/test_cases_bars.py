"""Bars of other tools' users in whole pictures, and siblings drawn in plain NumPy."""

from pathlib import Path

import pytest

import charact

ROOT = Path(__file__).resolve().parents[2]
CASES = ROOT.parent / "shared" / "cases"


def test_the_five_tilted_bars_of_the_case_are_found_and_no_other():
    folder = CASES / "ii1-five-tilted-bars"
    if not folder.is_dir():
        pytest.skip("the shared case ii1-five-tilted-bars is not here")
    (mtf,) = charact.mtf(folder / "b.tif", "bars", quick=True).find("mtf")
    assert mtf.status == "ok"
    assert mtf.frequency_cy_per_px == pytest.approx(0.0565, rel=0.01)
    assert mtf.value == pytest.approx(0.957, abs=0.004)
