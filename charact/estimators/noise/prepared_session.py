"""Preparation of a session: defective pixels replaced, values in units of the quantisation step,
results in DN.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.defective_pixels import (
    DefectivePixels,
    FrameView,
    find_defective_pixels,
    frame_view,
)
from charact.estimators.noise.findings import fields_of
from charact.estimators.noise.gain.series import has_multiplication
from charact.estimators.noise.pixel_survey import PixelSurvey, common_step, survey_pixels
from charact.estimators.noise.thresholds import SURVEY
from charact.frames.layout import AreaView, Layout
from charact.frames.session_layout import find_layout, left_out, of_amplifier
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

Places = NDArray[np.int64]


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
    view = session.stack(known[0].label).view
    area = view.under if isinstance(view, FrameView) else None
    origin = area.region[:2] if isinstance(area, AreaView) else (0, 0)
    exposure = {entry.label: entry.conditions.exposure_s or 0.0 for entry in session.stacks}
    darks = [survey for survey in known if survey.kind == "dark"]
    flats = [survey for survey in known if survey.kind == "flat"]
    chosen = (
        [max(darks, key=lambda survey: (exposure[survey.label], survey.frames))] if darks else []
    )
    chosen += [max(flats, key=lambda survey: survey.level_dn)] if flats else []
    return Result(
        measurements=tuple(_defect_count(survey, defects, origin, fields) for survey in chosen)
    )


def _defect_count(
    survey: PixelSurvey,
    defects: DefectivePixels,
    origin: tuple[int, int],
    fields: dict[str, Any],
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
            f"({row + origin[0]}, {col + origin[1]})"
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
    layout: Layout | None  # parts of the chip; None if the images are too small
    sound: Session  # darks and flats in DN, without what the layout leaves out

    def of_amplifier(self, number: int, context: Context) -> "Prepared":
        """Return the session of one amplifier (from 1, by rows), with settings as before
        preparation.
        """
        session = of_amplifier(self.sound, self.layout, number)
        return _prepared(session, _survey(session), self.layout, context)

    def in_dn(self, result: Result) -> Result:
        """Return a result in DN of the files, with a note on excluded pixels."""
        unit_dn, note = self.unit_dn, None if self.defects is None else self.defects.note
        notes = () if note is None else (note,)
        if self.layout is not None and self.layout.areas:
            notes += left_out(self.layout)
            names = ("region", "name", "measured")
            shown = dict(zip(names, map(list, zip(*self.layout.areas, strict=True)), strict=True))
            result = replace(result, evidence={**result.evidence, "layout": shown})
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

    Raises BadInput if the session has no amplifier of the context's number.
    """
    session = replace(
        session, stacks=load_frames(session.stacks) if context.spread is map else session.stacks
    )
    surveys = _survey(session)
    layout, session = find_layout(session, surveys)
    if context.amplifier is not None:
        session = of_amplifier(session, layout, context.amplifier)
    if any(entry.view is not None for entry in session.stacks):
        surveys = _survey(session)
    return _prepared(session, surveys, layout, context)


def _survey(session: Session) -> list[PixelSurvey]:
    """Return the survey of each dark and flat.

    Pixel means are compared in at most eight stacks distributed over the levels, because a defect
    shows in several.
    """
    entries = session.of_kind("dark", "flat")
    spread = set(
        np.linspace(0, len(entries) - 1, min(SURVEY.mean_stacks, len(entries)))
        .round()
        .astype(int)
        .tolist()
    )
    return [survey_pixels(entry, means=i in spread) for i, entry in enumerate(entries)]


def _prepared(
    session: Session, surveys: list[PixelSurvey], layout: Layout | None, context: Context
) -> Prepared:
    """Return a session prepared by its surveys."""
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
            survey.label,
            defects,
            survey.size,
            unit_dn=unit,
            integral=integral,
            seed=context.seed,
            under=session.stack(survey.label).view,
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
        layout=layout,
        sound=session,
    )


def _unit(surveys: list[PixelSurvey]) -> tuple[float, bool]:
    """Return the unit of the values, DN, and whether they are integers of it."""
    steps = [survey.step_dn for survey in surveys]
    step = common_step(steps)
    if step is not None and step < 1.0 and 1.0 in steps:
        # Averaged frames, whose steps are finer, keep the unit of single ones.
        return 1.0, False
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
