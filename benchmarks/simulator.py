"""Frames a second of the intensified camera, all stages on, against plain NumPy and OpenCV and
other simulators.

Each tier and each peer draws the same uneven scene, 768 x 493, in the same run. Peers live in an
environment of their own, `make .venv-peers/ready`; without it their rows are missing, and said to
be.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.plain_chain import CHARGE_E, PlainChain
from benchmarks.row import Row
from benchmarks.scenes import uneven
from tests.simulate.samplers import Sampler, drawn_by

LEVELS = (0.1, 1.0, 10.0, 100.0)
# Photoelectrons per pixel at which the shipped camera, at its nominal gain, fills a third of its
# wells.
NOMINAL_PE = 20.0
PEERS = Path(".venv-peers/bin/python")
# What is asked of one thread and of two, frames a second; or, of one, so many times a peer in the
# same run.
PROMISED_FPS = {1: 150.0, 2: 250.0}
PROMISED_RATIO = {"emccd_detect": 30.0, "pyxel": 27.0, "plain NumPy and OpenCV": 3.0}
# Below this light every pulse has a place of its own, and is promised this many times plain NumPy
# and OpenCV.
SPARSE_PE, SPARSE_RATIO = 0.8, 1.5


def rows() -> Iterator[Row]:
    """A row for each level and number of threads, and one for each peer."""
    plain = {level: _seconds_plain(level) for level in LEVELS}
    ours: dict[tuple[float, int], float] = {}
    for level in LEVELS:
        for threads in (1, 2):
            seconds = ours[level, threads] = seconds_a_frame(level, threads=threads)
            yield Row(
                name=f"frame of {level:g} pe/px, {threads} thread{'s' if threads > 1 else ''}",
                seconds=seconds,
                peer="plain NumPy and OpenCV",
                peer_seconds=plain[level],
                limit_seconds=max(1.0 / PROMISED_FPS[threads], plain[level] / _promised(level)),
            )
    for peer, frames_a_second in peers().items():
        yield Row(
            name="frame of 10 pe/px, 1 thread",
            seconds=ours[10.0, 1],
            peer=peer,
            peer_seconds=1.0 / frames_a_second,
            limit_seconds=max(1.0 / PROMISED_FPS[1], 1.0 / frames_a_second / PROMISED_RATIO[peer]),
        )


def _promised(level: float) -> float:
    return SPARSE_RATIO if level < SPARSE_PE else PROMISED_RATIO["plain NumPy and OpenCV"]


def seconds_a_frame(
    level: float, *, threads: int = 1, sampler: Sampler = "fast", frames: int = 60
) -> float:
    """Median time of a frame of the shipped camera, geometry and local depletion on, nothing left
    out, s.
    """
    from labdata import Conditions, load_sensor
    from simulate.camera.scene_to_photoelectrons import (
        camera_from_description,
        mcp_input_from_photoelectrons,
    )

    sensor = load_sensor("pulnix-ag5745ef3")
    camera = camera_from_description(sensor)
    plate = sensor.microchannel_plate
    gain = min(1.0, NOMINAL_PE / level) ** (1.0 / float(plate.gain_exponent))
    conditions = Conditions(mcp_v=float(plate.reference_v) * gain)
    light = mcp_input_from_photoelectrons(camera, uneven(level), conditions)
    stream = drawn_by(
        sampler, camera, light, conditions, seed=1, **({} if threads == 1 else {"threads": threads})
    )
    return median_seconds(lambda: next(stream), frames)


def _seconds_plain(level: float) -> float:
    chain = PlainChain(uneven(level), CHARGE_E * min(1.0, NOMINAL_PE / level))
    return median_seconds(chain.frame, 20)


def median_seconds(frame: Callable[[], object], count: int) -> float:
    """Median time of a frame after a few that are not counted, s."""
    for _ in range(3):
        frame()
    times = []
    for _ in range(count):
        start = time.perf_counter()
        frame()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def peers() -> dict[str, float]:
    """Frames a second of the peers that are installed, on the scene of ten photoelectrons; one
    thread.
    """
    if not PEERS.exists():
        print("other simulators are not installed: make .venv-peers/ready", file=sys.stderr)
        return {}
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "scene.npy", uneven(10.0))
        alone = os.environ | {
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "NUMBA_NUM_THREADS": "1",
        }
        command = [PEERS, "benchmarks/peers/frames.py", Path(folder) / "scene.npy"]
        done = subprocess.run(command, check=True, capture_output=True, text=True, env=alone)
    return json.loads(done.stdout.splitlines()[-1])
