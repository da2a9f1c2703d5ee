"""A client that acquires a plan on the virtual bench, to be killed: `python acquire_child.py BENCH SESSION PLAN`."""

import argparse
import sys
from pathlib import Path

from drivers.acquisition.acquire import acquire
from drivers.bench.setup import open_bench
from drivers.cameras.aravis.camera import AravisCamera
from drivers.errors import BenchError
from drivers.instruments.models import lines_on
from labdata.border import from_toml
from labdata.errors import BadInput
from labdata.limits import limits_in_force
from labdata.plan import Plan
from labdata.sensors import load_sensor
from simulate.rig.bench import VirtualBench


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("bench", type=Path)
    parser.add_argument("session", type=Path)
    parser.add_argument("plan", type=Path)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--time-scale", type=float, default=20.0)
    options = parser.parse_args()
    plan = from_toml(options.plan, Plan)
    sensor = load_sensor(plan.sensor or "pulnix-ag5745ef3")

    def tell(sentence: str, share: float = 0.0) -> None:
        print(f"{share:.3f} {sentence}", flush=True)

    rig = VirtualBench(options.bench, sensor, plan.seed, wires=plan.wires, time_scale=options.time_scale, say=tell)
    try:
        with rig:
            inside = rig.inside
            lines = None if inside is None else lines_on(inside.ports, rig.wires)
            wired = rig.wires.camera is not None
            print(f"pids camera={rig.camera.pid if rig.camera else 0}", flush=True)
            print(f"wires {rig.wires_folder}", flush=True)
            acquire(
                plan,
                options.session,
                camera=AravisCamera(rig.wires.camera, silence_s=rig.silence_s, say=tell)
                if wired
                else rig.in_process_camera(),
                bench=open_bench(
                    rig.wires,
                    limits_in_force(plan.limits, sensor, plan.overrides),
                    log=options.bench / "safety.jsonl",
                    lines=lines,
                    gate_hz=float(sensor.video.field_rate_hz),
                ),
                operator=rig.operator,
                resume=options.resume,
                progress=tell,
            )
    except (BadInput, BenchError) as error:
        print(error, file=sys.stderr)
        return 1
    print("done", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
