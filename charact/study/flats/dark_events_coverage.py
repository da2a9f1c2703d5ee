"""How often intervals of the law of single photoelectrons hold, and where the law is lost.

`make events-study` measures both again and rewrites the table.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np

from charact.method import Context
from charact.noise.events.event_measurements import measure_events
from charact.study.flats.dark_events import DarkScene
from labdata.measurement import intervals_of

NAMES = ("density", "height_dn", "relative_variance")
TABLE = "dark_events.json"


@dataclass(frozen=True, kw_only=True)
class EventCoverageResult:
    """What one stack of darks told of one parameter of the law.

    Parameters
    ----------
    axis, position
        What was swept and how far; "in scope" for scenes drawn at random.
    name, truth, value, low95, high95
        Parameter, its truth, and what was found; None where it was refused.
    status
        Of the mean pulse height.
    """

    axis: str
    position: float
    name: str
    truth: float
    value: float | None
    low95: float | None
    high95: float | None
    status: str

    @property
    def holds(self) -> bool:
        """Whether the 95 % interval holds the truth."""
        return self.low95 is not None and self.high95 is not None and self.low95 <= self.truth <= self.high95

    @property
    def silent(self) -> bool:
        """Whether it is ok and the truth further off than twice the 95 % half-interval on its side."""
        if self.status != "ok" or self.value is None or self.low95 is None or self.high95 is None:
            return False
        half = self.high95 - self.value if self.truth > self.value else self.value - self.low95
        return abs(self.truth - self.value) > 2.0 * half


def measure_darks(axis: str, position: float, scene: DarkScene, seed: int) -> tuple[EventCoverageResult, ...]:
    """Measure one stack of darks."""
    session = scene.session_drawn(np.random.default_rng(seed))
    result = measure_events(session.stacks[0], context=Context(seed=seed, quick=True, interlaced=scene.interlaced))
    (height,) = result.find("detected_photoelectron_gain")
    out = []
    for name in NAMES:
        value, low, high = None, None, None
        if height.posterior is not None:
            value, _, (low, high) = intervals_of(height.posterior[name])
        out.append(EventCoverageResult(axis=axis, position=position, name=name, truth=float(getattr(scene, name)), value=value,
                         low95=low, high95=high, status=height.status))  # fmt: skip
    return tuple(out)


def in_scope(rng: np.random.Generator) -> DarkScene:
    """Draw a scene inside the declared scope: pulses that stand out, in frames neither empty nor crowded.

    A third of the screens are dark at once, a third fast, a third slow. Half of the frames are interlaced, but for
    those of a fast screen, whose fields do not show its decay.
    """
    screen, interlaced = int(rng.integers(3)), bool(rng.integers(2))
    interlaced = interlaced and screen != 1
    return DarkScene(
        density=float(np.exp(rng.uniform(np.log(0.003), np.log(0.05)))),
        height_dn=float(np.exp(rng.uniform(np.log(60.0), np.log(300.0)))),
        relative_variance=float(rng.uniform(0.3, 1.2)),
        spot_px=float(rng.uniform(0.4, 1.2)),
        glow=float(rng.uniform(0.3, 0.6)) if screen == 2 else 0.0,
        glow_exposures=float(rng.uniform(1.0, 3.0)),
        fast_exposures=float(rng.uniform(0.02, 0.12)) if screen > 0 else 0.0,
        interlaced=interlaced,
        rows=256 if interlaced else 128,
    )


BASE = DarkScene()
# Axis: positions, and the scene at each.
AXES: dict[str, tuple[tuple[float, ...], Callable[[float], DarkScene]]] = {
    "events per pixel and frame": (
        (0.0, 1e-4, 5e-4, 2e-3, 0.01, 0.05, 0.2, 0.5),
        lambda at: replace(BASE, density=at),
    ),
    "mean height over read noise": (
        (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0),
        lambda at: replace(BASE, height_dn=at * BASE.read_noise_dn),
    ),
    "read noise, DN, height 40 times it": (
        (0.1, 0.2, 0.3, 0.4, 0.6, 1.0),
        lambda at: replace(BASE, read_noise_dn=at, height_dn=40.0 * at, pattern_dn=0.0),
    ),
    "frames": ((4, 8, 16, 32), lambda at: replace(BASE, frames=int(at))),
    "highest code, mean heights above the offset": (
        (0.3, 1.0, 3.0),
        lambda at: replace(BASE, full_scale_dn=round(BASE.offset_dn + at * BASE.height_dn)),
    ),
    "ion events over events": ((1e-4, 1e-3, 1e-2), lambda at: replace(BASE, ions=at * BASE.density)),
    "share of slow light, two exposures long": (
        (0.02, 0.1, 0.3, 0.6),
        lambda at: replace(BASE, glow=at, fast_exposures=0.06),
    ),
    "exposures that all light lasts": ((0.02, 0.1, 0.3, 1.0), lambda at: replace(BASE, fast_exposures=at)),
    "light of fields that spills over, fields": (
        (0.02, 0.06, 0.12),
        lambda at: replace(BASE, fast_exposures=at, interlaced=True),
    ),
    "flickering pixels": ((1e-4, 1e-3, 1e-2), lambda at: replace(BASE, hot=at)),
}


def tasks(seed: int, stacks: int, repeats: int) -> list[tuple[str, float, DarkScene, int]]:
    """Every stack to be measured."""
    rng = np.random.default_rng([seed, 1])
    out = [("in scope", float(number), in_scope(rng), int(rng.integers(1 << 31))) for number in range(stacks)]
    for axis, (positions, scene_at) in AXES.items():
        out += [(axis, float(at), scene_at(at), int(rng.integers(1 << 31))) for at in positions for _ in range(repeats)]
    return out


def summary(found: Sequence[EventCoverageResult]) -> dict[str, float | int | str]:
    """Summarise the stacks of one place and parameter."""
    sure = [one for one in found if one.status == "ok"]
    error = [abs(one.value / one.truth - 1.0) for one in sure if one.value is not None and one.truth > 0]
    return {
        "stacks": len(found),
        "ok": len(sure),
        "refused": sum(one.status == "refused" for one in found),
        "silent": sum(one.silent for one in found),
        "cover95": float(np.mean([one.holds for one in sure])) if sure else float("nan"),
        "error95_percent": 100.0 * float(np.quantile(error, 0.95)) if error else float("nan"),
    }


def group_by_parameter(found: Iterable[EventCoverageResult]) -> dict[tuple[str, float, str], list[EventCoverageResult]]:
    """Group by axis, position and parameter; scenes in scope are one place."""
    out: dict[tuple[str, float, str], list[EventCoverageResult]] = {}
    for one in found:
        position = 0.0 if one.axis == "in scope" else one.position
        out.setdefault((one.axis, position, one.name), []).append(one)
    return out


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=12)
    parser.add_argument("--stacks", type=int, default=60)
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    asked = parser.parse_args()
    with ProcessPoolExecutor(asked.workers) as pool:
        rows = list(pool.map(measure_darks, *zip(*tasks(asked.seed, asked.stacks, asked.repeats), strict=True)))
    found = [one for row in rows for one in row]
    table = [{"axis": axis, "position": position, "name": name, **summary(own)}
             for (axis, position, name), own in group_by_parameter(found).items()]  # fmt: skip
    for line in table:
        print("  ".join(f"{value:.4g}" if isinstance(value, float) else str(value) for value in line.values()))
    place = Path(str(resources.files("charact.study") / "tables")) / TABLE
    kept = {"seed": asked.seed, "summary": table, "stacks": [asdict(one) for one in found]}
    place.write_text(json.dumps(kept, indent=1, allow_nan=True).replace("NaN", "null") + "\n")


if __name__ == "__main__":
    main()
