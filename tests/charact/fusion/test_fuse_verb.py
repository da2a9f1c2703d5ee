"""The verb `fuse`: outputs, colour, sessions, and refusals in one sentence."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import charact
from charact.fusion import FusionTruth
from tests.charact.cli.runner import charact as command
from tests.charact.cli.runner import done_well
from tests.truth.fusion import Pair

TUTORIAL = Path(__file__).resolve().parents[3] / "docs" / "tutorial" / "fusion.md"
FILES = (
    "fused.tif",
    "fused.png",
    "sd.tif",
    "share.tif",
    "mask.png",
    "fused.json",
    "visible.png",
    "thermal.png",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("pair")
    pair = Pair(seed=1)
    visible, thermal = pair.frames(np.random.default_rng(0))
    tifffile.imwrite(path / "visible.tif", (visible + pair.dark_dn).astype(np.uint8))
    codes = np.clip(np.rint((thermal + 2.0) * 60.0), 0, 255).astype(np.uint8)
    Image.fromarray(codes).save(path / "thermal.png")
    Image.fromarray((visible + pair.dark_dn).astype(np.uint8)).save(path / "visible.png")
    colours = Image.fromarray(codes).quantize(16)
    colours.putpalette([value for i in range(16) for value in (i * 16, 255 - i * 16, 40)])
    colours.save(path / "palette.png")
    Image.fromarray(codes[:-1]).save(path / "small.png")
    return path


def run(*arguments: object) -> tuple[int, str]:
    done = command("fuse", *arguments)
    return done.exit_code, done.stdout


def test_a_folder_holds_picture_deviation_shares_and_marks(folder, tmp_path) -> None:
    out = tmp_path / "out"
    code, text = run(folder / "visible.tif", folder / "thermal.png", out, "--registered", "--json")
    document = json.loads(text)
    assert code == 0
    assert {one["quantity"] for one in document["measurements"]} == {
        "fused_noise",
        "fused_share",
        "fused_filled_area",
    }
    # Neither gain nor dark level is known.
    assert document["measurements"][0]["flags"] == ["no-darks", "uncalibrated"]
    assert sorted(path.name for path in out.iterdir()) == sorted(FILES)
    picture, sd, share = (tifffile.imread(out / name) for name in FILES[:1] + FILES[2:4])
    assert picture.shape == sd.shape == (240, 320) and share.shape == (2, 240, 320)
    assert picture.dtype == np.float32 and np.isfinite(picture).all() and (sd > 0).all()
    marks = json.loads((out / "fused.json").read_text())["marks"]
    assert (np.asarray(Image.open(out / "mask.png"))[180, 82] & marks["filled"]) > 0
    code, _ = run(folder / "visible.tif", folder / "thermal.png", out)
    assert code == 1
    assert (
        run(
            folder / "visible.tif",
            folder / "thermal.png",
            out,
            "--force",
            "--colour",
            "--registered",
        )[0]
        == 0
    )
    assert tifffile.imread(out / "fused.tif").shape == (240, 320, 3)


def test_stacks_of_a_session_are_bands(folder, tmp_path) -> None:
    session = tmp_path / "night"
    done_well("import", "frames", folder / "visible.png", folder / "thermal.png", session)
    code, text = run(
        f"{session}#visible", f"{session}#thermal", tmp_path / "out", "--registered", "--json"
    )
    assert code == 0 and json.loads(text)["measurements"]
    code, text = run(f"{session}#no", f"{session}#thermal", tmp_path / "other", "--json")
    assert code == 1 and "a stack must be one of" in json.loads(text)["error"]


@pytest.mark.parametrize(
    ("thermal", "said"),
    [("palette.png", "palette"), ("small.png", "the same rows and columns"), ("no.png", "exist")],
)
def test_what_is_no_second_band_is_refused_in_a_sentence(
    folder, tmp_path, thermal: str, said: str
) -> None:
    code, text = run(folder / "visible.tif", folder / thermal, tmp_path / "out", "--json")
    assert code == 1 and said in json.loads(text)["error"]
    assert not (tmp_path / "out").exists()


def test_settings_that_are_no_settings_are_refused(folder, tmp_path) -> None:
    pair = folder / "visible.tif", folder / "thermal.png"
    for arguments, said in (
        ((*pair, tmp_path / "out", "--span", "visible=1"), "--span must be"),
        ((*pair, tmp_path / "out", "--method", "magic"), "--method must be"),
        ((*pair, tmp_path / "out.jpg"), "OUT must be"),
        ((*pair, tmp_path / "out", "--imager", "pulnix-ag5745ef3"), "--imager must be"),
        (pair, "needs VISIBLE THERMAL"),
    ):
        code, text = run(*arguments, "--json")
        assert code == 1 and said in json.loads(text)["error"], arguments


def test_scores_stand_beside_their_controls(folder, tmp_path) -> None:
    out = tmp_path / "fused.png"
    run(folder / "visible.tif", folder / "thermal.png", out, "--registered")
    code, text = run("score", folder / "visible.png", folder / "thermal.png", out, "--json")
    rows = {row["quantity"]: row for row in json.loads(text)["scores"]}
    assert code == 0 and rows["entropy"]["noise_control"] > rows["entropy"]["value"]


@pytest.fixture(scope="module")
def night(folder, tmp_path_factory) -> Path:
    """Folder with a session `night` of six frames of both cameras, labelled as in the tutorial."""
    path = tmp_path_factory.mktemp("tutorial")
    pair, rng = Pair(seed=1), np.random.default_rng(4)
    frames = [pair.frames(rng) for _ in range(6)]
    visible = np.stack([one + pair.dark_dn for one, _ in frames]).astype(np.uint8)
    thermal = np.clip(np.rint((np.stack([one for _, one in frames]) + 2.0) * 60.0), 0, 255).astype(
        np.uint8
    )
    files = [path / "pulnix-ag5745ef3.tif", path / "vox-lwir-640.tif"]
    for file, stack in zip(files, (visible, thermal), strict=True):
        tifffile.imwrite(file, stack, photometric="minisblack")
    done_well("import", "frames", *files, path / "night")
    return path


def test_the_steps_of_the_tutorial_run_as_printed_on_a_session_of_two_cameras(
    night, monkeypatch
) -> None:
    monkeypatch.chdir(night)
    first, *commands = re.findall(r"^    charact (.*)$", TUTORIAL.read_text(), re.MULTILINE)
    assert first.startswith("simulate hangar night") and len(commands) == 4
    for line in commands:
        done_well(*shlex.split(line))
    page = (night / "fused" / "index.html").read_text()
    methods = [path.name for path in (night / "fused").iterdir() if path.is_dir()]
    assert len(methods) >= 8 and all(f'id="{name}"' in page for name in methods)
    # Bands, and four pictures of each method.
    assert page.count("data:image/jpeg") == 2 + 4 * len(methods)
    assert "copy of the visible band" in page and "http" not in page.replace("http-equiv", "")
    settings = json.loads((night / "frames" / "fused.json").read_text())
    assert settings["frames"] == 6 and tifffile.imread(night / "frames" / "fused.tif").shape == (
        6,
        240,
        320,
    )


def test_the_truth_adds_restoration_errors_in_its_zones(folder, tmp_path) -> None:
    pair = Pair(seed=1)
    truth = FusionTruth(
        bands=np.stack(pair.scene), zones=pair.zones, objects=np.zeros((240, 320), int)
    )
    truth.save(tmp_path / "truth.npz")
    given = folder / "visible.tif", folder / "thermal.png", tmp_path / "out", "--registered"
    code, text = run(*given, "--truth", tmp_path / "truth.npz", "--json")
    errors = {
        row["stack"]: row
        for row in json.loads(text)["measurements"]
        if row["quantity"] == "fusion_error"
    }
    assert code == 0 and set(errors) == {"dark", "halo", "core"} and errors["dark"]["unit"] == "%"
    # without a description halos stay
    assert 10.0 < errors["dark"]["value"] < errors["halo"]["value"]
    bands = [tmp_path / "out" / f"{name}.png" for name in ("visible", "thermal", "fused")]
    code, text = run("score", *bands, "--truth", tmp_path / "truth.npz", "--json")
    rows = {row["quantity"]: row["value"] for row in json.loads(text)["scores"]}
    assert code == 0 and rows["restoration_error_dark"] == pytest.approx(
        errors["dark"]["value"] / 100.0, rel=0.05
    )


def test_a_table_of_the_materials_colours_a_session(night, tmp_path) -> None:
    """Upper half sheet metal, lower half grass, in the truth of a visible frame."""
    rows, cols = 240, 320
    truth = {
        "focal_px": [400.0, 400.0],
        "position_m": np.zeros(3),
        "rotation": np.eye(3),
        "distortion_fraction": 0.0,
        "frame_distortion": [],
        "range_m": np.full((rows, cols), np.inf),
        "materials": ["grass", "sheet metal, painted pale"],
    }
    truth["material"] = np.where(np.arange(rows)[:, None] < rows // 2, 1, 0) * np.ones(
        (1, cols), int
    )
    (night / "night" / "truth").mkdir(exist_ok=True)
    for name in ("pulnix-ag5745ef3", "vox-lwir-640"):
        np.savez(night / "night" / "truth" / f"{name}.npz", **truth)
    given = f"{night}/night#pulnix-ag5745ef3", f"{night}/night#vox-lwir-640"
    colours = tmp_path / "colours.npz"
    assert run("table", *given, "hangar", colours)[0] == 0
    code, _ = run(
        *given, tmp_path / "out", "--method", "weighted", "--table", colours, "--registered"
    )
    picture = np.asarray(Image.open(tmp_path / "out" / "colour-table" / "fused.png")).astype(float)
    assert code == 0 and picture.shape == (rows, cols, 3)
    upper, lower = (
        picture[part].reshape(-1, 3).mean(axis=0) for part in (np.s_[:100], np.s_[140:])
    )
    # Pale paint is brighter than grass in every colour, and grass is greener than it is red and
    # blue.
    assert (upper > lower).all() and lower[1] > max(lower[0], lower[2])
    (night / "night" / "truth" / "pulnix-ag5745ef3.npz").unlink()
    assert run("table", *given, "hangar", colours, "--force")[0] == 1


def test_arrays_files_and_the_verb_have_one_picture(folder, tmp_path) -> None:
    names = folder / "visible.png", folder / "thermal.png"
    settings = {"method": "weighted", "registered": True, "bloom": False}
    of_files = charact.fuse(*names, **settings, out=tmp_path / "files")
    of_arrays = charact.fuse(*(np.asarray(Image.open(name)) for name in names), **settings)
    given = *names, tmp_path / "verb", "--method", "weighted", "--registered", "--no-bloom"
    printed = json.loads(run(*given, "--json")[1])["measurements"]
    pictures = [fusion.pictures["weighted"].picture for fusion in (of_files, of_arrays)]
    assert np.array_equal(*pictures)
    for name in FILES:
        files = [tmp_path / made / name for made in ("files", "verb")]
        assert files[0].read_bytes() == files[1].read_bytes(), name
    for row, m in zip(printed, of_files.result.measurements, strict=True):
        assert (row["quantity"], row["value"]) == (m.quantity, m.value)
        # The function names its parameter, the verb its option.
        assert "visible: blooming was left out: `bloom`" in m.notes
        assert "visible: blooming was left out: --no-bloom" in row["notes"]


def test_scores_of_arrays_are_those_of_the_verb(folder) -> None:
    names = [folder / "visible.png", folder / "thermal.png", folder / "visible.png"]
    rows = charact.fusion_scores(*(np.asarray(Image.open(name)) for name in names))
    assert [row._asdict() for row in rows] == json.loads(run("score", *names, "--json")[1])[
        "scores"
    ]


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"sequence": True, "method": ("pca", "weighted")}, "sequence needs one method"),
        ({"recursive": 0.2}, "recursive filters a sequence"),
        ({"imager": "pulnix-ag5745ef3"}, "imager must be a thermal camera"),
        ({"method": "all", "out": "fused.png"}, "out must be a folder for several methods"),
        ({"out": "fused.jpg"}, "out must be a folder, .png or .tif"),
        ({"range_m": 5.0}, "range_m needs the poses of both cameras"),
        ({"colour": True, "method": "pca"}, "colour needs the method auto"),
    ],
)
def test_what_cannot_be_fused_is_refused_in_a_sentence(settings, rule: str) -> None:
    frames = np.random.default_rng(1).normal(100.0, 3.0, (2, 64, 64))
    with pytest.raises(charact.BadInput, match=rule):
        charact.fuse(*frames, registered=True, **settings)
