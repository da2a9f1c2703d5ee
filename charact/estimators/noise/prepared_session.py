"""Preparation of a session: defective pixels replaced, values in units of the quantisation step,
results in DN.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.findings import fields_of
from charact.estimators.noise.gain.series import has_multiplication
from charact.estimators.noise.pixel_survey import PixelSurvey, common_step, survey_pixels
from charact.estimators.noise.thresholds import SURVEY
from charact.frames.stack_statistics import WHOLE_BYTES
from charact.method import Context
from labdata import (
    LoadedStackEntry,
    Measurement,
    Result,
    Session,
    StackEntry,
    make_measurement,
    make_refusal,
)
from labdata.frames import LazyStack

Places = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class DefectivePixels:
    """Excluded pixels of a session; positions are row times columns plus column."""

    pixels: Places  # pixels that are defective in all frames
    blinking: Places  # those that blink
    # by stack label, positions and frames of struck values; frame -1 for all frames of the stack
    struck: dict[str, tuple[Places, Places]] = field(default_factory=dict)

    @property
    def note(self) -> str | None:
        """Note on the excluded pixels; None for none."""
        hits = sum(len(hit_pixels) for hit_pixels, _ in self.struck.values())
        parts = [f"{len(self.pixels)} defective pixels of the session"] if len(self.pixels) else []
        parts += [f"{hits} outliers of single frames (cosmic rays, ion feedback)"] if hits else []
        return f"excludes {' and '.join(parts)}" if parts else None


def find_defective_pixels(surveys: Sequence[PixelSurvey], *, multiplies: bool) -> DefectivePixels:
    """Return the defective pixels.

    `surveys`: one of each stack, of equal size; `multiplies`: whether a tube or a register
    multiplies electrons; its pulses are valid outliers.
    """
    pixels = surveys[0].pixels
    outlying = np.zeros(pixels, bool)
    for survey in surveys:
        outlying[survey.bright] = outlying[survey.faint] = True
    if np.count_nonzero(outlying) > SURVEY.max_fraction * pixels:
        outlying[:] = False
    min_departure_dn = SURVEY.max_pulse * _slope(surveys) if multiplies else 0.0
    blinks = _blinking_mask(surveys, outlying)
    defective = outlying | blinks
    struck = {
        survey.label: hits
        for survey in surveys
        if len((hits := _outlying_values(survey, defective, min_departure_dn))[0])
    }
    return DefectivePixels(
        pixels=np.flatnonzero(defective), blinking=np.flatnonzero(blinks), struck=struck
    )


def _slope(surveys: Sequence[PixelSurvey]) -> float:
    """Return variance over signal of the flats by robust statistics, DN; 0 without flats."""
    darks = [survey for survey in surveys if survey.kind == "dark"]
    dark, noise = (
        min((getattr(survey, name) for survey in darks), default=0.0)
        for name in ("level_dn", "sd_dn")
    )
    flats = [survey for survey in surveys if survey.kind == "flat" and survey.level_dn > dark]
    slopes = [(survey.sd_dn**2 - noise**2) / (survey.level_dn - dark) for survey in flats]
    return max(float(np.median(slopes)), 0.0) if slopes else 0.0


def _blinking_mask(
    surveys: Sequence[PixelSurvey], outlying: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the pixels that are outliers more often than chance allows."""
    from scipy.special import bdtrc

    counts, trials = np.zeros(len(outlying), np.int64), 0
    for survey in surveys:
        if len(survey.sudden) <= SURVEY.max_fraction * survey.pixels:
            counts[survey.sudden] += survey.times
            trials += survey.trials
    if not trials:
        return np.zeros(len(outlying), bool)
    never = float(np.mean(counts[~outlying] == 0))
    rate = min(SURVEY.rate_variation * (1.0 - max(never, 1e-9) ** (1.0 / trials)), 1.0)
    needed = np.arange(2, trials + 2)
    enough = needed[bdtrc(needed - 1, trials, rate) * len(outlying) < SURVEY.false_alarm]
    blinks = counts >= (enough[0] if len(enough) else trials + 1)
    return (
        blinks
        if np.count_nonzero(blinks) <= SURVEY.max_fraction * len(outlying)
        else np.zeros(len(outlying), bool)
    )


def _outlying_values(
    survey: PixelSurvey, defective: NDArray[np.bool_], min_departure_dn: float
) -> tuple[Places, Places]:
    """Return the values far beyond the tail of their stack."""
    is_sound = ~defective[survey.sudden]
    uses_tail = (
        survey.kind == "flat"
        or min_departure_dn > 0
        or np.count_nonzero(is_sound) > SURVEY.blinking_fraction * survey.pixels
    )
    is_outlier = is_sound & (
        survey.departure_dn > max(min_departure_dn, survey.tail_dn(defective) if uses_tail else 0.0)
    )
    return survey.sudden[is_outlier], np.where(
        survey.times[is_outlier] > 1, -1, survey.frame[is_outlier]
    )


METHOD = "outlying-pixels"


def defect_pixels(
    session: Session,
    surveys: Sequence[PixelSurvey],
    defects: DefectivePixels | None,
    *,
    context: Context,
) -> Result:
    """Return the number of defective pixels in the dark of the longest exposure and in the
    brightest flat.
    """
    fields = fields_of(METHOD, context)
    known = [survey for survey in surveys if survey.threshold_dn > 0]
    if defects is None or not known:
        reason = (
            "defective pixels need stacks of two frames and of 32 x 32 px at least that "
            "change from frame to frame"
        )
        return Result(measurements=(make_refusal("defect_pixels", "px", reason, **fields),))
    exposure = {entry.label: entry.conditions.exposure_s or 0.0 for entry in session.stacks}
    darks = [survey for survey in known if survey.kind == "dark"]
    flats = [survey for survey in known if survey.kind == "flat"]
    chosen = (
        [max(darks, key=lambda survey: (exposure[survey.label], survey.frames))] if darks else []
    )
    chosen += [max(flats, key=lambda survey: survey.level_dn)] if flats else []
    return Result(measurements=tuple(_defect_count(survey, defects, fields) for survey in chosen))


def _defect_count(
    survey: PixelSurvey, defects: DefectivePixels, fields: dict[str, Any]
) -> Measurement:
    """Return the number of defective pixels of a stack."""
    blinking = np.intersect1d(defects.blinking, survey.sudden)
    bright, faint = (np.setdiff1d(pixels, blinking) for pixels in (survey.bright, survey.faint))
    counts = f"{len(bright)} bright, {len(faint)} faint, {len(blinking)} blinking"
    criterion = (
        f"a mean more than {survey.threshold_dn:.3g} DN ({SURVEY.outlying_sd:g} robust standard "
        f"deviations) off"
    )
    notes = [
        f"{counts}; {criterion} the surrounding ones, or outliers in more frames than chance allows"
    ]
    pixels = np.concatenate([bright, faint, blinking])
    count = len(np.unique(pixels))
    if count:
        rows, cols = np.divmod(pixels[: SURVEY.listed], survey.size[1])
        shown = ", ".join(
            f"({row}, {col})"
            for row, col in dict.fromkeys(zip(rows.tolist(), cols.tolist(), strict=True))
        )
        notes.append(f"row and column of the first: {shown}")
    lower, upper = (
        [number + len(blinking) for number in bounds]
        for bounds in (survey.lower_counts, survey.upper_counts)
    )
    around = [(float(min(lower[i], count)), float(max(upper[i], count))) for i in (0, 1)]
    return make_measurement(
        "defect_pixels",
        "px",
        float(count),
        *around,
        notes=tuple(notes),
        stack=survey.label,
        **fields,
    )


@dataclass(frozen=True, kw_only=True)
class FrameView:
    """Transformation of the frames of one stack on reading.

    A defective pixel takes the values of a valid one up to 32 px away in all frames, shifted by the
    difference of the surrounding medians, which preserves level, noise and pattern. Random
    distances average out the added correlation in spectra. Variances change by less than 1e-4 if
    one pixel of 200 is replaced.
    """

    unit_dn: float  # divisor of the values, DN
    integral: bool  # whether the values are integers then
    # pixels, donors: replaced pixels, and their replacements
    pixels: Places
    donors: Places
    # struck, frame, struck_donors: values replaced in single frames, the frames, and the
    # replacements
    struck: Places
    frame: Places
    struck_donors: Places

    def through(self, stack: LazyStack) -> LazyStack:
        """Return the transformed stack."""
        if self.unit_dn == 1.0 and not len(self.pixels) and not len(self.struck):
            return stack
        pixel, donor = (
            np.concatenate([self.pixels, self.struck]),
            np.concatenate([self.donors, self.struck_donors]),
        )
        first = stack.frames(0, min(len(stack), 2)).mean(axis=0, dtype=np.float64)
        shift = _surrounding_median(first, pixel) - _surrounding_median(first, donor)
        exact = stack.dtype.kind in "ui" or self.integral
        shift = np.rint(shift / self.unit_dn) * self.unit_dn if exact else shift
        throughout = len(self.pixels)

        def block(start: int, stop: int) -> NDArray:
            data = np.array(stack.frames(start, stop))
            flat = data.reshape(len(data), -1)
            if throughout:
                write_values(flat, np.s_[:], self.pixels, flat[:, self.donors], shift[:throughout])
            for at, frame, source, change in zip(
                self.struck, self.frame, self.struck_donors, shift[throughout:], strict=True
            ):
                if frame < 0:
                    write_values(flat, np.s_[:], at, flat[:, source], change)
                elif start <= frame < stop:
                    write_values(flat, frame - start, at, flat[frame - start, source], change)
            return self._in_units(data)

        full = None if stack.full_scale_dn is None else stack.full_scale_dn / self.unit_dn
        dtype = stack.dtype if self.unit_dn == 1.0 else np.dtype(np.float32)
        return replace(stack, block=block, full_scale_dn=full, dtype=dtype)

    def _in_units(self, data: NDArray) -> NDArray:
        if self.unit_dn == 1.0:
            return data
        scaled = data / self.unit_dn
        return (np.rint(scaled) if self.integral else scaled).astype(np.float32)


def write_values(flat: NDArray, frames, pixels, values: NDArray, shift) -> None:
    """Write shifted values, clipped to the range of an integer type."""
    shifted = values.astype(np.float64) + shift
    if flat.dtype.kind in "ui":
        limits = np.iinfo(flat.dtype)
        shifted = np.clip(shifted, limits.min, limits.max)
    flat[frames, pixels] = shifted.astype(flat.dtype)


def _surrounding_median(image: NDArray[np.float64], pixels: Places) -> NDArray[np.float64]:
    """Return the median of the 24 pixels around each position, DN."""
    rows, cols = image.shape
    row, col = np.divmod(pixels, cols)
    step = np.array([(i, j) for i in range(-2, 3) for j in range(-2, 3) if i or j])
    near_row = np.clip(row[:, None] + step[:, 0], 0, rows - 1)
    near_col = np.clip(col[:, None] + step[:, 1], 0, cols - 1)
    return np.median(image[near_row, near_col], axis=1) if len(pixels) else np.empty(0)


def choose_donors(
    pixels: Places, unsound: NDArray[np.bool_], size: tuple[int, int], rng: np.random.Generator
) -> Places:
    """Return a valid pixel near each position."""
    rows, cols = size
    donors = np.full(len(pixels), -1)
    while (missing := np.flatnonzero(donors < 0)).size:
        row, col = np.divmod(pixels[missing], cols)
        row = _mirror_inside(
            row + rng.integers(-SURVEY.replacement_px, SURVEY.replacement_px + 1, len(missing)),
            rows,
        )
        col = _mirror_inside(
            col + rng.integers(-SURVEY.replacement_px, SURVEY.replacement_px + 1, len(missing)),
            cols,
        )
        pixel = row * cols + col
        donors[missing] = np.where(unsound[pixel], -1, pixel)
    return donors


def _mirror_inside(position: NDArray, length: int) -> NDArray:
    """Return positions mirrored into the image."""
    position = np.abs(position) % (2 * length)
    return np.where(position < length, position, 2 * length - 1 - position)


def frame_view(
    label: str,
    defects: DefectivePixels | None,
    size: tuple[int, int],
    *,
    unit_dn: float,
    integral: bool,
    seed: int,
) -> FrameView:
    """Return the view of one stack."""
    none = np.empty(0, np.int64)
    pixels, struck, frame = none, none, none
    if defects is not None:
        pixels, (struck, frame) = defects.pixels, defects.struck.get(label, (none, none))
    unsound = np.zeros(size[0] * size[1], bool)
    unsound[pixels] = unsound[struck] = True
    rng = np.random.default_rng([seed, 71])
    return FrameView(
        unit_dn=unit_dn,
        integral=integral,
        pixels=pixels,
        donors=choose_donors(pixels, unsound, size, rng),
        struck=struck,
        frame=frame,
        struck_donors=choose_donors(struck, unsound, size, rng),
    )


# Files and folders that are memory-mapped.
MAPPED = (".npy", ".zarr")


def load_frames(entries: tuple[StackEntry, ...]) -> tuple[StackEntry, ...]:
    """Return darks and flats with their frames in memory, up to `WHOLE_BYTES`."""
    free_bytes, out = WHOLE_BYTES, []
    for entry in entries:
        plain = type(entry) is StackEntry and entry.kind in ("dark", "flat")
        paths = entry.paths if plain else ()
        if not paths or any(
            path.suffix in MAPPED or path.is_dir() or path.stat().st_size > free_bytes
            for path in paths
        ):
            out.append(entry)
            continue
        frames = entry.read()
        free_bytes -= frames.data.nbytes
        described = {item.name: getattr(entry, item.name) for item in fields(StackEntry)}
        out.append(LoadedStackEntry(**described, kept=frames) if free_bytes >= 0 else entry)
    return tuple(out)


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A session prepared for measurement."""

    # session, context: stacks with their views, and settings
    session: Session
    context: Context
    unit_dn: float  # unit of the values, DN
    surveys: tuple[PixelSurvey, ...]  # survey of each dark and flat of at least two frames
    defects: DefectivePixels | None  # defective pixels; None if the images are too small

    def in_dn(self, result: Result) -> Result:
        """Return a result in DN of the files, with a note on excluded pixels."""
        unit_dn, note = self.unit_dn, None if self.defects is None else self.defects.note
        notes = () if note is None else (note,)
        if unit_dn != 1.0:
            notes += (f"DN in other notes are units of {unit_dn:.4g} of the files' values",)
        noted = [
            m if m.value is None else replace(m, notes=(*m.notes, *notes))
            for m in result.measurements
        ]
        if unit_dn == 1.0:
            return replace(result, measurements=tuple(noted)) if notes else result
        return replace(
            result,
            measurements=tuple(_in_dn(m, unit_dn) for m in noted),
            evidence={
                name: _scale_figure_data(data, unit_dn) for name, data in result.evidence.items()
            },
        )


def prepare(session: Session, *, context: Context) -> Prepared:
    """Survey the darks and flats of a session and prepare it for measurement.

    Pixel means are compared in at most eight stacks distributed over the levels, because a defect
    shows in several.
    """
    session = replace(
        session, stacks=load_frames(session.stacks) if context.spread is map else session.stacks
    )
    entries = session.of_kind("dark", "flat")
    spread = set(
        np.linspace(0, len(entries) - 1, min(SURVEY.mean_stacks, len(entries)))
        .round()
        .astype(int)
        .tolist()
    )
    surveys = [survey_pixels(entry, means=i in spread) for i, entry in enumerate(entries)]
    multi_frame = [survey for survey in surveys if survey.frames > 1]
    is_large = (
        multi_frame and len({survey.size for survey in surveys}) == 1 and multi_frame[0].is_large
    )
    defects = (
        find_defective_pixels(multi_frame, multiplies=has_multiplication(session, context))
        if is_large
        else None
    )
    unit, integral = _unit(surveys)
    views = {
        survey.label: frame_view(
            survey.label, defects, survey.size, unit_dn=unit, integral=integral, seed=context.seed
        )
        for survey in surveys
    }
    stacks = tuple(replace(entry, view=views.get(entry.label)) for entry in session.stacks)
    full = None if context.full_scale_dn is None else context.full_scale_dn / unit
    return Prepared(
        session=replace(session, stacks=stacks),
        context=replace(context, full_scale_dn=full),
        unit_dn=unit,
        surveys=tuple(multi_frame),
        defects=defects,
    )


def _unit(surveys: list[PixelSurvey]) -> tuple[float, bool]:
    """Return the unit of the values, DN, and whether they are integers of it."""
    step = common_step([survey.step_dn for survey in surveys])
    if step is None:
        return 1.0, False
    if step > 0:
        return step, True
    noise = [survey.sd_dn for survey in surveys if survey.sd_dn > 0]
    return (
        (2.0 ** np.floor(np.log2(min(noise) / SURVEY.fine_units)), False) if noise else (1.0, False)
    )


def power_of_dn(unit: str) -> int:
    """Return the power of DN in a unit: 2 for DN2, 1 for DN or DN/e-, -1 for 1/DN, 0 for others."""
    numerator, _, denominator = unit.partition("/")
    powers = {"DN": 1, "DN2": 2}
    return powers.get(numerator, 0) - powers.get(denominator, 0)


def _in_dn(measurement: Measurement, unit_dn: float) -> Measurement:
    """Return a measurement converted from units to DN; logarithms of draws are shifted."""
    factor = unit_dn ** power_of_dn(measurement.unit)
    around = [
        None if pair is None else (pair[0] * factor, pair[1] * factor)
        for pair in (measurement.interval68, measurement.interval95)
    ]
    posterior = measurement.posterior
    if posterior is not None:
        draws = posterior.draws.copy()
        for column, unit in enumerate(posterior.units):
            power = power_of_dn(unit.removeprefix("log "))
            if unit.startswith("log "):
                draws[:, column] += power * np.log(unit_dn)
            else:
                draws[:, column] *= unit_dn**power
        posterior = replace(posterior, draws=draws)
    value = None if measurement.value is None else measurement.value * factor
    return replace(
        measurement, value=value, interval68=around[0], interval95=around[1], posterior=posterior
    )


def _scale_figure_data(data: Any, unit_dn: float, factor: float = 1.0) -> Any:
    """Return figure data in DN, each entry by the unit in its name."""
    if isinstance(data, dict):
        return {
            key: _scale_figure_data(value, unit_dn, _factor(key, unit_dn, factor))
            for key, value in data.items()
        }
    if isinstance(data, list):
        return [_scale_figure_data(value, unit_dn, factor) for value in data]
    return data * factor if isinstance(data, float) and factor != 1.0 else data


def _factor(key: str, unit_dn: float, outer: float) -> float:
    if re.search(r"_dn2(_|$)", key):
        return unit_dn**2
    if re.search(r"_per_dn(_|$)", key):
        return 1.0 / unit_dn
    return unit_dn if re.search(r"_dn(_|$)", key) else outer
