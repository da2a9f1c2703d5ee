"""A hundred bad inputs over all verbs, in three encodings of the terminal: each ends with exit code
1 and one sentence.
"""

import io
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import typer

from charact.cli.application import app, run

# Bad input of every verb: words of the command line, in a folder with the files of `folder`.
COMMANDS = """
mtf edge missing.tif
mtf edge missing-µ±°.tif
mtf edge letter.tif
mtf edge empty.npy
mtf edge vast.npy
mtf edge texts.npy
mtf edge huge-header.npy
mtf edge day
mtf edge hollow
mtf edge edge.npy --roi 1,2,3
mtf edge edge.npy --roi −1,2,3,4
mtf edge edge.npy --roi 60,0,60,60
mtf edge edge.npy --method µ
mtf edge edge.npy --units µm
mtf edge edge.npy --units lp/mm
mtf edge edge.npy --sensor nowhere-µ
mtf edge edge.npy --sensor letter.tif
mtf edge edge.npy --plot nowhere/a.png
mtf edge edge.npy --plot a.gif
mtf edge edge.npy --csv nowhere/a.csv
mtf edge edge.npy --annotate nowhere/a.png
mtf edge edge.npy --annotate a.jpg
mtf edge edge.npy --plane magenta
mtf edge edge.npy --axis 7
mtf edge edge.npy --extension 3
mtf edge edge.npy --black-dn 1e9
mtf edge edge.npy --black-dn nan
mtf bars edge.npy --frequency -0.1
mtf bars edge.npy --frequency 9
mtf point edge.npy --pinhole-px 99
mtf flats nowhere
mtf flats hollow
noise nowhere
noise letter.tif
noise broken
noise latin
noise binary
noise keys-µ
noise without-frames
noise day --method sorcery
noise day --amplifier −1
noise day --amplifier 9
noise day --scheduler nowhere:1
expose nowhere-µ --lux 1e-3
expose letter.tif --lux 1e-3
expose machine-vision --lux 0
expose machine-vision --lux 1e-12
expose machine-vision --lux 1 --contrast 0
expose machine-vision --lux 1 --reflectance 2
bloom nowhere
bloom letter.tif
bloom day --map nowhere/map.png
bloom edge.npy --map map.png
measure nowhere-µ
measure edge.npy
measure scenes
measure day --units furlongs
measure day --amplifier all-of-them
fit nowhere --sensor-out a.toml
fit day --sensor-out nowhere/a.toml
fit day --sensor-out letter.tif
validate nowhere
validate day
validate day --sensor nowhere-°
report nowhere
report edge.npy
compare day nowhere
compare edge.npy day
check day --limits nowhere.toml
check day --limits letter.tif
check day --limits day/session.toml
import frames out
import frames letter.tif out
import frames missing.tif out
import frames edge.npy out --kind sorcery
import frames edge.npy out --name {µ}V_*
import emva1288 missing.txt out
import emva1288 letter.tif out
convert nowhere out
convert letter.tif out
convert day out --to µ
convert day out.csv --to csv
convert day#µ out
convert day out --plane r
view nowhere-µ.tif
view letter.tif
view day#nothing
view edge.npy --out a.jpg
view edge.npy --out nowhere/a.png
fuse edge.npy out
fuse edge.npy missing.tif out
fuse edge.npy edge.npy out --method µ
fuse edge.npy edge.npy out --span visible=dark,light
fuse edge.npy edge.npy nowhere/a.png
fuse score edge.npy edge.npy missing.png
fuse table day#a day#b nowhere out.npz
fuse table day#a day#b hangar nowhere/out.npz
simulate nowhere out --sensor machine-vision
simulate letter.tif out --sensor machine-vision
simulate bench out --sensor nowhere-µ
simulate bench out --sensor machine-vision --kind sorcery
simulate bench out --sensor machine-vision --mcp-v 800
simulate edge.npy out --sensor machine-vision
temperatures nowhere out
temperatures hangar out --sensor nowhere
plan nowhere
plan letter.tif
plan binary/session.toml
acquire nowhere out
acquire demo out --resume --force
acquire letter.tif out
safe nowhere.toml
live --camera replay:nowhere#a
live --session nowhere
live --plan nowhere.toml
focus --session edge.npy
focus --session day --roi 1,2
watch nowhere-µ
watch edge.npy
chart µ
stability nothing
schema nothing-°
conform nothing
demo letter.tif
""".strip().splitlines()

SESSION = 'name = "trial"\n[[stack]]\nlabel = "a"\nkind = "{kind}"\nframes = "{frames}"\n{line}\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of frames and sessions, good ones and broken ones."""
    root = tmp_path_factory.mktemp("bad")
    row, col = np.mgrid[:64, :96]
    edge = np.round(100 + 80 / (1 + np.exp(-(col - 48 - 0.1 * row)))).astype(np.uint8)
    np.save(root / "edge.npy", edge)
    np.save(root / "vast.npy", np.full((40, 40), 1e300))
    np.save(root / "texts.npy", np.full((4, 4), "a"))
    np.save(root / "empty.npy", np.zeros((0, 4, 4)))
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (9999999, 99999, 9999)}\n"
    (root / "huge-header.npy").write_bytes(b"\x93NUMPY\x01\x00" + b"\x4a\x00" + header.encode())
    (root / "letter.tif").write_text("Dear lab, the frames are in the other folder.")
    for name, kind, frames, line in (
        ("day", "flat", "../edge.npy", ""),
        ("scenes", "scene", "../edge.npy", ""),
        ("hollow", "flat", "missing.npy", ""),
        ("broken", "flat", "../edge.npy", "[[["),
        ("keys-µ", "flat", "../edge.npy", '"mcp_µv" = 3'),
        ("without-frames", "flat", "../empty.npy", ""),
    ):
        (root / name).mkdir()
        text = SESSION.format(kind=kind, frames=frames, line=line)
        (root / name / "session.toml").write_text(text, encoding="utf-8")
    for name, content in (("latin", "name = 'µ'".encode("latin-1")), ("binary", bytes(range(256)))):
        (root / name).mkdir()
        (root / name / "session.toml").write_bytes(content)
    return root


def test_every_verb_is_tried_a_hundred_times_over():
    group = typer.main.get_command(app)
    assert {command.split()[0] for command in COMMANDS} == set(group.commands) - {
        "doctor",
        "methods",
    }
    assert len(set(COMMANDS)) >= 100


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "latin-1"])
@pytest.mark.parametrize("command", COMMANDS)
def test_bad_input_ends_in_one_sentence(
    command: str, encoding: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    printed, said = (io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2))
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    monkeypatch.chdir(folder)
    monkeypatch.setattr(signal, "signal", lambda number, handler: None)
    monkeypatch.setattr(sys, "argv", ["charact", *command.split()])
    monkeypatch.setattr(sys, "stdout", printed)
    monkeypatch.setattr(sys, "stderr", said)
    with pytest.raises(SystemExit) as ended:
        run()
    said.flush()
    sentence = said.buffer.getvalue().decode(encoding).strip()
    assert ended.value.code == 1, sentence
    assert len(sentence.splitlines()) == 1 and sentence.startswith("charact: "), sentence
    assert len(sentence) < 500 and "rror:" not in sentence, sentence
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
