"""Sessions of a point source far too bright before an intensified camera, drawn in closed form.

Neither the simulator nor a formula of the analysis has a part in it. The light meets the MCP (which
saturates), comes as pulses of random height, is blurred after the gain, overflows its columns,
smears them, is held by an automatic gain, read and digitised.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labdata import FrameStack, Session
from tests.truth.bloom_light import FINE, BloomScene, at_pixels, optics_of, picture_of
from tests.truth.sessions import session_in_memory, tube_stack

Array = NDArray[np.float64]


def noiseless_frame(scene: BloomScene, overload: float, *, faintest: float | None = None) -> Array:
    """Return the noiseless picture of a source that stands still, not clipped and not digitised,
    (row, col), DN.

    `faintest` is that of `stack`.
    """
    light = overload * scene.span_dn * picture_of(optics_of(scene), 0.0) + scene.background_dn
    charge = _columns(scene, _after_gain(scene, _plate(scene, light)))
    return scene.dark_dn + _gain(scene, overload, faintest) * charge


def stack(
    scene: BloomScene, overload: float, rng: np.random.Generator, *, faintest: float | None = None
) -> FrameStack:
    """Draw the frames of one level.

    `faintest`: overload of the faintest level, to whose mean an automatic gain returns; None: this
    is the faintest.
    """
    first = 0 if scene.lag > 0 else 1
    moves = [
        scene.motion_px * (frame - (scene.frames + 1) / 2)
        for frame in range(first, scene.frames + 1)
    ]
    pictures = [
        picture_of(optics_of(scene), move) for move in (moves if scene.motion_px else [0.0])
    ]
    light = overload * scene.span_dn * np.stack(pictures) + scene.background_dn
    mean = _plate(scene, light)
    noise = _pulses(scene, at_pixels(light), len(moves), rng) - at_pixels(mean)
    pulses = _after_gain(scene, mean) + _blur_light(scene, noise)
    if scene.lag > 0:
        pulses = (1.0 - scene.lag) * pulses[1:] + scene.lag * pulses[:-1]
    charge = _gain(scene, overload, faintest) * _columns(scene, pulses)
    return digitise_frames(scene, scene.dark_dn + charge, rng)


def _plate(scene: BloomScene, light: Array) -> Array:
    """Mean light after the plate, whose gain falls with it."""
    return light / (1.0 + light / _half_gain(scene))


def _half_gain(scene: BloomScene) -> float:
    return np.inf if scene.plate_saturation_dn is None else scene.plate_saturation_dn


def _pulses(scene: BloomScene, light: Array, frames: int, rng: np.random.Generator) -> Array:
    """Pulses of the photoelectrons where they fell, DN, (frame, row, col): the plate's gain falls
    with the light.
    """
    height = scene.photoelectron_dn / (1.0 + light / _half_gain(scene))
    mean = np.broadcast_to(light / scene.photoelectron_dn, (frames, scene.rows, scene.cols))
    # From so many photoelectrons on their summed pulses are as good as normal.
    bright = mean > 50.0
    out = np.empty(mean.shape)
    out[bright] = mean[bright] + np.sqrt(mean[bright] * scene.excess) * rng.standard_normal(
        int(bright.sum())
    )
    counted = rng.poisson(mean[~bright])
    if scene.excess > 1:
        shape = 1.0 / (scene.excess - 1.0)
        out[~bright] = rng.standard_gamma(shape * counted) / shape
    else:
        out[~bright] = counted
    return height * out


def _after_gain(scene: BloomScene, light: Array) -> Array:
    """Blur light that is given `FINE` times as finely as pixels, and return it at pixels.

    A Gaussian of 0.5 px that is sampled at pixels is 6 % narrower than it says.
    """
    return at_pixels(_blur_light(scene, light, FINE))


def _blur_light(scene: BloomScene, light: Array, finer: int = 1) -> Array:
    """Blur along the last two axes, which have so many samples in a pixel."""
    from scipy.ndimage import gaussian_filter

    sigma = finer * scene.post_gain_sigma_px
    if sigma <= 0:
        return light
    axes = (light.ndim - 2, light.ndim - 1)
    return gaussian_filter(
        light, (sigma / scene.row_pitch, sigma), axes=axes, mode="nearest", truncate=5.0
    )


def _columns(scene: BloomScene, light: Array) -> Array:
    """What the columns of the sensor make of the light: overflow, then smear, shape (.., row,
    col).
    """
    charge = light
    if scene.full_well_dn is not None:
        charge = apply_column_blooming(light, scene.full_well_dn)
    if scene.smear_fraction > 0:
        charge = charge + scene.smear_fraction * light.mean(axis=-2, keepdims=True)
    return charge


def apply_column_blooming(charge: Array, holds: float) -> Array:
    """Return charge settled along its columns: what a pixel cannot hold spills half up and half
    down, over and over.

    `charge`: before, shape (.., row, col); `holds`: most that a pixel keeps; what spills over an
    end of the column is gone. With u the charge that each pixel ever passed on, the settled column
    is q + u''/2 and never above the limit c, with u >= 0 and u = 0 where it stays below: u is the
    distance of a curve whose second difference is 2 (c - q) from its greatest convex minorant,
    whose slopes are the isotonic regression of the curve's.
    """
    from scipy.optimize import isotonic_regression

    out = charge.copy()
    for index in zip(*np.nonzero(charge.max(axis=-2) > holds), strict=True):
        column = (*index[:-1], slice(None), index[-1])
        slopes = np.concatenate([[0.0], np.cumsum(2.0 * (holds - charge[column]))])
        out[column] = holds - 0.5 * np.diff(isotonic_regression(slopes).x)
    return out


def _gain(scene: BloomScene, overload: float, faintest: float | None) -> float:
    """Factor by which an automatic gain brings the mean, light beyond full scale cut off, to the
    faintest level's.
    """
    if not scene.agc or faintest is None:
        return 1.0
    fixed = replace(scene, agc=False)
    means = [
        np.minimum(noiseless_frame(fixed, level) - scene.dark_dn, scene.span_dn).mean()
        for level in (faintest, overload)
    ]
    return float(means[0] / means[1])


def digitise_frames(scene: BloomScene, level_dn: Array, rng: np.random.Generator) -> FrameStack:
    """Read frames of given levels, shape (frame, row, col), DN: white noise, whole codes, the
    highest one.
    """
    noisy = level_dn + scene.read_noise_dn * rng.standard_normal(level_dn.shape)
    codes = np.clip(np.rint(noisy), 0, scene.full_scale_dn).astype(
        np.uint8 if scene.bits <= 8 else np.uint16
    )
    times = np.arange(len(codes)) / 30.0
    return FrameStack(data=codes, time_s=times, full_scale_dn=scene.full_scale_dn)


def bloom_session(
    scene: BloomScene, overloads: Sequence[float], rng: np.random.Generator, *, darks: bool = True
) -> Session:
    """Draw a point stack for each overload, and a dark stack of as many frames."""
    children = rng.spawn(len(overloads) + 1)
    entries = []
    for number, (overload, child) in enumerate(zip(overloads, children[1:], strict=True)):
        frames = stack(scene, overload, child, faintest=min(overloads))
        stated = 1e-6 * overload * float(np.exp(scene.light_sd * child.standard_normal()))
        entries.append(tube_stack("point", f"point-{number}", frames, stated))
    if darks:
        level = np.full((scene.frames, scene.rows, scene.cols), scene.dark_dn + scene.wrong_dark_dn)
        entries.insert(
            0, tube_stack("dark", "dark", digitise_frames(scene, level, children[0]), 0.0)
        )
    return session_in_memory(entries, name="a point source of closed form")
