"""Frames of a steady scene: every frame follows from the seed and its own number, whichever is drawn first."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import count

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
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


@dataclass(frozen=True, kw_only=True)
class ChainState:
    """All that a camera remembers between two frames.

    Parameters
    ----------
    frame
        Number of the next frame.
    glow
        Screen photons on pixels of the fields whose light is still seen, early and late half, oldest first, shape
        (field, half, row, col).
    depletion
        State of the plate's channels, see `simulate.iiccd.microchannel`; None after a rest, and always where the camera's
        plate saturates as a whole.
    automatic
        Where the automatic controls stand.
    """

    frame: int
    glow: NDArray[np.float32]
    depletion: NDArray[np.floating] | None = None
    automatic: AutomaticState = field(default_factory=AutomaticState)


def initial_state(camera: IntensifiedCamera, conditions: Conditions) -> ChainState:
    """Return the memory of a camera that has long been dark: nothing glows, channels are full, controls untouched."""
    fields = camera.afterglow(conditions).memory
    return ChainState(frame=0, glow=np.zeros((fields, 2, *camera.shape), np.float32))


def steady_state(camera: IntensifiedCamera, at_plate: StageImage, conditions: Conditions, *, seed: int) -> ChainState:
    """Return the memory of a camera that has long seen a steady scene, automatic controls untouched."""
    memory = initial_state(camera, conditions)
    plate = camera.plate(conditions)
    load = _load(plate, at_plate.in_whole_rows()) if camera.local_depletion else None
    fields = range(-len(memory.glow), 0)
    glow = [_field(camera, plate, at_plate, conditions, load, seed, number) for number in fields]
    return replace(memory, glow=np.array(glow, np.float32).reshape(memory.glow.shape), depletion=load)


def sequence(
    camera: IntensifiedCamera,
    scenes: Iterable[StageImage],
    conditions: Conditions,
    *,
    seed: int,
    memory: ChainState | None = None,
) -> Iterator[NDArray[np.unsignedinteger]]:
    """Yield a frame, shape (row, col), DN, for every scene, or for every two where fields are interlaced.

    Parameters
    ----------
    camera
        The camera.
    scenes
        Expected photoelectrons at the plate per cell and exposure, on the camera's cells, one for each exposure in the
        order of time. Taken one frame at a time, so that a run of any length needs the memory of one.
    conditions
        Gate, voltage, temperature, and which automatic controls were on.
    seed
        Seed of the run.
    memory
        What the camera remembers at the start; rested if None.

    Notes
    -----
    Here a frame does depend on those before it: through the screen's glow, through depleted channels of a camera with
    local depletion, and through automatic controls. With the `ChainState` from before a frame it can be drawn alone.
    """
    memory = initial_state(camera, conditions) if memory is None else memory
    coming: list[StageImage] = []
    for scene in scenes:
        coming.append(scene)
        if len(coming) == camera.fields_per_frame:
            frame, memory = next_frame(camera, coming, conditions, memory, seed=seed)
            coming = []
            yield frame


def next_frame(
    camera: IntensifiedCamera, scenes: Sequence[StageImage], conditions: Conditions, memory: ChainState, *, seed: int
) -> tuple[NDArray[np.unsignedinteger], ChainState]:
    """Return the next frame, shape (row, col), DN, and what is remembered after it.

    Parameters
    ----------
    camera, conditions, seed
        As for `sequence`.
    scenes
        One for each exposure of the frame.
    memory
        What is remembered before it.
    """
    if len(scenes) != camera.fields_per_frame:
        raise BadInput(f"a frame must have {camera.fields_per_frame} exposures, got {len(scenes)}")
    plate = camera.plate(conditions)
    plate = replace(plate, gain=plate.gain * memory.automatic.brightness)
    glow, depletion = camera.afterglow(conditions), memory.depletion
    fields, output = list(memory.glow), 0.0
    for n, scene in enumerate(scenes):
        during = None
        if camera.local_depletion:
            load = _load(plate, scene.in_whole_rows())
            during, depletion = plate.depletion.during(depletion, load), plate.depletion.next(depletion, load)
        number = camera.fields_per_frame * memory.frame + n
        fields.append(_field(camera, plate, scene, conditions, during, seed, number))
        output += _output(plate, scene) / len(scenes)
    shown = StageImage(values=apply_phosphor_decay(np.stack(fields), glow.halves))
    readout = camera.readout(conditions, memory.automatic)
    frame = readout.draw(shown, frame_rng(seed, memory.frame)).values[0]
    automatic = _next_automatic_state(camera, conditions, memory.automatic, frame, output)
    kept = np.stack(fields[len(fields) - len(memory.glow) :]) if len(memory.glow) else memory.glow
    return frame, ChainState(frame=memory.frame + 1, glow=kept, depletion=depletion, automatic=automatic)


def _field(
    camera: IntensifiedCamera,
    plate: MicrochannelPlate,
    scene: StageImage,
    conditions: Conditions,
    during: NDArray[np.floating] | None,
    seed: int,
    number: int,
) -> NDArray[np.float32]:
    """Light of one field's early and late pulses on the pixels, shape (half, row, col)."""
    coarse = scene.in_whole_rows()
    halves = coarse.with_values(np.repeat(0.5 * coarse.values[None], 2, axis=0))
    behind = camera.screen(conditions).stages[1:]
    working = plate if during is None else plate.with_depletion(during)
    drawn = Chain((working.under_load(scene, parts=2), *behind)).draw(halves, field_rng(seed, number)).values
    # What cells one row high blur away, without noise.
    by_rows = plate if during is None else plate.with_depletion(np.repeat(during, 2, axis=0))
    finer = Chain((by_rows, *behind)).mean(scene).values - Chain((working, *behind)).mean(coarse).values
    return drawn + np.float32(0.5) * finer


def _load(plate: MicrochannelPlate, coarse: StageImage) -> NDArray[np.floating]:
    assert coarse.grid is not None
    return plate.depletion.load(plate.gain * coarse.values, coarse.grid)


def _output(plate: MicrochannelPlate, scene: StageImage) -> float:
    """Mean output of the plate, electrons per s and cm2."""
    assert scene.grid is not None
    cm2_s = scene.values.size * scene.grid.cell_area_cm2 * plate.field_s
    return float(plate.mean(scene).values.sum(dtype=float)) / cm2_s


def _next_automatic_state(
    camera: IntensifiedCamera, conditions: Conditions, state: AutomaticState, frame: NDArray, output: float
) -> AutomaticState:
    """Where the controls stand after meters have read the frame that was taken and the screen current that it drew."""
    control, gain = camera.brightness_control(conditions), camera.automatic_gain(conditions)
    level = float(frame.mean()) - float(camera.sensor.video.black_level_dn)
    return AutomaticState(
        brightness=1.0 if control is None else control.next(state.brightness, output),
        gain=1.0 if gain is None else gain.next(state.gain, level),
    )
