"""Faults of camera, bench and grabber that are put into simulated frames, each by its size, and
what settles them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise import findings
from charact.estimators.noise.findings import Cause
from charact.validation.frames import MatchedStacks

Frames = NDArray[np.floating]
# Seed of the faults, the same for each size.
SEED = 5
# Period of a hum, rows.
HUM_ROWS = 17.0
# Standard deviation of a spot of dust, px.
DUST_PX = 3.5
# Standard deviation of the blur of a mask that sharpens, px.
MASK_PX = 1.0


@dataclass(frozen=True, kw_only=True)
class StackLevels:
    """Black level, signal of the brightest flat, and standard deviation of a pixel of the stack in
    time, DN.
    """

    black_dn: float
    bright_dn: float
    noise_dn: float


Put = Callable[[Frames, float, StackLevels, np.random.Generator], Frames]


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault that is put into frames (frame, row, col).

    Parameters
    ----------
    name, cause, flag
        What it is, the stage with what settles it, and a key of `labdata.flags.FLAGS`.
    put
        Returns frames with the fault of a size.
    size, unit
        Size that is simulated first: "%", "px", "sd" of the noise, or "" of one that has none.
    power
        Power of the size that small changes of the numbers follow, 2 of a noise.
    two_sided
        Whether the size may be negative.
    stacks
        The stacks that may have it: "dark", "bright" flat, "lit" ones, "all", or a kind of target.
    control
        Name of its negative control, of the first stacks; empty: it has none.
    of_maps
        Whether it departs from maps of the specimen, so that a session without any has none.
    """

    name: str
    cause: Cause
    flag: str
    put: Put
    size: float = 1.0
    unit: str = ""
    power: int = 1
    two_sided: bool = False
    stacks: tuple[str, ...] = ("all",)
    control: str = ""
    of_maps: bool = False

    def labels(self, chosen: MatchedStacks, stacks: str) -> tuple[str, ...]:
        """Return the labels of stacks; empty where the session has none."""
        if self.of_maps and chosen.maps is None:
            return ()
        shots = {
            "dark": [chosen.dark],
            "bright": [chosen.flats[-1]],
            "edge": [chosen.edge],
            "flats": list(chosen.flats),
            "lit": [*chosen.flats, chosen.edge, chosen.point],
            "all": list(chosen.compared),
        }[stacks]
        return tuple(shot.label for shot in shots if shot is not None)

    def put_into(
        self,
        frames: Mapping[str, NDArray],
        chosen: MatchedStacks,
        stacks: str,
        full_dn: float,
        size: float | None = None,
    ) -> dict[str, NDArray]:
        """Return frames with the fault, in whole DN within the digitiser's range."""
        changed = dict(frames)
        black_dn, bright_dn = (
            float(frames[shot.label].mean()) for shot in (chosen.dark, chosen.flats[-1])
        )
        for index, label in enumerate(self.labels(chosen, stacks)):
            before = frames[label].astype(float)
            levels = StackLevels(
                black_dn=black_dn,
                bright_dn=bright_dn - black_dn,
                noise_dn=float(before.std(axis=0).mean()),
            )
            rng = np.random.default_rng([SEED, index])
            after = self.put(before, self.size if size is None else size, levels, rng)
            changed[label] = np.clip(np.rint(after), 0.0, full_dn).astype(frames[label].dtype)
        return changed


def _scaled(frames: Frames, factor: Frames | float, levels: StackLevels) -> Frames:
    """Multiply the signal above black."""
    return levels.black_dn + (frames - levels.black_dn) * factor


def _over_field(frames: Frames) -> tuple[Frames, Frames]:
    """Return x and y over -1..1, shapes (1, col) and (row, 1)."""
    y, x = (np.linspace(-1.0, 1.0, size) for size in frames.shape[1:])
    return x[None, :], y[:, None]


def _hot_pixels(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    rows, cols = (rng.integers(length, size=6) for length in frames.shape[1:])
    frames[:, rows, cols] += size * levels.noise_dn
    return frames


def _cosmic_rays(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    rows, cols = (rng.integers(length - 6, size=(len(frames), 3, 1)) for length in frames.shape[1:])
    step = np.arange(6)
    frames[np.arange(len(frames))[:, None, None], rows + step, cols + step] += (
        size * levels.noise_dn
    )
    return frames


def _spots(frames: Frames, rng) -> Frames:
    """Return five spots of height 1, shape (row, col)."""
    rows, cols = np.indices(frames.shape[1:])
    centres = rng.uniform(0.1, 0.9, (5, 2)) * frames.shape[1:]
    squares = np.array([(rows - row) ** 2 + (cols - col) ** 2 for row, col in centres])
    return np.exp(-0.5 * squares / DUST_PX**2).max(axis=0)


def _hum(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(frames), 1))
    wave = np.sin(2.0 * np.pi * np.arange(frames.shape[1]) / HUM_ROWS + phase)
    return frames + size * levels.noise_dn * wave[:, :, None]


def _repeat_frame(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    frames[-1] = frames[-2]
    return frames


def _average(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    share = min(size / 100.0, 0.5)
    frames[1:] = (1.0 - share) * frames[1:] + share * frames[:-1]
    return frames


def _flicker(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    change = rng.standard_normal((len(frames), 1, 1))
    return _scaled(frames, 1.0 + size / 100.0 * change / change.std(), levels)


def _bend(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    # Before the digitiser rounds: whole codes would leave gaps.
    frames = frames + rng.uniform(-0.5, 0.5, frames.shape)
    share = (frames - levels.black_dn) / max(levels.bright_dn, 1.0)
    return _scaled(frames, 1.0 - size / 100.0 * share, levels)


def _uneven_codes(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    """Give values of even codes, or of odd ones where `size` is negative, to the next code."""
    narrow = frames % 2 == (size < 0.0)
    return frames + (narrow & (rng.random(frames.shape) < abs(size) / 100.0))


def _stuck_bit(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    bit = max(0, int(np.log2(max(size * levels.noise_dn, 1.0))))
    return (frames.astype(np.int64) | (1 << bit)).astype(float)


def _smooth(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    import cv2

    return np.stack([cv2.GaussianBlur(image, (0, 0), max(size, 0.05)) for image in frames])


def _blur_off_axis(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    """Blur by a standard deviation that grows from 0 at the centre to `size` in the corner."""
    x, y = _over_field(frames)
    place = np.hypot(x, y) / np.sqrt(2.0) * 4.0
    steps = np.stack(
        [frames, *(_smooth(frames, size * at / 4.0, levels, rng) for at in (1, 2, 3, 4))]
    )
    weights = np.maximum(1.0 - np.abs(place - np.arange(5)[:, None, None]), 0.0)
    return np.einsum("srt,sfrt->frt", weights, steps)


def _blur_lens_off_axis(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    # The noise of the photons is not blurred by a lens.
    mean = frames.mean(axis=0, keepdims=True)
    return frames + _blur_off_axis(mean, size, levels, rng) - mean


def _jitter(frames: Frames, size: float, levels: StackLevels, rng) -> Frames:
    import cv2

    rows, cols = frames.shape[1:]
    y, x = (grid.astype(np.float32) for grid in np.mgrid[:rows, :cols])
    moved = [
        cv2.remap(
            image.astype(np.float32),
            x + (size * rng.standard_normal((rows, 1))).astype(np.float32),
            y,
            cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for image in frames
    ]
    return np.stack(moved).astype(float)


DUST = Cause(stage="dust on a window, the target or the sensor", remedy="clean ones, or new maps")
KNOWN = (
    Fault(
        name="hot pixels",
        cause=Cause(
            stage="pixels of the sensor", remedy="a cooler sensor, or a map of its defects"
        ),
        flag="defects",
        put=_hot_pixels,
        size=25.0,
        unit="sd",
        stacks=("dark", "all"),
        control="hot pixels",
    ),
    Fault(
        name="cosmic rays or sparks",
        cause=Cause(stage="events in the sensor", remedy="frames without them, or shorter ones"),
        flag="defects",
        put=_cosmic_rays,
        size=40.0,
        unit="sd",
        stacks=("dark", "all"),
        control="three cosmic rays a frame",
    ),
    Fault(
        name=f"dust in spots of {DUST_PX:g} px",
        cause=DUST,
        flag="defects",
        put=lambda frames, size, levels, rng: _scaled(
            frames, 1.0 - size / 100.0 * _spots(frames, rng), levels
        ),
        size=10.0,
        unit="%",
        stacks=("flats", "lit"),
    ),
    Fault(
        name="dust that has moved",
        cause=DUST,
        flag="defects",
        put=lambda frames, size, levels, rng: _scaled(
            frames, 1.0 + size / 100.0 * (_spots(frames, rng) - _spots(frames, rng)), levels
        ),
        size=10.0,
        unit="%",
        stacks=("flats", "lit"),
        of_maps=True,
    ),
    Fault(
        name="hum",
        cause=Cause(stage="interference in the read-out", remedy="another supply, or grounding"),
        flag="correlated-noise",
        put=_hum,
        size=0.5,
        unit="sd",
        power=2,
        stacks=("bright", "all"),
        control="rolling hum of half the noise",
    ),
    Fault(
        name="noise of rows",
        cause=Cause(stage="clamp or supply of the read-out", remedy="`method` covariance-sum"),
        flag="correlated-noise",
        put=lambda frames, size, levels, rng: (
            frames + size * levels.noise_dn * rng.standard_normal((*frames.shape[:2], 1))
        ),
        size=0.2,
        unit="sd",
        power=2,
        stacks=("bright", "all"),
    ),
    Fault(
        name="a repeated frame",
        cause=Cause(stage="a grabber that lost a frame", remedy="frames that differ"),
        flag="processed",
        put=_repeat_frame,
        stacks=("bright", "dark", "all"),
        control="a repeated frame",
    ),
    Fault(
        name="average with earlier frames",
        cause=findings.AVERAGED,
        flag="processed",
        put=_average,
        size=30.0,
        unit="%",
        stacks=("all", "flats"),
    ),
    Fault(
        name="image lag",
        cause=findings.LAGGING,
        flag="lag",
        put=_average,
        size=5.0,
        unit="%",
        stacks=("lit",),
    ),
    Fault(
        name="flicker of the lamp",
        cause=findings.UNSTEADY,
        flag="flicker",
        put=_flicker,
        size=1.0,
        unit="%",
        power=2,
        stacks=("bright", "lit"),
        control="lamp flicker of 1 %",
    ),
    Fault(
        name="drift over the stack",
        cause=findings.UNSTEADY,
        flag="drift",
        put=lambda frames, size, levels, rng: _scaled(
            frames, 1.0 + size / 100.0 * np.linspace(-0.5, 0.5, len(frames))[:, None, None], levels
        ),
        size=2.0,
        unit="%",
        two_sided=True,
        stacks=("bright", "lit"),
    ),
    Fault(
        name="bend of the response up to the brightest flat",
        cause=findings.CURVED,
        flag="nonlinear",
        put=_bend,
        size=3.0,
        unit="%",
        two_sided=True,
        stacks=("lit",),
    ),
    Fault(
        name="vignetting in the corner",
        cause=Cause(stage="lens or light", remedy="a map of the light, or an even one"),
        flag="gradient",
        put=lambda frames, size, levels, rng: _scaled(
            frames, 1.0 - size / 200.0 * sum(at**2 for at in _over_field(frames)), levels
        ),
        size=10.0,
        unit="%",
        two_sided=True,
        stacks=("flats", "lit"),
        control="vignetting of 10 %",
    ),
    *(
        Fault(
            name=f"tilt of the light over the {length}",
            cause=Cause(stage="light", remedy="a map of the light, or an even one"),
            flag="gradient",
            put=lambda frames, size, levels, rng, axis=axis: _scaled(
                frames, 1.0 + size / 200.0 * _over_field(frames)[axis], levels
            ),
            size=5.0,
            unit="%",
            two_sided=True,
            stacks=("flats",),
        )
        for axis, length in enumerate(("width", "height"))
    ),
    *(
        Fault(
            name=f"{bits} low bits left out",
            cause=findings.COARSE,
            flag="quantised",
            put=lambda frames, size, levels, rng: (
                2.0 ** round(size) * np.floor(frames / 2.0 ** round(size))
            ),
            size=float(bits),
            stacks=("all", "bright"),
            control="lowest bit left out" if bits == 1 else "",
        )
        for bits in (1, 2, 4)
    ),
    Fault(
        name="odd codes wider than even ones",
        cause=Cause(
            stage="converter (differential nonlinearity)", remedy="noise of several DN, or dither"
        ),
        flag="nonlinear",
        put=_uneven_codes,
        size=5.0,
        unit="%",
        two_sided=True,
    ),
    Fault(
        name="a stuck bit",
        cause=findings.COARSE,
        flag="quantised",
        put=_stuck_bit,
        size=0.25,
        stacks=("flats", "all"),
    ),
    Fault(
        name="sharpening",
        cause=findings.SHARPENED,
        flag="processed",
        put=lambda frames, size, levels, rng: (
            frames + size / 100.0 * (frames - _smooth(frames, MASK_PX, levels, rng))
        ),
        size=30.0,
        unit="%",
        stacks=("lit", "all"),
    ),
    Fault(
        name="smoothing",
        cause=findings.SPREAD,
        flag="processed",
        put=_smooth,
        size=0.4,
        unit="px",
        power=2,
        stacks=("bright", "all"),
    ),
    Fault(
        name="blur of the frames off axis, in the corner",
        cause=findings.OFF_AXIS,
        flag="correlated-noise",
        put=_blur_off_axis,
        size=1.5,
        unit="px",
        power=2,
        stacks=("bright", "all"),
    ),
    Fault(
        name="blur of the lens off axis, in the corner",
        cause=findings.LENS_OFF_AXIS,
        flag="model-misfit",
        put=_blur_lens_off_axis,
        size=1.5,
        unit="px",
        power=2,
        stacks=("edge",),
    ),
    Fault(
        name="jitter of rows",
        cause=Cause(stage="clock of camera or grabber", remedy="a digital or a pixel-locked one"),
        flag="model-misfit",
        put=_jitter,
        size=0.3,
        unit="px",
        power=2,
        stacks=("edge", "all"),
    ),
    Fault(
        name="veiling glare",
        cause=Cause(stage="lens", remedy="a hood, or the description of the glare"),
        flag="model-misfit",
        put=lambda frames, size, levels, rng: frames + size / 100.0 * (frames.mean() - frames),
        size=2.0,
        unit="%",
        stacks=("edge",),
    ),
)
# Faults of the negative controls by name.
FAULTS = {fault.control: fault for fault in KNOWN if fault.control}
