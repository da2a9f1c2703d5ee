"""Controls of the validation: one camera parameter changed a stage, and faults put into the frames
of one stack.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.frames.image_lag import SLOWEST_DECAY
from charact.validation.frames import Camera, MatchedStacks
from charact.validation.statistic import Statistic
from charact.validation.thresholds import VALIDATION
from charact.validation.validation_result import ValidationControl

Frames = NDArray[np.floating]


@dataclass(frozen=True, kw_only=True)
class ParameterControl:
    """A parameter whose change must be noticed.

    `title` says what, `parameters` are its paths, of which the first counts that exists;
    `in_quadrature`: whether it is the standard deviation of a noise, whose square the numbers
    follow.
    """

    title: str
    parameters: tuple[str, ...]
    in_quadrature: bool = False


PARAMETERS = (
    ParameterControl(
        title="sensitivity", parameters=("photocathode.luminous_sensitivity_ua_per_lm",)
    ),
    ParameterControl(
        title="gain", parameters=("tube.luminous_gain", "video.conversion_gain_dn_per_e")
    ),
    ParameterControl(
        title="detection probability, as 1/F²",
        parameters=("microchannel_plate.detection_probability",),
    ),
    ParameterControl(title="blur after the gain", parameters=("tube.post_gain_share",)),
    ParameterControl(
        title="frequency of the tube's MTF, or blur of the lens",
        parameters=("tube.mtf_frequency_lp_per_mm", "optics.aberration_blur_um"),
    ),
    ParameterControl(title="video bandwidth", parameters=("video.bandwidth_mhz",)),
    ParameterControl(title="slow decay of the phosphor", parameters=SLOWEST_DECAY),
    ParameterControl(title="read noise", parameters=("ccd.read_noise_e",), in_quadrature=True),
    ParameterControl(
        title="noise of rows", parameters=("video.line_noise_dn",), in_quadrature=True
    ),
    ParameterControl(
        title="dark events: EBI or dark current",
        parameters=("photocathode.ebi_lm_per_cm2", "ccd.dark_current_e_per_s"),
    ),
    ParameterControl(title="PRNU", parameters=("ccd.prnu",), in_quadrature=True),
)


def change_parameter(
    camera: Camera, control: ParameterControl, change: float
) -> tuple[Camera, float] | None:
    """Return a camera with one parameter larger by a relative change, and the change; None without
    the parameter.

    A fraction that would exceed 1 is made smaller by as much.
    """
    known = camera.parameters()
    path = next(
        (path for path in control.parameters if path in known and float(known[path]) != 0.0), None
    )
    if path is None:
        return None
    value = float(known[path])
    if path.endswith(("share", "probability")) and value * (1.0 + change) > 1.0:
        change = -change
    return camera.with_values({path: value * (1.0 + change)}), change


def _hot_pixels(frames: Frames, rng: np.random.Generator) -> Frames:
    rows, cols = (rng.integers(size, size=6) for size in frames.shape[1:])
    frames[:, rows, cols] += 12.0 * frames.std()
    return frames


def _hum(frames: Frames, rng: np.random.Generator) -> Frames:
    wave = np.sin(
        2.0 * np.pi * np.arange(frames.shape[1]) / 17.0 + rng.uniform(0.0, 6.0, (len(frames), 1))
    )
    return frames + 0.5 * frames.std(axis=0).mean() * wave[:, :, None]


def _repeat_frame(frames: Frames, rng: np.random.Generator) -> Frames:
    frames[-1] = frames[-2]
    return frames


def _shading(frames: Frames, rng: np.random.Generator) -> Frames:
    y, x = (np.linspace(-1.0, 1.0, size) for size in frames.shape[1:])
    return frames * (1.0 - 0.1 * (x[None, None, :] ** 2 + y[None, :, None] ** 2))


def _flicker(frames: Frames, rng: np.random.Generator) -> Frames:
    return frames * (1.0 + 0.01 * rng.standard_normal((len(frames), 1, 1)))


def _missing_bit(frames: Frames, rng: np.random.Generator) -> Frames:
    return 2.0 * (frames // 2.0)


def _cosmic_rays(frames: Frames, rng: np.random.Generator) -> Frames:
    rows, cols = (rng.integers(size - 6, size=(len(frames), 3, 1)) for size in frames.shape[1:])
    step = np.arange(6)
    frames[np.arange(len(frames))[:, None, None], rows + step, cols + step] += 40.0 * frames.std()
    return frames


# Fault, the stack that has it (dark or brightest flat), and what it does to its frames.
FAULTS: dict[str, tuple[str, Callable[[Frames, np.random.Generator], Frames]]] = {
    "hot pixels": ("dark", _hot_pixels),
    "three cosmic rays a frame": ("dark", _cosmic_rays),
    "rolling hum of half the noise": ("flat", _hum),
    "a repeated frame": ("flat", _repeat_frame),
    "vignetting of 10 %": ("flat", _shading),
    "lamp flicker of 1 %": ("flat", _flicker),
    "lowest bit left out": ("flat", _missing_bit),
}


def null_control(title: str, of_next_set: Callable[[], tuple[Statistic, ...]]) -> ValidationControl:
    """Return the control that frames of the fitted camera itself pass, with the statistics of the
    last set.

    Notes
    -----
    A right camera fails now and then, and a set of its posterior may be an extreme one. So sets
    are compared until the share that fails is that of sound or of useless statistics, by the
    likelihood ratio of both (sequential test; Wald 1945): mostly one set decides.
    """
    ratio = 1.0
    while True:
        control = ValidationControl(name="null", title=title, statistics=of_next_set())
        shares = VALIDATION.useless_share, VALIDATION.sound_share
        useless, sound = (1.0 - share if control.passed else share for share in shares)
        ratio *= useless / sound
        if not 1.0 <= ratio < VALIDATION.useless_ratio:
            return control


def put_fault(
    frames: Mapping[str, NDArray], chosen: MatchedStacks, name: str, rng: np.random.Generator
) -> dict[str, NDArray]:
    """Return frames with one fault in one stack, in whole DN within the digitiser's range."""
    kind, change = FAULTS[name]
    label = chosen.dark.label if kind == "dark" else chosen.flats[-1].label
    before = frames[label]
    top = np.iinfo(before.dtype).max if before.dtype.kind == "u" else np.inf
    changed = np.clip(np.rint(change(before.astype(float), rng)), 0, top).astype(before.dtype)
    return {**frames, label: changed}
