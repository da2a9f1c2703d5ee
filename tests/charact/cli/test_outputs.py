"""Files of the command line: what is written, what is not replaced, and tables of several files."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.special import erf

from charact.cli.outputs import next_free, remove_session, why_kept
from charact.live import watch_files
from labdata import (
    Conditions,
    Result,
    SessionWriter,
    make_refusal,
    measurement_from_sd,
    open_session,
    read_frames,
    result_io,
)
from tests.charact.cli.runner import assert_one_sentence, charact, done_well

# Outputs that exist: every verb refuses them before any work and names the next free one; --force
# spares the rest.


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


# `view`, `convert`, `watch FOLDER` and tables of several files: what they write, and what they do
# not replace.


PLAIN = {"method": "covariance-sum"}


@pytest.fixture
def edges(tmp_path: Path) -> Path:
    """A folder of two edges."""
    row, col = np.mgrid[:64, :80]
    for number in (1, 2):
        mean = 1000.0 + 400.0 * erf((col - 40 + 0.1 * (row - 32)) / 1.5)
        np.save(
            tmp_path / f"e{number}.npy",
            np.random.default_rng(number).poisson(mean).astype(np.uint16),
        )
    return tmp_path


@pytest.fixture
def day(tmp_path: Path) -> Path:
    """A session of one flat with a saved result."""
    folder = tmp_path / "day"
    folder.mkdir()
    np.save(folder / "flat.npy", np.arange(2 * 6 * 8, dtype=np.uint16).reshape(2, 6, 8))
    (folder / "session.toml").write_text(
        'name = "d"\n[[stack]]\nlabel = "flat"\nkind = "flat"\nframes = "flat.npy"\n'
    )
    gain = measurement_from_sd("system_gain", "DN/e-", 0.28, 0.01, **PLAIN)
    result_io.save(
        Result(measurements=(gain, make_refusal("prnu", "%", "one frame", **PLAIN))), folder
    )
    return folder


@pytest.mark.parametrize("kind", ["tif", "npy", "fits", "h5"])
def test_converted_frames_are_those_of_the_session(day, tmp_path, kind):
    assert charact("convert", day, tmp_path / "out", "--to", kind).exit_code == 0
    assert np.array_equal(
        read_frames(tmp_path / "out" / f"flat.{kind}", axis="0").data, np.load(day / "flat.npy")
    )


def test_nothing_is_replaced(day, tmp_path):
    before = (day / "flat.npy").read_bytes()
    assert_one_sentence(charact("convert", day, day, "--to", "npy"), "must be new", "day-2 is free")
    assert_one_sentence(charact("convert", day, day, "--to", "npy", "--force"), "its own frames")
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).save(tmp_path / "a.png")
    own = (tmp_path / "a.png").read_bytes()
    assert_one_sentence(
        charact("view", tmp_path / "a.png", "--out", tmp_path / "a.png"), "must not replace"
    )
    assert (day / "flat.npy").read_bytes() == before and (tmp_path / "a.png").read_bytes() == own


def test_results_go_out_as_csv_json_and_xml(day, tmp_path):
    from xml.etree import ElementTree

    for kind in ("csv", "json", "emva"):
        asked = ("convert", day, tmp_path / f"r.{kind}", "--to", kind)
        assert charact(*asked).exit_code == 0
        assert_one_sentence(charact(*asked), f"r-2.{kind} is free")
        assert charact(*asked, "--force").exit_code == 0
    assert_one_sentence(
        charact("convert", day, tmp_path / "r.csv", "--to", "json", "--force"), "another kind"
    )
    rows = list(csv.DictReader((tmp_path / "r.csv").read_text().splitlines()))
    assert [row["quantity"] for row in rows] == ["system_gain", "prnu"] and float(
        rows[0]["value"]
    ) == 0.28
    assert rows[1]["reason"] == "one frame" and rows[1]["value"] == ""
    assert len(json.loads((tmp_path / "r.json").read_text())["measurements"]) == 2
    gain = ElementTree.parse(tmp_path / "r.emva").find("sensitivity/K")
    assert gain is not None
    assert (gain.findtext("value"), gain.findtext("unit")) == ("0.28", "DN/e-")
    page = tmp_path / "sheet.html"
    assert charact("convert", day, page, "--to", "emva").exit_code == 0
    assert charact("convert", day, page, "--to", "emva", "--force").exit_code == 0
    assert "0.28" in page.read_text(encoding="utf-8")


def test_a_picture_shows_dark_as_black_and_light_as_white(day, tmp_path):
    assert charact("view", f"{day}#flat", "--out", tmp_path / "p.png").exit_code == 0
    picture = np.asarray(Image.open(tmp_path / "p.png"))
    assert picture.shape == (6, 8) and picture[0, 0] == 0 and picture[-1, -1] == 255


def test_several_files_have_a_line_each_and_a_bad_one_stops_no_other(edges, tmp_path):
    (edges / "bad.tif").write_text("no picture")
    out = ("--csv", tmp_path / "t.csv", "--plot", tmp_path / "t.png", "--method", "edge-slanted")
    done = charact("mtf", "edge", edges / "e1.npy", edges / "bad.tif", edges / "e2.npy", *out)
    assert done.exit_code == 1 and "1 of 3 files gave no value" in done.stderr
    assert [line.split()[1] for line in done.stdout.splitlines()] == ["mtf50", "mtf50"]
    assert {
        row["file"] for row in csv.DictReader((tmp_path / "t.csv").read_text().splitlines())
    } == {
        str(edges / "e1.npy"),
        str(edges / "e2.npy"),
    }
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")


def test_a_plot_of_an_unknown_kind_is_refused_before_any_work(edges):
    assert_one_sentence(
        charact("mtf", "edge", edges / "e1.npy", "--plot", "x.xyz"), ".png, .svg, .pdf", "x.xyz"
    )
    done = charact("mtf", "edge", edges / "e1.npy", edges / "e2.npy", "--annotate", "a.png")
    assert_one_sentence(done, "one image, got 2")


def test_a_file_is_measured_when_it_is_complete(tmp_path):
    whole = b"x" * 100
    growing = tmp_path / "a.tif"
    growing.write_bytes(whole[:10])

    def grow(_: float) -> None:
        growing.write_bytes(whole[: growing.stat().st_size + 45])

    seen = [
        path.stat().st_size for path in watch_files(tmp_path, once=True, patience_s=9.0, sleep=grow)
    ]
    assert seen == [100]


def test_shipped_charts_are_shown_and_the_study_that_measures_them_is_named(tmp_path):
    done = charact("chart", "mtf50", "--out", tmp_path)
    assert (
        done.exit_code == 0
        and "edge-parametric" in done.stdout
        and "edge-forward" in (tmp_path / "chart-mtf50.svg").read_text()
    )
    failures = charact("stability", "mtf50")
    assert "silent" in failures.stdout
    for shown, study in ((done, "chart"), (failures, "stability")):
        assert f"make study NAME={study} QUANTITY=mtf50" in shown.stdout
    assert_one_sentence(charact("chart", "snr"), "QUANTITY must be one with a shipped table, cov")


def test_a_report_is_opened_on_request_and_a_missing_browser_is_said(tmp_path, monkeypatch):
    page, opened = tmp_path / "report.html", []
    monkeypatch.setattr("charact.cli.sessions.load_or_measure", lambda *_, **__: Result())
    monkeypatch.setattr("charact.api.modelling.report", lambda *_, **__: page)
    for code, sentence in ((0, ""), (1, f"no browser could be started: open {page}")):
        monkeypatch.setattr("typer.launch", lambda at, code=code: opened.append(at) or code)
        done = done_well("report", tmp_path, "--open")
        assert done.stdout.strip() == str(page) and done.stderr.strip() == sentence
    assert opened == [page.as_uri()] * 2
    done_well("report", tmp_path)
    assert len(opened) == 2


@pytest.mark.parametrize("place", ["", "session"])
def test_convert_and_view_take_a_demonstration_as_measure_does(place, tmp_path):
    folder = tmp_path / "demo" / place
    folder.mkdir(parents=True)
    np.save(folder / "a.npy", np.arange(64, dtype=np.uint8).reshape(1, 8, 8))
    stack = '[[stack]]\nlabel = "a"\nkind = "flat"\nframes = "a.npy"\n'
    (folder / "session.toml").write_text(f'name = "t"\n{stack}')
    result_io.save(
        Result(measurements=(measurement_from_sd("prnu", "%", 1, 0.1, method="m"),)), folder
    )
    done_well("convert", tmp_path / "demo", tmp_path / "out", "--to", "npy")
    assert np.load(tmp_path / "out" / "a.npy").shape == (1, 8, 8)
    done_well("convert", f"{tmp_path / 'demo'}#a", tmp_path / "a", "--to", "npy")
    done_well("convert", tmp_path / "demo", tmp_path / "a.csv", "--to", "csv")
    assert "prnu" in (tmp_path / "a.csv").read_text()
    done_well("view", tmp_path / "demo", "--out", tmp_path / "a.png")
