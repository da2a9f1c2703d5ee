"""Many sessions in one verb: each gets what it would get alone, and a bad one among them costs the
others nothing.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.charact.cli.runner import charact


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two sessions of a camera of white noise and, between them, a folder that holds none."""
    rng = np.random.default_rng(1)
    made = [tmp_path_factory.mktemp(name) for name in ("first", "none", "last")]
    for folder in (made[0], made[2]):
        stacks = []
        for number, electrons in enumerate((0.0, 400.0, 900.0, 2000.0)):
            frames = (
                20.0 + 0.05 * rng.poisson(electrons, (4, 48, 64)) + rng.standard_normal((4, 48, 64))
            )
            np.save(folder / f"{number}.npy", np.rint(frames).astype(np.uint8))
            kind = "flat" if number else "dark"
            stacks.append(
                f'[[stack]]\nlabel = "{number}"\nkind = "{kind}"\nframes = "{number}.npy"\n'
            )
        (folder / "session.toml").write_text('name = "white"\n' + "".join(stacks))
    return made


def run(*arguments: object):
    return charact("noise", *arguments, "--quick", "--method", "variance")


def without_times(text: str) -> dict:
    told = json.loads(text)
    for measurement in told.get("measurements", []):
        measurement.pop("seconds")
    return told


def test_each_session_gets_one_object_a_line_as_it_would_alone(folders: list[Path]) -> None:
    done = run(*folders, "--json")
    alone = [run(folder, "--json") for folder in folders]
    assert done.exit_code == 1
    assert [without_times(line) for line in done.stdout.splitlines()] == [
        without_times(one.stdout) for one in alone
    ]
    assert [one.exit_code for one in alone] == [0, 1, 0]
    assert f"1 of 3 sessions gave no value: {folders[1]}" in done.stderr


def test_people_see_which_session_a_number_is_of(folders: list[Path]) -> None:
    done = run(folders[0], folders[2])
    assert done.exit_code == 0
    lines = done.stdout.splitlines()
    first, last = (lines.index(f"{folder}:") for folder in (folders[0], folders[2]))
    for part in (lines[first + 1 : last], lines[last + 1 :]):
        assert sum(line.startswith("system_gain") for line in part) == 1
