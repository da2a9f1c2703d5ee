"""Transform method for points: Fourier transform of the spot above its background, over its
light.
"""

from typing import Any

import numpy as np

import charact
from charact.estimators.mtf.curve import CurveFinding, crossing_frequency, widen_by
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.point.blur_models_2d import pinhole
from charact.estimators.mtf.point.checks import finding, judge_by, motion_findings
from charact.estimators.mtf.point.source import (
    DetectedSource,
    PointRefusal,
    detect_source,
    refuse_all,
)
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.frames.clipping import is_clipped_at_black
from charact.frames.stack import Stack
from charact.frames.thresholds import CLIPPING
from charact.method import Context, register
from labdata import (
    Array,
    Curve,
    FrameStack,
    Measurement,
    Provenance,
    Result,
    has_tube,
    make_refusal,
    measurement_from_sd,
)

METHOD = "point-spread"
FREQUENCY = np.linspace(0.0, 0.5, 251)
EFFECTS = {
    "saturated": "pixels are at full scale",
    "several-targets": "light of another source in the region is included",
    "window-too-small": (
        f"light beyond {ACCURACY.spot_radius_px:g} px is not included; MTF50 is "
        f"high by its fraction"
    ),
    "model-misfit": (
        f"asymmetry exceeds {100 * LIMITS.max_asymmetry:g} % of the light: MTF50 error up to that"
    ),
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
        Frames of one point source; a jackknife over frames gives the uncertainties.
    region
        ROW, COL, HEIGHT, WIDTH that contains the source; None: the whole frame.
    pinhole_px
        Diameter of the source's image, column pitches, whose transfer is divided out. None: a
        point.
    context
        Pitches and full scale.

    Notes
    -----
    MTF(f) = |sum v exp(-2 pi i f x)| / sum v over a disc of 8 px, v above the mean of the ring from
    8 to 14 px.
    """
    cut_stack = stack if region is None else stack.region(*region)
    settings = {"half_px": ACCURACY.spot_radius_px, "pinhole_px": pinhole_px}
    common: dict[str, Any] = {
        "method": METHOD,
        "region": region or (0, 0, *cut_stack.shape[1:]),
        "provenance": Provenance(version=charact.__version__, seed=context.seed, settings=settings),
    }
    if min(cut_stack.shape[1:]) < 2 * ACCURACY.background_radius_px:
        reason = f"a spot needs a region of at least {2 * ACCURACY.background_radius_px:.0f} px"
        return refuse_all(common, reason, "window-too-small")
    source = detect_source(cut_stack.data, context.pitch_ratio)
    if isinstance(source, PointRefusal):
        return refuse_all(common, *source)
    if len(cut_stack) < LIMITS.min_transform_frames:
        reason = f"a spot needs at least {LIMITS.min_transform_frames} frames, got {len(cut_stack)}"
        return refuse_all(common, reason, "too-few-frames")
    spots, findings, missing = _spots(cut_stack, source, context)
    if any(check.flag == "saturated" for check in findings):
        return refuse_all(
            common,
            "the spot must stay below full scale: clipped light has no transform",
            "saturated",
        )
    light = spots.sum(axis=(1, 2))
    if light.mean() < LIMITS.min_light_sd * ACCURACY.lag_factor * light.std(ddof=1) / np.sqrt(
        len(light)
    ):
        return refuse_all(common, "no target: the spot's light is not significant over the frames")
    positions = _places(cut_stack.shape[1:], source, context)
    measurements, curves = [], {}
    for name, angle, position in (("mtf", 0.0, positions[1]), ("mtf_vertical", 90.0, positions[0])):
        numbers, curve = _direction(
            spots, position, pinhole_px or 0.0, missing, {**common, "orientation_deg": angle}
        )
        modulus = curve.value
        measurements += [judge_by(findings, number, FREQUENCY, modulus) for number in numbers]
        curves[name] = widen_by(findings, curve, FREQUENCY, modulus)
    return Result(measurements=tuple(measurements), curves=curves)


def _places(
    shape: tuple[int, int], source: DetectedSource, context: Context
) -> tuple[Array, Array]:
    """Return rows and columns as distances from the source, column pitches, shape (row, 1) and (1,
    col).
    """
    rows, cols = np.arange(shape[0]) - source.row, np.arange(shape[1]) - source.col
    return np.asarray(rows[:, None] * context.pitch_ratio, np.float64), cols[None, :].astype(float)


def _spots(
    stack: FrameStack, source: DetectedSource, context: Context
) -> tuple[Array, list[CurveFinding], float]:
    """Return spots above their rings (frame, row, col), findings, and the fraction of light that
    may be missing.
    """
    y, x = _places(stack.shape[1:], source, context)
    radius = np.hypot(x, y)
    disc = radius < ACCURACY.spot_radius_px
    ring = (radius >= ACCURACY.spot_radius_px) & (radius < ACCURACY.background_radius_px)
    background = stack.data[:, ring].mean(axis=1)
    spots = np.where(disc, stack.data - background[:, None, None], 0.0)
    full = Stack.of(stack, context).ceiling_dn
    saturated = full is not None and stack.data[:, disc].max() >= CLIPPING.full_fraction * full
    cut = min(-y[0, 0], y[-1, 0], -x[0, 0], x[0, -1]) < ACCURACY.background_radius_px
    mean = spots.mean(axis=0)
    is_wide = float((mean * radius**2).sum()) > LIMITS.max_rms_radius_px**2 * float(mean.sum())
    # The halo of an intensifier extends beyond the disc: its light is missing from the
    # normalisation.
    has_lost_light = bool(cut) or is_wide or has_tube(context.camera)
    tail, tail_sd = _tail(spots, radius)
    # A background ring brighter than its surroundings is part of a halo.
    bare = (radius >= ACCURACY.background_radius_px) & (radius < 22.0)
    over = background - stack.data[:, bare].mean(axis=1)
    over_sd = ACCURACY.lag_factor * over.std(ddof=1) / np.sqrt(len(over))
    has_lost_light |= tail > max(LIMITS.max_border_light, 3.0 * tail_sd)
    has_lost_light |= bool(over.mean() > LIMITS.min_halo_excess_sd * over_sd)
    raised = (
        ("saturated", saturated),
        ("several-targets", source.has_others),
        ("window-too-small", has_lost_light),
        ("model-misfit", _is_asymmetric(spots, x, y)),
        ("clipped", is_clipped_at_black(stack.data[:, ring])),
    )
    motion = motion_findings(
        spots, *_offsets_from_centre(mean, x.ravel(), y.ravel()), np.arange(stack.shape[1]) % 2 == 1
    )
    missing = ACCURACY.light_beyond * float(np.hypot(max(tail, 0.0), tail_sd))
    return (
        np.asarray(spots, np.float64),
        [*(finding(flag, EFFECTS[flag]) for flag, is_raised in raised if is_raised), *motion],
        missing,
    )


def _offsets_from_centre(mean: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return positions of columns and rows from the centre of light."""
    light = float(mean.sum())
    return x - float((mean * x).sum()) / light, y - float((mean * y[:, None]).sum()) / light


def _tail(spots: Array, radius: Array) -> tuple[float, float]:
    """Return the fraction of light at the disc's border and its standard uncertainty."""
    fraction = spots[:, (radius >= 6.5) & (radius < ACCURACY.spot_radius_px)].sum(axis=1)
    light = float(spots.sum(axis=(1, 2)).mean())
    return float(fraction.mean()) / light, ACCURACY.lag_factor * float(
        fraction.std(ddof=1)
    ) / np.sqrt(len(fraction)) / light


def _is_asymmetric(spots: Array, x: Array, y: Array) -> bool:
    """Return whether the transform has a phase that no shift explains: two sources, or stepwise
    motion.
    """
    mean = spots.mean(axis=0)
    across, down = _offsets_from_centre(mean, x.ravel(), y.ravel())
    for turn in np.deg2rad([0.0, 45.0, 90.0, 135.0]):
        position = across[None, :] * np.cos(turn) + down[:, None] * np.sin(turn)
        for frequency in (0.06, 0.1):
            # A shift doubles the phase at twice the frequency; the remainder is asymmetry.
            wave = np.sin(4.0 * np.pi * frequency * position) - 2.0 * np.sin(
                2.0 * np.pi * frequency * position
            )
            odd = np.tensordot(spots, wave, axes=2)
            error = ACCURACY.lag_factor * float(odd.std(ddof=1)) / np.sqrt(len(odd))
            if abs(odd.mean()) > max(
                LIMITS.max_asymmetry_sd * error, LIMITS.max_asymmetry * float(mean.sum())
            ):
                return True
    return False


def _direction(
    spots: Array, position: Array, pinhole_px: float, missing: float, common: dict
) -> tuple[list[Measurement], Curve]:
    """Return levels and curve along one direction, with jackknife uncertainties."""
    waves = np.exp(-2j * np.pi * FREQUENCY[:, None] * position.ravel())
    lines = spots.sum(axis=1 if position.shape[0] == 1 else 2)
    mean = lines.mean(axis=0)
    left_out = (lines.sum(axis=0) - lines) / (len(lines) - 1)
    curves = np.abs(np.concatenate([mean[None], left_out]) @ waves.T)
    passed = pinhole(FREQUENCY, pinhole_px)
    curves = curves / curves[:, :1] / passed
    scale = ACCURACY.lag_factor * np.sqrt((len(lines) - 1) ** 2 / len(lines))
    sd = np.hypot(scale * curves[1:].std(axis=0, ddof=1), missing * curves[0])
    measurements = []
    for quantity, level in (("mtf50", 0.5), ("mtf10", 0.1)):
        crossing, reason = crossing_frequency(FREQUENCY, curves, level), ""
        if not np.isfinite(crossing).all():
            reason = f"the MTF must fall to {level:g} below {FREQUENCY[-1]:g} cy/px"
        elif np.interp(crossing, FREQUENCY, passed).min() < LIMITS.min_pinhole_mtf:
            reason = (
                f"a pinhole of {pinhole_px:g} px must transmit {LIMITS.min_pinhole_mtf:g} of the "
                "contrast at this frequency"
            )
        if reason:
            measurements.append(make_refusal(quantity, "cy/px", reason, **common))
            continue
        error = float(
            np.hypot(
                scale * crossing[1:].std(ddof=1), ACCURACY.crossing_factor * missing * crossing[0]
            )
        )
        measurements.append(
            measurement_from_sd(quantity, "cy/px", float(crossing[0]), error, **common)
        )
    half68, half95 = 0.994458 * sd, 1.959964 * sd
    curve = Curve(
        frequency_cy_per_px=FREQUENCY,
        value=curves[0],
        interval68=np.stack([curves[0] - half68, curves[0] + half68]),
        interval95=np.stack([curves[0] - half95, curves[0] + half95]),
    )
    return measurements, curve
