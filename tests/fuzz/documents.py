"""Documents that nobody meant: plans, sessions, sensors and ledgers mangled and read; only BadInput may come of it.

Run it for a while with `python tests/fuzz/documents.py SECONDS [SEED]`; `TARGETS` names what is read.
"""

import random
import re
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import contextmanager
from importlib import resources
from pathlib import Path

import numpy as np

from drivers.acquisition.forecast import forecast
from drivers.acquisition.plan_check import check_plan
from labdata.border import from_toml, to_toml
from labdata.dose_ledger import DoseLedger
from labdata.errors import BadInput
from labdata.plan import Plan
from labdata.sensors import load_camera, load_sensor
from labdata.session import open_session
from labdata.tube_dose import Dose

LONGEST_S = 10.0
"""A document that takes longer hangs, s."""

MOST_BYTES = 4 << 30
"""Address space that reading may take, bytes."""

VALUES = (
    "nan", "inf", "-inf", "0", "-0.0", "-1", "1e400", "1e308", "-1e308", "5e-324", "9" * 400, "1" + "0" * 5000, "0x10",
    "true", "false", '""', '"a"', '"../../etc"', '"\\u0000"', '"\\ud83d"', '"ü☃"', "[]", "[[]]", "{}", "{ a = 1 }",
    "[1, 2]", "[nan, 1]", "[[1], [2]]", "1979-05-27T07:32:00Z", "07:32:00", "'''x'''", "[" * 60 + "]" * 60,
    "[" * 3000, '"' + "x" * 20_000 + '"', "{ value = 1, low = 2 }", '{ value = "x" }', "100000", "2e9", "1e-9",
)  # fmt: skip
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


def _read_plan(path: Path) -> None:
    plan = from_toml(path, Plan)
    sensor = None if plan.sensor is None else load_sensor(plan.sensor)
    check_plan(plan, path.parent, sensor)
    foreseen = forecast(plan, sensor)
    assert foreseen.seconds >= 0.0 and foreseen.dose.factor95 >= 1.0 and foreseen.hottest
    if len(plan.steps) < 200:  # what was read is written so that it reads the same
        path.write_text(to_toml(plan), encoding="utf-8")
        assert from_toml(path, Plan) == plan


def _read_session(path: Path) -> None:
    for entry in open_session(path.parent).stacks:
        entry.read()


def _read_sensor(path: Path) -> None:
    load_camera(path)


def _read_ledger(path: Path) -> None:
    DoseLedger(path).total()


def _plans() -> list[bytes]:
    shipped = [file.read_bytes() for file in (resources.files("charact.cli") / "plans").iterdir() if file.is_file()]
    return [SWEPT, SWEPT, *shipped]


def _sensors() -> list[bytes]:
    files = resources.files("labdata.sensors").iterdir()
    return [file.read_bytes() for file in files if file.name.endswith(".toml")]


def _ledgers() -> list[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        ledger = DoseLedger(Path(folder) / "tube.jsonl")
        for charge in (1e-9, 2e-6):
            ledger.append(Dose(screen_c_per_cm2=charge, hours_at_gain=0.1, log_sd=0.4), session="s")
        return [ledger.path.read_bytes()]


TARGETS: dict[str, tuple[Callable[[Path], None], Callable[[], list[bytes]], str]] = {
    "plan": (_read_plan, _plans, "plan.toml"),
    "session": (_read_session, lambda: [SESSION], "session.toml"),
    "sensor": (_read_sensor, _sensors, "sensor.toml"),
    "ledger": (_read_ledger, _ledgers, "tube.jsonl"),
}
"""What is read: how, from which sound documents, and under which name."""


def mangled(document: bytes, rng: random.Random) -> bytes:
    """Return a document with one to four things wrong with it."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        document = rng.choice((_value, _value, _value, _key, _line, _bytes, _cut))(document, rng)
    return document


def _value(document: bytes, rng: random.Random) -> bytes:
    places = list(NUMBER.finditer(document))
    if not places:
        return document
    place = rng.choice(places)
    value = rng.choice(VALUES).encode() if rng.random() < 0.7 else rng.choice(places).group()
    return document[: place.start()] + value + document[place.end() :]


def _key(document: bytes, rng: random.Random) -> bytes:
    place = rng.choice(list(LINE.finditer(document)) or [re.match(b"", document)])
    new = f"{rng.choice(KEYS)} = {rng.choice(VALUES)}\n" if rng.random() < 0.5 else f"[[{rng.choice(KEYS)}]]\n"
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
    """Read a document in a folder; return whether it was sound. Anything but BadInput, and a hang, comes out."""
    how, _, name = TARGETS[target]
    path = folder / name
    path.write_bytes(document)
    with _deadline():
        try:
            how(path)
        except BadInput as error:
            assert len(str(error).strip()) > 0, "a refusal says why"
            return False
    return True


@contextmanager
def _deadline():
    def late(*_: object) -> None:
        raise TimeoutError(f"a document must be read within {LONGEST_S:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def prepared(folder: Path) -> Path:
    """Make the frames that sound sessions name, and return the folder."""
    np.save(folder / "a.npy", np.zeros((2, 4, 4), np.uint16))
    return folder


def fuzz(seconds: float, seed: int, say: Callable[[str], None] = print) -> int:
    """Read mangled documents for a time, s; return how many broke the reader, each told with what made it again."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, hard))
    broken, rng = 0, random.Random(seed)
    counts = {target: [0, 0] for target in TARGETS}
    sound = {target: documents() for target, (_, documents, _) in TARGETS.items()}
    try:
        with tempfile.TemporaryDirectory() as there:
            folder, until_s = prepared(Path(there)), time.monotonic() + seconds
            while time.monotonic() < until_s:
                target = rng.choice(tuple(TARGETS))
                document = mangled(rng.choice(sound[target]), rng)
                counts[target][0] += 1
                try:
                    counts[target][1] += read(target, document, folder)
                except Exception as error:  # whatever it is, it is what is looked for
                    broken += 1
                    kept = Path(tempfile.gettempdir()) / f"charact-fuzz-{target}-{seed}-{broken}"
                    kept.write_bytes(document)
                    say(f"{target}: {type(error).__name__}: {str(error)[:200]}; kept as {kept}")
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
    for target, (read_so_far, whole) in counts.items():
        say(f"{target}: {read_so_far} documents read, {whole} of them still sound")
    return broken


if __name__ == "__main__":
    wanted_s, chosen = float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else time.time_ns() % 2**31
    print(f"seed {chosen}")
    sys.exit(1 if fuzz(wanted_s, chosen) else 0)
