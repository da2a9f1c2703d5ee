"""A client killed at random moments loses no acknowledged frame, and the tube is safe within a second."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from labdata.sensors import load_sensor, save_sensor
from labdata.session import MANIFEST, open_session
from simulate.rig import aravis_library
from simulate.rig.outputs import read_outputs

pytestmark = [
    pytest.mark.wires,
    pytest.mark.aravis,
    pytest.mark.skipif(not aravis_library.is_available(), reason="the Aravis library is not on this machine"),
]
KILLS = int(os.environ.get("CHARACT_KILLS", "3"))
LATEST_S = 2.5
FRAMES = 15 + 15 * KILLS  # of each of four stacks: more than can be taken before the last kill
CHILD = Path(__file__).with_name("acquire_child.py")
SAFE_WITHIN_S = 1.0
PLAN = """
name = "killed"
sensor = "{sensor}"
seed = 11
override = [{{ limit = "ramp_v_per_s", value = 4000.0, reason = "the virtual output moves faster than life" }}]
"""
STEP = """
[[step]]
label = "{label}"
kind = "{kind}"
frames = {frames}
mcp_v = {mcp_v}
gate_ns = 1.6e7
"""


class Client:
    """The acquiring process, and what it has told."""

    def __init__(self, folder: Path, *, resume: bool) -> None:
        self.session = folder / "session"
        self._told = folder / "told"
        arguments = [str(folder / "bench"), str(self.session), str(folder / "plan.toml")]
        with self._told.open("w") as told:
            self.process = subprocess.Popen(
                [sys.executable, str(CHILD), *arguments, *(["--resume"] if resume else [])],
                stdout=told,
                stderr=subprocess.STDOUT,
            )

    def told(self) -> list[str]:
        """Whole lines so far."""
        text = self._told.read_text()
        return text[: text.rfind("\n") + 1].splitlines()

    def acknowledged(self) -> dict[str, int]:
        """Frames of each stack that the client was told are safe."""
        counts = {}
        for line in self.told():
            words = line.split()
            if len(words) >= 6 and words[3] == "of":
                counts[words[1].rstrip(":")] = int(words[2])
        return counts

    def wires(self) -> Path | None:
        return next((Path(line.split(" ", 1)[1]) for line in self.told() if line.startswith("wires ")), None)

    def wait_for_bench(self) -> None:
        """Wait until its bench is up; another virtual camera may still hold the wire."""
        while self.process.poll() is None and self.wires() is None:
            time.sleep(0.02)

    def kill(self) -> float:
        killed_s = time.time()
        self.process.kill()
        self.process.wait()
        return killed_s


def write_plan(folder: Path, frames: int) -> None:
    sensor = load_sensor("pulnix-ag5745ef3")
    save_sensor(replace(sensor, ccd=replace(sensor.ccd, rows=61, columns=84)), folder / "sensor.toml")
    steps = [("dark", "dark", 650.0), ("low", "flat", 650.0), ("high", "flat", 750.0), ("edge", "edge", 700.0)]
    text = PLAN.format(sensor=folder / "sensor.toml")
    for label, kind, mcp_v in steps:
        text += STEP.format(label=label, kind=kind, frames=frames, mcp_v=mcp_v)
        text += "" if kind == "dark" else "illuminance_lux = 1e-5\n"
    (folder / "plan.toml").write_text(text)


def assert_frames_are_safe(client: Client, told: dict[str, int]) -> None:
    """Every frame that the client was told of is in the session, whole (its digest is compared on reading)."""
    if not sum(told.values()):
        return
    session = open_session(client.session)
    for label, count in told.items():
        if count:
            assert len(session.stack(label).read()) >= count


def seconds_until_shut(wires: Path, since_s: float) -> float:
    """Seconds from a moment until the gate is shut on its wire."""
    while time.time() < since_s + 5.0:
        if not read_outputs(wires).gate_open:
            return time.time() - since_s
        time.sleep(0.01)
    return np.inf


def seconds_until_ordered_off(log: Path, killed_s: float) -> float:
    until_s = time.time() + 5.0
    while time.time() < until_s:
        for line in log.read_text().splitlines():
            entry = json.loads(line)
            moment_s = datetime.fromisoformat(entry["time"]).timestamp() - killed_s
            if moment_s > -0.001 and entry["event"].startswith("high voltage: HVOF"):
                return moment_s
        time.sleep(0.05)
    return np.inf


def test_a_client_killed_at_random_moments_loses_no_frame_and_leaves_the_tube_safe(tmp_path, seed):
    rng = np.random.default_rng(seed)
    write_plan(tmp_path, frames=FRAMES)
    log, report = tmp_path / "bench" / "safety.jsonl", []
    begun = False
    for _ in range(KILLS):
        client = Client(tmp_path, resume=begun)
        client.wait_for_bench()
        time.sleep(rng.uniform(0.0, LATEST_S))
        gate_was_open = (wires := client.wires()) is not None and read_outputs(wires).gate_open
        assert client.process.poll() is None, client.told()[-3:]
        killed_s, told = client.kill(), client.acknowledged()
        if gate_was_open:
            assert wires is not None
            shut_s, off_s = seconds_until_shut(wires, killed_s), seconds_until_ordered_off(log, killed_s)
            report.append((sum(told.values()), round(shut_s, 2), round(off_s, 2)))
            assert max(shut_s, off_s) < SAFE_WITHIN_S
        assert_frames_are_safe(client, client.acknowledged())
        begun = (client.session / "plan.toml").exists()
    last = Client(tmp_path, resume=begun)
    assert last.process.wait(timeout=600.0) == 0, last.told()[-3:]
    print("frames told, s to gate shut, s to high voltage off:", report)
    session = open_session(tmp_path / "session")
    assert (tmp_path / "session" / MANIFEST).exists()
    for entry in session.stacks:
        frames = entry.read().data
        assert entry.finished
        assert len(frames) == FRAMES
        assert len({frame.tobytes() for frame in frames}) == len(frames), "a frame was drawn twice"
