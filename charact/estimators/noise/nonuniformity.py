"""Nonuniformity of mean frames by EMVA 1288 Release 4.0 Linear: parts of rows, columns and pixels,
spectrograms, profiles and histograms.

    s^2 = var <y> - sigma^2/L                                              (eq. 33 to 36)
    s_cav^2 = s_col^2 + s_px^2/M,  s_rav^2 = s_row^2 + s_px^2/N            (eq. 37 to 41)
    s^2 = s_col^2 + s_row^2 + s_px^2                                       (eq. 42)
    DSNU = s_dark/K,  PRNU = (s_50^2 - s_dark^2)^(1/2) / (mu_50 - mu_dark) (eq. 66, 67)

<y>: mean of L frames of M rows and N columns; sigma^2: temporal variance of a pixel; cav, rav:
variances of the means of columns and of rows, less sigma^2/(L M) and sigma^2/(L N). 50: a flat at
half of saturation.

Each is given of the frames as they are, as the reference program of the EMVA 1288 group takes it,
and behind the high-pass filter of section 8.1, which removes shading: a frame less itself behind
boxes of 7 x 7 and 11 x 11 pixels and a binomial filter of 3 x 3.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from charact.estimators.noise.defective_pixels import FrameView
from charact.estimators.noise.findings import finding
from charact.estimators.noise.thresholds import DATA_SHEET
from charact.frames.stack_statistics import StackStatistics
from charact.verdict import Finding, judge
from labdata import Array, Measurement, Result, StackEntry, make_measurement, make_refusal
from labdata import open_lazy_stack as open_stack

# The smooth part h along an axis, and the fraction of white noise 1 - 2 h(0)^2 + (sum h^2)^2 that a
# frame less its smooth part keeps.
SMOOTH = np.convolve(np.convolve(np.full(7, 1 / 7), np.full(11, 1 / 11)), (0.25, 0.5, 0.25))
KEPT = float(1.0 - 2.0 * SMOOTH.max() ** 2 + (SMOOTH @ SMOOTH) ** 2)
# Frames that are read at once.
BLOCK = 16
PARTS = ("", "_column", "_row", "_pixel")
HIDDEN = "hidden by temporal noise; more frames of one stack show less"


@dataclass(frozen=True, kw_only=True)
class MeanFrame:
    """Mean of the frames of a stack, and how much its frames change."""

    dn: Array  # shape (row, col), DN
    frames: int
    pixel_dn2: float  # temporal variance of a pixel, DN^2
    # temporal variance of the means of columns and of rows about those of their frames, DN^2
    column_dn2: float
    row_dn2: float
    frame_dn2: float = 0.0  # temporal variance of the means of frames, DN^2

    @cached_property
    def filtered(self) -> Array:
        """The mean behind the high-pass filter."""
        return highpass(self.dn)

    def variances(self, *, filtered: bool) -> tuple[Array, Array, Array]:
        """Return s^2 and its parts of columns, rows and pixels, their standard errors, and by how
        much noise in time of complete lines and frames shifts them, shape (4,) each, DN^2.

        The standard takes noise in time for white: of it lines have sigma^2/(L M), and all of
        sigma^2/L, flicker included, varies over the frame. The errors are those of the mean frame
        of this chip; of a pattern s and residual noise n they are (2 n^4 + 4 s^2 n^2)/pixels
        squared.
        """
        frame = self.filtered if filtered else self.dn
        rows, cols = frame.shape
        noise = np.array([self.pixel_dn2, self.column_dn2, self.row_dn2, self.pixel_dn2])
        noise = noise / self.frames
        white = noise[0] * (KEPT if filtered else 1.0)
        across, down = frame.mean(axis=0).var(), frame.mean(axis=1).var()
        measured = np.array([across - white / rows, down - white / cols, frame.var() - white])
        mixing = np.array([[1.0, 0.0, 1.0 / rows], [0.0, 1.0, 1.0 / cols], [1.0, 1.0, 1.0]])
        column, row, pixel = np.linalg.solve(mixing, measured)
        square = np.array([measured[2], column, row, pixel])
        number = np.array([rows * cols, cols, rows, rows * cols])
        sd = np.sqrt((2.0 * noise**2 + 4.0 * np.maximum(square, 0.0) * noise) / number)
        lines = np.maximum(noise[1:3] - noise[0] / np.array([rows, cols]), 0.0)
        flicker = self.frame_dn2 / self.frames
        return square, sd, np.array([-flicker, *lines, -flicker - lines.sum()])


def mean_frame_of(level: StackStatistics) -> MeanFrame:
    """Return the mean frame of a stack with its defective pixels, which the standard counts."""
    assert level.entry is not None
    stack = open_stack(_with_defects(level.entry))
    total = square = np.zeros(stack.shape[1:])
    columns, rows = [], []
    for first in range(0, len(stack), BLOCK):
        data = stack.frames(first, min(first + BLOCK, len(stack))).astype(np.float64)
        total = total + data.sum(axis=0)
        square = square + np.einsum("frc,frc->rc", data, data)
        columns.append(data.mean(axis=1))
        rows.append(data.mean(axis=2))
    mean = total / len(stack)
    lines = np.concatenate(columns), np.concatenate(rows)
    by_column, by_row = (
        (means - means.mean(axis=1, keepdims=True)).var(axis=0, ddof=1).mean() for means in lines
    )
    return MeanFrame(
        dn=mean,
        frames=len(stack),
        pixel_dn2=float(np.mean(square - total * mean) / (len(stack) - 1)),
        column_dn2=float(by_column),
        row_dn2=float(by_row),
        frame_dn2=float(lines[1].mean(axis=1).var(ddof=1)),
    )


def _with_defects(entry: StackEntry) -> StackEntry:
    """Return a stack whose defective pixels and struck values are not replaced."""
    view, none = entry.view, np.empty(0, np.int64)
    if not isinstance(view, FrameView):
        return entry
    names = ("pixels", "donors", "struck", "frame", "struck_donors")
    return replace(entry, view=replace(view, **dict.fromkeys(names, none)))


def highpass(frame: Array) -> Array:
    """Return a frame less its smooth part (8.1); beyond its edges it is mirrored."""
    import cv2

    return frame - cv2.sepFilter2D(frame, -1, SMOOTH, SMOOTH, borderType=cv2.BORDER_REFLECT)


def nonuniformity(
    dark: StackStatistics,
    flat: StackStatistics,
    gain: Array,
    findings: list[Finding],
    *,
    missing: str,
    seed: int,
    **fields: Any,
) -> Result:
    """Return DSNU and PRNU with their parts, and the standard's pictures of both.

    `flat`: the one at half of saturation; `gain`: draws of K, DN per electron; `findings`: on K,
    with unbounded effects; `missing`: frames that the standard asks for.
    """
    of_dark, of_flat = mean_frame_of(dark), mean_frame_of(flat)
    signal_dn = float(of_flat.dn.mean() - of_dark.dn.mean())
    rng = np.random.default_rng([seed, 20])
    out: list[Measurement] = []
    for suffix in ("", "_filtered"):
        square, sd, raised = of_dark.variances(filtered=bool(suffix))
        lit, lit_sd, lit_raised = of_flat.variances(filtered=bool(suffix))
        noise = (square, sd, raised)
        response = (lit - square, np.hypot(lit_sd, sd), lit_raised - raised)
        for unit, scale, name, dn2, of_gain in (
            ("DN", np.ones_like(gain), "dsnu", noise, []),
            ("e-", 1.0 / gain, "dsnu", noise, findings),
            ("%", np.full_like(gain, 100.0 / signal_dn), "prnu", response, []),
        ):
            for part, *of_part in zip(PARTS, *dn2, strict=True):
                if part and unit == "DN":
                    break
                quantity = f"{name}_1288{part}{suffix}"
                out.append(_root(quantity, unit, scale, of_part, rng, of_gain, **fields))
    pictures = dict(_pictures(of_dark, of_flat, signal_dn))
    pictures["spectrograms"]["missing"] = missing
    return Result(measurements=tuple(out), evidence=pictures)


def _root(
    quantity: str,
    unit: str,
    scale: Array,
    of_part: list[float],
    rng: np.random.Generator,
    findings: list[Finding],
    **fields: Any,
) -> Measurement:
    """Return the root of a variance, its standard error and its shift by lines and frames in time,
    DN^2, in a unit of the scale's draws.
    """
    square, sd, raised = of_part
    factor = float(np.median(scale))
    if square <= 0.0:
        limit = factor * float(np.sqrt(max(square - raised, 0.0) + DATA_SHEET.limit_sd * sd))
        return make_refusal(
            quantity, unit, HIDDEN, notes=(f"at most {limit:.3g} {unit}",), **fields
        )
    draws = scale * np.sqrt(np.maximum(square + sd * rng.standard_normal(len(scale)), 0.0))
    value = factor * float(np.sqrt(square))
    low95, low68, high68, high95 = np.quantile(draws, DATA_SHEET.quantiles).tolist()
    interval68, interval95 = (
        (min(low, value), max(high, value)) for low, high in ((low68, high68), (low95, high95))
    )
    m = make_measurement(quantity, unit, value, interval68, interval95, **fields)
    shift = value - factor * float(np.sqrt(max(square - raised, 0.0)))
    bound, sign = abs(shift), 1 if shift > 0.0 else -1
    effect = f"noise in time of complete lines and frames shifts it by {shift:+.2g} {unit}"
    is_small = bound < DATA_SHEET.small_shift * (interval95[1] - interval95[0])
    lines = [] if is_small else [finding("too-few-frames", effect, bound=bound, sign=sign)]
    judged = judge(m, [*findings, *lines])
    # No root is negative.
    limits = (
        pair and (max(pair[0], 0.0), pair[1]) for pair in (judged.interval68, judged.interval95)
    )
    return replace(judged, **dict(zip(("interval68", "interval95"), limits, strict=True)))


def _pictures(
    dark: MeanFrame, flat: MeanFrame, signal_dn: float
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and data of the standard's figures (8.6 to 8.8): spectrograms, profiles and
    histograms of dark and response.
    """
    response = flat.dn - dark.dn
    percent = 100.0 / signal_dn
    smooth = {"dn": dark.filtered, "percent": percent * (flat.filtered - dark.filtered)}
    # Root of the temporal variance, and the root of the spatial one before and after its removal.
    marks = {}
    for unit, stack, scale in (("dn", dark, 1.0), ("percent", flat, percent)):
        noise, frame = scale**2 * stack.pixel_dn2, smooth[unit]
        spatial = max(float(frame.var()) - KEPT * noise / stack.frames, 0.0)
        marks[unit] = {"temporal": noise**0.5, "measured": float(frame.std()), "1288": spatial**0.5}
    yield (
        "spectrograms",
        {
            "figure": "spectrograms",
            **{
                f"{way}_{unit}": _rounded(_spectrogram(frame, axis))
                for unit, frame in smooth.items()
                for way, axis in (("horizontal", 1), ("vertical", 0))
            },
            **{f"{mark}_{unit}": v for unit, of in marks.items() for mark, v in of.items()},
        },
    )
    profiles = {
        f"{stack}_{way}_{name}_dn": _rounded(line)
        for stack, frame in (("dark", dark.dn), ("bright", response))
        for way, axis in (("horizontal", 0), ("vertical", 1))
        for name, line in _profiles(frame, axis).items()
    }
    size = {"horizontal_px": dark.dn.shape[1], "vertical_px": dark.dn.shape[0]}
    yield "profiles", {"figure": "profiles", **size, **profiles}
    yield (
        "defect-histograms",
        {
            "figure": "defect-histograms",
            **{
                # Numbers of pixels are in no unit.
                f"{name}_{unit}" if name == "deviation" else f"{name}_of_{of}": values
                for of, (unit, frame) in zip(("dsnu", "prnu"), smooth.items(), strict=True)
                for name, values in _histogram(frame).items()
            },
        },
    )


def _rounded(values: Array) -> list[float]:
    """Return values to six digits."""
    return [float(f"{value:.6g}") for value in values]


def _spectrogram(frame: Array, axis: int) -> Array:
    """Return the root of the mean power of the lines along an axis, which of white noise is its
    standard deviation at every frequency (8.6).
    """
    power = np.abs(np.fft.rfft(frame - frame.mean(), axis=axis, norm="ortho")) ** 2
    return np.sqrt(power.mean(axis=1 - axis))[1:]


def _profiles(frame: Array, axis: int) -> dict[str, Array]:
    """Return middle line, mean, least and largest value over an axis, of groups of lines where
    these are many (8.7).
    """
    count = frame.shape[1 - axis]
    starts = np.unique(np.linspace(0, count, DATA_SHEET.points, endpoint=False).astype(int))
    lines = frame.take(frame.shape[axis] // 2, axis=axis)[starts]
    size = np.diff([*starts, count])
    return {
        "middle": lines,
        "mean": np.add.reduceat(frame.mean(axis=axis), starts) / size,
        "least": np.minimum.reduceat(frame.min(axis=axis), starts),
        "largest": np.maximum.reduceat(frame.max(axis=axis), starts),
    }


def _histogram(frame: Array) -> dict[str, list[float]]:
    """Return the number of pixels by deviation from the mean, the normal distribution of equal
    variance, and the share of pixels that deviate by as much or more, % (8.8).
    """
    deviation = (frame - frame.mean()).ravel()
    pixels, edges = np.histogram(deviation, DATA_SHEET.bins)
    middle, sd = 0.5 * (edges[1:] + edges[:-1]), max(float(deviation.std()), 1e-12)
    chance = np.exp(-0.5 * (middle / sd) ** 2) / (np.sqrt(2.0 * np.pi) * sd)
    normal = chance * (edges[1] - edges[0]) * deviation.size
    steps = np.linspace(0.0, np.abs(deviation).max(), len(middle))
    rarer = np.searchsorted(np.sort(np.abs(deviation)), steps)
    return {
        "deviation": _rounded(middle),
        "pixels": _rounded(pixels),
        "normal": _rounded(normal),
        "share": _rounded(100.0 * (1.0 - rarer / deviation.size)),
    }
