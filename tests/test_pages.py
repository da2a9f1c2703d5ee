"""The pages say what is so: their commands and programs run as printed, and their pictures and links are there."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from charact.cli.application import app
from labdata.session import open_session

ROOT = Path(__file__).resolve().parents[1]
README, TUTORIAL, SIMULATOR = (ROOT / name for name in ("README.md", "docs/tutorial.md", "docs/simulator.md"))
COMMANDS = re.findall(r"^    charact (simulate docs/.*)$", TUTORIAL.read_text(), re.MULTILINE)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """A folder with nothing but the docs in it."""
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_tutorial_of_the_simulator_has_its_steps():
    assert len(COMMANDS) == 4


@pytest.mark.parametrize("command", COMMANDS)
def test_a_step_of_the_tutorial_runs_as_printed(elsewhere, command):
    done = CliRunner().invoke(app, shlex.split(command))
    assert done.exit_code == 0, done.output
    (entry,) = open_session(elsewhere / shlex.split(command)[2]).stacks
    assert entry.read().data.shape[1:] == (493, 768)
    if "--stage-images" in command:
        assert (elsewhere / "stages" / "stages.png").stat().st_size > 0


def test_the_program_on_frame_1000_draws_it():
    (program,) = re.findall(r"^```python\n(.*?)^```", SIMULATOR.read_text(), re.MULTILINE | re.DOTALL)
    names: dict = {}
    exec(program, names)
    following = names["camera"].frames(names["light"], names["conditions"], seed=7, first_frame=999)
    next(following)
    assert np.array_equal(names["frame_1000"], next(following))


@pytest.mark.parametrize("page", [README, *sorted((ROOT / "docs").glob("*.md"))], ids=lambda page: page.name)
def test_pictures_and_links_of_a_page_are_there(page):
    linked = re.findall(r"\]\(([^)#:]+)\)", page.read_text())
    assert [name for name in linked if not (page.parent / name).exists()] == []


def test_pictures_are_small():
    assert all(picture.stat().st_size < 600_000 for picture in (ROOT / "docs").rglob("*.png"))
