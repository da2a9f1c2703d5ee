"""One virtual instrument as a process of its own: `python -m simulate.virtual_bench dg645 --folder
F --parent PID`.
"""

import argparse
import signal
import sys
from functools import lru_cache, partial
from pathlib import Path

from simulate.virtual_bench.faults import FaultFile
from simulate.virtual_bench.instrument import virtual_model
from simulate.virtual_bench.instruments.meters import PowerMeter
from simulate.virtual_bench.outputs import read_outputs, read_placement, replace_file
from simulate.virtual_bench.pseudo_terminal import PseudoTerminal, serve


def main() -> None:
    """Serve until the bench stops this process or has ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", help="model of instrument, such as dg645")
    parser.add_argument(
        "--folder", type=Path, required=True, help="folder of the bench: link, outputs and faults"
    )
    parser.add_argument("--parent", type=int, required=True, help="process whose end ends this one")
    parser.add_argument(
        "--address", type=int, default=0, help="its GPIB address, where it stands behind an adapter"
    )
    parser.add_argument(
        "--time-scale", type=float, default=1.0, help="how much faster than life it moves"
    )
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    model = virtual_model(asked.model)
    instrument = model.make(asked.address, asked.time_scale)
    if isinstance(instrument, PowerMeter):
        instrument.connect_light(partial(light_at, asked.folder))
    terminal = PseudoTerminal(asked.folder / model.bench_name, baud=model.baud)
    instrument.publish(asked.folder)
    replace_file(asked.folder / f"{model.bench_name}.ready.json", "{}")
    try:
        faults = FaultFile(asked.folder, model.bench_name)
        serve(instrument, terminal, folder=asked.folder, faults=faults, parent=asked.parent)
    finally:
        terminal.close()


def light_at(wires: Path) -> float:
    """Return the illuminance on the photocathode, lux, of the bench whose wires lie in a folder."""
    truth = _truth(Path(wires).parent / "truth")
    outputs = read_outputs(wires)
    if truth is None:
        return outputs.room_light_lux
    return truth.illuminance_lux(read_placement(Path(wires).parent), outputs)


@lru_cache(maxsize=1)
def _truth(folder: Path):
    # Read at the first question only: describing a camera takes longer than starting an instrument.
    from simulate.virtual_bench.true_sensor import read_truth

    return read_truth(folder) if folder.is_dir() else None


main()
