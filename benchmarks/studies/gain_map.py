"""Where the covariance gain breaks: thousands of random simulated cameras, half of them past the
declared scope.

`make study NAME=gain-map` writes the table. A cell is one specimen of the intensified camera with a
dark and some flats, lag, interlace and automatic gain off; in half of the cells one thing breaks
it, from too little to matter to far too much.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact.estimators.noise  # noqa: F401  # registers the methods
from benchmarks.studies import scenario_map
from benchmarks.studies.harness import attempt
from benchmarks.studies.scenario_map import (
    Breaking,
    Scenario,
    ScenarioOutcome,
    draw_case,
    draw_scenario,
    outcome_of,
)
from charact.method import Context
from charact.method.registry import methods_of_kind
from labdata import Camera, Conditions, FrameStack, Session, StackEntry, Target, load_sensor
from labdata.session import Kind
from tests.truth.cases.case import Case
from tests.truth.sessions import session_in_memory, stack_in_memory

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
        How far an automatic gain turns up, dB; 0: it is off. The session does not say that it is
        on.
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
    def camera(self) -> Camera:
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
    def description(self) -> Camera:
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
        from simulate.camera import true_quantities

        return true_quantities.true_quantities(self.camera, self.settings)

    @property
    def photoelectrons(self) -> NDArray[np.float64]:
        """Photoelectrons of a pixel and exposure in each flat."""
        return np.array(self.signal_dn) / self.truth["photoelectron_gain"]

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw the dark and the flats."""
        lux = self.photoelectrons / self.truth["photoelectrons_per_lux"]
        stacks = [
            self._stack("dark", 0.0, rng),
            *(self._stack("flat", float(level), rng) for level in lux),
        ]
        return session_in_memory(
            stacks, interlaced=self.interlaced, camera=self.description, bit_depth=8
        )

    @cached_property
    def _bench(self) -> Any:
        """The camera on its bench, which keeps what its pictures share."""
        from simulate.lab import LabBench

        return LabBench(self.camera)

    def _stack(self, kind: Kind, lux: float, rng: np.random.Generator) -> StackEntry:
        told = replace(self.settings, illuminance_lux=lux, illuminance_relative_sd=0.03)
        return stack_in_memory(
            kind, self._expose_frames(kind, told, rng), told, label=f"{kind}-{lux:.3g}"
        )

    def _expose_frames(
        self, kind: Kind, conditions: Conditions, rng: np.random.Generator
    ) -> FrameStack:
        seed = int(rng.integers(1 << 31))
        real = replace(conditions, automatic_gain=True) if self.gain_range_db else conditions
        if kind == "dark" or not (self.flicker or self.drift):
            return self._bench.expose(kind, Target(), real, frames=self.frames, seed=seed)
        trend = self.drift * np.linspace(-0.5, 0.5, self.frames)
        light = np.maximum(1.0 + trend + self.flicker * rng.standard_normal(self.frames), 0.0)
        lux = light * float(real.illuminance_lux or 0.0)
        return _join_frames(
            self._bench.expose(
                kind,
                Target(),
                replace(real, illuminance_lux=float(value)),
                frames=1,
                seed=seed,
                first_frame=number,
            )
            for number, value in enumerate(lux)
        )


def _join_frames(frames) -> FrameStack:
    """One stack of frames taken one by one."""
    single = list(frames)
    return replace(
        single[0],
        data=np.concatenate([one.data for one in single]),
        time_s=np.concatenate([one.time_s for one in single]),
        frame_number=np.concatenate([one.frame_number for one in single]),
    )


TABLE = Path(__file__).with_name("tables") / "gain_map.json"
METHOD, QUANTITY = "covariance-sum", "covariance_gain"
CELLS, REPEATS = 3000, 1
# What breaks gains, from where it hardly matters to where nothing is left, and whether steps are
# even in ln.
BREAKING: Breaking = {
    "decay_ms": (1.0, 100.0, True),
    "interlaced_decay_ms": (1.0, 60.0, True),
    "gain_range_db": (0.1, 20.0, True),
    "flicker": (0.001, 0.5, True),
    "drift": (0.002, 0.8, True),
    "saturation": (0.6, 4.0, True),
    "gamma": (0.45, 2.2, True),
    "frames": (2.0, 8.0, False),
    "rows": (24.0, 96.0, True),
    "dim_dn": (0.02, 2.0, True),
}


def cell_of(number: int) -> Scenario[GainScene]:
    """Return a cell from its number."""
    return draw_scenario(number, BREAKING, _scene_in_scope, _broken)


def _scene_in_scope(rng: np.random.Generator) -> GainScene:
    size = int(rng.integers(112, 161))
    brightest = float(np.exp(rng.uniform(np.log(25.0), np.log(140.0))))
    return GainScene(
        specimen=int(rng.integers(1 << 31)),
        mcp_v=float(rng.uniform(720.0, 840.0)),
        signal_dn=_levels(brightest, float(rng.uniform(3.0, 10.0)), int(rng.integers(3, 6))),
        frames=int(rng.integers(8, 25)),
        rows=size,
        columns=size + 16,
    )


def _levels(brightest_dn: float, span: float, count: int) -> tuple[float, ...]:
    return tuple(float(level) for level in brightest_dn * np.geomspace(1.0 / span, 1.0, count))


def _broken(scene: GainScene, axis: str, strength: float) -> GainScene:
    """Return a scene with one thing wrong."""
    if axis == "interlaced_decay_ms":
        return replace(scene, interlaced=True, decay_ms=strength)
    if axis == "saturation":
        black, full = BLACK_AND_FULL_DN
        return replace(
            scene, signal_dn=_levels(strength * (full - black), 10.0, len(scene.signal_dn))
        )
    if axis == "frames":
        return replace(scene, frames=round(strength))
    if axis == "rows":
        return replace(scene, rows=round(strength), columns=round(strength) + 8)
    if axis == "dim_dn":
        return replace(scene, signal_dn=_levels(strength, 4.0, len(scene.signal_dn)))
    return replace(scene, **{axis: strength})


def measure_scenario(
    number: int, *, repeats: int = REPEATS, quick: bool = True, method: str = METHOD
) -> ScenarioOutcome:
    """Draw a cell's frames and put the method to each of them."""
    cell = cell_of(number)
    truth = cell.scene.truth[QUANTITY]
    rows = [
        attempt(methods_of_kind("flats")[method], case_of(cell, i), Context(quick=quick))
        for i in range(repeats)
    ]
    return outcome_of(cell, rows, truth, truths=(truth, truth))


def case_of(cell: Scenario[GainScene], repeat: int) -> Case:
    """Return one drawing of a cell."""
    scene = cell.scene
    return draw_case(
        cell,
        repeat,
        kind="flats",
        quantity=QUANTITY,
        truth=scene.truth[QUANTITY],
        draw=scene.session_drawn,
        context={
            "camera": scene.description,
            "interlaced": scene.interlaced,
            "full_scale_dn": BLACK_AND_FULL_DN[1],
        },
    )


def main() -> None:
    """Make the map."""
    scenario_map.make_map(
        measure_scenario,
        kind="flats",
        method=METHOD,
        table=TABLE,
        cells=CELLS,
        repeats=REPEATS,
        about=__doc__,
    )
    plot_map(json.loads(TABLE.read_text()), FIGURE)


FIGURE = Path("docs/pictures/noise/gain-map.png")
LABELS = {
    "decay_ms": "decay of the screen (ms)",
    "interlaced_decay_ms": "the same, interlaced (ms)",
    "gain_range_db": "range of an automatic gain (dB)",
    "flicker": "rms flicker of the light (1)",
    "drift": "drift of the light, last over first less 1 (1)",
    "saturation": "brightest level / full scale (1)",
    "gamma": "exponent of the response (1)",
    "frames": "frames of each stack (1)",
    "rows": "rows, and columns less 8 (px)",
    "dim_dn": "signal of the brightest level (DN)",
}


def plot_map(found: Mapping[str, Any], path: Path) -> Path:
    """Draw the table of `benchmarks.studies.gain_map`; returns the path of the PNG."""
    scope = ("photoelectrons of the brightest level (1)", _brightest)
    return scenario_map.plot_map(
        found, path, breaking=BREAKING, labels=LABELS, scope=scope, columns=4
    )


def _brightest(number: int) -> float:
    return float(cell_of(number).scene.photoelectrons[-1])


if __name__ == "__main__":
    main()
