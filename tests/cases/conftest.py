"""Shared sessions of flats and darks, measured."""

import shutil
from pathlib import Path

import pytest

from charact.estimators import noise
from charact.session_measurement import method_context
from labdata import Result, open_session

CASES = Path(__file__).resolve().parents[2].parent / "shared" / "cases"


@pytest.fixture
def case(tmp_path):
    """Measure the noise of a shared session by its name."""

    def of(name: str) -> Result:
        if not (CASES / name).is_dir():
            pytest.skip(f"the shared case {name} is not beside this checkout")
        session = open_session(shutil.copytree(CASES / name, tmp_path / name))
        return noise.measure(session, context=method_context(session, quick=True, seed=0))

    return of
