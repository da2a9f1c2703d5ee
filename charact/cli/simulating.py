"""Simulated frames of a scene as a session: what a measuring verb takes can be made without a bench."""

from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

from labdata.conditions import Conditions
from labdata.session import Kind
from labdata.target import Target


def simulated(
    scene: Path,
    out: Path,
    *,
    sensor: str,
    kind: Kind,
    target: Target,
    conditions: Conditions,
    frames: int,
    seed: int,
) -> None:
    """Render a scene, expose frames of it through a sensor and keep them as a session, frame by frame."""
    from labdata.sensors import load_sensor, save_sensor
    from labdata.store import SessionWriter
    from simulate.lab import LabBench

    description = load_sensor(sensor)
    if conditions.mcp_v is None:
        conditions = replace(conditions, mcp_v=float(description.microchannel_plate.reference_v))
    bench = LabBench(description, scene)
    stream = bench.stream(kind, target, conditions, seed=seed)
    first = next(stream)
    video = description.video
    with SessionWriter.create(
        out, name=f"simulated {kind}", sensor="sensor.toml", bit_depth=video.bit_depth, interlaced=video.interlaced
    ) as writer:
        save_sensor(description, out / "sensor.toml")
        with writer.begin_stack(kind, kind, first.shape, first.dtype, conditions, target=target) as stack:
            for number, frame in enumerate(chain((first,), islice(stream, frames - 1))):
                stack.append(frame, number * bench.camera.frame_s, number)
            stack.finish(notes=(f"simulated by charact, seed {seed}",))
