"""Smear: signal collected by columns during charge transfer, uniform along the column."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.estimators.bloom.column_artefacts import (
    FULL_SHARE,
    ROUNDED_DN,
    ColumnArtefacts,
    compare_columns,
)
from charact.estimators.bloom.findings import finding
from charact.estimators.bloom.point_stack import DETECTED, PointStack
from charact.estimators.bloom.series.halo_edge_step import between_variance
from charact.estimators.bloom.thresholds import Unmeasurable
from charact.frames.robust import robust_sd
from charact.method import Context
from charact.verdict import judge
from labdata import Array, Mask
from labdata.measurement import Measurement, make_refusal, measurement_from_sd

# Number of columns left and right of the core for comparison.
FLANK_PX = 8
# Minimum rows on each side of the streak for a comparison of both.
LEAST_SIDE = 6
APART = 5.0
# Relative uncertainty of the stated light between stacks: neutral-density steps are rarely known
# better.
LIGHT_SD = 0.03
# Minimum ratio of the light of two stacks with smear for a test of proportionality.
LEAST_RATIO = 2.5


@dataclass(frozen=True, kw_only=True)
class Core:
    """Columns of the core, and their signal.

    `half_width_px`: columns on either side of the source's column; `light`: stated light;
    `light_dn`, `light_sd_dn`: mean over these columns of their summed signal above that of their
    neighbours', per unit light, and its standard error, DN; `stack`: label of the unsaturated
    stack.
    """

    half_width_px: int
    light: float
    light_dn: float
    light_sd_dn: float
    stack: str


@dataclass(frozen=True, kw_only=True)
class Smear:
    """Uniform column signal of one stack.

    `label`: the stack; `light`: stated light; `level_dn`, `level_sd_dn`: mean of the core's columns
    above their neighbours far from the source, and its standard error, DN; `uneven`: whether it
    differs between above and below the source.
    """

    label: str
    light: float
    level_dn: float
    level_sd_dn: float
    uneven: bool


def smear_measurement(
    spots: tuple[PointStack, ...], context: Context, **fields: Any
) -> tuple[Measurement, dict[str, Any]]:
    """Return the smear fraction of stacks of one source at several known illuminances, and its
    figure data.

    The fraction f refers to the summed signal S of a column of R rows, each of which receives f S /
    R. A stack with visible smear has a saturated core, so that S is scaled from an unsaturated
    stack by the ratio of stated light. Linearity of the tube is verified only by a second stack
    with proportional smear: with one alone the number is flagged `extrapolated`. Without visible
    smear it is refused with an upper limit that assumes linearity.
    """
    clear = [spot for spot in spots if spot.significance > DETECTED]
    smears, reasons = [], []
    try:
        core = _core_of(clear, context)
    except Unmeasurable as refusal:
        return make_refusal("smear_fraction", "1", str(refusal), **fields), {}
    for spot in clear:
        if (spot.exposure_lux_ns or 0.0) > LEAST_RATIO * core.light:
            try:
                smears.append(_smear_of(spot, core, context))
            except Unmeasurable as refusal:
                reasons.append(str(refusal))
    if not smears:
        reason = reasons[0] if reasons else "no stack is brighter than the unsaturated one"
        return make_refusal("smear_fraction", "1", reason, **fields), {}
    rows = clear[0].image.shape[0]
    evidence = {
        "figure": "bloom-smear",
        "label": [smear.label for smear in smears],
        "light_per_row_dn": [smear.light * core.light_dn / rows for smear in smears],
        "level_dn": [smear.level_dn for smear in smears],
        "level_sd_dn": [smear.level_sd_dn for smear in smears],
        "core_stack": core.stack,
        "core_columns": 2 * core.half_width_px + 1,
    }
    return _fraction(smears, core, rows, **fields), {"bloom-smear": evidence}


def _core_of(spots: list[PointStack], context: Context) -> Core:
    """Sum the signal of each column of the brightest unsaturated stack."""
    if not spots:
        raise Unmeasurable("no point source is detected")
    if any(spot.exposure_lux_ns is None for spot in spots):
        raise Unmeasurable("the illuminance of the stacks is unknown: smear has no reference")
    linear = [spot for spot in spots if spot.exposure_lux_ns and _is_linear(spot)]
    if not linear:
        raise Unmeasurable("every stack saturates the core: the signal of its columns is unknown")
    spot = max(linear, key=lambda stack: stack.exposure_lux_ns or 0.0)
    near_rows = np.abs(np.arange(spot.image.shape[0]) - spot.row) * context.pitch_ratio <= 24
    sums = spot.image[near_rows].sum(axis=0)
    col = round(spot.col)
    column_excess = sums[max(0, col - 6) : col + 7] - np.median(sums)
    over = np.flatnonzero(column_excess > 0.25 * column_excess.max())
    half = int(np.clip(np.abs(over - min(6, col)).max(), 1, 6))
    value, sd = _contrast(spot.image, near_rows, half, col)
    light, value = spot.exposure_lux_ns or 1.0, value * near_rows.sum()
    noise = np.hypot(
        sd * near_rows.sum(),
        np.sqrt(spot.noise.sum_variance((2 * half + 1) * value)) / (2 * half + 1),
    )
    if not value > 0 or noise > 0.25 * value:
        raise Unmeasurable(
            "the signal of the core's columns is too uncertain: the unsaturated stacks are too "
            "faint"
        )
    return Core(
        half_width_px=half,
        light=light,
        light_dn=value / light,
        light_sd_dn=float(noise) / light,
        stack=spot.label,
    )


def _is_linear(spot: PointStack) -> bool:
    row, col = round(spot.row), round(spot.col)
    peak = float(spot.image[max(0, row - 2) : row + 3, max(0, col - 2) : col + 3].max())
    return peak - spot.dark_dn < 0.65 * (spot.full_scale_dn - spot.dark_dn)


def _contrast(image: Array, rows: Mask, half: int, col: int) -> tuple[float, float]:
    """Mean of the core's columns less their neighbours' over some rows, and its standard error.

    The error is the scatter of the same difference elsewhere along these rows, which includes
    correlated noise.
    """
    along = image[rows].mean(axis=0)
    half_span = half + 3 + FLANK_PX
    weight = np.zeros(2 * half_span + 1)
    weight[:FLANK_PX], weight[-FLANK_PX:] = -0.5 / FLANK_PX, -0.5 / FLANK_PX
    weight[half_span - half : half_span + half + 1] = 1.0 / (2 * half + 1)
    padded = np.pad(along, half_span, mode="reflect")
    everywhere = np.correlate(padded, weight, mode="valid")
    cols = np.arange(len(along))
    clear_cols = (
        (cols >= half_span)
        & (cols < len(along) - half_span)
        & (np.abs(cols - col) > half_span + half)
    )
    other_contrasts = (
        everywhere[clear_cols]
        if clear_cols.sum() >= 4 * half_span
        else everywhere[np.abs(cols - col) > half_span + half]
    )
    if len(other_contrasts) < half_span:
        raise Unmeasurable(
            "the frame is too narrow: there are no columns far from the source for comparison"
        )
    spread = max(robust_sd(other_contrasts, 0.0), float(np.std(other_contrasts)))
    return float(everywhere[col]), max(spread, ROUNDED_DN / np.sqrt(rows.sum()))


def _smear_of(spot: PointStack, core: Core, context: Context) -> Smear:
    """Uniform column signal of one stack."""
    col, half = round(spot.col), core.half_width_px
    # The round profile is subtracted first, since its curvature resembles a faint column.
    columns = compare_columns(spot, context, half_width_px=spot.image.shape[1])
    middle = slice(max(0, col - half), col + half + 1)
    far_rows = _far_rows(columns, middle, float(spot.noise.sd(spot.light.level_dn)))
    far_above, far_below = far_rows & (columns.row_offset < 0), far_rows & (columns.row_offset > 0)
    if far_rows.sum() < 16:
        raise Unmeasurable(
            "the source's streak or halo extends to the frame's top and bottom: smear is not "
            "separable from them"
        )
    # One full column is sufficient, since a streak's columns differ in length.
    column_level = float(np.median(spot.image[far_rows, middle], axis=0).max()) - spot.dark_dn
    if column_level > FULL_SHARE * (spot.full_scale_dn - spot.dark_dn):
        raise Unmeasurable(
            "the columns are bright from top to bottom: smear is not separable from a streak"
        )
    level, sd = _contrast(columns.excess_dn, far_rows, half, col)
    # Halo and wing add noise to these columns.
    sd *= float(
        np.sqrt(
            (columns.sd_dn[far_rows, middle] ** 2).mean() / np.median(columns.sd_dn[far_rows]) ** 2
        )
    )
    uneven = False
    if min(far_above.sum(), far_below.sum()) >= LEAST_SIDE:
        (up, up_sd), (down, down_sd) = (
            _contrast(columns.excess_dn, rows, half, col) for rows in (far_above, far_below)
        )
        uneven = abs(up - down) > APART * np.hypot(up_sd, down_sd)
    return Smear(
        label=spot.label,
        light=spot.exposure_lux_ns or 0.0,
        level_dn=level,
        level_sd_dn=sd,
        uneven=bool(uneven),
    )


def _far_rows(columns: ColumnArtefacts, middle: slice, noise: float) -> Mask:
    """Rows beyond the streak and outside the noisy part of the halo; `noise`: that of a pixel of
    the background, DN.
    """
    excess = columns.excess_dn[:, middle].max(axis=1)
    quiet = columns.sd_dn[:, middle].max(axis=1) < 1.3 * max(
        noise, float(np.median(columns.sd_dn[[0, -1]]))
    )
    out = np.zeros(len(excess), bool)
    for side in (-1, 1):
        rows = np.flatnonzero(columns.row_offset * side > 0)[::side]
        quiet_rows = rows[quiet[rows]]
        if len(quiet_rows) < LEAST_SIDE:
            continue
        last = excess[quiet_rows[-max(LEAST_SIDE, len(quiet_rows) // 4) :]]
        level = float(np.median(last))
        spread = max(noise, robust_sd(last, level))
        over = excess[rows] > level + 6.0 * spread
        run = np.flatnonzero(over[:-1] & over[1:])
        # The last pixels of a streak are partly filled: two rows more.
        outer_rows = rows[run[-1] + 4 :] if len(run) else rows
        out[outer_rows[quiet[outer_rows]]] = True
    return out


def _fraction(smears: list[Smear], core: Core, rows: int, **fields: Any) -> Measurement:
    """Combine stacks; scatter beyond their errors widens the interval."""
    light, level, error = np.array(
        [(smear.light, smear.level_dn, smear.level_sd_dn) for smear in smears]
    ).T
    fraction, sd = rows * level / (light * core.light_dn), rows * error / (light * core.light_dn)
    is_visible = level > 4.0 * error
    weight = 1.0 / (sd**2 + (LIGHT_SD * float(np.average(fraction, weights=sd**-2))) ** 2)
    weight /= weight.sum()
    mean = float(weight @ fraction)
    between = between_variance(fraction[is_visible], sd[is_visible]) ** 0.5
    scatter_sd = max(LIGHT_SD * mean, min(between, 0.3 * mean))
    # The light of the unsaturated stack has the same uncertainty.
    known = float(np.hypot(mean * core.light_sd_dn / core.light_dn, scatter_sd))
    total = float(np.sqrt(weight**2 @ (sd**2 + scatter_sd**2) + known**2))
    if not is_visible.any():
        upper_limit = max(mean, 0.0) + 2.0 * total
        reason = (
            f"no stack shows smear: it is at most {upper_limit:.2g} of a column's signal, if the "
            f"light is as stated"
        )
        return make_refusal("smear_fraction", "1", reason, refusal="not-applicable", **fields)
    checks = (
        ("extrapolated", light[is_visible].max() < LEAST_RATIO * light[is_visible].min(), None),
        ("nonlinear", _bends(light[is_visible], fraction[is_visible], sd[is_visible]), None),
        (
            "model-misfit",
            any(smear.uneven for smear, visible in zip(smears, is_visible, strict=True) if visible),
            "the columns are brighter on one side of the source, unlike smear",
        ),
    )
    number = measurement_from_sd("smear_fraction", "1", mean, total, **fields)
    return judge(number, [finding(flag, effect) for flag, raised, effect in checks if raised])


def _bends(light: Array, fraction: Array, sd: Array) -> bool:
    """Whether the fraction changes with the light: the column signal is then nonlinear."""
    if len(fraction) < 2:
        return False
    order = np.argsort(light)
    low, high = order[0], order[-1]
    differ = abs(fraction[high] - fraction[low]) > APART * np.hypot(sd[high], sd[low])
    return bool(differ and abs(fraction[high] / fraction[low] - 1.0) > 0.15)
