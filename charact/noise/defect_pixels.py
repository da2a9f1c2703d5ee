"""Defective pixels: bright, faint and blinking ones, and values struck in single frames."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from charact.method import Context
from charact.noise.provenance import provenance
from charact.noise.sound.pixels import DefectivePixels
from charact.noise.sound.survey import PixelSurvey
from charact.noise.thresholds import SURVEY
from labdata.measurement import Measurement, Result, make_measurement, make_refusal
from labdata.session import Session

METHOD = "outlying-pixels"


def defect_pixels(
    session: Session, surveys: Sequence[PixelSurvey], found: DefectivePixels | None, *, context: Context
) -> Result:
    """Return the number of defective pixels in the dark of the longest exposure and in the brightest flat."""
    fields: dict[str, Any] = {"method": METHOD, "provenance": provenance(context)}
    known = [one for one in surveys if one.threshold_dn > 0]
    if found is None or not known:
        reason = "defective pixels need stacks of two frames and of 32 x 32 px at least that change from frame to frame"
        return Result(measurements=(make_refusal("defect_pixels", "px", reason, **fields),))
    exposure = {entry.label: entry.conditions.exposure_s or 0.0 for entry in session.stacks}
    darks = [one for one in known if one.kind == "dark"]
    flats = [one for one in known if one.kind == "flat"]
    chosen = [max(darks, key=lambda one: (exposure[one.label], one.frames))] if darks else []
    chosen += [max(flats, key=lambda one: one.level_dn)] if flats else []
    return Result(measurements=tuple(_defect_count(one, found, fields) for one in chosen))


def _defect_count(one: PixelSurvey, found: DefectivePixels, fields: dict[str, Any]) -> Measurement:
    """Return the number of defective pixels of a stack."""
    blinking = np.intersect1d(found.blinking, one.sudden)
    bright, faint = (np.setdiff1d(places, blinking) for places in (one.bright, one.faint))
    each = f"{len(bright)} bright, {len(faint)} faint, {len(blinking)} blinking"
    far = f"a mean more than {one.threshold_dn:.3g} DN ({SURVEY.outlying_sd:g} robust standard deviations) off"
    notes = [f"{each}; {far} the surrounding ones, or outliers in more frames than chance allows"]
    places = np.concatenate([bright, faint, blinking])
    count = len(np.unique(places))
    if count:
        rows, cols = np.divmod(places[: SURVEY.listed], one.size[1])
        shown = ", ".join(
            f"({row}, {col})" for row, col in dict.fromkeys(zip(rows.tolist(), cols.tolist(), strict=True))
        )
        notes.append(f"row and column of the first: {shown}")
    least, most = ([number + len(blinking) for number in bounds] for bounds in (one.least, one.most))
    around = [(float(min(least[i], count)), float(max(most[i], count))) for i in (0, 1)]
    return make_measurement("defect_pixels", "px", float(count), *around, notes=tuple(notes), stack=one.label, **fields)
