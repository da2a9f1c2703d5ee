"""Preparation of a session: defective pixels replaced, values in units of the quantisation step, results in DN."""

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from charact.method import Context
from charact.noise.sound.kept import load_frames
from charact.noise.sound.pixels import DefectivePixels, find_defective_pixels
from charact.noise.sound.step import common_step
from charact.noise.sound.survey import PixelSurvey, survey_pixels
from charact.noise.sound.view import frame_view
from charact.noise.thresholds import SURVEY
from charact.noise.tube import has_multiplication
from labdata.measurement import Interval, Measurement, Posterior, Result
from labdata.session import Session


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A session prepared for measurement.

    Parameters
    ----------
    session, context
        Stacks with their views, and settings.
    unit_dn
        Unit of the values, DN.
    surveys
        Survey of each dark and flat of at least two frames.
    found
        Defective pixels; None if the images are too small.
    """

    session: Session
    context: Context
    unit_dn: float
    surveys: tuple[PixelSurvey, ...]
    found: DefectivePixels | None

    def in_dn(self, result: Result) -> Result:
        """Return a result in DN of the files, with a note on excluded pixels."""
        note = None if self.found is None else self.found.note
        notes = () if note is None else (note,)
        if self.unit_dn == 1.0:
            return (
                replace(result, measurements=tuple(_with_notes(m, notes) for m in result.measurements))
                if notes
                else result
            )
        notes += (f"DN in other notes are units of {self.unit_dn:.4g} of the files' values",)
        return replace(
            result,
            measurements=tuple(_in_dn(_with_notes(m, notes), self.unit_dn) for m in result.measurements),
            evidence={name: _scale_figure_data(data, self.unit_dn) for name, data in result.evidence.items()},
        )


def prepare(session: Session, *, context: Context) -> Prepared:
    """Survey the darks and flats of a session and prepare it for measurement.

    Parameters
    ----------
    session
        The session.
    context
        Seed, sensor and full scale.

    Notes
    -----
    Pixel means are compared in at most eight stacks distributed over the levels, because a defect shows in several.
    """
    session = replace(session, stacks=load_frames(session.stacks) if context.spread is map else session.stacks)
    entries = session.of_kind("dark", "flat")
    spread = set(np.linspace(0, len(entries) - 1, min(SURVEY.mean_stacks, len(entries))).round().astype(int).tolist())
    spread |= (
        {i for i, entry in enumerate(entries) if entry.kind == "dark"} if len(entries) <= SURVEY.mean_stacks else set()
    )
    surveys = [survey_pixels(entry, means=i in spread) for i, entry in enumerate(entries)]
    many = [one for one in surveys if one.frames > 1]
    sizes = {one.size for one in surveys}
    large = many and len(sizes) == 1 and many[0].pixels >= SURVEY.min_pixels and min(many[0].size) >= SURVEY.min_side_px
    found = find_defective_pixels(many, multiplies=has_multiplication(session, context)) if large else None
    unit, whole = _unit(surveys)
    views = {
        one.label: frame_view(one.label, found, one.size, unit_dn=unit, whole=whole, seed=context.seed)
        for one in surveys
    }
    stacks = tuple(replace(entry, view=views.get(entry.label)) for entry in session.stacks)
    full = None if context.full_scale_dn is None else context.full_scale_dn / unit
    return Prepared(session=replace(session, stacks=stacks), context=replace(context, full_scale_dn=full), unit_dn=unit,
                    surveys=tuple(many), found=found)  # fmt: skip


def _unit(surveys: list[PixelSurvey]) -> tuple[float, bool]:
    """Return the unit of the values, DN, and whether they are integers of it."""
    step = common_step([one.step_dn for one in surveys])
    if step is None:
        return 1.0, False
    if step > 0:
        return step, True
    noise = [one.sd_dn for one in surveys if one.sd_dn > 0]
    return (2.0 ** np.floor(np.log2(min(noise) / SURVEY.fine_units)), False) if noise else (1.0, False)


def _with_notes(measurement: Measurement, notes: tuple[str, ...]) -> Measurement:
    return replace(measurement, notes=(*measurement.notes, *notes)) if measurement.value is not None else measurement


def power_of_dn(unit: str) -> int:
    """Return the power of DN in a unit: 2 for DN2, 1 for DN or DN/e-, -1 for 1/DN, 0 for others."""
    above, _, below = unit.partition("/")
    powers = {"DN": 1, "DN2": 2}
    return powers.get(above, 0) - powers.get(below, 0)


def _in_dn(measurement: Measurement, unit_dn: float) -> Measurement:
    """Return a measurement converted from units to DN."""
    factor = unit_dn ** power_of_dn(measurement.unit)

    def around(interval: Interval | None) -> Interval | None:
        return None if interval is None else (interval[0] * factor, interval[1] * factor)

    kept = measurement.posterior
    return replace(
        measurement,
        value=None if measurement.value is None else measurement.value * factor,
        interval68=around(measurement.interval68),
        interval95=around(measurement.interval95),
        posterior=None if kept is None else _posterior(kept, unit_dn),
    )


def _posterior(kept: Posterior, unit_dn: float) -> Posterior:
    """Return draws in DN; logarithms are shifted."""
    draws = kept.draws.copy()
    for column, unit in enumerate(kept.units):
        logarithm = unit.removeprefix("log ")
        if logarithm != unit:
            draws[:, column] += power_of_dn(logarithm) * np.log(unit_dn)
        else:
            draws[:, column] *= unit_dn ** power_of_dn(unit)
    return replace(kept, draws=draws)


def _scale_figure_data(data: Any, unit_dn: float, factor: float = 1.0) -> Any:
    """Return figure data in DN, each entry by the unit in its name."""
    if isinstance(data, dict):
        return {key: _scale_figure_data(value, unit_dn, _factor(key, unit_dn, factor)) for key, value in data.items()}
    if isinstance(data, list):
        return [_scale_figure_data(value, unit_dn, factor) for value in data]
    return data * factor if isinstance(data, float) and factor != 1.0 else data


def _factor(key: str, unit_dn: float, outer: float) -> float:
    if re.search(r"_dn2(_|$)", key):
        return unit_dn**2
    if re.search(r"_per_dn(_|$)", key):
        return 1.0 / unit_dn
    return unit_dn if re.search(r"_dn(_|$)", key) else outer
