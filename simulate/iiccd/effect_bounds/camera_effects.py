"""Which effects a picture does not need: the least first, while their influences together stay in the tolerance."""

from collections.abc import Iterable
from dataclasses import replace

from labdata.conditions import Conditions
from simulate.effect_selection import DEFAULT_TOLERANCE, EffectSelection, OptionalEffect, select_effects
from simulate.iiccd import true_quantities
from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.chip import DRAW_MARGIN_PX
from simulate.iiccd.effect_bounds.effects import bound_effects
from simulate.iiccd.effect_bounds.noise_budget import UNTOUCHED, NoiseBudget, per_pixel
from simulate.iiccd.stage_image import StageImage


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
