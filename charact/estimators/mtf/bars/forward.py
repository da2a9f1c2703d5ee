"""Forward method for bar targets: the exact spectrum of N finite bars, fitted to the pixels."""

import numpy as np

import charact
from charact.estimators.mtf.bars.bar_image_model import BarShape, table_of
from charact.estimators.mtf.bars.bar_measurement import (
    BarMeasurement,
    BarRefusal,
    StatedBars,
    measure_bars_in,
)
from charact.estimators.mtf.bars.checks import findings_of_draws
from charact.estimators.mtf.bars.target import BarTarget
from charact.estimators.mtf.bars.thresholds import LIMITS
from charact.estimators.mtf.mean_frame import Region
from charact.estimators.mtf.target_motion import TargetMotion, measure_line_motion
from charact.frames.stack import Stack
from charact.method import Context, register
from charact.transfer.cores import ON_BARS
from charact.transfer.stages import aperture
from charact.verdict import judge
from labdata import Array, FrameStack, Provenance, Result, make_refusal, measurement_from_draws

METHOD = "bars-forward"


def measure_bar_motion(stack: Stack, target: BarTarget) -> TargetMotion:
    """Return the motion of a target across its bars through a stack."""
    across, along = target.coordinates(stack.data.shape[1:])
    on_bars = (np.abs(across) < target.width_px / 2.0 + 0.5 / target.frequency) & (
        np.abs(along) < target.length_px / 2.0
    )
    if not on_bars.any():
        return TargetMotion()
    line = np.floor(along).astype(np.int64)
    return measure_line_motion(list(stack.data), across, line - line[on_bars].min(), on_bars)


def bar_profile(stack: Stack, target: BarTarget, mtf: float) -> dict:
    """Return the mean profile across the bars and a model with the measured MTF, as figure data.

    The model has the tube transfer exp(-(f/fc)^1.2) with the measured value at the fundamental.
    """
    mean = stack.mean_frame_dn
    across, along = target.coordinates(mean.shape)
    on_bars = (np.abs(along) < 0.3 * target.length_px) & (
        np.abs(across) < target.width_px / 2 + 1.5 / target.frequency
    )
    edges = np.arange(
        across[on_bars].min(), across[on_bars].max() + 0.25, max(0.25, 0.04 / target.frequency)
    )
    position = np.digitize(across[on_bars], edges)
    count = np.bincount(position, minlength=len(edges) + 1)[1:-1]
    filled = count > 0
    value = (
        np.bincount(position, mean[on_bars], minlength=len(edges) + 1)[1:-1][filled] / count[filled]
    )
    distance = (0.5 * (edges[1:] + edges[:-1]))[filled]
    shape = _model_profile(distance, target, mtf)
    scale, level = np.polyfit(shape, value, 1) if shape.std() > 0 else (0.0, float(value.mean()))
    model = level + scale * shape
    return {
        "figure": "bars",
        "distance_px": distance.tolist(),
        "value_dn": value.tolist(),
        "model_dn": model.tolist(),
        "residual_dn": (value - model).tolist(),
        "frequency_cy_per_px": target.frequency,
        "mtf": mtf,
    }


def _model_profile(distance: Array, target: BarTarget, mtf: float) -> Array:
    """Return N blurred bars at distances from their centre, 1 on a wide bar."""
    pixel = float(aperture(np.array([target.frequency]), target.angle_rad)[0])
    core = float(np.clip(mtf / pixel, 1e-3, 0.999))
    shape = BarShape(
        bars=target.bars,
        frequency=target.frequency,
        length_px=np.inf,
        reference=target.frequency,
        form=ON_BARS[0],
        log_attenuation=float(np.log(-np.log(core))),
        form_one=float(np.log(1.2)),
        form_two=0.0,
        departure=0.0,
        angle_rad=target.angle_rad,
    )
    return table_of(shape, float(np.abs(distance).max()), 1.0).at(distance, distance)[0]


def _refuse_impossible(measured: BarMeasurement, stated: StatedBars) -> BarRefusal:
    """Refuse an MTF that no blurred bars have."""
    return BarRefusal(
        f"no target: an MTF is at most 1, got {float(np.median(measured.mtf)):.3g} at "
        f"{measured.target.frequency:.4g} cy/px for {measured.target.bars} bars; {stated.remedy}",
        "model-misfit",
    )


@register("bars", METHOD)
def bars_forward(
    stack: FrameStack,
    *,
    region: Region | None = None,
    bars: int | None = None,
    frequency_cy_per_px: float | None = None,
    context: Context,
) -> Result:
    """Measure the MTF at the frequency of a bar target.

    Parameters
    ----------
    stack
        Frames of one target.
    region
        ROW, COL, HEIGHT, WIDTH that contains the complete target and its blur, or a strip across
        all bars; None: the whole frame.
    bars
        Number of bars; None: counted in the image.
    frequency_cy_per_px
        Bar frequency, cycles per column pitch across the bars, at which the MTF is reported; None:
        measured.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf` at the fundamental, and the profile across the bars as figure data.

    Notes
    -----
    The spectrum of N bars of width w = 1/(2 f) and pitch P is O(v) = w sinc(v w) sin(pi N v P) /
    sin(pi v P). At the bar frequency it is (2/pi) O(0), so that MTF(f) = (pi/2) |I(f)| / I(0), I
    the spectrum of the image above its pedestal. O times a blur model, with a free departure at f,
    and the pixel aperture is fitted to the pixels. For a camera with a description, whose halo is
    wide and known, complete targets are summed instead; the light beyond the window is a parameter
    with a prior from the description.
    """
    cut_stack = Stack.of(stack if region is None else stack.region(*region), context)
    where = region or (0, 0, *cut_stack.mean_frame_dn.shape)
    stated = StatedBars(bars=bars, frequency=frequency_cy_per_px)
    measured = measure_bars_in(cut_stack, stated, context)
    if isinstance(measured, BarMeasurement) and np.median(measured.mtf) > LIMITS.max_reported_mtf:
        measured = _refuse_impossible(measured, stated)
    if isinstance(measured, BarRefusal):
        refusal = make_refusal(
            "mtf",
            "1",
            measured.reason,
            method=METHOD,
            flags=(measured.flag,),
            region=where,
            frequency_cy_per_px=stated.frequency,
            provenance=Provenance(version=charact.__version__, seed=context.seed),
        )
        return Result(measurements=(refusal,))
    motion = measure_bar_motion(cut_stack, measured.target)
    doubts = findings_of_draws(
        measured.mtf, motion, measured.target.frequency, measured.posterior.flags
    )
    number = measurement_from_draws(
        "mtf",
        "1",
        measured.mtf,
        method=METHOD,
        notes=measured.notes,
        region=where,
        frequency_cy_per_px=measured.target.frequency,
        orientation_deg=float(np.rad2deg(measured.target.angle_rad)) % 180.0,
        posterior=measured.posterior,
        provenance=Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={
                "quick": context.quick,
                "bars": measured.target.bars,
                "margin_px": measured.margin_px,
            },
        ),
    )
    measurement = judge(number, [*measured.findings, *doubts])
    return Result(
        measurements=(measurement,),
        evidence={"bars": bar_profile(cut_stack, measured.target, measurement.value or 0.0)},
    )
