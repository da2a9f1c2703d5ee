"""What an instrument beside the tube feels of the virtual bench: the light that truly falls on the cathode."""

from functools import lru_cache
from pathlib import Path

from simulate.virtual_bench.operator import read_placement
from simulate.virtual_bench.outputs import read_outputs


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
    from simulate.virtual_bench.truth_folder import read_truth

    return read_truth(folder) if folder.is_dir() else None
