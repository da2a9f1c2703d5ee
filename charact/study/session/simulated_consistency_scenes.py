"""The same targets before a simulated camera whose numbers nobody was told, in focus or one of them out of it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from charact import mtf
from charact.method import Context
from charact.session_measurement import with_stack_label
from charact.study.flats.flat_cases import InMemoryStack
from charact.study.session.consistency_scenes import BARS_CY_PER_PX, KINDS
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.measurement import Result
from labdata.sensor import Sensor
from labdata.sensors import load_sensor
from labdata.session import Kind, Session
from labdata.target import Target

SENSOR = "pulnix-ag5745ef3"
ROWS, COLUMNS, FRAMES = 256, 320, 12
TARGET_LUX, POINT_LUX, FLAT_LUX = 2.5e-4, 1.5e-3, (8e-5, 2.4e-4)
MCP_V, GATE_NS = 800.0, 1.6e7


@dataclass(frozen=True, kw_only=True)
class SimulatedScene:
    """A specimen of an intensified camera before an edge, three groups of bars, a pinhole, even light and darkness.

    Parameters
    ----------
    camera
        The specimen.
    edge_deg, bars_deg
        Tilts, degrees.
    """

    camera: Sensor
    edge_deg: float
    bars_deg: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "SimulatedScene":
        """A specimen within the ranges of its description."""
        from simulate.virtual_bench.true_sensor import draw_true_sensor

        camera = draw_true_sensor(_small(load_sensor(SENSOR)), int(rng.integers(1 << 31)))
        return cls(camera=camera, edge_deg=rng.uniform(3.0, 12.0), bars_deg=rng.uniform(1.0, 6.0))

    def measured(self, rng: np.random.Generator, context: Context, *, defocus: float = 0.0, of: str = "edge") -> Result:
        """Simulate and measure every target; as for `charact.study.session.consistency_scenes.SessionScene`."""
        result = Result()
        for label, kind in KINDS.items():
            camera = _with_defocus(self.camera, defocus) if defocus and label.startswith(of) else self.camera
            frames = self._frames(camera, kind, label, rng)
            asked = {"bars": {"bars": 4, "frequency_cy_per_px": _frequency(label)}, "point": {"pinhole_px": 1.0}}
            result += with_stack_label(mtf.measure(kind, frames, context=context, **asked.get(kind, {})), label)
        return result + mtf.measure_flats(self._flats(rng), context=context)

    def context(self, seed: int, *, quick: bool) -> Context:
        """What methods are told: the description of the type, not the specimen."""
        sensor = _small(load_sensor(SENSOR))
        interlaced, full_scale_dn = sensor.video.interlaced, 2.0**sensor.video.bit_depth - 1.0
        return Context(seed=seed, quick=quick, sensor=sensor, interlaced=interlaced, full_scale_dn=full_scale_dn)

    def truth_at(self, level: float, angle_deg: float) -> float:
        """Frequency along a direction at which the MTF falls to a level, cycles per column pitch."""
        from simulate.iiccd import true_quantities

        return true_quantities.true_crossing_frequency(self.camera, level, angle_deg)

    def _frames(self, camera: Sensor, kind: Kind, label: str, rng: np.random.Generator) -> FrameStack:
        target = {
            "edge": Target(angle_deg=self.edge_deg),
            "bars": Target(bars=4, frequency_cy_per_px=_frequency(label), angle_deg=self.bars_deg),
            "point": Target(pinhole_px=1.0),
        }
        return _expose_stack(camera, kind, target[kind], POINT_LUX if kind == "point" else TARGET_LUX, rng)

    def _flats(self, rng: np.random.Generator) -> Session:
        levels: tuple[tuple[Kind, float], ...] = (("dark", 0.0), *(("flat", lux) for lux in FLAT_LUX))
        stacks = tuple(
            InMemoryStack(
                label=f"{kind}-{number}", kind=kind, frames="", folder=Path("."), conditions=_conditions(lux),
                held=_expose_stack(self.camera, kind, Target(), lux, rng),
            )
            for number, (kind, lux) in enumerate(levels)
        )  # fmt: skip
        return Session(folder=Path("."), name="flats", stacks=stacks, sensor=self.camera, bit_depth=8)


def _expose_stack(camera: Sensor, kind: Kind, target: Target, lux: float, rng: np.random.Generator) -> FrameStack:
    from simulate.lab import LabBench

    seed = int(rng.integers(1 << 31))
    return LabBench(camera).expose(kind, target, _conditions(lux), frames=FRAMES, seed=seed)


def _conditions(lux: float) -> Conditions:
    return Conditions(illuminance_lux=lux, mcp_v=MCP_V, gate_ns=GATE_NS)


def _small(sensor: Sensor) -> Sensor:
    return replace(sensor, ccd=replace(sensor.ccd, rows=ROWS, columns=COLUMNS))


def _frequency(label: str) -> float:
    return float(label.removeprefix("bars-")) if label.startswith("bars") else BARS_CY_PER_PX[0]


def _with_defocus(sensor: Sensor, share: float) -> Sensor:
    """A lens out of focus: its blur grows by this share of a pixel of the chip, as seen through the taper."""
    pixel_um = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
    blur = float(np.hypot(float(sensor.optics.aberration_blur_um), share * pixel_um))
    return sensor.with_values({"optics.aberration_blur_um": blur})
