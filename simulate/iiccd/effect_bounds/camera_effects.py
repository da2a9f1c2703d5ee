"""Which effects a picture does not need: the least first, while their influences together stay in the tolerance."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.effect_selection import DEFAULT_TOLERANCE, EffectSelection, OptionalEffect, select_effects
from simulate.iiccd import true_quantities, tube_photometry
from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.effect_bounds.noise_budget import MISSED, UNTOUCHED, Map, NoiseBudget, per_pixel
from simulate.iiccd.grid import DRAW_MARGIN_PX, SCENE_MARGIN_PX
from simulate.iiccd.pattern import GRANULARITY_MM
from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.transfer import HaloBlur, VideoFilter

# Level that one normal number in a thousand exceeds.
ONE_IN_A_THOUSAND = 3.09
# Rings in which the displacement by the fibres is bounded by that of their outer edge.
RINGS = 6
# Seconds that effects cost for a million pixels, once and a frame, as `python -m benchmarks.economy --costs` measures
# them: medians, which scatter by some 0.05 s and 0.5 ms; what is not here costs less than that.
SETUP_S = {
    "pulse-height law": 1.5,
    "fibre geometry": 0.6,
    "local depletion": 0.25,
    "screen mottle": 0.15,
    "plate saturation": 0.15,
    "afterglow": 0.1,
    "multi-fibre pattern": 0.1,
}
FRAME_S = {"overflow": 5.3e-3, "pulse-height law": 2.9e-3, "afterglow": 1.9e-3, "dark pattern": 0.7e-3}


def bound_effects(picture: NoiseBudget) -> list[OptionalEffect]:
    """Return every optional effect with its influence on a picture."""
    influences = {**_light(picture), **_tube(picture), **_patterns(picture), **_detector(picture), **_video(picture)}
    millions = picture.expected.size / 1e6
    return [
        OptionalEffect(
            name=name,
            influence=influence,
            setup_s=SETUP_S.get(name, 0.0) * millions,
            frame_s=FRAME_S.get(name, 0.0) * millions,
        )
        for name, influence in influences.items()
    ]


def _light(picture: NoiseBudget) -> dict[str, float]:
    """What happens to light and photoelectrons before the gain."""
    camera, sensor, n = picture.camera, picture.camera.sensor, picture.expected
    cathode = sensor.photocathode
    scattered = HaloBlur(fraction=1.0, gap_mm=float(cathode.gap_mm), elastic_share=float(cathode.halo_elastic_share))
    found = {
        "halo": float(cathode.halo_fraction) * picture.of_light(picture.blurred(scattered) - n),
        "dark emission": picture.of_light(picture.dark_pe) + _skewness_influence(picture, picture.dark_pe),
        "bright-source protection": 0.0,
    }
    lux = float(picture.photoelectrons.mean()) / true_quantities.field_pixel_area_cm2(camera) / camera.field_s
    lux /= tube_photometry.photoelectrons_per_lumen_s(sensor) * 1e-4
    blur = camera.bright_source_protection().blur(lux)
    if blur is not None:
        found["bright-source protection"] = picture.of_light(picture.blurred(blur) - n)
    if camera.geometry:
        found["fibre geometry"] = picture.of_light(_displacement_change(picture))
    return found


def _displacement_change(picture: NoiseBudget) -> Map:
    """How much a displacement by the fibres can change a pixel: no more than all that is in reach.

    Notes
    -----
    Distortion by D (r/R)^2 moves light by D r^3/R^2 and stretches areas by the factor (1 + D s^2)(1 + 3 D s^2), about
    4 D s^2 with s = r/R. A multi-fibre is off by half the root mean square by which neighbours differ, in x and in y.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    taper, cells, wide = picture.camera.sensor.taper, picture.camera.cells, picture.surroundings
    distortion = abs(float(taper.distortion_fraction))
    rows, cols = wide.shape
    y = (np.arange(rows) - SCENE_MARGIN_PX - 0.5 * (picture.camera.shape[0] - 1)) * cells.pitch_y_mm
    x = (np.arange(cols) - SCENE_MARGIN_PX - 0.5 * (picture.camera.shape[1] - 1)) * cells.pitch_x_mm
    corner_mm = 0.5 * np.hypot(cells.rows * cells.pitch_y_mm, cells.columns * cells.pitch_x_mm)
    place = picture.frame_of(np.hypot(y[:, None], x[None, :])) / corner_mm
    hexagons = wide.size * cells.pitch_x_mm * cells.pitch_y_mm / (float(taper.pattern_pitch_um) * 1e-3) ** 2
    shear_mm = 0.5 * extreme(2.0 * hexagons) * float(taper.shear_um) * 1e-3 * float(taper.demagnification)
    stretch = (1.0 + distortion * place**2) * (1.0 + 3.0 * distortion * place**2) - 1.0
    change = np.zeros(picture.expected.shape)
    for ring in range(RINGS):
        inner, outer = ring / RINGS, (ring + 1) / RINGS
        far_mm = distortion * outer**3 * corner_mm + shear_mm
        reach = [2 * int(np.ceil(far_mm / pitch)) + 1 for pitch in (cells.pitch_y_mm, cells.pitch_x_mm)]
        span = picture.frame_of(maximum_filter(wide, reach) - minimum_filter(wide, reach))
        here = (place >= inner) & ((place < outer) | (ring == RINGS - 1))
        change[here] = span[here]
    return change + stretch * picture.expected


def extreme(count: float) -> float:
    """Return what the largest of so many normal numbers stays below but for a chance of `MISSED`, in their sd."""
    from scipy.special import ndtri

    return float(-ndtri(MISSED / max(count, 1.0)))


def _tube(picture: NoiseBudget) -> dict[str, float]:
    found = _saturation(picture)
    found["ion events"] = _ions(picture)
    found["pulse-height law"] = _skewness_influence(picture, picture.expected)
    found["afterglow"] = _afterglow(picture)
    return found


def _saturation(picture: NoiseBudget) -> dict[str, float]:
    """A plate that is loaded, as a whole and place by place; without saturation there is no local one either."""
    mean = picture.mean_load
    found = {"plate saturation": picture.of_gain(mean)}
    if picture.camera.local_depletion:
        neighbourhood = _Neighbourhood(float(picture.plate.depletion_blur_um or 0.0))
        local = np.maximum(picture.load(picture.blurred(neighbourhood)), 0.0)
        # Relative to whichever gain is the lower.
        found["local depletion"] = picture.of_gain((local - mean) / (1.0 + np.minimum(local, mean)))
        found["plate saturation"] = max(found["plate saturation"], picture.of_gain(local))
    return found


def _ions(picture: NoiseBudget) -> float:
    """Rare bright events: their mean, their variance, and how far they push the level of one frame in a thousand.

    Notes
    -----
    An event is seen by as many pixels as its light is spread over, about three times the reciprocal of what blur leaves
    of the variance, in as many fields as the screen remembers. A chance p of that shifts the level that normal noise
    exceeds with a chance q by p/(q z).
    """
    pixels, fields = 3.0 / picture.blurs[0], 1 + int(np.sum(picture.shares.mean(axis=0)[1:] > 0.01))
    pushed = min(picture.ions * pixels * fields / 1e-3 / ONE_IN_A_THOUSAND, 1.0)
    mean = picture.of_mean(picture.ions * picture.plate.ion_event_size_pe / picture.plate.detection_probability)
    return max(picture.of_variance(picture.of_ions) + mean, pushed)


def _skewness_influence(picture: NoiseBudget, photoelectrons: Map | float) -> float:
    """Influence of the skewness that pulses of so many photoelectrons bring, where one frame in a thousand lies.

    Notes
    -----
    Cornish and Fisher: the level lies (z^2 - 1)/6 skewnesses higher; counted with the least noise that the tolerance
    leaves.
    """
    third = photoelectrons * picture.charge_e * picture.pulses[1]
    least = picture.variance * (1.0 - picture.dropped)
    return float(np.max(third / least**1.5)) * (ONE_IN_A_THOUSAND**2 - 1.0) / 6.0


def _afterglow(picture: NoiseBudget) -> float:
    """A screen that does not remember: more noise in every field, as nothing is averaged, and no likeness of fields."""
    share = float(np.max(picture.of_pulses / picture.variance))
    second, third = picture.decay
    together = float(np.mean(np.sum(picture.shares[:, 1:] * picture.shares[:, :-1], axis=1))) / second
    grown = np.sqrt(1.0 + share * (1.0 / second - 1.0)) - 1.0
    skewed = _skewness_influence(picture, picture.expected) * abs(1.0 - second**1.5 / third)
    return max(float(grown) + skewed, together * share)


def _patterns(picture: NoiseBudget) -> dict[str, float]:
    sensor, cells = picture.camera.sensor, picture.camera.cells
    pixels = float(picture.expected.size)
    grains = pixels * cells.pitch_x_mm * cells.pitch_y_mm / GRANULARITY_MM**2
    lit = picture.of_gain(1.0)
    return {
        "multi-fibre pattern": float(sensor.microchannel_plate.pattern_contrast) * lit,
        "screen mottle": extreme(2.0 * grains) * float(sensor.phosphor.gain_nonuniformity) * lit,
        "chicken wire": float(sensor.taper.pattern_contrast) * lit,
        "unequal pixels": extreme(2.0 * pixels) * float(sensor.ccd.prnu) * lit,
    }


def _detector(picture: NoiseBudget) -> dict[str, float]:
    ccd = picture.ccd
    beyond = np.maximum(picture.brightest_e - ccd.full_well_e, 0.0)
    pattern = _dark_pattern(picture)
    return {
        "overflow": picture.of_mean(beyond / picture.charge_e),
        "smear": picture.of_mean(picture.smear),
        "dark pattern": pattern,
        # Without dark charge there is no pattern of it.
        "dark charge": picture.of_white(picture.white * ccd.dark_e) + pattern,
        "read noise": picture.of_white(picture.white * ccd.read_noise_e**2),
    }


def _dark_pattern(picture: NoiseBudget) -> float:
    """Pixels that are darker or hotter than others: their mean and their noise."""
    off = picture.hottest_e
    return max(picture.of_mean(off / picture.charge_e), picture.of_white(picture.white * off))


def _video(picture: NoiseBudget) -> dict[str, float]:
    video = picture.camera.video()
    if not isinstance(video.low_pass, VideoFilter):
        return {}
    n, late = picture.expected, video.sync_jitter_px
    beside = np.pad(n, ((0, 0), (1, 1)), mode="edge")
    left, right = n - beside[:, :-2], beside[:, 2:] - n
    steepest = np.maximum(np.abs(left), np.abs(right))
    moved = picture.of_white((late * steepest * picture.charge_e) ** 2)
    # A shift within a pixel averages neighbours: the variance of white noise falls by 3/2 late^2.
    averaged = picture.of_white(1.5 * late**2 * picture.variance)
    return {
        "sync jitter": max(moved + averaged, picture.of_mean(0.5 * late**2 * (right - left))),
        "line noise": picture.of_white(picture.line_noise_e**2),
    }


@dataclass(frozen=True)
class _Neighbourhood:
    """Gaussian neighbourhood of channels whose output counts."""

    sigma_um: float

    def transfer(self, fx_per_mm: NDArray[np.floating], fy_per_mm: NDArray[np.floating]) -> NDArray[np.floating]:
        squared = fx_per_mm**2 + fy_per_mm**2
        return np.exp(-2.0 * (np.pi * self.sigma_um * 1e-3) ** 2 * squared)


def select_camera_effects(
    camera: IntensifiedCamera, freed: StageImage, conditions: Conditions, tolerance: float = DEFAULT_TOLERANCE
) -> tuple[IntensifiedCamera, EffectSelection]:
    """Return the camera without what this light does not need, and the plan that says so.

    Parameters
    ----------
    camera
        The camera, nothing left out.
    freed
        Photoelectrons that light frees from the cathode, per cell of `camera.scene_cells` and exposure.
    conditions
        Gate, voltage and temperature, and which automatic controls were on.
    tolerance
        What may change, as a share of the temporal noise of each pixel.

    Notes
    -----
    Controls that are on pass from where they start to where they settle; an effect counts as it does at the worse end.
    """
    untouched = NoiseBudget(camera, per_pixel(camera, freed), conditions, tolerance)
    ends = (bound_effects(replace(untouched, state=state)) for state in _ends(untouched))
    plan = select_effects(_worst(ends), tolerance)
    return replace(camera, left_out=plan.names), plan


def _ends(picture: NoiseBudget) -> Iterable[AutomaticState]:
    """Where the automatic controls start, and the farthest they may go."""
    yield UNTOUCHED
    camera, conditions = picture.camera, picture.conditions
    control, gain = camera.brightness_control(conditions), camera.automatic_gain(conditions)
    if control is None and gain is None:
        return
    brightness = 1.0
    if control is not None:
        n = float(picture.frame_of(picture.surroundings, DRAW_MARGIN_PX).mean())
        output = picture.plate.gain * n / true_quantities.field_pixel_area_cm2(camera) / picture.plate.field_s
        brightness = min(1.0, control.limit_e_per_s_cm2 / max(output, 1e-300))
    yield AutomaticState(brightness=brightness)
    if gain is not None:
        yield AutomaticState(gain=gain.highest)
        yield AutomaticState(brightness=brightness, gain=gain.highest)


def _worst(ends: Iterable[list[OptionalEffect]]) -> list[OptionalEffect]:
    """Every effect with the largest of its influences."""
    return [max(same, key=lambda effect: effect.influence) for same in zip(*ends, strict=True)]
