"""Transform method for points: Fourier transform of the spot above its background, over its
light.
"""

from typing import Any

import numpy as np

import charact
from charact.estimators.mtf.curve import (
    LEVELS,
    CurveFinding,
    crossing_frequency,
    curve_of,
    widen_by,
)
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.point.blur_models_2d import pinhole
from charact.estimators.mtf.point.checks import (
    finding,
    judge_by,
    motion_findings,
    noise_findings,
    undersampled,
)
from charact.estimators.mtf.point.nonlinearity import chance_of_less_noise
from charact.estimators.mtf.point.source import (
    PointRefusal,
    detect_source,
    refuse_all,
    round_down,
)
from charact.estimators.mtf.point.source_count import two_sources
from charact.estimators.mtf.point.spot_light import FREQUENCY, SpotLight, light_of_spot
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.clipping import is_clipped_at_black
from charact.frames.stack import Stack
from charact.frames.thresholds import CLIPPING
from charact.method import Context, register
from labdata import (
    Array,
    FrameStack,
    Measurement,
    Provenance,
    Result,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

METHOD = "point-spread"
ASSUMED = (
    "The camera response is assumed linear: one frame shows no gamma, and several do where the "
    "read noise outweighs that of the light only."
)
EFFECTS = {
    "several-targets": "light of another source in the region is included",
    "window-too-small": "light outside is not included; MTF50 is too high by its fraction",
    "clipped": "noise is clipped at black, which raises the background",
}


@register("point", METHOD)
def point_spread(
    stack: FrameStack,
    *,
    region: Region | None = None,
    pinhole_px: float | None = None,
    context: Context,
) -> Result:
    """Measure the MTF in both directions as the modulus of the spot's Fourier transform.

    Parameters
    ----------
    stack
        Frames of one point source. The uncertainties are those of the noise of the light and of the
        background; of eight frames and more, or a described tube, those of the frames' scatter.
    region
        ROW, COL, HEIGHT, WIDTH that contains the source; None: the whole frame.
    pinhole_px
        Diameter of the source's image, column pitches, whose transfer is divided out. None: a
        point.
    context
        Seed, pitches and full scale.

    Notes
    -----
    See `charact.estimators.mtf.point.spot_light`: no form of the blur is assumed. Light beyond the
    disc, of which the wings give the size, widens the intervals.
    """
    cut_stack = stack if region is None else stack.region(*region)
    common: dict[str, Any] = {
        "method": METHOD,
        "region": region or (0, 0, *cut_stack.shape[1:]),
        "notes": (*stack.notes, ASSUMED),
    }
    settings = {"pinhole_px": pinhole_px}
    common["provenance"] = Provenance(
        version=charact.__version__, seed=context.seed, settings=settings
    )
    tube, full = has_tube(context.camera), Stack.of(cut_stack, context).ceiling_dn
    if min(cut_stack.shape[1:]) < LIMITS.min_region_px:
        reason = f"a spot needs a region of at least {LIMITS.min_region_px} px"
        return refuse_all(common, reason, "window-too-small")
    source = detect_source(cut_stack.data, context.pitch_ratio)
    if isinstance(source, PointRefusal):
        return refuse_all(common, *source)
    if tube and len(cut_stack) < LIMITS.min_transform_frames:
        reason = (
            f"a spot of a tube needs at least {LIMITS.min_transform_frames} frames, got "
            f"{len(cut_stack)}"
        )
        return refuse_all(common, reason, "too-few-frames")
    spot = light_of_spot(cut_stack.data, source, context.pitch_ratio, has_tube=tube)
    if spot is None:
        return refuse_all(common, "a spot must leave a background around it", "window-too-small")
    if full is not None and spot.frames[:, spot.disc].max() >= CLIPPING.full_fraction * full:
        return refuse_all(
            common,
            "the spot must stay below full scale: clipped light has no transform",
            "saturated",
        )
    light, light_sd = spot.light[0], spot.light_sd
    if light < LIMITS.min_light_sd * light_sd:
        reason = (
            f"no target: the light must be at least {LIMITS.min_light_sd:g} standard "
            f"uncertainties, got {round_down(light / light_sd):.1f}"
        )
        return refuse_all(common, reason)
    pair = two_sources(spot)
    if pair is not None:
        return refuse_all(common, pair.reason, "several-targets")
    findings = _findings(spot, tube, full)
    passed = pinhole(FREQUENCY, pinhole_px or 0.0)
    measured, curves = [], {}
    rng = np.random.default_rng([context.seed, 1])
    count = ACCURACY.quick_draws if context.quick else ACCURACY.draws
    for angle in (0.0, 90.0):
        transform = spot.transform(vertical=angle > 0.0)
        curves_drawn = transform.draws(rng, count) / passed
        at_angle = {**common, "orientation_deg": angle}
        measured.append(
            (
                [_crossing(quantity, curves_drawn, passed, at_angle) for quantity in LEVELS],
                curve_of(FREQUENCY, curves_drawn),
            )
        )
    steps_px = {0.0: 1.0, 90.0: spot.pixel_area}
    aliased = undersampled([number for numbers, _ in measured for number in numbers], steps_px)
    measurements = []
    for name, angle, (numbers, curve) in zip(
        ("mtf", "mtf_vertical"), steps_px, measured, strict=True
    ):
        checks = [*findings, aliased[angle]] if aliased else findings
        measurements += [judge_by(checks, number, FREQUENCY, curve.value) for number in numbers]
        curves[name] = widen_by(checks, curve, FREQUENCY, curve.value)
    return Result(measurements=tuple(measurements), curves=curves)


def _crossing(quantity: str, curves: Array, passed: Array, common: dict[str, Any]) -> Measurement:
    """Return MTF50 or MTF10 of drawn curves, shape (draw, frequency)."""
    level = LEVELS[quantity]
    crossings = crossing_frequency(FREQUENCY, curves, level)
    finite, reason = crossings[np.isfinite(crossings)], ""
    if finite.size < (1.0 - LIMITS.max_lost_draws) * crossings.size:
        reason = f"the MTF must fall to {level:g} below {FREQUENCY[-1]:g} cy/px"
    elif np.interp(finite, FREQUENCY, passed).min() < LIMITS.min_pinhole_mtf:
        reason = (
            f"a pinhole must transmit {LIMITS.min_pinhole_mtf:g} of the contrast at this frequency"
        )
    if reason:
        return make_refusal(quantity, "cy/px", reason, **common)
    return measurement_from_draws(quantity, "cy/px", finite, **common)


def _findings(spot: SpotLight, tube: bool, full_dn: float | None) -> list[CurveFinding]:
    """Return the findings of a spot's light."""
    light, wings = spot.light
    # The halo of an intensifier extends beyond the disc: its light is missing from the
    # normalisation.
    lost = spot.is_cut or tube or wings > LIMITS.max_wings * light
    raised = (
        ("several-targets", spot.has_neighbours),
        ("window-too-small", lost),
        ("clipped", is_clipped_at_black(spot.frames[:, spot.background])),
    )
    height = spot.frames - spot.level
    row, col = (slice(at.min(), at.max() + 1) for at in np.nonzero(spot.disc))
    # Of a ring the middle is dark.
    radius_px = max(ACCURACY.motion_radius_px, 0.5 * spot.radius_px)
    parity = np.arange(spot.x.shape[0])[row] % 2 == 1
    return [
        *(finding(flag, EFFECTS[flag]) for flag, is_raised in raised if is_raised),
        *noise_findings(chance_of_less_noise(spot, full_dn)),
        *motion_findings(height[:, row, col], spot.x[0, col], spot.y[row, 0], parity, radius_px),
    ]
