"""Defects of cameras and benches that a lab would mind, each with its amount and the stacks that
show it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

Frames = NDArray[np.float64]

DARK, FLAT, FLATS, LIT = (
    ("dark",),
    ("bright",),
    ("low", "mid", "bright"),
    ("low", "mid", "bright", "edge", "point"),
)
ALL = ("dark", *LIT)


@dataclass(frozen=True, kw_only=True)
class Digitiser:
    """Black level and full scale, DN, and standard deviation in time of the stack's pixels, DN."""

    black: float
    top: float
    noise: float


@dataclass(frozen=True, kw_only=True)
class Defect:
    """One defect.

    `stacks`: labels of the stacks that have it; `groups`: groups of numbers that speak of it;
    `put`: changes frames (frame, row, col), or None where camera parameters are multiplied by
    `factors`, by path; `has_tube`: whether only cameras with, or without, a tube are meant.
    """

    name: str
    stacks: tuple[str, ...]
    groups: tuple[str, ...]
    put: Callable[[Frames, Digitiser, np.random.Generator], Frames] | None = None
    factors: Mapping[str, float] = field(default_factory=dict)
    has_tube: bool | None = None


def _scale(frames: Frames, factor: float | Frames, adc: Digitiser) -> Frames:
    """Multiply the signal above black."""
    return adc.black + (frames - adc.black) * factor


def _coordinates(frames: Frames) -> tuple[Frames, Frames]:
    """Return x and y over -1..1, shapes (1, col) and (row, 1)."""
    y, x = (np.linspace(-1.0, 1.0, size) for size in frames.shape[1:])
    return x[None, :], y[:, None]


def _fixed_hum(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    rows = np.arange(frames.shape[1])[:, None]
    return frames + 0.2 * adc.noise * np.sin(2.0 * np.pi * rows / 17.0 + rng.uniform(0.0, 6.0))


def _rolling_hum(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    phase = rng.uniform(0.0, 6.0, (len(frames), 1, 1))
    return frames + 0.2 * adc.noise * np.sin(
        2.0 * np.pi * np.arange(frames.shape[1])[:, None] / 17.0 + phase
    )


def _ghost(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    signal = frames.mean(axis=0) - adc.black
    moved = np.roll(signal, -30, axis=1)
    moved[:, -30:] = signal[:, -1:]
    return frames + 0.02 * moved


def _deviating_pixels(
    frames: Frames, adc: Digitiser, rng: np.random.Generator, sd: float
) -> Frames:
    rows, cols = (rng.integers(size, size=6) for size in frames.shape[1:])
    frames[:, rows, cols] += sd * adc.noise
    return frames


def _dead_column(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    column = frames.shape[2] // 3
    frames[:, :, column] = _scale(frames[:, :, column], 0.8, adc)
    return frames


def _hot_column(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    frames[:, :, frames.shape[2] // 3] += max(3.0 * adc.noise, 1.0)
    return frames


def _vignetting(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    x, y = _coordinates(frames)
    return _scale(frames, 1.0 - 0.025 * (x**2 + y**2), adc)


def _field_gain(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    frames[:, 1::2] = _scale(frames[:, 1::2], 1.01, adc)
    return frames


def _repeated_frame(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    frames[3] = frames[2]
    return frames


def average_pairs(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Replace each frame by its mean with the one before."""
    frames[1:] = (frames[1:] + frames[:-1]) / 2.0
    return frames


def _dropped_field(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    frames[2, 1:-1:2] = (frames[2, :-2:2] + frames[2, 2::2]) / 2.0
    return frames


def _amplifier_glow(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    y, x = np.indices(frames.shape[1:])
    return frames + 5.0 * adc.noise * np.exp(-np.hypot(x, y) / 15.0)


def _stuck_bit(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    bit = max(0, int(np.log2(max(adc.noise, 1.0) / 4.0)))
    return (frames.astype(np.int64) | (1 << bit)).astype(float)


def _clipping(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    return np.minimum(frames, 0.9 * adc.top)


def _gamma(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    span = adc.top - adc.black
    return adc.black + span * np.maximum((frames - adc.black) / span, 0.0) ** 0.95


def sharpen(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Mask unsharply by 30 % of 1 px."""
    return np.stack([one + 0.3 * (one - cv2.GaussianBlur(one, (0, 0), 1.0)) for one in frames])


def _cosmic_rays(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    for one in frames:
        for _ in range(3):
            row, col = rng.integers(one.shape[0] - 6), rng.integers(one.shape[1] - 6)
            one[row + np.arange(6), col + np.arange(6)] += 40.0 * adc.noise
    return frames


def _veiling_glare(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    signal = frames - adc.black
    return adc.black + 0.98 * signal + 0.02 * signal.mean()


def _lag(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    before = frames.copy()
    frames[1:] = 0.97 * before[1:] + 0.03 * before[:-1]
    return frames


def _dust(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    y, x = np.indices(frames.shape[1:])
    for _ in range(5):
        row, col = (rng.uniform(12.0, size - 12.0) for size in frames.shape[1:])
        frames = _scale(
            frames, 1.0 - 0.1 * np.exp(-(((y - row) ** 2 + (x - col) ** 2) / 6.0**2)), adc
        )
    return frames


def _jitter(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    rows, cols = frames.shape[1:]
    y, x = (grid.astype(np.float32) for grid in np.mgrid[:rows, :cols])
    moved = [
        cv2.remap(
            one.astype(np.float32),
            x + np.float32(0.3) * rng.standard_normal((rows, 1)).astype(np.float32),
            y,
            cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for one in frames
    ]
    return np.stack(moved).astype(float)


def bend(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Lower the signal s to s (1 - 0.1 s / full), before the digitiser rounds."""
    signal = frames + rng.uniform(-0.5, 0.5, frames.shape) - adc.black
    return adc.black + signal * (1.0 - 0.1 * signal / (adc.top - adc.black))


def gamma_of_codes(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Raise the code over full scale to the power 0.8, before the digitiser rounds."""
    return (
        adc.top * (np.maximum(frames + rng.uniform(-0.5, 0.5, frames.shape), 0.0) / adc.top) ** 0.8
    )


def keep_eight_bits(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Leave out all but the highest 8 bits, or the two lowest of 8."""
    step = max(4.0, (adc.top + 1.0) / 256.0)
    return step * np.floor(frames / step)


def blur_off_axis(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Blur by a Gaussian of 0 px at the centre to 1.5 px standard deviation in the corner."""
    x, y = _coordinates(frames)
    place = np.hypot(x, y) / np.sqrt(2.0) * 10.0
    low = np.minimum(place.astype(int), 9)
    out = np.empty_like(frames)
    for index, one in enumerate(frames):
        steps = np.stack(
            [one, *(cv2.GaussianBlur(one, (15, 15), 0.15 * sd) for sd in range(1, 11))]
        )
        inner, outer = (np.take_along_axis(steps, (low + more)[None], axis=0)[0] for more in (0, 1))
        out[index] = inner + (place - low) * (outer - inner)
    return out


def blur_lens_off_axis(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Blur the mean frame off axis as a lens does, which leaves the noise of photons as it is."""
    mean = frames.mean(axis=0, keepdims=True)
    return frames + blur_off_axis(mean, adc, rng) - mean


def step_gain(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    """Raise the gain by 2 % in the middle of the stack."""
    half = len(frames) // 2
    frames[half:] = _scale(frames[half:], 1.02, adc)
    return frames


def _dead_pixels(frames: Frames, adc: Digitiser, rng: np.random.Generator) -> Frames:
    rows, cols = (rng.integers(size, size=6) for size in frames.shape[1:])
    frames[:, rows, cols] = _scale(frames[:, rows, cols], 0.5, adc)
    return frames


PATTERN, TIME, SPACE = (
    ("fixed-pattern", "defects"),
    ("time", "rows-and-columns"),
    ("autocorrelation", "noise-spectrum"),
)

# Defects that are put into frames.
OF_FRAMES = (
    Defect(name="fixed hum, 0.2 of the noise", stacks=FLAT, groups=PATTERN, put=_fixed_hum),
    Defect(
        name="rolling hum, 0.2 of the noise", stacks=FLAT, groups=(*SPACE, *TIME), put=_rolling_hum
    ),
    Defect(name="ghost of the edge, 2 %", stacks=("edge",), groups=("edge", "mtf"), put=_ghost),
    Defect(name="ghost of the point, 2 %", stacks=("point",), groups=("point",), put=_ghost),
    Defect(
        name="6 hot pixels, 12 sd",
        stacks=DARK,
        groups=PATTERN,
        put=lambda frames, adc, rng: _deviating_pixels(frames, adc, rng, 12.0),
    ),
    Defect(name="6 dead pixels, half the signal", stacks=FLAT, groups=PATTERN, put=_dead_pixels),
    Defect(name="dead column, 0.8 of the signal", stacks=FLAT, groups=PATTERN, put=_dead_column),
    Defect(name="hot column, 3 sd", stacks=DARK, groups=PATTERN, put=_hot_column),
    Defect(
        name="vignetting, 5 % in the corner", stacks=FLATS, groups=("shading",), put=_vignetting
    ),
    Defect(
        name="tilt of the light, 3 % over the width",
        stacks=FLATS,
        groups=("shading",),
        put=lambda frames, adc, rng: _scale(frames, 1.0 + 0.015 * _coordinates(frames)[0], adc),
    ),
    Defect(
        name="fixed rows, 0.5 %",
        stacks=FLATS,
        groups=PATTERN,
        put=lambda frames, adc, rng: _scale(
            frames, 1.0 + 0.005 * rng.standard_normal((frames.shape[1], 1)), adc
        ),
    ),
    Defect(
        name="fixed columns, 0.5 %",
        stacks=FLATS,
        groups=PATTERN,
        put=lambda frames, adc, rng: _scale(
            frames, 1.0 + 0.005 * rng.standard_normal(frames.shape[2]), adc
        ),
    ),
    Defect(
        name="row noise, 0.2 of the noise",
        stacks=FLAT,
        groups=(*SPACE, *TIME),
        put=lambda frames, adc, rng: (
            frames + 0.2 * adc.noise * rng.standard_normal((*frames.shape[:2], 1))
        ),
    ),
    Defect(name="gain of odd rows, 1 %", stacks=FLATS, groups=PATTERN, put=_field_gain),
    Defect(name="a repeated frame", stacks=FLAT, groups=("time",), put=_repeated_frame),
    Defect(
        name="mean of two frames",
        stacks=FLATS,
        groups=("time", "photon-transfer"),
        put=average_pairs,
    ),
    Defect(
        name="a field interpolated from the other",
        stacks=FLAT,
        groups=("time", *SPACE),
        put=_dropped_field,
    ),
    Defect(
        name="dark shading, 0.5 sd or 1 DN",
        stacks=DARK,
        groups=("shading",),
        put=lambda frames, adc, rng: frames + max(0.5 * adc.noise, 1.0) * _coordinates(frames)[1],
    ),
    Defect(
        name="amplifier glow, 5 sd", stacks=DARK, groups=("shading", *PATTERN), put=_amplifier_glow
    ),
    Defect(
        name="stuck bit of a quarter of the noise",
        stacks=FLATS,
        groups=("histogram",),
        put=_stuck_bit,
    ),
    Defect(
        name="clipping at 90 % of full scale",
        stacks=ALL,
        groups=("histogram", "point"),
        put=_clipping,
    ),
    Defect(
        name="clipping at the black level",
        stacks=DARK,
        groups=("histogram", "photon-transfer", "dark-events"),
        put=lambda frames, adc, rng: np.maximum(frames, np.rint(adc.black)),
    ),
    Defect(
        name="gamma of 0.95",
        stacks=LIT,
        groups=("level", "photon-transfer", "linearity", "edge", "covariance"),
        put=_gamma,
    ),
    Defect(
        name="blur of 1.5 px in the corners",
        stacks=FLAT,
        groups=("field", *SPACE),
        put=blur_off_axis,
    ),
    Defect(
        name="sharpening, 30 % of 1 px", stacks=LIT, groups=("mtf", "edge", *SPACE), put=sharpen
    ),
    Defect(
        name="interpolation of 0.25 px",
        stacks=FLAT,
        groups=SPACE,
        put=lambda frames, adc, rng: 0.75 * frames + 0.25 * np.roll(frames, 1, axis=2),
    ),
    Defect(
        name="salt noise, 5e-5",
        stacks=DARK,
        groups=("histogram", "dark-events"),
        put=lambda frames, adc, rng: np.where(rng.random(frames.shape) < 5e-05, adc.top, frames),
    ),
    Defect(
        name="3 cosmic rays a frame, 40 sd",
        stacks=DARK,
        groups=("histogram", "dark-events"),
        put=_cosmic_rays,
    ),
    Defect(
        name="drift of 2 % over the stack",
        stacks=FLAT,
        groups=TIME,
        put=lambda frames, adc, rng: _scale(
            frames, 1.0 + 0.02 * np.linspace(-0.5, 0.5, len(frames))[:, None, None], adc
        ),
    ),
    Defect(
        name="flicker of 1 %",
        stacks=FLAT,
        groups=TIME,
        put=lambda frames, adc, rng: _scale(
            frames, 1.0 + 0.01 * rng.standard_normal((len(frames), 1, 1)), adc
        ),
    ),
    Defect(name="veiling glare, 2 %", stacks=("edge",), groups=("edge", "mtf"), put=_veiling_glare),
    Defect(name="lag of 3 % a frame", stacks=LIT, groups=("time",), put=_lag),
    Defect(
        name="PRNU, 1 %",
        stacks=FLATS,
        groups=PATTERN,
        put=lambda frames, adc, rng: _scale(
            frames, 1.0 + 0.01 * rng.standard_normal(frames.shape[1:]), adc
        ),
    ),
    Defect(name="5 dust spots, 10 %", stacks=FLATS, groups=PATTERN, put=_dust),
    Defect(name="jitter of rows, 0.3 px", stacks=("edge",), groups=("edge", "mtf"), put=_jitter),
    Defect(
        name="lowest bit left out",
        stacks=ALL,
        groups=("histogram", "level"),
        put=lambda frames, adc, rng: 2.0 * (frames // 2.0),
    ),
)

# Defects that are parameters of the camera; a camera has those whose paths it knows.
OF_CAMERA = (
    # 4 to 6.8 um: with an MTF50 of 0.2 cycles per pixel of 18 um at the cathode, or 4 to 4.6 um: of
    # 0.48 per 16 um.
    Defect(
        name="defocus, MTF50 6 % lower",
        stacks=("edge",),
        groups=("mtf", "edge", "point"),
        has_tube=True,
        factors={"optics.aberration_blur_um": 1.71},
    ),
    Defect(
        name="defocus, MTF50 6 % lower",
        stacks=("edge",),
        groups=("mtf", "edge", "point"),
        has_tube=False,
        factors={"optics.aberration_blur_um": 1.16},
    ),
    Defect(
        name="EBI, or dark current, x 50",
        stacks=ALL,
        groups=("dark-events", "photon-transfer", "level"),
        factors={"photocathode.ebi_lm_per_cm2": 50.0, "ccd.dark_current_e_per_s": 50.0},
    ),
    Defect(
        name="ions, or clock-induced charge, x 100",
        stacks=ALL,
        groups=("dark-events", "histogram", "covariance"),
        factors={
            "microchannel_plate.ion_event_rate_per_s_cm2": 100.0,
            "register.clock_induced_e": 100.0,
        },
    ),
    Defect(name="DSNU x 40", stacks=ALL, groups=PATTERN, factors={"ccd.dsnu_e": 40.0}),
    Defect(
        name="line noise x 20",
        stacks=ALL,
        groups=(*SPACE, *TIME),
        factors={"video.line_noise_dn": 20.0},
    ),
    Defect(
        name="fibre pattern x 4",
        stacks=LIT,
        groups=PATTERN,
        factors={"taper.pattern_contrast": 4.0},
    ),
    # Excess noise 1 + 1 / shape of 2 becomes 2.4.
    Defect(
        name="excess noise, 20 %",
        stacks=LIT,
        groups=("photon-transfer", "covariance"),
        factors={
            "microchannel_plate.pulse_height_shape": 0.714,
            "register.pulse_height_shape": 0.714,
        },
    ),
)
DEFECTS = (*OF_FRAMES, *OF_CAMERA)
