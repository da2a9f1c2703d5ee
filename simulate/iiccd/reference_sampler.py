"""Reference sampler: every pulse drawn on cells, for static and for moving scenes.

A frame of a static scene follows from the seed and its own number.
"""

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
    camera: IntensifiedCamera, at_mcp: StageImage, conditions: Conditions, *, seed: int, first_frame: int = 0
) -> Iterator[NDArray[np.unsignedinteger]]:
    """Yield the frames of a static scene, shape (row, col), DN; never ends.

    Parameters
    ----------
    camera
        The camera.
    at_mcp
        Expected photoelectrons at the MCP input per cell and exposure, on the camera's cells.
    conditions
        Gate, voltage, temperature, and which automatic controls were on.
    seed
        Seed of the run.
    first_frame
        Number of the first frame.

    Notes
    -----
    Phosphor decay: the lag fields of a frame are drawn again. Pulses are drawn on cells one row
    high; what those blur away of the scene is added without noise, so that frames average to `mean_frame`.
    """
    glow = camera.afterglow(conditions)
    coarse = at_mcp.in_whole_rows()
    halves = coarse.with_values(np.repeat(0.5 * coarse.values[None], 2, axis=0))
    n_fields = glow.n_lag_fields + camera.fields_per_frame
    recent = np.empty((n_fields, 2, *camera.shape), np.float32)
    field = camera.fields_per_frame * first_frame - glow.n_lag_fields
    stages = _Stages(camera, at_mcp, coarse, conditions)
    for frame in count(first_frame):
        while field < camera.fields_per_frame * (frame + 1):
            screen = stages.pulse_stages(max(field // camera.fields_per_frame, 0))
            recent[field % n_fields] = screen.draw(halves, field_rng(seed, field)).values
            field += 1
        order = np.arange(field - n_fields, field) % n_fields
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
    """Stages of a static scene, cached by the state of the automatic controls."""

    def __init__(
        self, camera: IntensifiedCamera, at_mcp: StageImage, coarse: StageImage, conditions: Conditions
    ) -> None:
        self._camera, self._at_plate, self._coarse, self._conditions = camera, at_mcp, coarse, conditions
        self._state = camera.automatic_state_of(at_mcp, conditions)
        self._pulse_stages = lru_cache(maxsize=2)(self._pulse_stages_at)
        self._finer = lru_cache(maxsize=1)(self._finer_at)
        self._readout = lru_cache(maxsize=1)(self._readout_at)

    def pulse_stages(self, frame: int) -> Chain:
        """From the MCP, under the whole exposure's load, to the pixels."""
        return self._pulse_stages(self._state(frame).brightness)

    def finer(self, frame: int) -> NDArray[np.float32]:
        """Part of the mean image that cells one row high do not resolve."""
        return self._finer(self._state(frame).brightness)

    def readout(self, frame: int) -> Chain:
        """From the scan to the digitiser."""
        return self._readout(self._state(frame).gain)

    def _pulse_stages_at(self, brightness: float) -> Chain:
        plate, *behind = self._camera.mcp_to_pixels(self._conditions, AutomaticState(brightness=brightness)).stages
        assert isinstance(plate, MicrochannelPlate)
        # A map of the load must lie on the cells of the draw.
        load = self._coarse if self._camera.local_depletion else self._at_plate
        return Chain((plate.under_load(load, parts=2), *behind))

    def _finer_at(self, brightness: float) -> NDArray[np.float32]:
        screen = self._camera.mcp_to_pixels(self._conditions, AutomaticState(brightness=brightness))
        return screen.mean(self._at_plate).values - screen.mean(self._coarse).values

    def _readout_at(self, gain: float) -> Chain:
        return self._camera.readout(self._conditions, AutomaticState(gain=gain))


@dataclass(frozen=True, kw_only=True)
class ChainState:
    """State of the camera between two frames.

    Parameters
    ----------
    frame
        Number of the next frame.
    glow
        Phosphor photons on pixels of the fields whose light is still seen, early and late half, oldest first, shape
        (field, half, row, col).
    depletion
        State of the MCP's channels, see `simulate.iiccd.microchannel`; None after a rest, and always where the camera's
        MCP saturates as a whole.
    automatic
        Where the automatic controls stand.
    """

    frame: int
    glow: NDArray[np.float32]
    depletion: NDArray[np.floating] | None = None
    automatic: AutomaticState = field(default_factory=AutomaticState)


def initial_state(camera: IntensifiedCamera, conditions: Conditions) -> ChainState:
    """Return the state after a long time in the dark: no decay light, channels full, controls at 1."""
    fields = camera.afterglow(conditions).n_lag_fields
    return ChainState(frame=0, glow=np.zeros((fields, 2, *camera.shape), np.float32))


def steady_state(camera: IntensifiedCamera, at_mcp: StageImage, conditions: Conditions, *, seed: int) -> ChainState:
    """Return the state after a long exposure to a static scene, controls in their initial state."""
    state = initial_state(camera, conditions)
    plate = camera.mcp(conditions)
    load = _load(plate, at_mcp.in_whole_rows()) if camera.local_depletion else None
    fields = range(-len(state.glow), 0)
    glow = [_field(camera, plate, at_mcp, conditions, load, seed, number) for number in fields]
    return replace(state, glow=np.array(glow, np.float32).reshape(state.glow.shape), depletion=load)


def sequence(
    camera: IntensifiedCamera,
    scenes: Iterable[StageImage],
    conditions: Conditions,
    *,
    seed: int,
    state: ChainState | None = None,
) -> Iterator[NDArray[np.unsignedinteger]]:
    """Yield a frame, shape (row, col), DN, for every scene, or for every two where fields are interlaced.

    Parameters
    ----------
    camera
        The camera.
    scenes
        Expected photoelectrons at the MCP input per cell and exposure, on the camera's cells, one for each exposure
        in the order of time. Taken one frame at a time, so that a run of any length needs the memory of one.
    conditions
        Gate, voltage, temperature, and which automatic controls were on.
    seed
        Seed of the run.
    state
        State of the camera at the start; the initial state if None.

    Notes
    -----
    Here a frame does depend on those before it: through the phosphor's glow, through depleted channels of a camera
    with local depletion, and through automatic controls. With the `ChainState` from before a frame it can be drawn
    alone.
    """
    state = initial_state(camera, conditions) if state is None else state
    coming: list[StageImage] = []
    for scene in scenes:
        coming.append(scene)
        if len(coming) == camera.fields_per_frame:
            frame, state = next_frame(camera, coming, conditions, state, seed=seed)
            coming = []
            yield frame


def next_frame(
    camera: IntensifiedCamera, scenes: Sequence[StageImage], conditions: Conditions, state: ChainState, *, seed: int
) -> tuple[NDArray[np.unsignedinteger], ChainState]:
    """Return the next frame, shape (row, col), DN, and the state after it.

    Parameters
    ----------
    camera, conditions, seed
        As for `sequence`.
    scenes
        One for each exposure of the frame.
    state
        State before the frame.
    """
    if len(scenes) != camera.fields_per_frame:
        raise BadInput(f"a frame must have {camera.fields_per_frame} exposures, got {len(scenes)}")
    plate = camera.mcp(conditions)
    plate = replace(plate, gain=plate.gain * state.automatic.brightness)
    glow, depletion = camera.afterglow(conditions), state.depletion
    fields, output = list(state.glow), 0.0
    for n, scene in enumerate(scenes):
        during = None
        if camera.local_depletion:
            load = _load(plate, scene.in_whole_rows())
            during, depletion = plate.depletion.during(depletion, load), plate.depletion.next(depletion, load)
        number = camera.fields_per_frame * state.frame + n
        fields.append(_field(camera, plate, scene, conditions, during, seed, number))
        output += _output(plate, scene) / len(scenes)
    shown = StageImage(values=apply_phosphor_decay(np.stack(fields), glow.halves))
    readout = camera.readout(conditions, state.automatic)
    frame = readout.draw(shown, frame_rng(seed, state.frame)).values[0]
    automatic = _next_automatic_state(camera, conditions, state.automatic, frame, output)
    kept = np.stack(fields[len(fields) - len(state.glow) :]) if len(state.glow) else state.glow
    return frame, ChainState(frame=state.frame + 1, glow=kept, depletion=depletion, automatic=automatic)


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
    behind = camera.mcp_to_pixels(conditions).stages[1:]
    working = plate if during is None else plate.with_depletion(during)
    drawn = Chain((working.under_load(scene, parts=2), *behind)).draw(halves, field_rng(seed, number)).values
    # Mean that cells one row high do not resolve, without noise.
    by_rows = plate if during is None else plate.with_depletion(np.repeat(during, 2, axis=0))
    finer = Chain((by_rows, *behind)).mean(scene).values - Chain((working, *behind)).mean(coarse).values
    return drawn + np.float32(0.5) * finer


def _load(plate: MicrochannelPlate, coarse: StageImage) -> NDArray[np.floating]:
    assert coarse.grid is not None
    return plate.depletion.load(plate.gain * coarse.values, coarse.grid)


def _output(plate: MicrochannelPlate, scene: StageImage) -> float:
    """Mean output of the MCP, electrons per s and cm2."""
    assert scene.grid is not None
    cm2_s = scene.values.size * scene.grid.cell_area_cm2 * plate.field_s
    return float(plate.mean(scene).values.sum(dtype=float)) / cm2_s


def _next_automatic_state(
    camera: IntensifiedCamera, conditions: Conditions, state: AutomaticState, frame: NDArray, output: float
) -> AutomaticState:
    """State of the automatic controls after a frame and the phosphor current of its exposures."""
    control, gain = camera.brightness_control(conditions), camera.automatic_gain(conditions)
    level = float(frame.mean()) - float(camera.sensor.video.black_level_dn)
    return AutomaticState(
        brightness=1.0 if control is None else control.next(state.brightness, output),
        gain=1.0 if gain is None else gain.next(state.gain, level),
    )
