"""Frames of a steady scene: every frame follows from the seed and its own number, whichever is drawn first."""

from collections.abc import Iterator
from functools import lru_cache
from itertools import count

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.chain import Chain
from simulate.iiccd.microchannel import MicrochannelPlate
from simulate.iiccd.phosphor import apply_phosphor_decay
from simulate.iiccd.stage_image import StageImage


def steady_frames(
    camera: IntensifiedCamera, at_plate: StageImage, conditions: Conditions, *, seed: int, first_frame: int = 0
) -> Iterator[NDArray[np.unsignedinteger]]:
    """Yield the frames of a steady scene, one after the other, shape (row, col), DN; never ends.

    Parameters
    ----------
    camera
        The camera.
    at_plate
        Expected photoelectrons at the plate per cell and exposure, on the camera's cells.
    conditions
        Gate, voltage, temperature, and which automatic controls were on.
    seed
        Seed of the run.
    first_frame
        Number of the first frame.

    Notes
    -----
    The screen remembers: the fields from which a frame still glows are drawn again. Pulses are drawn on cells one row
    high; what those blur away of the scene is added without noise, so that frames average to `mean_frame`.
    """
    glow = camera.afterglow(conditions)
    coarse = at_plate.in_whole_rows()
    halves = coarse.with_values(np.repeat(0.5 * coarse.values[None], 2, axis=0))
    remembered = glow.memory + camera.fields_per_frame
    recent = np.empty((remembered, 2, *camera.shape), np.float32)
    field = camera.fields_per_frame * first_frame - glow.memory
    stages = _Stages(camera, at_plate, coarse, conditions)
    for frame in count(first_frame):
        while field < camera.fields_per_frame * (frame + 1):
            screen = stages.screen(max(field // camera.fields_per_frame, 0))
            recent[field % remembered] = screen.draw(halves, field_rng(seed, field)).values
            field += 1
        order = np.arange(field - remembered, field) % remembered
        shown = apply_phosphor_decay(recent, glow.halves, order) + stages.finer(frame)
        yield stages.readout(frame).draw(StageImage(values=shown), frame_rng(seed, frame)).values[0]


def field_rng(seed: int, field: int) -> np.random.Generator:
    """Return the generator of one field's pulses."""
    # Fields before the first frame, whose light it still shows, have numbers below zero; seeds may not.
    return np.random.default_rng([seed, 0, field + 1024])


def frame_rng(seed: int, frame: int) -> np.random.Generator:
    """Return the generator of one frame's readout."""
    return np.random.default_rng([seed, 1, frame])


class _Stages:
    """The stages that a steady run passes, frame by frame: always the same unless automatic controls are on."""

    def __init__(
        self, camera: IntensifiedCamera, at_plate: StageImage, coarse: StageImage, conditions: Conditions
    ) -> None:
        self._camera, self._at_plate, self._coarse, self._conditions = camera, at_plate, coarse, conditions
        self._state = camera.automatic_state_of(at_plate, conditions)
        self._screen = lru_cache(maxsize=2)(self._screen_at)
        self._finer = lru_cache(maxsize=1)(self._finer_at)
        self._readout = lru_cache(maxsize=1)(self._readout_at)

    def screen(self, frame: int) -> Chain:
        """From the plate, under the whole exposure's load, to the pixels."""
        return self._screen(self._state(frame).brightness)

    def finer(self, frame: int) -> NDArray[np.float32]:
        """What cells one row high blur away of the expected picture."""
        return self._finer(self._state(frame).brightness)

    def readout(self, frame: int) -> Chain:
        """From the scan to the digitiser."""
        return self._readout(self._state(frame).gain)

    def _screen_at(self, brightness: float) -> Chain:
        plate, *behind = self._camera.screen(self._conditions, AutomaticState(brightness=brightness)).stages
        assert isinstance(plate, MicrochannelPlate)
        # A map of the load must lie on the cells of the draw.
        load = self._coarse if self._camera.local_depletion else self._at_plate
        return Chain((plate.under_load(load, parts=2), *behind))

    def _finer_at(self, brightness: float) -> NDArray[np.float32]:
        screen = self._camera.screen(self._conditions, AutomaticState(brightness=brightness))
        return screen.mean(self._at_plate).values - screen.mean(self._coarse).values

    def _readout_at(self, gain: float) -> Chain:
        return self._camera.readout(self._conditions, AutomaticState(gain=gain))
