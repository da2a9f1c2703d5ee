"""3-D noise of one stack: seven components, and the means of its exposures."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.frames.components import (
    ROW,
    TIME,
    Component,
    components,
    shading,
    subtract_means,
)
from charact.frames.contrasts import Contrasts, contrasts, row_sets
from charact.frames.thresholds import CUBE, STACK
from charact.method import Context
from charact.method.stopwatch import Stopwatch
from labdata.camera.description import is_thermal
from labdata.frames import LazyStack

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FrameMeans:
    """Means of the exposures of one stack."""

    mean_dn: Array  # mean of each exposure about the mean of its parity, shape (exposure,), DN
    # frequencies above zero, shape (frequency,), cycles per exposure
    frequency_cy_per_exposure: Array
    # variance of the means at each frequency without drift, shape (frequency,), DN^2
    power_dn2: Array
    exposure_period_s: float | None  # exposure period, s; None without time stamps
    # drift_dn, drift_seen: linear change from first to last exposure, DN, and whether it is
    # significant
    drift_dn: float
    drift_seen: bool
    line: int | None  # index of the strongest frequency if significant, else None

    @property
    def line_rms_dn(self) -> float:
        """Root mean square of the flicker line, DN; 0 for none."""
        return 0.0 if self.line is None else float(np.sqrt(self.power_dn2[self.line]))

    @property
    def line_hz(self) -> float | None:
        """Frequency of the line, or of its alias below half of the exposure rate, Hz."""
        if self.line is None or self.exposure_period_s is None:
            return None
        return float(self.frequency_cy_per_exposure[self.line] / self.exposure_period_s)


def frame_means(field_mean_dn: Array, time_s: NDArray) -> FrameMeans:
    """Search the means of exposures for drift and a flicker line.

    `field_mean_dn`: mean of every frame of each field, shape (field, frame), DN, at least four
    frames; `time_s`: time of each frame, shape (frame,), s; empty if unknown.

    The largest of m powers of white noise exceeds the fraction g of their sum with probability m (1
    - g)^(m - 1) (Fisher, Proc. R. Soc. A 125, 54 (1929), first term).
    """
    fields = len(field_mean_dn)
    series = (field_mean_dn - field_mean_dn.mean(axis=1, keepdims=True)).T.ravel()
    drift, is_significant, residual = _drift(series, fields)
    power = 2.0 * np.abs(np.fft.rfft(residual)[1:]) ** 2 / len(residual) ** 2
    if len(residual) % 2 == 0:
        power[-1] /= 2.0
    frequency = np.asarray(np.fft.rfftfreq(len(residual))[1:], np.float64)
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    return FrameMeans(
        mean_dn=series,
        frequency_cy_per_exposure=frequency,
        power_dn2=power,
        exposure_period_s=step / fields if step > 0 else None,
        drift_dn=drift,
        drift_seen=is_significant,
        line=_line(power),
    )


def _drift(series: Array, constraints: int) -> tuple[float, bool, Array]:
    """Return the linear change from first to last, whether it is significant, and the residual."""
    from scipy.special import fdtrc

    time = np.linspace(-0.5, 0.5, len(series))
    slope = float(time @ series / (time @ time))
    residual = series - slope * time
    free = len(series) - constraints - 1
    explained, residual_variance = slope**2 * float(time @ time), float(residual @ residual) / free
    if residual_variance <= 0:
        return slope, slope != 0, residual
    return slope, bool(fdtrc(1, free, explained / residual_variance) < STACK.false_alarm), residual


def _line(power: Array) -> int | None:
    """Return the index of a significant power."""
    if power.sum() <= 0:
        return None
    strongest = int(np.argmax(power))
    fraction = float(power[strongest] / power.sum())
    return (
        strongest if len(power) * (1.0 - fraction) ** (len(power) - 1) < STACK.false_alarm else None
    )


@dataclass(frozen=True, kw_only=True)
class Cube:
    """3-D noise of one stack."""

    components: dict[str, Component]  # variance of each component, by its axes: "t" to "tvh"
    shading_dn: float  # smooth shading that the components exclude, DN rms
    # difference of even and odd rows where it is significant, else 0, DN: in the mean of all
    # frames ("v") and frame by frame ("tv")
    row_difference_dn: dict[str, float]
    means: FrameMeans  # means of the exposures
    # row_mean_dn, column_mean_dn: mean of each row, shape (row,), and of each column, shape (col,),
    # DN
    row_mean_dn: Array
    column_mean_dn: Array
    fields: int  # number of cubes: 2 for interlaced frames, 4 if their lines are scanned both ways
    seconds: float  # run time, s


def cube_of(stack: LazyStack, *, context: Context) -> Cube | None:
    """Return the 3-D noise of a stack; None if it is too short or too small."""
    frames, rows, cols = stack.shape
    two_way = is_thermal(context.camera) and context.camera.scanner is not None
    sets = row_sets(interlaced=context.interlaced, two_way=two_way)
    if frames < CUBE.min_frames or min(rows // sets, cols) < CUBE.min_pixels:
        return None
    watch = Stopwatch()
    measured = contrasts(stack, interlaced=context.interlaced, two_way=two_way)
    parts = components(measured)
    fields = 2 if context.interlaced else 1
    # Lines of both directions of one field have one exposure.
    mean_dn = measured.frame_mean_dn.reshape(sets // fields, fields, frames).mean(axis=0)
    return Cube(
        components=parts,
        shading_dn=_shading(measured),
        row_difference_dn={
            name: 0.0 if sets > 1 else _row_difference(measured, fixed=name == "v")
            for name in ("v", "tv")
        },
        means=frame_means(mean_dn, stack.time_s),
        row_mean_dn=(measured.by_row[..., 0].mean(axis=1) / np.sqrt(measured.size[2])).T.ravel(),
        column_mean_dn=(measured.by_col[:, :, 0].mean(axis=1) / np.sqrt(measured.size[1])).mean(
            axis=0
        ),
        fields=len(measured.by_row),
        seconds=watch.seconds(),
    )


def _shading(measured: Contrasts) -> float:
    """Return the root mean square of the smooth shading of the mean image, DN."""
    image = measured.by_pixel[:, 0] / np.sqrt(measured.size[0])
    rows, cols = (np.column_stack([np.full(n, n**-0.5), shading(n)]) for n in measured.size[1:])
    smooth = rows.T @ image @ cols
    smooth[:, 0, 0] = 0.0
    return float(np.sqrt(np.sum(smooth**2) / image.size))


def _row_difference(measured: Contrasts, *, fixed: bool) -> float:
    """Return the difference of even and odd rows, DN; 0 where alternating rows have no more power
    than others.
    """
    rows = subtract_means(measured.by_row[..., :1], (TIME, ROW), fixed=False)
    if fixed:
        rows = subtract_means(
            measured.by_row[..., :1].mean(axis=1, keepdims=True), (ROW,), fixed=True
        )
    sign = (-1.0) ** np.arange(rows.shape[2]) / np.sqrt(rows.shape[2])
    alternating = np.einsum("ftvx,v->ft", rows, sign)
    power = float(np.mean(alternating**2) / np.mean(rows**2)) if np.any(rows) else 0.0
    limit = (
        CUBE.alternating_power
        if fixed
        else 1.0 + CUBE.alternating_sd * np.sqrt(2.0 / (measured.size[0] - 1))
    )
    if power <= limit:
        return 0.0
    return 2.0 * float(np.sqrt(np.mean(alternating**2) / rows.shape[2] / measured.size[2]))
