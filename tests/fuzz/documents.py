"""Documents that nobody meant: plans, sessions, sensors, scenes and the like, mangled and read.

Only BadInput may come of it. `TARGETS` names what is read; a new kind of file adds its line there.
"""

import random
import re
import tempfile
from collections.abc import Callable
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np

from drivers import plan_report
from labdata import (
    BadInput,
    Dose,
    DoseLedger,
    import_emva1288,
    load_camera,
    load_phosphor,
    open_session,
    plan_toml,
    read_plan,
    session,
)
from simulate.radiance import load_scene
from simulate.radiance.outdoor import OutdoorScene, build_surfaces

VALUES = (
    "nan",
    "inf",
    "-inf",
    "0",
    "-0.0",
    "-1",
    "1e400",
    "1e308",
    "-1e308",
    "5e-324",
    "9" * 400,
    "1" + "0" * 5000,
    "0x10",
    "true",
    "false",
    '""',
    '"a"',
    '"../../etc"',
    '"\\u0000"',
    '"\\ud83d"',
    '"ü☃"',
    "[]",
    "[[]]",
    "{}",
    "{ a = 1 }",
    "[1, 2]",
    "[nan, 1]",
    "[[1], [2]]",
    "1979-05-27T07:32:00Z",
    "07:32:00",
    "'''x'''",
    "[" * 60 + "]" * 60,
    "[" * 3000,
    '"' + "x" * 20_000 + '"',
    "{ value = 1, low = 2 }",
    '{ value = "x" }',
    "100000",
    "2e9",
    "1e-9",
)
KEYS = (
    "step",
    "sweep",
    "override",
    "settle",
    "limits",
    "wires",
    "stack",
    "target",
    "name",
    "until",
    "search",
    '""',
    "a.b",
)
NUMBER = re.compile(rb"(?<== )[^\n,}\]]+")
LINE = re.compile(rb"[^\n]*\n")

SWEPT = b"""
name = "swept"
sensor = "pulnix-ag5745ef3"
tube = "SN 1"
[limits]
mcp_v = 860.0
[settle]
after_gain_s = 2.0
after_light_s = 0.5
[[override]]
limit = "gate_duty"
value = 1.0
reason = "the gate unit is simply on"
[[step]]
label = "dark"
kind = "dark"
frames = 4
mcp_v = 700.0
gate_ns = 1.6e7
[[step]]
label = "bars"
kind = "bars"
frames = 4
illuminance_lux = 1e-4
target = { bars = 4, frequency_cy_per_px = 0.1, angle_deg = 0.0 }
[[sweep]]
kind = "flat"
frames = 2
mcp_v = [600.0, 700.0]
gate_ns = 1.6e7
illuminance_lux = [1e-4, 2e-4]
repeats = 2
order = "randomised"
seed = 4
dark_every = 2
dark_frames = 3
[[sweep]]
label = "edges"
kind = "edge"
frames = 2
target = [{ angle_deg = 5.0 }, { angle_deg = 85.0 }]
illuminance_lux = 1e-4
"""
SESSION = b"""
name = "trial"
sensor = "pulnix-ag5745ef3"
bit_depth = 12
interlaced = true
notes = ["one"]
[[stack]]
label = "dark-1"
kind = "dark"
frames = "a.npy"
mcp_v = 700.0
[[stack]]
label = "flat-1"
kind = "flat"
frames = ["a.npy", "a.npy"]
exposure_s = 0.0167
illuminance_lux = 1e-4
asked = { mcp_v = 700.0 }
target = { region = [0, 0, 4, 4] }
lost_frames = 2
finished = true
notes = ["two"]
"""
DESCRIPTOR = b"""v 4.0
n 12 4 4
b 1000000 250.5
i a.npy
i a.npy
d 1000000
i a.npy
i a.npy
b 2000000 501
i a.npy
i .\\a.npy
i a.npy
"""


def _read_plan(path: Path) -> None:
    plan = read_plan(path)
    foreseen = plan_report(plan, path.parent)
    assert foreseen.seconds >= 0.0 and foreseen.dose.factor95 >= 1.0 and foreseen.hottest
    if len(plan.steps) < 200:  # what was read is written so that it reads the same
        path.write_text(plan_toml(plan), encoding="utf-8")
        assert read_plan(path) == plan


def _read_session(path: Path) -> None:
    for entry in open_session(path.parent).stacks:
        entry.read()


def _read_sensor(path: Path) -> None:
    load_camera(path)


def _read_ledger(path: Path) -> None:
    DoseLedger(path).total()


def _read_phosphor(path: Path) -> None:
    load_phosphor(path)


def _read_scene(path: Path) -> None:
    for mesh in (resources.files("simulate") / "scenes").iterdir():
        if mesh.name.endswith((".obj", ".mtl")) and not (path.parent / mesh.name).exists():
            (path.parent / mesh.name).write_bytes(mesh.read_bytes())
    if isinstance(scene := load_scene(path), OutdoorScene):
        build_surfaces(scene)


def _read_descriptor(path: Path) -> None:
    (path.parent / session.MANIFEST).unlink(missing_ok=True)
    import_emva1288(path, path.parent)


def _shipped(package: str, folder: str = ".") -> list[bytes]:
    """The TOML files that ship with a package."""
    files = (resources.files(package) / folder).iterdir()
    return [file.read_bytes() for file in files if file.name.endswith(".toml")]


def _ledgers() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        ledger = DoseLedger(Path(folder) / "tube.jsonl")
        for charge in (1e-9, 2e-6):
            ledger.append(Dose(screen_c_per_cm2=charge, hours_at_gain=0.1, log_sd=0.4), session="s")
        return [ledger.path.read_bytes()]


Reader = Callable[[Path], None]
TARGETS: dict[str, tuple[Reader, Callable[[], list[bytes]], str]] = {
    "plan": (
        _read_plan,
        lambda: [SWEPT, SWEPT, *_shipped("drivers.acquisition", "plans")],
        "plan.toml",
    ),
    "session": (_read_session, lambda: [SESSION], session.MANIFEST),
    "sensor": (_read_sensor, lambda: _shipped("labdata.sensors"), "sensor.toml"),
    "phosphor": (_read_phosphor, lambda: _shipped("labdata.phosphors"), "phosphor.toml"),
    "scene": (_read_scene, lambda: _shipped("simulate", "scenes"), "scene.toml"),
    "EMVA 1288 descriptor": (_read_descriptor, lambda: [DESCRIPTOR], "series.txt"),
    "ledger": (_read_ledger, _ledgers, "tube.jsonl"),
}
"""What is read: how, from which sound documents, and under which name."""


def mangled(document: bytes, rng: random.Random) -> bytes:
    """Return a document with one to four things wrong with it."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        document = rng.choice((_value, _value, _value, _word, _key, _line, _bytes, _cut))(
            document, rng
        )
    return document


def _value(document: bytes, rng: random.Random) -> bytes:
    places = list(NUMBER.finditer(document))
    if not places:
        return document
    place = rng.choice(places)
    value = rng.choice(VALUES).encode() if rng.random() < 0.7 else rng.choice(places).group()
    return document[: place.start()] + value + document[place.end() :]


def _word(document: bytes, rng: random.Random) -> bytes:
    words = document.split(b" ")
    words[rng.randrange(len(words))] = rng.choice(VALUES).encode()
    return b" ".join(words)


def _key(document: bytes, rng: random.Random) -> bytes:
    place = rng.choice(list(LINE.finditer(document)) or [re.match(b"", document)])
    new = (
        f"{rng.choice(KEYS)} = {rng.choice(VALUES)}\n"
        if rng.random() < 0.5
        else f"[[{rng.choice(KEYS)}]]\n"
    )
    return document[: place.start()] + new.encode() + document[place.start() :]


def _line(document: bytes, rng: random.Random) -> bytes:
    lines = document.splitlines(keepends=True) or [b""]
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    change = rng.randrange(3)
    if change == 0:
        del lines[at]
    elif change == 1:
        lines.insert(at, lines[other])
    else:
        lines[at], lines[other] = lines[other], lines[at]
    return b"".join(lines)


def _bytes(document: bytes, rng: random.Random) -> bytes:
    data = bytearray(document or b" ")
    for _ in range(rng.randrange(1, 6)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


def _cut(document: bytes, rng: random.Random) -> bytes:
    first, last = sorted(rng.randrange(len(document) + 1) for _ in range(2))
    return document[:first] + document[last:] if rng.random() < 0.5 else document[:last]


def read(target: str, document: bytes, folder: Path) -> bool:
    """Read a document in a folder; return whether it was sound. Anything but BadInput comes out."""
    how, _, name = TARGETS[target]
    path = folder / name
    path.write_bytes(document)
    try:
        how(path)
    except BadInput as error:
        assert len(str(error).strip()) > 0, "a refusal says why"
        return False
    return True


def prepared(folder: Path) -> Path:
    """Make the frames that sound sessions name, and return the folder."""
    np.save(folder / "a.npy", np.zeros((2, 4, 4), np.uint16))
    return folder


@cache
def sound(target: str) -> list[bytes]:
    """The documents of a target that nothing is wrong with."""
    return TARGETS[target][1]()


def once(rng: random.Random, folder: Path) -> bool:
    """Mangle one document of any target and read it; whether it was still sound."""
    return mangle_and_read(rng.choice(tuple(TARGETS)), rng, folder)


def mangle_and_read(target: str, rng: random.Random, folder: Path) -> bool:
    """Mangle one document of a target and read it; whether it was still sound."""
    return read(target, mangled(rng.choice(sound(target)), rng), prepared(folder))
