"""Defective pixels of a session: bright, faint, blinking ones, and values struck in single frames.

A pixel blinks if it is an outlier in more frames than chance allows. Outliers at random pixels are the tail of the
noise (pulses of a tube or register), unless they lie far beyond that tail.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.pixel_survey import PixelSurvey
from charact.noise.provenance import provenance
from charact.noise.thresholds import SURVEY
from labdata.measurement import Measurement, Result, make_measurement, make_refusal
from labdata.session import Session

Places = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class DefectivePixels:
    """Excluded pixels of a session; positions are row times columns plus column."""

    places: Places  # pixels that are defective in all frames
    blinking: Places  # those that blink
    # by stack label, positions and frames of struck values; frame -1 for all frames of the stack
    struck: dict[str, tuple[Places, Places]] = field(default_factory=dict)

    @property
    def note(self) -> str | None:
        """Note on the excluded pixels; None for none."""
        hits = sum(len(places) for places, _ in self.struck.values())
        parts = [f"{len(self.places)} defective pixels of the session"] if len(self.places) else []
        parts += [f"{hits} outliers of single frames (cosmic rays, ion feedback)"] if hits else []
        return f"excludes {' and '.join(parts)}" if parts else None


def find_defective_pixels(surveys: Sequence[PixelSurvey], *, multiplies: bool) -> DefectivePixels:
    """Return the defective pixels.

    `surveys`: one of each stack, of equal size; `multiplies`: whether a tube or a register multiplies electrons; its
    pulses are valid outliers.
    """
    pixels = surveys[0].pixels
    wrong = np.zeros(pixels, bool)
    for one in surveys:
        wrong[one.bright] = wrong[one.faint] = True
    if np.count_nonzero(wrong) > SURVEY.max_fraction * pixels:
        wrong[:] = False
    least = SURVEY.max_pulse * _slope(surveys) if multiplies else 0.0
    blinks = _blinking_mask(surveys, wrong)
    away = wrong | blinks
    struck = {one.label: hits for one in surveys if len((hits := _outlying_values(one, away, least))[0])}
    return DefectivePixels(places=np.flatnonzero(away), blinking=np.flatnonzero(blinks), struck=struck)


def _slope(surveys: Sequence[PixelSurvey]) -> float:
    """Return variance over signal of the flats by robust statistics, DN; 0 without flats."""
    darks = [one for one in surveys if one.kind == "dark"]
    dark, noise = (
        (min(darks, key=lambda one: one.level_dn).level_dn, min(one.sd_dn for one in darks)) if darks else (0, 0)
    )
    flats = [one for one in surveys if one.kind == "flat" and one.level_dn > dark]
    slopes = [(one.sd_dn**2 - noise**2) / (one.level_dn - dark) for one in flats]
    return max(float(np.median(slopes)), 0.0) if slopes else 0.0


def _departures_are_rare(one: PixelSurvey) -> bool:
    """Return whether outliers are rare."""
    return len(one.sudden) <= SURVEY.max_fraction * one.pixels


def _blinking_mask(surveys: Sequence[PixelSurvey], wrong: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the pixels that are outliers more often than chance allows."""
    from scipy.stats import binom

    counts, trials = np.zeros(len(wrong), np.int64), 0
    for one in surveys:
        if _departures_are_rare(one):
            counts[one.sudden] += one.times
            trials += one.trials
    if not trials:
        return np.zeros(len(wrong), bool)
    never = float(np.mean(counts[~wrong] == 0))
    rate = min(SURVEY.rate_variation * (1.0 - max(never, 1e-9) ** (1.0 / trials)), 1.0)
    needed = np.arange(2, trials + 2)
    enough = needed[binom.sf(needed - 1, trials, rate) * len(wrong) < SURVEY.false_alarm]
    blinks = counts >= (enough[0] if len(enough) else trials + 1)
    return blinks if np.count_nonzero(blinks) <= SURVEY.max_fraction * len(wrong) else np.zeros(len(wrong), bool)


def _outlying_values(one: PixelSurvey, away: NDArray[np.bool_], least: float) -> tuple[Places, Places]:
    """Return the values far beyond the tail of their stack."""
    rest = ~away[one.sudden]
    own = one.kind == "flat" or least > 0 or np.count_nonzero(rest) > SURVEY.blinking_fraction * one.pixels
    far = rest & (one.departure_dn > max(least, one.tail_dn(away) if own else 0.0))
    return one.sudden[far], np.where(one.times[far] > 1, -1, one.frame[far])


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
