"""Bounds on the influence of each camera effect on a frame, and the selection of effects.

Bounds follow from the expected photoelectrons and the camera's numbers: no frame is drawn and no stage is run. The
unit of an influence is the temporal noise of the affected pixel.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.effect_selection import DEFAULT_TOLERANCE, EffectSelection, OptionalEffect, select_effects
from simulate.iiccd import true_quantities, tube_photometry
from simulate.iiccd.accuracy import ACCURACY
from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.effect_bounds.noise_budget import UNTOUCHED, Map, NoiseBudget, per_pixel
from simulate.iiccd.grid import DRAW_MARGIN_PX, SCENE_MARGIN_PX
from simulate.iiccd.pattern import GRANULARITY_MM
from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.transfer import HaloBlur, VideoFilter

# Level that one normal number in a thousand exceeds.
ONE_IN_A_THOUSAND = 3.09
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


def bound_effects(budget: NoiseBudget) -> list[OptionalEffect]:
    """Return each optional effect with its influence on the frame."""
    influences = {**_light(budget), **_tube(budget), **_patterns(budget), **_detector(budget), **_video(budget)}
    millions = budget.mean_pe.size / 1e6
    return [
        OptionalEffect(
            name=name,
            influence=influence,
            setup_s=SETUP_S.get(name, 0.0) * millions,
            frame_s=FRAME_S.get(name, 0.0) * millions,
        )
        for name, influence in influences.items()
    ]


def _light(budget: NoiseBudget) -> dict[str, float]:
    """Effects on light and photoelectrons before the gain."""
    camera, sensor, n = budget.camera, budget.camera.sensor, budget.mean_pe
    cathode = sensor.photocathode
    scattered = HaloBlur(fraction=1.0, gap_mm=float(cathode.gap_mm), elastic_share=float(cathode.halo_elastic_share))
    found = {
        "halo": float(cathode.halo_fraction) * budget.of_light(budget.with_blur(scattered) - n),
        "dark emission": budget.of_light(budget.dark_pe) + _skewness_influence(budget, budget.dark_pe),
        "bright-source protection": 0.0,
    }
    lux = float(budget.photoelectrons.mean()) / true_quantities.field_pixel_area_cm2(camera) / camera.field_s
    lux /= tube_photometry.photoelectrons_per_lumen_s(sensor) * 1e-4
    blur = camera.bright_source_protection().blur(lux)
    if blur is not None:
        found["bright-source protection"] = budget.of_light(budget.with_blur(blur) - n)
    if camera.geometry:
        found["fibre geometry"] = budget.of_light(_displacement_change(budget))
    return found


def _displacement_change(budget: NoiseBudget) -> Map:
    """Bound on the change of a pixel by displacement in the taper: the range of values within its extent.

    Notes
    -----
    Distortion by D (r/R)^2 moves light by D r^3/R^2 and stretches areas by the factor (1 + D s^2)(1 + 3 D s^2), about
    4 D s^2 with s = r/R. A multi-fibre is off by half the root mean square by which neighbours differ, in x and in y.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    taper, cells, wide = budget.camera.sensor.taper, budget.camera.cells, budget.surroundings
    distortion = abs(float(taper.distortion_fraction))
    rows, cols = wide.shape
    y = (np.arange(rows) - SCENE_MARGIN_PX - 0.5 * (budget.camera.shape[0] - 1)) * cells.pitch_y_mm
    x = (np.arange(cols) - SCENE_MARGIN_PX - 0.5 * (budget.camera.shape[1] - 1)) * cells.pitch_x_mm
    corner_mm = 0.5 * np.hypot(cells.rows * cells.pitch_y_mm, cells.columns * cells.pitch_x_mm)
    place = budget.frame_of(np.hypot(y[:, None], x[None, :])) / corner_mm
    hexagons = wide.size * cells.pitch_x_mm * cells.pitch_y_mm / (float(taper.pattern_pitch_um) * 1e-3) ** 2
    shear_mm = 0.5 * extreme(2.0 * hexagons) * float(taper.shear_um) * 1e-3 * float(taper.demagnification)
    stretch = (1.0 + distortion * place**2) * (1.0 + 3.0 * distortion * place**2) - 1.0
    change = np.zeros(budget.mean_pe.shape)
    for ring in range(ACCURACY.n_distortion_rings):
        inner, outer = ring / ACCURACY.n_distortion_rings, (ring + 1) / ACCURACY.n_distortion_rings
        far_mm = distortion * outer**3 * corner_mm + shear_mm
        reach = [2 * int(np.ceil(far_mm / pitch)) + 1 for pitch in (cells.pitch_y_mm, cells.pitch_x_mm)]
        span = budget.frame_of(maximum_filter(wide, reach) - minimum_filter(wide, reach))
        here = (place >= inner) & ((place < outer) | (ring == ACCURACY.n_distortion_rings - 1))
        change[here] = span[here]
    return change + stretch * budget.mean_pe


def extreme(count: float) -> float:
    """Return the level, in sd, that the largest of `count` normals exceeds with `Accuracy.extreme_probability`."""
    from scipy.special import ndtri

    return float(-ndtri(ACCURACY.extreme_probability / max(count, 1.0)))


def _tube(budget: NoiseBudget) -> dict[str, float]:
    found = _saturation(budget)
    found["ion events"] = _ions(budget)
    found["pulse-height law"] = _skewness_influence(budget, budget.mean_pe)
    found["afterglow"] = _afterglow(budget)
    return found


def _saturation(budget: NoiseBudget) -> dict[str, float]:
    """MCP saturation and local gain depletion; without saturation there is no depletion."""
    mean = budget.mean_load
    found = {"plate saturation": budget.of_gain(mean)}
    if budget.camera.local_depletion:
        neighbourhood = _Neighbourhood(float(budget.mcp.depletion_blur_um or 0.0))
        local = np.maximum(budget.load(budget.with_blur(neighbourhood)), 0.0)
        # Relative to whichever gain is the lower.
        found["local depletion"] = budget.of_gain((local - mean) / (1.0 + np.minimum(local, mean)))
        found["plate saturation"] = max(found["plate saturation"], budget.of_gain(local))
    return found


def _ions(budget: NoiseBudget) -> float:
    """Ion feedback: mean, variance, and shift of the level that one frame in a thousand exceeds.

    Notes
    -----
    An event is seen by as many pixels as its light is spread over, about three times the reciprocal of what blur leaves
    of the variance, in as many fields as the phosphor remembers. A chance p of that shifts the level that normal noise
    exceeds with a chance q by p/(q z).
    """
    pixels, fields = 3.0 / budget.blurs[0], 1 + int(np.sum(budget.shares.mean(axis=0)[1:] > 0.01))
    pushed = min(budget.ions * pixels * fields / 1e-3 / ONE_IN_A_THOUSAND, 1.0)
    mean = budget.of_mean(budget.ions * budget.mcp.ion_event_size_pe / budget.mcp.detection_probability)
    return max(budget.of_variance(budget.of_ions) + mean, pushed)


def _skewness_influence(budget: NoiseBudget, photoelectrons: Map | float) -> float:
    """Influence of pulse skewness on the level that one frame in a thousand exceeds.

    Notes
    -----
    Cornish and Fisher: the level lies (z^2 - 1)/6 skewnesses higher; counted with the least noise that the tolerance
    leaves.
    """
    third = photoelectrons * budget.charge_e * budget.pulses[1]
    least = budget.variance * (1.0 - budget.max_neglect_fraction)
    return float(np.max(third / least**1.5)) * (ONE_IN_A_THOUSAND**2 - 1.0) / 6.0


def _afterglow(budget: NoiseBudget) -> float:
    """Influence of phosphor decay: without it the noise of each field is larger and fields are uncorrelated."""
    share = float(np.max(budget.of_pulses / budget.variance))
    second, third = budget.decay
    together = float(np.mean(np.sum(budget.shares[:, 1:] * budget.shares[:, :-1], axis=1))) / second
    grown = np.sqrt(1.0 + share * (1.0 / second - 1.0)) - 1.0
    skewed = _skewness_influence(budget, budget.mean_pe) * abs(1.0 - second**1.5 / third)
    return max(float(grown) + skewed, together * share)


def _patterns(budget: NoiseBudget) -> dict[str, float]:
    sensor, cells = budget.camera.sensor, budget.camera.cells
    pixels = float(budget.mean_pe.size)
    grains = pixels * cells.pitch_x_mm * cells.pitch_y_mm / GRANULARITY_MM**2
    lit = budget.of_gain(1.0)
    return {
        "multi-fibre pattern": float(sensor.microchannel_plate.pattern_contrast) * lit,
        "screen mottle": extreme(2.0 * grains) * float(sensor.phosphor.gain_nonuniformity) * lit,
        "chicken wire": float(sensor.taper.pattern_contrast) * lit,
        "unequal pixels": extreme(2.0 * pixels) * float(sensor.ccd.prnu) * lit,
    }


def _detector(budget: NoiseBudget) -> dict[str, float]:
    ccd = budget.ccd
    beyond = np.maximum(budget.brightest_e - ccd.full_well_e, 0.0)
    pattern = _dark_pattern(budget)
    return {
        "overflow": budget.of_mean(beyond / budget.charge_e),
        "smear": budget.of_mean(budget.smear),
        "dark pattern": pattern,
        # Without dark charge there is no pattern of it.
        "dark charge": budget.of_white(budget.white * ccd.dark_e) + pattern,
        "read noise": budget.of_white(budget.white * ccd.read_noise_e**2),
    }


def _dark_pattern(budget: NoiseBudget) -> float:
    """Influence of DSNU: change of the mean and of the noise."""
    off = budget.hottest_e
    return max(budget.of_mean(off / budget.charge_e), budget.of_white(budget.white * off))


def _video(budget: NoiseBudget) -> dict[str, float]:
    video = budget.camera.video()
    if not isinstance(video.low_pass, VideoFilter):
        return {}
    n, late = budget.mean_pe, video.sync_jitter_px
    padded = np.pad(n, ((0, 0), (1, 1)), mode="edge")
    left, right = n - padded[:, :-2], padded[:, 2:] - n
    steepest = np.maximum(np.abs(left), np.abs(right))
    moved = budget.of_white((late * steepest * budget.charge_e) ** 2)
    # A shift within a pixel averages neighbours: the variance of white noise falls by 3/2 late^2.
    averaged = budget.of_white(1.5 * late**2 * budget.variance)
    return {
        "sync jitter": max(moved + averaged, budget.of_mean(0.5 * late**2 * (right - left))),
        "line noise": budget.of_white(budget.line_noise_e**2),
    }


@dataclass(frozen=True)
class _Neighbourhood:
    """Gaussian neighbourhood of the channels that deplete a channel."""

    sigma_um: float

    def transfer(self, fx_per_mm: NDArray[np.floating], fy_per_mm: NDArray[np.floating]) -> NDArray[np.floating]:
        squared = fx_per_mm**2 + fy_per_mm**2
        return np.exp(-2.0 * (np.pi * self.sigma_um * 1e-3) ** 2 * squared)


def select_camera_effects(
    camera: IntensifiedCamera, photoelectrons: StageImage, conditions: Conditions, tolerance: float = DEFAULT_TOLERANCE
) -> tuple[IntensifiedCamera, EffectSelection]:
    """Return the camera without the effects that this light does not need, and the selection.

    Parameters
    ----------
    camera
        The camera, nothing left out.
    photoelectrons
        Photoelectrons that light frees from the cathode, per cell of `camera.scene_cells` and exposure.
    conditions
        Gate, voltage and temperature, and which automatic controls were on.
    tolerance
        What may change, as a fraction of the temporal noise of each pixel.

    Notes
    -----
    Controls that are on pass from where they start to where they settle; an effect counts as it does at the worse end.
    """
    untouched = NoiseBudget(camera, per_pixel(camera, photoelectrons), conditions, tolerance)
    ends = (bound_effects(replace(untouched, state=state)) for state in _ends(untouched))
    plan = select_effects(_worst(ends), tolerance)
    return replace(camera, left_out=plan.names), plan


def _ends(budget: NoiseBudget) -> Iterable[AutomaticState]:
    """Initial and extreme states of the automatic controls."""
    yield UNTOUCHED
    camera, conditions = budget.camera, budget.conditions
    control, gain = camera.brightness_control(conditions), camera.automatic_gain(conditions)
    if control is None and gain is None:
        return
    brightness = 1.0
    if control is not None:
        n = float(budget.frame_of(budget.surroundings, DRAW_MARGIN_PX).mean())
        output = budget.mcp.gain * n / true_quantities.field_pixel_area_cm2(camera) / budget.mcp.field_s
        brightness = min(1.0, control.limit_e_per_s_cm2 / max(output, 1e-300))
    yield AutomaticState(brightness=brightness)
    if gain is not None:
        yield AutomaticState(gain=gain.highest)
        yield AutomaticState(brightness=brightness, gain=gain.highest)


def _worst(ends: Iterable[list[OptionalEffect]]) -> list[OptionalEffect]:
    """Largest influence of each effect."""
    return [max(same, key=lambda effect: effect.influence) for same in zip(*ends, strict=True)]
