"""A frame of pure noise holds no target, and of many sessions in one verb each gets what it would
get alone.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.charact.cli.runner import charact

VERBS = {"edge": (), "bars": ("--frequency", "0.12"), "point": ()}


def noise_frame(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Noise of several cameras: white, correlated by blur, Poisson, and none at all."""
    from scipy.ndimage import gaussian_filter

    shape = (96, 128)
    frames = {
        "white": 100 + 5 * rng.standard_normal(shape),
        "correlated": 100 + 30 * gaussian_filter(rng.standard_normal(shape), 1.5),
        "poisson": rng.poisson(8.0, shape).astype(float),
        "constant": np.full(shape, 77.0),
    }
    return np.clip(np.round(frames[kind]), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", ["white", "correlated", "poisson", "constant"])
@pytest.mark.parametrize("verb", VERBS)
def test_noise_is_never_an_mtf(verb: str, noise: str, tmp_path: Path, seed: int) -> None:
    np.save(tmp_path / "noise.npy", noise_frame(noise, np.random.default_rng(seed)))
    assert not ok_measurements("mtf", verb, tmp_path / "noise.npy", "--quick", *VERBS[verb])


@pytest.mark.parametrize("kind", ["flat", "point", "edge", "dark"])
def test_a_session_of_noise_is_never_ok(kind: str, tmp_path: Path, seed: int) -> None:
    """Noise that does not follow the light is no camera: darks alone may give a read noise, and
    nothing else.

    That no pixel stands out is true of any frames, whatever made them: none is defective.
    """
    rng = np.random.default_rng(seed)
    np.save(tmp_path / "noise.npy", np.stack([noise_frame("white", rng) for _ in range(4)]))
    stack = f'[[stack]]\nlabel = "a"\nkind = "{kind}"\nframes = "noise.npy"\n'
    (tmp_path / "session.toml").write_text(f'name = "noise"\n{stack}')
    every = ok_measurements("measure", tmp_path, "--quick")
    assert all(m["value"] == 0.0 for m in every if m["quantity"] == "defect_pixels")
    found = [m for m in every if m["quantity"] != "defect_pixels"]
    assert {m["quantity"] for m in found} <= {"read_noise", "dark_signal", "dsnu", "blur_factor"}
    if kind != "dark":
        assert not found


FLATS = {
    "saturated": lambda rng: np.full((4, 96, 128), 255, np.uint8),
    "broken": lambda rng: np.where(rng.random((4, 96, 128)) < 1e-4, np.nan, 90.0),
    "no frames": lambda rng: np.zeros((0, 96, 128), np.uint8),
}


@pytest.mark.parametrize("kinds", [("flat", "flat"), ("dark", "flat")])
@pytest.mark.parametrize("case", FLATS)
def test_flats_that_tell_nothing_are_never_a_gain(
    case: str, kinds: tuple[str, ...], tmp_path: Path, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    text = 'name = "noise"\n'
    for index, kind in enumerate(kinds):
        np.save(tmp_path / f"{index}.npy", FLATS[case](rng))
        text += f'[[stack]]\nlabel = "{index}"\nkind = "{kind}"\nframes = "{index}.npy"\n'
    (tmp_path / "session.toml").write_text(text)
    found = ok_measurements("noise", tmp_path, "--quick")
    assert {m["quantity"] for m in found} <= {"read_noise", "dark_signal", "dsnu", "blur_factor"}
    assert "dark" in kinds or not found


def ok_measurements(*arguments: object) -> list[dict]:
    done = charact(*arguments, "--json")
    assert done.exit_code in (0, 1), done.output
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return [m for m in json.loads(done.stdout).get("measurements", ()) if m["status"] == "ok"]


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
