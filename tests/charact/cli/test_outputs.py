"""Outputs that exist: every verb refuses them before any work and names the next free one; --force
spares the rest.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from charact.cli.outputs import next_free, remove_session, why_kept
from labdata import Conditions, SessionWriter, open_session
from tests.charact.cli.runner import assert_one_sentence, charact, done_well


def write_session(folder: Path, level: int = 100) -> Path:
    """Write a session as a simulation does, of one stack of two flats."""
    with (
        SessionWriter.create(folder, name="s") as writer,
        writer.begin_stack("flat", "flat", (6, 8), np.uint16, Conditions()) as stack,
    ):
        for number in range(2):
            stack.append(np.full((6, 8), level, np.uint16), float(number), number)
        stack.finish()
    return folder


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a simulated session, an acquired one, one of an import, and files of frames and
    results.
    """
    monkeypatch.chdir(tmp_path)
    for name in ("simulated", "acquired"):
        write_session(tmp_path / name)
    for name in ("plan.toml", "log.jsonl"):
        (tmp_path / "acquired" / name).write_text("")
    np.save("flat.npy", np.full((2, 6, 8), 7, np.uint16))
    done_well("import", "frames", "flat.npy", "imported", "--kind", "flat")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("mine")
    (tmp_path / "sheet.csv").write_text("mine")
    done_well("convert", "simulated", "converted", "--to", "npy")
    (tmp_path / "demo" / "session").mkdir(parents=True)
    (tmp_path / "demo" / "session" / "session.toml").write_text("")
    return tmp_path


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder."""
    return {
        str(path): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


# A verb with an output that exists, the name to suggest, and what is said where --force replaces
# nothing.
TAKEN = [
    ("acquire demo acquired", "acquired-2", None),
    ("acquire demo simulated", "simulated-2", "a session simulated"),
    ("acquire demo sheet.csv", "sheet-2.csv", "a file"),
    ("demo demo", "demo-2", "without demo.txt"),
    ("simulate airfield simulated --sensor emccd-512", "simulated-2", None),
    ("simulate airfield acquired --sensor emccd-512 --preview", "acquired-2", "a session acquired"),
    ("simulate airfield imported --sensor emccd-512", "imported-2", "frames made elsewhere"),
    (
        "simulate airfield simulated --sensor simulated/session.toml",
        "simulated-2",
        "its input session.toml",
    ),
    ("import emva1288 absent.txt imported", "imported-2", None),
    ("import frames flat.npy simulated", "simulated-2", "a session simulated"),
    ("temperatures hangar notes", "notes-2", "without a temperatures.json"),
    ("convert simulated converted --to npy", "converted-2", None),
    ("fit simulated --sensor-out simulated/session.toml", "session-2.toml", "no sensor"),
    ("report simulated --out sheet.csv", "sheet-2.csv", "another kind"),
]


@pytest.mark.parametrize(("line", "free", "kept"), TAKEN, ids=[line for line, *_ in TAKEN])
def test_an_output_that_exists_is_refused_before_any_work(
    here: Path, line: str, free: str, kept: str | None
) -> None:
    before = contents(here)
    assert_one_sentence(
        charact(*line.split()), "an output must be new", f"{free} is free", "--force replaces"
    )
    if kept:
        assert_one_sentence(
            charact(*line.split(), "--force"), "--force replaces only", kept, f"{free} is free"
        )
    assert contents(here) == before


def test_a_resumed_run_is_no_new_one(here: Path) -> None:
    assert_one_sentence(charact("acquire", "demo", "acquired"), "--resume continues acquired")
    assert_one_sentence(charact("acquire", "demo", "acquired", "--resume", "--force"), "got both")


def test_the_next_free_name_counts_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("demo", "demo-2", "day-1", "2024-03-21", "a.b"):
        (tmp_path / name).mkdir()
    (tmp_path / "sheet.xml").write_text("")
    asked = ("demo", "demo-2", "day-1", "2024-03-21", "a.b", "sheet.xml")
    assert [next_free(tmp_path / name).name for name in asked] == [
        "demo-3",
        "demo-3",
        "day-2",
        "2024-03-21-2",
        "a.b-2",
        "sheet-2.xml",
    ]
    monkeypatch.chdir(tmp_path / "demo")
    assert next_free(Path()) == tmp_path / "demo-3"


def test_a_replaced_session_leaves_the_files_of_others(here: Path) -> None:
    folder = here / "simulated"
    for name in (
        "results.json",
        "results-0123.npz",
        "validation.json",
        "fitted.toml",
        "economy.json",
    ):
        (folder / name).write_text("of the session before")
    (folder / "frames" / "mine.tif").write_text("mine")
    (folder / "notes.txt").write_text("mine")
    assert why_kept(folder, "simulation") is None
    remove_session(folder, "simulation")
    assert sorted(path.name for path in folder.rglob("*")) == [
        ".lock",
        "frames",
        "mine.tif",
        "notes.txt",
    ]
    assert open_session(write_session(folder, 9)).stacks[0].read().data.max() == 9


def test_a_session_that_is_being_written_is_not_replaced(here: Path) -> None:
    hold = (
        "from labdata.session_writer import SessionWriter as S; w = S.resume('acquired'); "
        "print(1, flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", hold], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout and other.stdout.readline() == b"1\n"
        before = contents(here)
        assert_one_sentence(
            charact("acquire", "demo", "acquired", "--force"), "a session that is being written"
        )
        assert contents(here) == before
        other.communicate(b"\n")
    assert why_kept(here / "acquired", "plan") is None


def test_an_import_replaces_its_manifest_or_nothing(here: Path) -> None:
    np.save(here / "imported" / "dark.npy", np.full((2, 6, 8), 7, np.uint16))
    (here / "imported" / "results.json").write_text("of the frames before")
    before = (here / "imported" / "session.toml").read_bytes()
    failed = charact("import", "frames", "absent.npy", "imported", "--force")
    assert failed.exit_code == 1 and (here / "imported" / "session.toml").read_bytes() == before
    done_well("import", "frames", "imported/dark.npy", "imported", "--kind", "dark", "--force")
    assert sorted(path.name for path in (here / "imported").iterdir()) == [
        "dark.npy",
        "session.toml",
    ]
    assert [entry.kind for entry in open_session(here / "imported").stacks] == ["dark"]


def test_converted_files_are_replaced_but_not_the_frames_themselves(here: Path) -> None:
    (here / "converted" / "notes.txt").write_text("mine")
    (here / "converted" / "flat.npy").write_bytes(b"an earlier conversion")
    done_well("convert", "simulated", "converted", "--to", "npy", "--force")
    assert (
        np.load(here / "converted" / "flat.npy").max() == 100
        and (here / "converted" / "notes.txt").exists()
    )
    own = charact("convert", "flat.npy", ".", "--to", "npy", "--force")
    assert_one_sentence(own, "its own frames")
    assert np.load(here / "flat.npy").max() == 7
