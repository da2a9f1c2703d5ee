"""The documentation is right: commands and programs run as printed; pictures, links and tables are
complete.
"""

import json
import math
import re
import runpy
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest
import scipy.special
import tifffile
from typer.main import get_command
from typer.testing import CliRunner

from charact.cli.application import app
from labdata import FLAGS, QUANTITIES

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if "generated" not in path.parts),
]
TUTORIAL = ROOT / "docs" / "tutorial" / "index.md"


def _slanted_edge() -> np.ndarray:
    """An edge of 5 degrees with a Gaussian line spread of 0.7 px and Poisson noise, shape (row,
    col), DN.
    """
    row, col = np.mgrid[:96, :96] - 47.5
    lit = scipy.special.ndtr((col - math.tan(math.radians(5.0)) * row) / 0.7)
    return np.random.default_rng(0).poisson(200.0 + 1000.0 * lit).astype(np.uint16)


def test_the_steps_of_the_tutorial_run_as_printed(tmp_path, monkeypatch):
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^    charact (.*)$", TUTORIAL.read_text(), re.MULTILINE)
    assert len(commands) == 12
    for command in commands:
        done = CliRunner().invoke(app, shlex.split(command))
        assert done.exit_code == 0, f"{command}: {done.output}"
    assert (tmp_path / "stages" / "stages.png").stat().st_size > 0
    assert (tmp_path / "night" / "radiance.png").stat().st_size > 0


def _commands_of(text: str) -> list[str]:
    """Arguments of every command of a text, in a line of its own or within a sentence."""
    lines = re.findall(r"^ {4}charact (.*)$", text, re.MULTILINE)
    inline = re.findall(r"`charact ([^`]+)`", re.sub(r"^ {4}.*$", "", text, flags=re.MULTILINE))
    return [command.partition("  #")[0].strip() for command in (*lines, *inline)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_verbs_and_options_of_a_page_exist(page):
    for arguments in _commands_of(page.read_text()):
        verb, words = get_command(app), shlex.split(arguments)
        if arguments == "VERB --help":  # stands for each
            continue
        while hasattr(verb, "commands") and words:
            if words[0] in verb.commands:
                verb = verb.commands[words.pop(0)]
            elif "pictures" in verb.commands:  # `fuse` without a name fuses pictures
                verb = verb.commands["pictures"]
            else:
                assert words[0].startswith("-"), arguments
                break
        context = verb.make_context(verb.name, [], resilient_parsing=True)
        context.resilient_parsing = False
        verb.make_parser(context).parse_args(words)


def test_the_page_of_an_ordinary_camera_leads_to_its_report(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (ROOT / "docs" / "how-to" / "camera.md").read_text()
    folder = tmp_path / "my-camera"
    folder.mkdir()
    (manifest,) = re.findall(r"^```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    (folder / "session.toml").write_text(manifest)
    rng = np.random.default_rng(3)
    for stack in tomllib.loads(manifest)["stack"]:
        electrons = 0.5 * stack.get("photons_per_px", 0.0) * np.ones((8, 96, 96))
        if stack["kind"] == "edge":
            electrons = np.repeat(_slanted_edge()[None].astype(float), 8, axis=0)
        frames = 64.0 + 0.5 * (rng.poisson(electrons) + 5.0 * rng.standard_normal(electrons.shape))
        np.save(folder / stack["frames"], np.rint(frames).astype(np.uint16))
    for command in re.findall(r"^    charact (.*)$", text, re.MULTILINE):
        done = CliRunner().invoke(app, shlex.split(command))
        assert done.exit_code == 0, f"{command}: {done.output}"
    html = (folder / "report.html").read_text()
    assert "EMVA 1288 data sheet" in html and "bench 2" in html
    assert (folder / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if "```python\n" in page.read_text()],
    ids=lambda page: page.name,
)
def test_the_programs_of_a_page_run_as_printed(page, tmp_path, monkeypatch):
    if page.name == "README.md":
        pytest.skip("the README's program needs a session of a user; the tutorial makes sessions")
    monkeypatch.chdir(tmp_path)
    tifffile.imwrite("edge.tif", _slanted_edge())
    for program in re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
        names: dict = {}
        exec(program, names)
        if "frame_1000" in names:
            following = names["camera"].frames(
                names["light"], names["conditions"], seed=7, first_frame=999
            )
            next(following)
            assert np.array_equal(names["frame_1000"], next(following))


@pytest.mark.parametrize(
    "example", sorted((ROOT / "docs" / "examples").glob("plot_*.py")), ids=lambda path: path.stem
)
def test_an_example_runs_and_draws_a_figure(example, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    from matplotlib import pyplot as plt

    runpy.run_path(str(example))
    assert len(plt.get_fignums()) == 1
    plt.close("all")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_and_links_of_a_page_are_there(page):
    linked = re.findall(r"\]\(([^)#:]+)[^)]*\)", page.read_text())
    absent = [name for name in linked if not (page.parent / name).exists()]
    assert [name for name in absent if "generated/" not in name and "gallery/" not in name] == []


def test_the_reference_has_every_quantity_and_every_flag():
    for page, keys in (("quantities.md", QUANTITIES), ("flags.md", FLAGS)):
        named = set(
            re.findall(r"`([a-z0-9_-]+)`", (ROOT / "docs" / "reference" / page).read_text())
        )
        assert set(keys) <= named, page


def test_pictures_are_small():
    assert all(
        picture.stat().st_size < 600_000 for picture in (ROOT / "docs" / "pictures").rglob("*.png")
    )


# The instructions of a Containerfile, as its reference names them.
INSTRUCTIONS = (
    "ADD ARG CMD COPY ENTRYPOINT ENV EXPOSE FROM HEALTHCHECK LABEL ONBUILD RUN SHELL "
    "STOPSIGNAL USER VOLUME WORKDIR"
)


def test_the_containerfile_names_what_there_is():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    text = re.sub(r"\\\n", " ", (ROOT / "Containerfile").read_text())
    lines = [
        line.split(maxsplit=1) for line in text.splitlines() if line and not line.startswith("#")
    ]
    assert lines[0][0] == "FROM" and {name for name, _ in lines} <= set(INSTRUCTIONS.split())
    copied = [source for name, rest in lines if name == "COPY" for source in shlex.split(rest)[:-1]]
    assert copied and all((ROOT / source).exists() for source in copied)
    start, arguments = (json.loads(dict(lines)[name]) for name in ("ENTRYPOINT", "CMD"))
    assert start[0] in project["scripts"]
    assert CliRunner().invoke(app, [*start[1:], *arguments]).exit_code == 0
    extras = re.findall(r"/src\[([^]]+)\]", text)[0].split(",")
    assert set(extras) <= set(project["optional-dependencies"])
    assert re.match(r"\S+/python:3\.1[1-9]-", lines[0][1])
