"""The virtual tube: frame after frame of what stands before it, under the voltages on its wires at that moment."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.sensor import Sensor
from simulate.lab import LabBench
from simulate.rig.operator import Placement, read_placement
from simulate.rig.outputs import read_outputs
from simulate.rig.truth_folder import TRUTH, read_truth


class VirtualTube:
    """An intensified camera on the virtual bench.

    Every frame is drawn when it is exposed, from the state of the bench at that moment, so that no frame can show
    conditions that are past. Its noise follows from the bench's seed, the number of the placement before the camera,
    and how many frames were exposed since: the same plan, taken again with the same seed, gives the same frames.

    Parameters
    ----------
    folder
        Folder of the bench: its truth, and what its operator placed.
    wires
        Folder of the wires of the instruments that now run.
    """

    def __init__(self, folder: Path, wires: Path) -> None:
        self._folder, self._wires = Path(folder), Path(wires)
        self._truth = truth = read_truth(self._folder / TRUTH)
        self._bench = LabBench(truth.sensor)
        self._placement = Placement()
        self._frame = 0

    @property
    def sensor(self) -> Sensor:
        """The specimen."""
        return self._truth.sensor

    def expose(self, *, exposure_s: float, gain_db: float) -> NDArray:
        """Expose one frame, shape (row, col), DN.

        Parameters
        ----------
        exposure_s
            Exposure of one field, s.
        gain_db
            Gain behind the sensor, dB.
        """
        placement = read_placement(self._folder)
        self._frame = self._frame + 1 if placement.number == self._placement.number else 0
        self._placement = placement
        stack = self._bench.expose(
            placement.kind,
            placement.target,
            self.conditions(placement, exposure_s=exposure_s, gain_db=gain_db),
            frames=1,
            seed=frame_seed(self._truth.seed, placement.number),
            first_frame=self._frame,
        )
        return stack.data[0]

    def conditions(self, placement: Placement, *, exposure_s: float, gain_db: float) -> Conditions:
        """Return the true conditions at the tube now."""
        outputs = read_outputs(self._wires)
        return Conditions(
            exposure_s=exposure_s,
            mcp_v=round(outputs.mcp_v, 2),
            gate_ns=outputs.open_ns(exposure_s),
            illuminance_lux=placement.illuminance_lux * self._truth.light_per_reading,
            camera_gain_db=gain_db,
        )


def frame_seed(seed: int, placement: int) -> int:
    """Return the seed of the frames of one placement."""
    return int(np.random.SeedSequence((seed, placement)).generate_state(1, np.uint64)[0] >> 1)
