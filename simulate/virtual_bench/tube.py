"""Virtual tube: frames under the present target, light, voltage and gate of the virtual bench."""

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata import Camera, Conditions, Kind, Target
from labdata.gating import IN_STEP, fields_open_ns, whole_field_s
from simulate.camera.fast_sampler.frame_generator import SEGMENT_FRAMES
from simulate.lab import LabBench
from simulate.radiance.lab_target import PlacedTarget, as_stood
from simulate.virtual_bench.outputs import Outputs, TargetPlacement, read_placement
from simulate.virtual_bench.true_sensor import TRUTH, read_truth

# Distance in row and col, px, and angle by which a target stands off where it should, at most
DISPLACED_PX, TURNED_DEG = 2.0, 1.0
# Open times are rounded to this fraction of one opening, since each is drawn as a scene of its own
STEPS = 32


@dataclass(frozen=True, kw_only=True)
class Fields:
    """Timing of gate and fields of a camera."""

    width_ns: float  #: Width of one opening, ns
    rate_hz: float  #: Openings a second, Hz
    field_hz: float  #: Fields a second, Hz
    exposure_s: float  #: Exposure of a field, which ends with it, s
    first_s: float  #: When the first field begins, s after an opening begins

    @classmethod
    def of(cls, outputs: Outputs, *, field_hz: float, exposure_s: float, phase: float) -> "Fields":
        """Return the timing of a gate and the fields; `phase`: of a gate that the camera does not
        trigger, 0 to 1.
        """
        # Relative difference between the clock of a gate generator and that of a camera, two
        # ordinary crystals
        rates = {
            "clock": outputs.gate_hz * (1.0 + 2e-5),
            "mains": outputs.gate_hz,
            "camera": field_hz,
        }
        rate_hz = rates[outputs.gate_trigger]
        first_s = (
            -outputs.gate_delay_ns * 1e-9 if outputs.gate_trigger == "camera" else phase / rate_hz
        )
        return cls(
            width_ns=outputs.gate_ns,
            rate_hz=rate_hz,
            field_hz=field_hz,
            exposure_s=exposure_s,
            first_s=first_s,
        )

    def open_ns(self, first_field: int, fields: int) -> NDArray[np.floating]:
        """Return the open time of the gate in each field, ns."""
        ends_s = self.first_s + (np.arange(first_field, first_field + fields) + 1.0) / self.field_hz
        return fields_open_ns(
            ends_s - self.exposure_s, self.exposure_s, width_ns=self.width_ns, rate_hz=self.rate_hz
        )

    def lights_ns(self, first_field: int, fields: int) -> tuple[float, ...]:
        """Return the same to a `STEPS`-th of an opening, ns."""
        step_ns = self.width_ns / STEPS
        return tuple(
            float(light_ns)
            for light_ns in np.round(self.open_ns(first_field, fields) / step_ns) * step_ns
        )

    @property
    def in_step(self) -> bool:
        """Whether all fields within a minute are open for the same time."""
        return float(np.ptp(self.open_ns(0, round(60.0 * self.field_hz)))) < IN_STEP * self.width_ns


# light that a closed gate lets through, over an open one: 1e6 to 1e7 to one in the visible
GATE_EXTINCTION = 1e-7


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Target and conditions of the next frame."""

    placement: TargetPlacement
    conditions: Conditions
    #: How gate and fields run against one another, where they do not keep step
    fields: Fields | None = None


class VirtualTube:
    """An intensified camera on the virtual bench.

    Every frame is drawn when it is exposed, from the state of the bench at that moment, so that no
    frame can show conditions that are past. Its noise follows from the bench's seed, the number of
    the placement before the camera, and how many frames were exposed since: the same plan, taken
    again with the same seed, gives the same frames.
    """

    def __init__(self, folder: Path, outputs: Callable[[], Outputs]) -> None:
        self._folder, self._outputs = Path(folder), outputs
        self._truth = read_truth(self._folder / TRUTH)
        self._bench = LabBench(self._truth.sensor)
        self._scene: Scene | None = None
        self._frame = 0
        self._frames: Iterator[NDArray] = iter(())
        self._lights: dict[float, Iterator[NDArray]] = {}

    @property
    def sensor(self) -> Camera:
        """The device."""
        return self._truth.sensor

    def scene(self, *, exposure_s: float, gain_db: float) -> Scene:
        """Return the present target and the true conditions at the tube for a field's exposure, s,
        and a gain, dB.
        """
        placement, outputs = read_placement(self._folder), self._outputs()
        placement = replace(placement, target=self._stood(placement))
        if outputs.room_light_lux:
            # it falls on everything, darks included
            placement = replace(placement, kind="flat", target=Target())
        field_hz = float(self.sensor.video.field_rate_hz)
        exposure_s = min(exposure_s, 1.0 / field_hz)
        fields = self._fields(outputs, field_hz, whole_field_s(exposure_s, field_hz))
        open_ns = outputs.open_ns(exposure_s) if fields is None else float(fields.open_ns(0, 1)[0])
        conditions = Conditions(
            exposure_s=exposure_s,
            # an MCP without voltage multiplies by next to nothing
            mcp_v=max(round(outputs.mcp_v, 2), 1.0),
            gate_ns=max(open_ns, exposure_s * 1e9 * GATE_EXTINCTION),
            illuminance_lux=self._truth.illuminance_lux(placement, outputs),
            camera_gain_db=gain_db,
            temperature_c=outputs.temperature_c,
        )
        beating = None if fields is None or fields.in_step else fields
        return Scene(placement=placement, conditions=conditions, fields=beating)

    def _stood(self, placement: TargetPlacement) -> Target:
        """The target where the operator stands it: off its centre and angle by chance. The same one
        stands at the same place, as in a series of light levels.
        """
        kind, target = placement.kind, as_stood(placement.kind, placement.target)
        if kind not in ("edge", "bars", "point"):
            return target
        rng = np.random.default_rng([self._truth.seed, zlib.crc32(f"{kind} {target}".encode())])
        row_px, col_px, turn = rng.uniform(-1.0, 1.0, 3)
        if target.angle_deg is not None:
            target = replace(target, angle_deg=target.angle_deg + TURNED_DEG * turn)
        return PlacedTarget(
            **vars(target), offset_px=(DISPLACED_PX * row_px, DISPLACED_PX * col_px)
        )

    def prepare(self, scene: Scene) -> None:
        """Render the target ahead of its first frame."""
        self._bench.mcp_input(scene.placement.kind, scene.placement.target, scene.conditions)

    def warm_up(self) -> None:
        """Draw a dark and a lit frame in advance, so that compilation delays no later frame."""
        exposure_s = 1.0 / float(self.sensor.video.field_rate_hz)
        shown: tuple[tuple[Kind, float], ...] = (("dark", 0.0), ("flat", 1e-4))
        for kind, lux in shown:
            conditions = Conditions(
                exposure_s=exposure_s,
                gate_ns=exposure_s * 1e9,
                illuminance_lux=lux,
                mcp_v=float(self.sensor.microchannel_plate.reference_v),
            )
            next(iter(self._bench.stream(kind, Target(), conditions, seed=0, first_frame=0)))

    def expose(self, scene: Scene) -> NDArray:
        """Expose one frame of a scene, shape (row, col), DN."""
        if scene.fields is not None:
            return self._woven(scene, scene.fields)
        if scene != self._scene:
            same_placement = (
                self._scene is not None and scene.placement.number == self._scene.placement.number
            )
            # The lag of the phosphor is drawn again at the start of a segment: a changed scene
            # begins with one.
            self._frame = (
                -(-self._frame // SEGMENT_FRAMES) * SEGMENT_FRAMES if same_placement else 0
            )
            self._scene = scene
            self._frames = self._bench.stream(
                scene.placement.kind,
                scene.placement.target,
                scene.conditions,
                seed=frame_seed(self._truth.seed, scene.placement.number),
                first_frame=self._frame,
            )
        self._frame += 1
        return next(self._frames)

    def _fields(self, outputs: Outputs, field_hz: float, exposure_s: float) -> Fields | None:
        """Timing of gate and fields; None where the gate idles or its phase has no effect."""
        pulsed = outputs.gate_open and 0.0 < outputs.gate_ns * outputs.gate_hz < 1e9
        whole_fields = outputs.gate_trigger == "clock" and exposure_s == 1.0 / field_hz
        if not pulsed or whole_fields:
            return None
        phase = float(np.random.default_rng([self._truth.seed, 0x5E]).random())
        return Fields.of(outputs, field_hz=field_hz, exposure_s=exposure_s, phase=phase)

    def _woven(self, scene: Scene, fields: Fields) -> NDArray:
        """Expose one frame whose fields have different open times."""
        if scene != self._scene:
            self._scene, self._frame, self._lights = scene, 0, {}
        count = 2 if self.sensor.video.interlaced else 1
        open_ns = fields.lights_ns(self._frame * count, count)
        self._frame += 1
        pictures = {light_ns: next(self._light(scene, light_ns)) for light_ns in set(open_ns)}
        frame = pictures[open_ns[0]].copy()
        for field in range(1, count):
            frame[field::count] = pictures[open_ns[field]][field::count]
        return frame

    def _light(self, scene: Scene, open_ns: float) -> Iterator[NDArray]:
        """Frames of a scene whose gate is open for a time, ns."""
        if open_ns not in self._lights:
            least_ns = (scene.conditions.exposure_s or 0.0) * 1e9 * GATE_EXTINCTION
            self._lights[open_ns] = self._bench.stream(
                scene.placement.kind,
                scene.placement.target,
                replace(scene.conditions, gate_ns=max(open_ns, least_ns)),
                seed=frame_seed(self._truth.seed, scene.placement.number) + round(open_ns),
            )
        return self._lights[open_ns]


def frame_seed(seed: int, placement: int) -> int:
    """Return the seed of the frames of one placement."""
    return int(np.random.SeedSequence((seed, placement)).generate_state(1, np.uint64)[0] >> 1)
