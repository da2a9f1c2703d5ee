"""`view`, `convert`, `watch FOLDER` and tables of several files: what they write, and what they do
not replace.
"""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.special import erf

from charact.live import watch_files
from labdata import Result, make_refusal, measurement_from_sd, read_frames, result_io
from tests.charact.cli.runner import assert_one_sentence, charact

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
    assert gain is not None and float(gain.text) == 0.28 and gain.get("unit") == "DN/e-"


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
