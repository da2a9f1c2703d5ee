"""The JSON of every measuring verb keeps the contract, as a checker outside the project sees it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

CHARACT = Path(sys.executable).with_name("charact")


@pytest.fixture
def check_contract(shared_data: Path) -> Path:
    checker = shared_data.parent / "check-contract"
    if not checker.is_file():
        pytest.skip("the contract's checker is not beside this checkout")
    return checker


def holds(checker: Path, *arguments: object, expect: int | None = None) -> None:
    expected = () if expect is None else ("--expect", str(expect))
    done = subprocess.run(
        [sys.executable, checker, *expected, CHARACT, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.stdout.strip() == "contract holds", done.stdout


@pytest.mark.parametrize(
    ("method", "file"), [("auto", "h_edge.tif"), ("edge-slanted", "v_edge.tif")]
)
def test_edge(check_contract: Path, shared_data: Path, method: str, file: str) -> None:
    path = shared_data / "burns_sfrmat3" / file
    holds(check_contract, "mtf", "edge", path, "--quick", "--method", method, expect=0)


@pytest.mark.parametrize("kind", [("bars", "--frequency", "0.12"), ("point",)])
def test_a_target_that_is_not_there(
    check_contract: Path, shared_data: Path, kind: tuple[str, ...]
) -> None:
    holds(
        check_contract,
        "mtf",
        kind[0],
        shared_data / "burns_sfrmat3" / "h_edge.tif",
        "--quick",
        *kind[1:],
    )


def test_noise_of_a_real_camera(check_contract: Path, shared_data: Path, tmp_path: Path) -> None:
    """Every fifth exposure of EMVA 1288 reference set 001: 26 of light, then 26 in the dark."""
    whole = shared_data / "emva001_basler_ccd12" / "EMVA1288_Data.txt"
    head, *exposures = re.split("^(?=[bd] )", whole.read_text(), flags=re.MULTILINE)
    part = "".join([head, *exposures[:26:5], *exposures[26::5]])
    (tmp_path / "part.txt").write_text(
        re.sub("^i ", f"i {whole.parent}/", part, flags=re.MULTILINE)
    )
    importing = [CHARACT, "import", "emva1288", tmp_path / "part.txt", tmp_path / "s"]
    subprocess.run(importing, check=True, capture_output=True)
    holds(check_contract, "noise", tmp_path / "s", "--quick", expect=0)
    holds(check_contract, "measure", tmp_path / "s", "--quick", expect=0)
    holds(check_contract, "bloom", tmp_path / "s", "--quick", expect=1)


def test_missing_input(check_contract: Path, tmp_path: Path) -> None:
    for verb in (("mtf", "edge"), ("measure",)):
        holds(check_contract, *verb, tmp_path / "missing.tif", expect=1)
