"""One virtual instrument as a process of its own: `python -m simulate.rig delay_generator --folder F --parent PID`."""

import argparse
import signal
import sys
from pathlib import Path

from simulate.rig.delay_generator import DelayGenerator
from simulate.rig.faults import FaultFile
from simulate.rig.high_voltage import HighVoltageSupply
from simulate.rig.prologix import PrologixAdapter
from simulate.rig.pseudo_terminal import PseudoTerminal, serve

DELAY_GENERATOR_BAUD = 9600


def main() -> None:
    """Serve until the bench stops us or is gone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("instrument", choices=("delay_generator", "high_voltage"))
    parser.add_argument("--folder", type=Path, required=True, help="folder of the bench: link, outputs and faults")
    parser.add_argument("--parent", type=int, required=True, help="process whose end ends this one")
    parser.add_argument("--address", type=int, default=14, help="GPIB address of the supply")
    parser.add_argument("--time-scale", type=float, default=1.0, help="how much faster than life the supply moves")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    if asked.instrument == "delay_generator":
        instrument, baud = DelayGenerator(), DELAY_GENERATOR_BAUD
    else:
        supply = HighVoltageSupply(time_scale=asked.time_scale)
        instrument, baud = PrologixAdapter({asked.address: supply}), None
    terminal = PseudoTerminal(asked.folder / asked.instrument, baud=baud)
    instrument.publish(asked.folder)
    try:
        faults = FaultFile(asked.folder, asked.instrument)
        serve(instrument, terminal, folder=asked.folder, faults=faults, parent=asked.parent)
    finally:
        terminal.close()


main()
