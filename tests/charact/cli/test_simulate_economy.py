"""`charact simulate` plans: it says what it leaves out and why, keeps the plan, and leaves nothing
out when told so.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from labdata import open_session
from tests.charact.cli.runner import done_well, small_camera

ROWS, COLS = 64, 96


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A small camera, and an evenly dim picture of it in DN."""
    folder = tmp_path_factory.mktemp("economy")
    small_camera(folder, ROWS, COLS)
    np.save(folder / "dim.npy", np.full((ROWS, COLS), 1, np.uint16))
    return folder


def _simulated(folder: Path, out: str, *more: object, camera: str = "pulnix-ag5745ef3") -> Result:
    return done_well(
        "simulate",
        folder / "dim.npy",
        folder / out,
        "--sensor",
        folder / f"{camera}.toml",
        "--photoelectrons-per-dn",
        1,
        "--frames",
        2,
        *more,
    )


def _left_out(session: Path) -> set[str]:
    plan = json.loads((session / "economy.json").read_text())
    return {effect["name"] for effect in plan["effects"] if not effect["kept"]}


def test_a_dim_scene_goes_without_halo_overflow_and_smear_and_the_session_says_so(folder):
    done = _simulated(folder, "dim", "--explain")
    assert {"halo", "column blooming", "smear"} <= _left_out(folder / "dim")
    rows = {line[:26].strip(): line for line in done.stdout.splitlines()}
    assert "left out" in rows["halo"]
    assert "kept" in rows["pulse-height distribution"]
    notes = " ".join(open_session(folder / "dim").stacks[0].notes)
    assert "halo" in notes
    assert "% of the temporal noise, of 10 % allowed" in notes


def test_within_nothing_only_what_has_no_influence_is_left_out(folder):
    _simulated(folder, "within", "--error-budget", 0)
    plan = json.loads((folder / "within" / "economy.json").read_text())
    assert all(effect["kept"] == (effect["influence"] > 0.0) for effect in plan["effects"])


def test_exact_keeps_everything(folder):
    done = _simulated(folder, "exact", "--exact", "--explain")
    assert not _left_out(folder / "exact")
    assert "left out  " not in done.stdout
    assert "nothing left out" in " ".join(open_session(folder / "exact").stacks[0].notes)


def test_a_camera_without_a_tube_keeps_every_stage_and_says_so(folder):
    small_camera(folder, ROWS, COLS, "emccd-512")
    done = _simulated(folder, "emccd", "--explain", camera="emccd-512")
    assert "all effects are retained" in done.stdout
