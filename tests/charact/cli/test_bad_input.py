"""What a command says: one sentence for bad input, no number for noise, JSON by the contract."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.charact.cli.runner import assert_one_sentence, charact

# Bad input ends in one sentence, and a frame of pure noise in no number.


# Bad input ends in one sentence that names the rule and the value, exit code 1, and no traceback.


SESSION = """
name = "trial"
[[stack]]
label = "flat-1"
kind = "flat"
frames = "flat.npy"
{line}
"""


@pytest.fixture
def edge(tmp_path: Path) -> Path:
    row, col = np.mgrid[:64, :96]
    image = 100 + 80 / (1 + np.exp(-(col - 48 - 0.1 * row)))
    path = tmp_path / "edge.npy"
    np.save(path, np.round(image).astype(np.uint8))
    return path


def session(folder: Path, line: str) -> Path:
    np.save(folder / "flat.npy", np.zeros((2, 8, 8), np.uint8))
    (folder / "session.toml").write_text(SESSION.format(line=line))
    return folder


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("missing.tif", None, ("missing.tif",)),
        ("letter.tif", b"Dear lab, the frames are in the other folder.", ("letter.tif",)),
        ("cut.tif", b"II*\x00" + bytes(3000), ("cut.tif",)),
        ("frames.xyz", b"1234", (".xyz", ".tif", ".fits", ".dng")),
    ],
)
def test_a_file_that_is_no_image_is_named(
    tmp_path: Path, name: str, content: bytes | None, words
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert_one_sentence(charact("mtf", "edge", tmp_path / name), *words)


def test_a_session_file_is_refused_by_key_and_place(tmp_path: Path) -> None:
    assert_one_sentence(charact("measure", tmp_path), "session.toml")
    assert_one_sentence(
        charact("noise", session(tmp_path, "mcp_volt = 780.0")), "mcp_volt", "flat-1"
    )
    assert_one_sentence(charact("noise", session(tmp_path, "mcp_v = -780.0")), "mcp_v", "-780")
    (tmp_path / "session.toml").write_text('name = "empty"\n')
    assert_one_sentence(charact("noise", tmp_path), "stack")


@pytest.mark.parametrize(
    ("kind", "option", "words"),
    [
        ("edge", "--roi=0,0,65,10", ("64 rows and 96 columns", "0,0,65,10")),
        ("edge", "--roi=-1,0,10,10", ("64 rows and 96 columns",)),
        ("edge", "--roi=10,10,all", ("ROW,COL,HEIGHT,WIDTH", "10,10,all")),
        ("edge", "--method=sorcery", ("sorcery", "edge-forward")),
        ("edge", "--units=furlongs", ("furlongs", "lp/mm")),
        ("edge", "--units=lp/mm", ("--pitch-um", "--sensor")),
        ("bars", "--frequency=-0.1", ("-0.1",)),
    ],
)
def test_an_option_out_of_its_range_is_refused(
    edge: Path, kind: str, option: str, words: tuple[str, ...]
) -> None:
    assert_one_sentence(charact("mtf", kind, edge, option), *words)


def test_a_session_of_bars_that_shows_none_is_refused_in_one_sentence(
    edge: Path, tmp_path: Path
) -> None:
    assert charact("import", "frames", edge, tmp_path / "mine", "--kind", "bars").exit_code == 0
    done = charact("measure", tmp_path / "mine", "--json")
    (refusal,) = json.loads(done.stdout)["measurements"]
    assert done.exit_code == 1
    assert (refusal["status"], refusal["flags"]) == ("refused", ["no-target"])
    assert refusal["reason"] in done.stderr


def test_of_a_session_of_scenes_nothing_is_measured_and_no_verb_says_otherwise(
    edge: Path, tmp_path: Path
) -> None:
    done = charact("import", "frames", edge, tmp_path / "mine")
    assert done.exit_code == 0 and "charact measure" not in done.stdout
    assert "session.toml" in done.stdout
    done = charact("measure", tmp_path / "mine", "--json")
    assert_one_sentence(done, "dark, flat, edge, bars or point", "'scene'", "session.toml")
    assert "'scene'" in json.loads(done.stdout)["error"]
    done = charact("import", "frames", edge, tmp_path / "known", "--kind", "edge")
    assert "Next: charact measure" in done.stdout


@pytest.mark.parametrize("verb", ["noise", "measure", "fit", "validate", "report", "watch"])
def test_a_picture_in_place_of_a_session_is_answered_with_what_makes_one(
    edge: Path, verb: str
) -> None:
    more = ("--sensor-out", "fitted.toml") if verb == "fit" else ()
    assert_one_sentence(
        charact(verb, edge, *more), "folder with a session.toml", f"charact import frames {edge}"
    )


def test_a_map_of_a_bare_picture_and_the_mtf_of_a_session_name_what_is_needed(
    edge: Path, tmp_path: Path
) -> None:
    assert_one_sentence(
        charact("bloom", edge, "--map", "map.png"),
        "--map needs a session with point sources",
        "--kind point",
    )
    folder = session(tmp_path, "")
    assert_one_sentence(
        charact("mtf", "edge", folder), "images or stacks", f"charact measure {folder}"
    )
    assert_one_sentence(
        charact("mtf", "flats", tmp_path / "nope"), "session folder", "file of frames", "nope"
    )


def test_flats_in_lines_per_millimetre_take_a_pitch(tmp_path: Path) -> None:
    folder = session(tmp_path, "")
    assert_one_sentence(
        charact("mtf", "flats", folder, "--units", "lp/mm"),
        "needs a positive --pitch-um, or a sensor description",
    )
    done = charact("mtf", "flats", folder, "--units", "lp/mm", "--pitch-um", "10")
    assert done.exit_code == 1 and "--pitch-um" not in done.stderr


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        (("mtf", "edge", "a.tif", "--seed", "-1"), "'--seed'"),
        (("noise", "a", "--seed", "-1"), "greater than or equal to 0"),
        (
            ("simulate", "airfield", "out", "--sensor", "pulnix-ag5745ef3", "--seed", "-1"),
            "'--seed'",
        ),
        (("bloom", "a", "--map-of", "point-1"), "needs --map"),
        (("mtf", "edge", "a.tif", "--no-such-option"), "No such option"),
        (("no-such-verb",), "No such command"),
        (("mtf", "edge"), "Missing argument"),
    ],
)
def test_misuse_ends_with_two(verb: tuple[str, ...], words: str) -> None:
    done = charact(*verb)
    assert done.exit_code == 2, done.output
    assert words in done.output


def test_bad_input_is_also_said_in_json(tmp_path: Path) -> None:
    done = charact("mtf", "edge", tmp_path / "missing.tif", "--json")
    assert_one_sentence(done, "missing.tif")
    said = json.loads(done.stdout)
    assert set(said) == {"charact", "input", "error"} and "missing.tif" in said["error"]


def test_an_interrupt_ends_in_one_sentence_that_tells_how_to_go_on(
    tmp_path: Path, monkeypatch
) -> None:
    def interrupted(*arguments, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr("charact.cli.benches.acquire_session", interrupted)
    plan = tmp_path / "plan.toml"
    plan.write_text('name = "short"\n\n[[step]]\nlabel = "dark"\nkind = "dark"\nframes = 2\n')
    done = charact("acquire", plan, tmp_path / "out")
    assert done.exit_code == 130, done.output
    assert "--resume" in done.output
    assert "Traceback" not in done.output


# A frame of pure noise holds no target, and of many sessions in one verb each gets what it would
# get alone.


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
        assert sum(line.split()[:1] == ["system_gain"] for line in part) == 1


# The JSON of every measuring verb keeps the contract, as a checker outside the project sees it.


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
