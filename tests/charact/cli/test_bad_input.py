"""Bad input ends in one sentence that names the rule and the value, exit code 1, and no
traceback.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.charact.cli.runner import assert_one_sentence, charact

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
