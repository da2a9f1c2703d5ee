"""Measured and simulated frames under the same conditions, cropped to the same size."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from labdata.sensor import Sensor
from labdata.session import Kind, Session, StackEntry
from labdata.target import Target

# Size of a centred crop: sufficient for every statistic, and fast to simulate.
SHAPE = (192, 256)
# Size of an edge crop: pixels far from the edge add noise and little signal.
ALONG_EDGE, ACROSS_EDGE = 192, 72
FEWEST_FRAMES = 3


@dataclass(frozen=True, kw_only=True)
class MatchedFrames:
    """Frames of a stack that are compared: as in the session, their number, and corner and shape of the crop."""

    label: str
    kind: Kind
    conditions: Conditions
    target: Target
    frames: int
    corner: tuple[int, int]
    shape: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class MatchedStacks:
    """Stacks of a validation.

    `others` are for display only; `measured` has the frames by label, shape (frame, row, col), DN; `notes` name
    excluded stacks. Without an edge the MTF is not compared.
    """

    dark: MatchedFrames
    flats: tuple[MatchedFrames, ...]
    edge: MatchedFrames | None
    others: tuple[MatchedFrames, ...]
    measured: dict[str, NDArray]
    notes: tuple[str, ...]

    @property
    def compared(self) -> tuple[MatchedFrames, ...]:
        """Dark, flats and edge."""
        return (self.dark, *self.flats, *((self.edge,) if self.edge else ()))


def choose(session: Session) -> MatchedStacks:
    """Select a dark, up to three flats within the linear range, an edge, and stacks for display.

    Raises
    ------
    BadInput
        If there is no dark or no usable flat of at least three frames.
    """
    darks = _shots(session, "dark")
    if not darks:
        raise BadInput(
            f"a validation needs a dark stack of {FEWEST_FRAMES} frames or more, got none in {session.name!r}"
        )
    dark = max(darks, key=lambda item: item[0].frames)
    flats, notes = _flats(session)
    edges, bars, points = (_shots(session, kind) for kind in ("edge", "bars", "point"))
    if not edges:
        notes.append("no edge: the MTF is not compared")
    shown = bars[:1] + points[-1:]
    return MatchedStacks(
        dark=dark[0],
        flats=tuple(shot for shot, _ in flats),
        edge=edges[0][0] if edges else None,
        others=tuple(shot for shot, _ in shown),
        measured={shot.label: _cut(shot, entry) for shot, entry in (dark, *flats, *edges[:1], *shown)},
        notes=tuple(notes),
    )


def simulate_frames(sensor: Sensor, shots: tuple[MatchedFrames, ...], *, seed: int) -> dict[str, NDArray]:
    """Simulate frames of a sensor under the stacks' conditions by label, shape (frame, row, col), DN.

    The sensor is as small as the crop, and its fixed patterns follow from the sensor's name.
    """
    from simulate.lab import LabBench

    out, benches = {}, {}
    for index, shot in enumerate(shots):
        rows, columns = shot.shape
        if shot.shape not in benches:
            benches[shot.shape] = LabBench(replace(sensor, ccd=replace(sensor.ccd, rows=rows, columns=columns)))
        bench, target = benches[shot.shape], replace(shot.target, region=None)
        own = seed + 1000 * index
        out[shot.label] = bench.expose(shot.kind, target, shot.conditions, frames=shot.frames, seed=own).data
    return out


def _shots(session: Session, kind: Kind) -> list[tuple[MatchedFrames, StackEntry]]:
    """Return the stacks of a kind with enough frames and known light."""
    out = []
    for entry in session.of_kind(kind):
        frames, rows, columns = entry.read().shape
        if frames < FEWEST_FRAMES or (kind != "dark" and entry.conditions.illuminance_lux is None):
            continue
        height, width = SHAPE
        if kind == "edge":
            upright = abs(np.cos(np.deg2rad(entry.target.angle_deg or 0.0))) > np.sqrt(0.5)
            height, width = (ALONG_EDGE, ACROSS_EDGE) if upright else (ACROSS_EDGE, ALONG_EDGE)
        shape = (min(height, rows - rows % 2), min(width, columns))
        shot = MatchedFrames(
            label=entry.label, kind=entry.kind, conditions=entry.conditions, target=entry.target,
            frames=min(frames, 16 if kind == "edge" else 8), corner=_corner(entry.target, (rows, columns), shape),
            shape=shape,
        )  # fmt: skip
        out.append((shot, entry))
    return out


def _corner(target: Target, whole: tuple[int, int], shape: tuple[int, int]) -> tuple[int, int]:
    """Return the first row and column of a crop centred on the target; an even row keeps the field parity."""
    row, col, height, width = target.region or (0, 0, *whole)
    top = int(np.clip(round(row + (height - shape[0]) / 2), 0, whole[0] - shape[0]))
    left = int(np.clip(round(col + (width - shape[1]) / 2), 0, whole[1] - shape[1]))
    return top - top % 2, left


def _cut(shot: MatchedFrames, entry: StackEntry) -> NDArray:
    return np.array(entry.read().region(*shot.corner, *shot.shape).data[: shot.frames])


def _flats(session: Session) -> tuple[list[tuple[MatchedFrames, StackEntry]], list[str]]:
    """Select flats of low, medium and high signal; return them and notes on excluded ones."""
    sensor = session.sensor
    if sensor is None:
        raise BadInput(f"a validation needs a session of a described sensor, got none in {session.name!r}")
    full = float(2 ** (session.bit_depth or sensor.video.bit_depth) - 1)
    usable, notes = [], []
    for shot, entry in _shots(session, "flat"):
        frames = _cut(shot, entry)
        clipped = float(np.mean((frames >= full) | (frames <= 0)))
        if frames.mean() > 0.8 * full or clipped > 1e-3:
            notes.append(f"{shot.label} is outside the linear range")
        else:
            usable.append((float(frames.mean()), (shot, entry)))
    if not usable:
        raise BadInput(f"a validation needs a flat inside the range with {FEWEST_FRAMES} frames or more, got none")
    usable.sort(key=lambda item: item[0])
    picked = sorted({round(place) for place in np.linspace(0, len(usable) - 1, min(3, len(usable)))})
    return [usable[place][1] for place in picked], notes
