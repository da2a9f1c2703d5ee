"""How often intervals of the law of single photoelectrons hold, and where the law is lost.

`make study NAME=dark-events` measures both again and rewrites the table.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.events.event_measurements import measure_events
from charact.method import Context
from labdata import Conditions, FrameStack, Session
from labdata.measurement import intervals_of
from tests.truth.sessions import session_in_memory, stack_in_memory

Array = NDArray[np.float64]

# Pulses that fall beside the image still send light into it from so far, px.
OUTSIDE_PX = 12
# Light of earlier exposures is followed for so many.
FOLLOWED = 24
# Light of a pulse below this is none, DN.
LEAST_DN = 0.02


@dataclass(frozen=True, kw_only=True)
class DarkScene:
    """Dark frames of an intensified camera, with one knob for each way in which counting
    photoelectrons breaks.

    Parameters
    ----------
    density
        Detected events per pixel and exposure; of interlaced frames, per pixel of a field, which
        holds two rows.
    height_dn, relative_variance
        Mean pulse height, DN, and relative variance of the gamma law of heights; 0: all alike.
    spot_px
        Standard deviation of the Gaussian spot, px; pixels gather its light over their area.
    read_noise_dn, offset_dn, pattern_dn, full_scale_dn
        White noise, mean level, standard deviation of the pixels' levels, highest code, DN.
    ions, ion_height_dn
        Ion events per pixel and exposure, and their mean height, DN, gamma of shape 10.
    glow
        Share of a pulse's light that the screen gives off slowly.
    glow_exposures, fast_exposures
        Times in which the slow light and the rest fall to 1/e, exposures.
    interlaced
        Whether frames are made of two fields, each exposed by itself, whose pixels gather the light
        of two rows.
    hot
        Share of the pixels that flicker by themselves.
    frames, rows, cols
        Size of the stack.
    exposure_s
        Exposure, s; None leaves it unknown.
    """

    density: float = 0.01
    height_dn: float = 80.0
    relative_variance: float = 1.0
    spot_px: float = 0.7
    read_noise_dn: float = 2.0
    offset_dn: float = 100.3
    pattern_dn: float = 1.0
    full_scale_dn: float = 4095.0
    ions: float = 0.0
    ion_height_dn: float = 2500.0
    glow: float = 0.0
    glow_exposures: float = 2.0
    fast_exposures: float = 0.0
    interlaced: bool = False
    hot: float = 0.0
    frames: int = 64
    rows: int = 128
    cols: int = 128
    exposure_s: float | None = 0.02

    def session_drawn(self, rng: np.random.Generator) -> Session:
        """Draw the dark stack as a session."""
        level = self.offset_dn + self.pattern_dn * rng.standard_normal((self.rows, self.cols))
        hot = rng.random((self.rows, self.cols)) < self.hot
        light, codes = self._light(rng), []
        for number in range(self.frames):
            frame = light[number]
            noise = self.read_noise_dn * rng.standard_normal(frame.shape)
            noise += hot * 40.0 * self.read_noise_dn * (rng.random(frame.shape) < 0.3)
            codes.append(
                np.clip(np.rint(level + frame + noise), 0, self.full_scale_dn).astype(np.uint16)
            )
        stack = FrameStack(data=np.stack(codes), full_scale_dn=self.full_scale_dn)
        conditions = Conditions(exposure_s=self.exposure_s, mcp_v=800.0)
        entry = stack_in_memory("dark", stack, conditions)
        return session_in_memory((entry,))

    def _light(self, rng: np.random.Generator) -> Array:
        """Light of all frames, DN, shape (frame, row, col); the screen has glowed for long when
        they begin.
        """
        fields = 2 if self.interlaced else 1
        out = np.zeros((self.frames, self.rows, self.cols))
        before = FOLLOWED if self.glow or self.fast_exposures else 0
        for exposure in range(-before, fields * self.frames):
            y, x, height = self._events(rng)
            share = self._shares(rng.random(len(height)))
            for late in range(share.shape[1]):
                # What no code would ever show takes time for nothing.
                if len(height) == 0 or np.max(share[:, late] * height) < LEAST_DN:
                    break
                frame, field = divmod(exposure + late, fields)
                if not 0 <= frame < self.frames:
                    continue
                rows = out[frame, field::fields]
                # A field's pixel gathers two rows from its own on.
                rows += self._spots(
                    (y - 0.5 * field * (fields - 1)) / fields, x, height * share[:, late], len(rows)
                )
        return out

    def _events(self, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Rows and columns of one exposure's events, in rows of the frame, and their heights,
        DN.
        """
        rows, cols = self.rows + 4 * OUTSIDE_PX, self.cols + 2 * OUTSIDE_PX
        area = rows * cols / (2.0 if self.interlaced else 1.0)
        count, ions = rng.poisson(self.density * area), rng.poisson(self.ions * area)
        height = np.full(count, self.height_dn)
        if self.relative_variance > 0:
            height = height * rng.gamma(1.0 / self.relative_variance, self.relative_variance, count)
        height = np.concatenate([height, self.ion_height_dn * rng.gamma(10.0, 0.1, ions)])
        return (
            rng.uniform(0.0, rows, len(height)) - 2 * OUTSIDE_PX,
            rng.uniform(0.0, cols, len(height)) - OUTSIDE_PX,
            height,
        )

    def _shares(self, moment: Array) -> Array:
        """Shares of the light in each event's own and the following exposures, shape (event,
        exposure).
        """
        if not self.glow and not self.fast_exposures:
            return np.ones((len(moment), 1))
        late = np.zeros((len(moment), FOLLOWED + 1))
        for share, time in (
            (self.glow, self.glow_exposures),
            (1.0 - self.glow, self.fast_exposures),
        ):
            if time > 0:
                late += share * np.exp(-(np.arange(1.0, FOLLOWED + 2) - moment[:, None]) / time)
        return np.concatenate([1.0 - late[:, :1], late[:, :-1] - late[:, 1:]], axis=1)

    def _spots(self, y: Array, x: Array, height: Array, rows: int) -> Array:
        """Sum of spots at places in rows of the exposure and in columns, shape (row, col)."""
        from scipy.special import ndtr

        reach = int(np.ceil(5.0 * self.spot_px)) + 1
        step = np.arange(-reach, reach + 2)
        high, wide = rows + 2 * (reach + 1), self.cols + 2 * (reach + 1)
        inside = (y > -reach) & (y < rows + reach) & (x > -reach) & (x < self.cols + reach)
        y, x, height = y[inside] + reach + 1, x[inside] + reach + 1, height[inside]
        row, col = np.floor(y).astype(int), np.floor(x).astype(int)
        across, along = (
            max(self.spot_px, 1e-6),
            max(self.spot_px, 1e-6) / (2.0 if self.interlaced else 1.0),
        )
        down = np.diff(ndtr((row[:, None] + step - y[:, None]) / along), axis=1) * height[:, None]
        over = np.diff(ndtr((col[:, None] + step - x[:, None]) / across), axis=1)
        places = ((row[:, None] + step[:-1])[:, :, None] * wide) + (col[:, None] + step[:-1])[
            :, None, :
        ]
        kept = (row[:, None] + step[:-1] >= 0) & (row[:, None] + step[:-1] < high)
        fits = (
            kept[:, :, None]
            & ((col[:, None] + step[:-1] >= 0) & (col[:, None] + step[:-1] < wide))[:, None, :]
        )
        light = down[:, :, None] * over[:, None, :]
        image = np.asarray(np.bincount(places[fits], light[fits], high * wide), np.float64).reshape(
            high, wide
        )
        cut = reach + 1
        return image[cut : cut + rows, cut : cut + self.cols]


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
        return (
            self.low95 is not None
            and self.high95 is not None
            and self.low95 <= self.truth <= self.high95
        )

    @property
    def silent(self) -> bool:
        """Whether it is ok and the truth further off than twice the 95 % half-interval on its
        side.
        """
        if self.status != "ok" or self.value is None or self.low95 is None or self.high95 is None:
            return False
        half = self.high95 - self.value if self.truth > self.value else self.value - self.low95
        return abs(self.truth - self.value) > 2.0 * half


def measure_darks(
    axis: str, position: float, scene: DarkScene, seed: int
) -> tuple[EventCoverageResult, ...]:
    """Measure one stack of darks."""
    session = scene.session_drawn(np.random.default_rng(seed))
    result = measure_events(
        session.stacks[0], context=Context(seed=seed, quick=True, interlaced=scene.interlaced)
    )
    (height,) = result.find("detected_photoelectron_gain")
    out = []
    for name in NAMES:
        value, low, high = None, None, None
        if height.posterior is not None:
            value, _, (low, high) = intervals_of(height.posterior[name])
        out.append(
            EventCoverageResult(
                axis=axis,
                position=position,
                name=name,
                truth=float(getattr(scene, name)),
                value=value,
                low95=low,
                high95=high,
                status=height.status,
            )
        )
    return tuple(out)


def in_scope(rng: np.random.Generator) -> DarkScene:
    """Draw a scene inside the declared scope: pulses that stand out, in frames neither empty nor
    crowded.

    A third of the screens are dark at once, a third fast, a third slow. Half of the frames are
    interlaced, but for those of a fast screen, whose fields do not show its decay.
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
    "ion events over events": (
        (1e-4, 1e-3, 1e-2),
        lambda at: replace(BASE, ions=at * BASE.density),
    ),
    "share of slow light, two exposures long": (
        (0.02, 0.1, 0.3, 0.6),
        lambda at: replace(BASE, glow=at, fast_exposures=0.06),
    ),
    "exposures that all light lasts": (
        (0.02, 0.1, 0.3, 1.0),
        lambda at: replace(BASE, fast_exposures=at),
    ),
    "light of fields that spills over, fields": (
        (0.02, 0.06, 0.12),
        lambda at: replace(BASE, fast_exposures=at, interlaced=True),
    ),
    "flickering pixels": ((1e-4, 1e-3, 1e-2), lambda at: replace(BASE, hot=at)),
}


def tasks(seed: int, stacks: int, repeats: int) -> list[tuple[str, float, DarkScene, int]]:
    """Every stack to be measured."""
    rng = np.random.default_rng([seed, 1])
    out = [
        ("in scope", float(number), in_scope(rng), int(rng.integers(1 << 31)))
        for number in range(stacks)
    ]
    for axis, (positions, scene_at) in AXES.items():
        out += [
            (axis, float(at), scene_at(at), int(rng.integers(1 << 31)))
            for at in positions
            for _ in range(repeats)
        ]
    return out


def summary(found: Sequence[EventCoverageResult]) -> dict[str, float | int | str]:
    """Summarise the stacks of one place and parameter."""
    sure = [one for one in found if one.status == "ok"]
    error = [
        abs(one.value / one.truth - 1.0) for one in sure if one.value is not None and one.truth > 0
    ]
    return {
        "stacks": len(found),
        "ok": len(sure),
        "refused": sum(one.status == "refused" for one in found),
        "silent": sum(one.silent for one in found),
        "cover95": float(np.mean([one.holds for one in sure])) if sure else float("nan"),
        "error95_percent": 100.0 * float(np.quantile(error, 0.95)) if error else float("nan"),
    }


def group_by_parameter(
    found: Iterable[EventCoverageResult],
) -> dict[tuple[str, float, str], list[EventCoverageResult]]:
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
        rows = list(
            pool.map(
                measure_darks, *zip(*tasks(asked.seed, asked.stacks, asked.repeats), strict=True)
            )
        )
    found = [one for row in rows for one in row]
    table = [
        {"axis": axis, "position": position, "name": name, **summary(own)}
        for (axis, position, name), own in group_by_parameter(found).items()
    ]
    for line in table:
        print(
            "  ".join(
                f"{value:.4g}" if isinstance(value, float) else str(value)
                for value in line.values()
            )
        )
    place = Path(__file__).with_name("tables") / TABLE
    kept = {"seed": asked.seed, "summary": table, "stacks": [asdict(one) for one in found]}
    place.write_text(json.dumps(kept, indent=1, allow_nan=True).replace("NaN", "null") + "\n")


if __name__ == "__main__":
    main()
