"""Flats and a dark of a simulated camera whose numbers nobody was told, with a knob for all that breaks gains."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.study.flats.flat_cases import InMemoryStack
from labdata.conditions import Conditions
from labdata.frames import FrameStack
from labdata.sensor import Sensor
from labdata.sensors import load_sensor
from labdata.session import Kind, Session
from labdata.target import Target

SENSOR = "pulnix-ag5745ef3"
GATE_NS = 1.6e7
# Decay of a screen so fast that no field sees another's light, ms.
NO_LAG_MS = 0.01
BLACK_AND_FULL_DN = 12.0, 255.0


@dataclass(frozen=True, kw_only=True)
class GainScene:
    """A specimen of an intensified camera before even light of some levels, and in the dark.

    Parameters
    ----------
    specimen
        Seed of the specimen, drawn within the ranges of its description.
    mcp_v
        Voltage of the plate, V.
    signal_dn
        Signal of each flat, DN, before whatever breaks it.
    frames, rows, columns
        Frames of each stack and their size.
    interlaced
        Whether two fields make a frame.
    decay_ms
        Decay of nearly all of the screen's light, ms; None: no lag at all.
    gain_range_db
        How far an automatic gain turns up, dB; 0: it is off. The session does not say that it is on.
    flicker
        Relative standard deviation of the light from frame to frame.
    drift
        Relative change of the light from the first to the last frame.
    gamma
        Exponent of the video's response.
    """

    specimen: int
    mcp_v: float
    signal_dn: tuple[float, ...]
    frames: int
    rows: int
    columns: int
    interlaced: bool = False
    decay_ms: float | None = None
    gain_range_db: float = 0.0
    flicker: float = 0.0
    drift: float = 0.0
    gamma: float = 1.0

    @cached_property
    def camera(self) -> Sensor:
        """The specimen."""
        from simulate.virtual_bench.true_sensor import draw_true_sensor

        drawn = draw_true_sensor(self.description, self.specimen)
        values = {"video.gamma": self.gamma}
        if self.decay_ms is None:
            values |= {"phosphor.fast_decay_ms": NO_LAG_MS, "phosphor.fast_fraction": 1.0}
        else:
            values |= {"phosphor.fast_decay_ms": self.decay_ms}
        if self.gain_range_db:
            values |= {"video.automatic_gain_range_db": self.gain_range_db}
        return drawn.with_values(values)

    @cached_property
    def description(self) -> Sensor:
        """The type, on a small chip."""
        sensor = load_sensor(SENSOR)
        ccd = replace(sensor.ccd, rows=self.rows, columns=self.columns)
        return replace(sensor, ccd=ccd, video=replace(sensor.video, interlaced=self.interlaced))

    @property
    def settings(self) -> Conditions:
        """Gate and voltage."""
        return Conditions(mcp_v=self.mcp_v, gate_ns=GATE_NS)

    @cached_property
    def truth(self) -> dict[str, float]:
        """What the simulator says of the specimen."""
        from simulate.iiccd import true_quantities

        return true_quantities.true_quantities(self.camera, self.settings)

    @property
    def photoelectrons(self) -> NDArray[np.float64]:
        """Photoelectrons of a pixel and exposure in each flat."""
        return np.array(self.signal_dn) / self.truth["photoelectron_gain"]

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw the dark and the flats."""
        lux = self.photoelectrons / self.truth["photoelectrons_per_lux"]
        stacks = [self._stack("dark", 0.0, rng), *(self._stack("flat", float(level), rng) for level in lux)]
        return Session(folder=Path("."), name="simulated flats", stacks=tuple(stacks), interlaced=self.interlaced,
                       sensor=self.description, bit_depth=8)  # fmt: skip

    @cached_property
    def _bench(self) -> Any:
        """The camera on its bench, which keeps what its pictures share."""
        from simulate.lab import LabBench

        return LabBench(self.camera)

    def _stack(self, kind: Kind, lux: float, rng: np.random.Generator) -> InMemoryStack:
        told = replace(self.settings, illuminance_lux=lux, illuminance_relative_sd=0.03)
        return InMemoryStack(label=f"{kind}-{lux:.3g}", kind=kind, frames="", folder=Path("."), conditions=told,
                         held=self._expose_frames(kind, told, rng))  # fmt: skip

    def _expose_frames(self, kind: Kind, conditions: Conditions, rng: np.random.Generator) -> FrameStack:
        seed = int(rng.integers(1 << 31))
        real = replace(conditions, automatic_gain=True) if self.gain_range_db else conditions
        if kind == "dark" or not (self.flicker or self.drift):
            return self._bench.expose(kind, Target(), real, frames=self.frames, seed=seed)
        trend = self.drift * np.linspace(-0.5, 0.5, self.frames)
        light = np.maximum(1.0 + trend + self.flicker * rng.standard_normal(self.frames), 0.0)
        lux = light * float(real.illuminance_lux or 0.0)
        return _join_frames(self._bench.expose(kind, Target(), replace(real, illuminance_lux=float(value)),
                                          frames=1, seed=seed, first_frame=number)
                       for number, value in enumerate(lux))  # fmt: skip


def _join_frames(frames) -> FrameStack:
    """One stack of frames taken one by one."""
    single = list(frames)
    return replace(
        single[0],
        data=np.concatenate([one.data for one in single]),
        time_s=np.concatenate([one.time_s for one in single]),
        frame_number=np.concatenate([one.frame_number for one in single]),
    )
