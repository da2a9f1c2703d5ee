"""What the plain methods for edges share: the way from frames to a result around an estimator without a noise model.

Such an estimator gathers pixels by their distance from a straight line and transforms a windowed line spread. It is
normalised to the light inside its window; its intervals are jackknifed over blocks of rows.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context
from charact.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency
from charact.mtf.edge import checks as edge_checks
from charact.mtf.edge.checks import Facts, sharpening_flags, with_findings
from charact.mtf.edge.nonlinearity import growth_of
from charact.mtf.edge.pixels import line
from charact.mtf.edge.pixels.line import orientation_deg
from charact.mtf.edge.pixels.prepare_edge import EdgeRefusal, PreparedEdge, prepare_edge
from charact.mtf.edge.pixels.profile import EdgeProfile
from charact.mtf.edge.thresholds import ACCURACY, THRESHOLDS
from charact.mtf.mean_frame import OrientedFrame, Region
from charact.mtf.nonlinearity import noise_flags
from labdata.frames import FrameStack
from labdata.measurement import Curve, Measurement, Provenance, Result, make_refusal, measurement_from_sd

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class MtfEstimate:
    """What an estimator makes of an edge.

    Parameters
    ----------
    frequency
        Along the normal of the edge, equally spaced from zero, shape (f,), cy per column pitch.
    value
        Response of all rows, one at zero, shape (f,).
    parts
        The same with each block of rows left out, shape (block, f).
    notes
        What a reader may want to know of the estimate.
    """

    frequency: Array
    value: Array
    parts: Array
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ConventionalMethod:
    """An estimator with what is known of its limits.

    Parameters
    ----------
    name
        Name of the method.
    estimate
        From the upright picture and the line of its edge to the response.
    bias_sd
        Bias of MTF50 over the declared scope, relative, as a standard deviation: measured against closed forms.
    min_snr
        Step over the noise of a pixel below which noise is known to bias it.
    settings
        Its numbers, for the provenance.
    """

    name: str
    estimate: Callable[[OrientedFrame, line.EdgeLine], MtfEstimate]
    bias_sd: float
    min_snr: float
    settings: dict[str, float]


def measure_conventionally(
    plain: ConventionalMethod, stack: FrameStack, region: Region | None, context: Context
) -> Result:
    """Find the edge, estimate its response and say what must be distrusted.

    Parameters
    ----------
    plain
        The estimator.
    stack, region, context
        As every method gets them.
    """
    edge = prepare_edge(stack, region, context)
    provenance = Provenance(version=charact.__version__, settings=dict(plain.settings))
    common = {"method": plain.name, "region": edge.where, "provenance": provenance}
    reason = edge.reason if isinstance(edge, EdgeRefusal) else _refusal(edge)
    if reason is not None or isinstance(edge, EdgeRefusal):
        return _refuse_all(str(reason), common)
    picture, profile = edge.picture, edge.profile
    response = plain.estimate(picture, edge.rows.line)
    common |= {
        "orientation_deg": orientation_deg(picture, profile.angle_rad),
        "flags": _flags(plain, edge, crossing_frequency(response.frequency, response.value[None], 0.5)[0], context),
        "notes": (
            *edge.notes,
            *edge_checks.course_notes(edge.roughness),
            *response.notes,
            "Normalised to the light inside the region.",
        ),
    }
    facts = Facts(edge=edge, half=float(crossing_frequency(response.frequency, response.value[None], 0.5)[0]))
    measurements = [*_measurements(plain, response, common), _edge_angle(edge, common)]
    return Result(
        measurements=tuple(with_findings(one, facts) for one in measurements),
        curves={"mtf": _curve(response)},
        evidence={
            "edge-spread": {
                "figure": "edge-spread",
                "distance_px": profile.distance.tolist(),
                "value_dn": profile.value.tolist(),
                "sd_dn": np.sqrt(np.diag(profile.covariance)).tolist(),
                "step_dn": profile.step,
            }
        },
    )


def mean_by_cell(cell: NDArray[np.int64], value: Array, size: int) -> Array:
    """Return the mean of the pixels of each cell, of all rows and with each block of rows left out.

    Parameters
    ----------
    cell
        Cell of every pixel, shape (row, col); those outside 0 to `size` are left out.
    value
        Shape (row, col).
    size
        Number of cells.

    Returns
    -------
    ndarray
        Shape (1 + block, cell); empty cells are interpolated by cubic splines between their neighbours: at 45 degrees
        three of four are empty, and straight lines between the others would blur the edge.
    """
    inside = (cell >= 0) & (cell < size)
    block = np.broadcast_to((np.arange(len(value)) * ACCURACY.jackknife_blocks // len(value))[:, None], value.shape)
    index = (block * size + cell)[inside]
    total = np.bincount(index, weights=value[inside], minlength=ACCURACY.jackknife_blocks * size).reshape(
        ACCURACY.jackknife_blocks, size
    )
    count = np.bincount(index, minlength=ACCURACY.jackknife_blocks * size).reshape(ACCURACY.jackknife_blocks, size)
    totals = np.concatenate([total.sum(0)[None], total.sum(0) - total])
    counts = np.concatenate([count.sum(0)[None], count.sum(0) - count])
    place = np.arange(size)
    means = totals / np.maximum(counts, 1)
    for mean, filled in zip(means, counts > 0, strict=True):
        if not filled.all() and filled.any():
            from scipy.interpolate import CubicSpline

            held = np.clip(place[~filled], place[filled][0], place[filled][-1])
            mean[~filled] = CubicSpline(place[filled], mean[filled])(held)
    return means


def _noise(profile: EdgeProfile) -> float:
    return float(np.sqrt(max(profile.grain.dark_variance, profile.grain.bright_variance)))


def _refusal(edge: PreparedEdge) -> str | None:
    """Return why nothing plain can be made of an edge, if so."""
    rows, cols = edge.picture.value.shape
    if rows < THRESHOLDS.conventional_rows or cols < THRESHOLDS.conventional_cols:
        least = f"{THRESHOLDS.conventional_rows} rows across {THRESHOLDS.conventional_cols} px"
        return f"a conventional edge method needs {least}, got {rows} across {cols}"
    noise, step = _noise(edge.profile), edge.profile.step
    if step < 3.0 * noise / np.sqrt(len(edge.profile.distance)) or edge.rows.line.strength < 60.0:
        return "no target: no edge stands clear of the noise"
    if step < THRESHOLDS.conventional_step_sd * noise:
        return (
            f"a conventional edge method needs a step of {THRESHOLDS.conventional_step_sd:g} times the pixel noise, "
            f"got {step / noise:.1f}"
        )
    return None


def _flags(plain: ConventionalMethod, edge: PreparedEdge, half: float, context: Context) -> tuple[str, ...]:
    used, profile = edge.used, edge.profile
    return (
        *edge_checks.picture_flags(used.data, context.full_scale_dn or used.full_scale_dn),
        *edge_checks.line_flags(edge.picture, edge.rows, edge.profile),
        *noise_flags(growth_of(edge)),
        *(("low-signal",) if profile.step < plain.min_snr * _noise(profile) else ()),
        *(
            ("quantised",)
            if profile.step < THRESHOLDS.coarse_step_dn and edge_checks.noise_below_quantisation(edge.picture, profile)
            else ()
        ),
        *(("defects",) if profile.defects else ()),
        *edge.flags,
        *sharpening_flags(edge, half),
        *edge.blur_flags(lambda moved: not moved.mtf_loss(half) < THRESHOLDS.conventional_motion),
        *_window_flags(profile, half),
    )


def _window_flags(profile: EdgeProfile, half: float) -> tuple[str, ...]:
    """Return flags of what a plain estimator, unlike a fit, cannot allow for."""
    flags = []
    if not np.isfinite(half) or profile.gathered.half_width_px < 2.5 / half:
        flags.append("window-too-small")
    for side in (profile.distance < -8, profile.distance > 8):
        if np.count_nonzero(side) < 8:
            continue
        slope, _ = np.polyfit(profile.distance[side], profile.value[side], 1, w=np.sqrt(profile.count[side]))
        if abs(slope) * np.ptp(profile.distance[side]) > 0.025 * profile.step:
            flags.append("gradient")
    return tuple(flags)


def _measurements(plain: ConventionalMethod, response: MtfEstimate, common: dict) -> list[Measurement]:
    found = []
    frequency = response.frequency
    for quantity, level in (("mtf50", 0.5), ("mtf10", 0.1)):
        value = crossing_frequency(frequency, response.value[None], level)[0]
        each = crossing_frequency(frequency, response.parts, level)
        if not np.isfinite(value) or not np.isfinite(each).all() or value > FINE[-1]:
            found.append(
                make_refusal(quantity, "cy/px", f"the response does not fall to {level:g} within 1 cy/px", **common)
            )
            continue
        # Scatter, a share of a frequency step, and the estimator's own bias.
        sd = np.sqrt(
            _crossing_sd(response, value, each) ** 2 + (0.1 * frequency[1]) ** 2 + (plain.bias_sd * float(value)) ** 2
        )
        found.append(measurement_from_sd(quantity, "cy/px", float(value), float(sd), **common))
    for pinned in PINNED:
        each = np.array([np.interp(pinned, frequency, part) for part in response.parts])
        value = float(np.interp(pinned, frequency, response.value))
        found.append(
            measurement_from_sd("mtf", "1", value, float(_jackknife(each)), frequency_cy_per_px=pinned, **common)
        )
    return found


def _crossing_sd(response: MtfEstimate, crossing: float, each: Array) -> float:
    """Return the standard error of a crossing: the response's scatter around there over its slope at large.

    Noise makes a response of no model uneven: where it falls steeply by chance its own crossings, one for each block
    left out, hardly scatter, and the true one may be far. They serve where too few frequencies are near.
    """
    frequency = response.frequency
    near = np.abs(frequency / crossing - 1.0) < ACCURACY.crossing_range
    if np.count_nonzero(near) < 3:
        return float(_jackknife(each))
    slope = np.polyfit(frequency[near], response.value[near], 1)[0]
    scatter = float(np.sqrt(np.mean(_jackknife(response.parts[:, near]) ** 2)))
    return scatter / max(-slope, ACCURACY.min_crossing_slope / crossing)


def _edge_angle(edge: PreparedEdge, common: dict) -> Measurement:
    used = np.flatnonzero(np.isfinite(edge.rows.offset))
    sd = edge.rows.offset_sd / np.sqrt(np.sum((used - used.mean()) ** 2)) / edge.picture.pitch_ratio
    angle = abs(float(np.rad2deg(edge.profile.angle_rad)))
    return measurement_from_sd("edge_angle", "deg", angle, float(np.rad2deg(sd)), **common)


def _jackknife(parts: Array) -> Array:
    """Return the standard error from leave-one-block-out values (block, ...)."""
    count = len(parts)
    return np.sqrt((count - 1) / count * np.sum((parts - parts.mean(axis=0)) ** 2, axis=0))


def _curve(response: MtfEstimate) -> Curve:
    value = np.interp(REPORTED, response.frequency, response.value)
    sd = _jackknife(np.array([np.interp(REPORTED, response.frequency, part) for part in response.parts]))
    return Curve(
        frequency_cy_per_px=REPORTED,
        value=value,
        interval68=np.stack([value - 0.994458 * sd, value + 0.994458 * sd]),
        interval95=np.stack([value - 1.959964 * sd, value + 1.959964 * sd]),
    )


def _refuse_all(reason: str, common: dict) -> Result:
    flags = ("no-target",) if reason.startswith("no target") else ("low-signal",)
    units = {"mtf50": "cy/px", "mtf10": "cy/px", "edge_angle": "deg"}
    return Result(measurements=tuple(make_refusal(q, unit, reason, flags=flags, **common) for q, unit in units.items()))
