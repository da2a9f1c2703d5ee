"""First page of a report: the verdict in a sentence, the data sheet, and the figures that show
it.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from charact.reporting.emva_sheet import emva_summary, emva_xml
from charact.reporting.exports import as_json, table_of_files
from charact.reporting.figure_registry import Figure
from charact.reporting.frequency_unit import FrequencyUnit
from charact.reporting.summary import setting_of
from charact.verdict.purpose import lacks_of, purpose_of
from labdata import FLAGS, Measurement, Result, Session, has_tube
from labdata.number_format import (
    plus_minus,
    plus_minus_of,
    quantity_title,
    round_to_spread,
)

if TYPE_CHECKING:
    from charact.validation import Validation

# Quantities of the data sheets, in order: of a tube as its makers state them, of a plain camera as
# EMVA 1288 does.
TUBE_SHEET = (
    "mtf50",
    "limiting_resolution",
    "tube_snr",
    "figure_of_merit",
    "minimum_illumination",
    "ebi",
    "covariance_gain",
    "photoelectron_gain",
    "excess_noise_factor",
    "read_noise",
    "halo_diameter",
    "halo_fraction",
    "bloom_diameter",
    "prnu",
)
CAMERA_SHEET = (
    "mtf50",
    "quantum_efficiency",
    "system_gain",
    "read_noise",
    "snr_max",
    "saturation_capacity",
    "dynamic_range",
    "minimum_illumination",
    "linearity_error",
    "dark_current",
    "dsnu",
    "prnu",
    "bloom_diameter",
)
# Figures of the first page, the first kind that was made of each row.
FIGURES = (
    ("noise-against-gain", "photon-transfer", "noise-by-gain", "snr-light"),
    ("bloom-series", "lit-edge", "point-profile", "edge-spread", "bars"),
)
# Flags under which a number says little about the camera.
GRAVE = frozenset(
    {"saturated", "clipped", "no-target", "not-converged", "aliased", "agc", "dark-mismatch"}
)


MARKS = {"ok": "✓", "suspect": "▲", "refused": "✕"}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Verdict on a session: its status, its heading and the reasons."""

    status: str  #: "ok", "suspect" or "refused"
    heading: str
    reasons: tuple[str, ...] = ()

    @property
    def line(self) -> str:
        """The verdict with its mark."""
        return f"{MARKS[self.status]} {self.heading}"


@dataclass(frozen=True, kw_only=True)
class SheetRow:
    """Row of the data sheet."""

    title: str
    name: str
    value: str
    status: str
    flags: tuple[str, ...] = ()
    departure: str = ""  #: Why the value is not to standard


def is_tube(session: Session, result: Result) -> bool:
    """Return whether the data sheet is that of an image intensifier: it is described, or its noise
    is correlated.
    """
    if has_tube(session.camera):
        return True
    gains = [
        m
        for m in result.find("system_gain")
        if m.value is not None and "correlated-noise" not in m.flags
    ]
    return not gains and any(m.value is not None for m in result.find("covariance_gain"))


def leading(session: Session, result: Result) -> tuple[Measurement, ...]:
    """Return the measurement of each quantity and unit of the data sheet: the first ok one, or the
    first suspect one where most are suspect, else the first value.
    """
    leading_measurements: list[Measurement] = []
    for quantity in TUBE_SHEET if is_tube(session, result) else CAMERA_SHEET:
        of_quantity = [m for m in result.find(quantity) if m.value is not None]
        if quantity == "bloom_diameter":  # one for each exposure of the source: that of the longest
            of_quantity.sort(key=lambda m: m.value or 0.0, reverse=True)
        units = dict.fromkeys(m.unit for m in of_quantity)
        for unit in units:
            of_unit = [m for m in of_quantity if m.unit == unit]
            doubtful = 2 * sum(m.status != "ok" for m in of_unit) > len(of_unit)
            leading_measurements.append(min(of_unit, key=lambda m: (m.status == "ok") == doubtful))
    return tuple(leading_measurements)


def sheet(session: Session, result: Result) -> tuple[SheetRow, ...]:
    """Return the rows of the data sheet, frequencies in the user's unit; those of EMVA 1288 have
    its names.
    """
    unit, standard = unit_of(session), None if is_tube(session, result) else emva_summary(result)
    entries = standard["rows"] if standard and not standard["reason"] else ()
    named = {entry.quantity for entry, *_ in entries}
    rows = [
        SheetRow(
            title=_short_title(m, len([n for n in result.find(m.quantity) if n.unit == m.unit])),
            name=m.quantity,
            value=_value(m, unit),
            status=m.status,
            flags=m.flags,
        )
        for m in leading(session, result)
        if m.quantity not in named
    ]
    rows += [
        SheetRow(
            title=f"{entry.name} {entry.symbol}".strip(),
            name=entry.quantity,
            value=value,
            status=status,
            flags=flags,
            departure=entry.departure,
        )
        for entry, value, status, flags in entries
        if not entry.shown_unit or entry.quantity == "minimum_illumination"
    ]
    return tuple(rows)


def _short_title(m: Measurement, count: int) -> str:
    """Return the title of a quantity without what it explains after a colon, with its stack or
    setting where one of `count` is chosen.
    """
    title = quantity_title(m).partition(":")[0]
    chosen = {"bloom_diameter": m.stack, "limiting_resolution": m.stack or "bright light"}.get(
        m.quantity
    )
    chosen = chosen or (setting_of(m) if count > 1 else "")
    return f"{title} ({chosen})" if chosen else title


def unit_of(session: Session) -> FrequencyUnit:
    """Return the unit of frequencies on the page: that of the cathode, or cycles per pixel."""
    camera = session.camera
    if has_tube(camera):
        return FrequencyUnit.of(camera, unit="lp/mm-cathode")
    return FrequencyUnit(unit="cy/px")


def _value(m: Measurement, unit: FrequencyUnit) -> str:
    assert m.value is not None
    if m.unit != "cy/px":
        return plus_minus(m) + ("" if m.unit == "1" else f" {m.unit}")
    value, name = unit(m.value, m)
    name = "lp/mm at cathode" if name == "lp/mm-cathode" else name
    if m.interval95 is None:
        return f"{round_to_spread(value)} {name}"
    low, high = (unit(end, m)[0] for end in m.interval95)
    return f"{plus_minus_of(value, low, high)} {name}"


def verdict(session: Session, result: Result, validation: "Validation | None") -> Verdict:
    """Return the verdict on the leading quantities and, where there is one, on the validation."""
    sheet = leading(session, result)
    purpose = purpose_of(session, is_tube=is_tube(session, result))
    lacks = lacks_of(session, result, purpose)
    frames = "; ".join(dict.fromkeys(words for lack in lacks for words in lack.frames))
    to_add = (f"Not enough for {purpose.title}: add {frames}",) if lacks else ()
    if not sheet:
        reason = next(
            (m.reason for m in result.measurements if m.reason), "the session has no measurement"
        )
        return Verdict(
            status="refused", heading="Nothing could be measured", reasons=(reason, *to_add)
        )
    suspect = [m for m in sheet if m.status != "ok"]
    reasons = tuple(_reasons(suspect))
    if validation is not None and validation.verdict == "differs":
        return _difference(validation, reasons)
    grave = [m for m in suspect if GRAVE & set(m.flags)]
    if len(suspect) > len(sheet) / 2 or len(grave) > 1:
        return Verdict(
            status="refused",
            heading=f"Do not trust: {len(suspect)} of {len(sheet)} leading numbers are suspect",
            reasons=(*to_add, *reasons),
        )
    if lacks:
        why_not = (f"{lack.quantity}: {lack.reason}" for lack in lacks)
        return Verdict(status="suspect", heading="".join(to_add[:1]), reasons=(*why_not, *reasons))
    checked = "" if validation is None else ", and simulated frames agree with the measured ones"
    if validation is not None and validation.verdict == "undecided":
        from charact.reporting.validation_text import doubts_of, unseen_sentences

        reasons = (*doubts_of(validation), *unseen_sentences(validation), *reasons)
        if not suspect:
            heading = f"All {len(sheet)} leading numbers are ok; the fitted sensor is undecided"
            return Verdict(status="suspect", heading=heading, reasons=reasons)
    if suspect:
        heading = f"Look at {len(suspect)} of {len(sheet)} leading numbers before use"
        return Verdict(status="suspect", heading=heading, reasons=reasons)
    counted = f"all {len(sheet)} leading numbers are" if len(sheet) > 1 else "its number is"
    return Verdict(
        status="ok",
        heading=f"Fit for {purpose.title}: {counted} ok{checked}",
    )


def _difference(validation: "Validation", reasons: tuple[str, ...]) -> Verdict:
    """Return the verdict on a fitted sensor that differs beyond a tolerance.

    It is not to be trusted where it does so by far, or where the departure has no size.
    """
    from charact.reporting.validation_text import difference_sentence, doubts_of, size_text
    from charact.validation.thresholds import VALIDATION

    differing = validation.of("differs")
    first = differing[0]
    is_far = first.excess > VALIDATION.far
    whose = "Do not trust the fitted sensor: it" if is_far else "The fitted sensor"
    size = f"by {size_text(first)} in" if first.departure is not None else "in"
    sentences = tuple(difference_sentence(statistic) for statistic in differing)
    return Verdict(
        status="refused" if is_far else "suspect",
        heading=f"{whose} differs {size} {first.worst or first.title}",
        reasons=(*doubts_of(validation), *sentences, *reasons),
    )


def _reasons(suspect: Sequence[Measurement]) -> list[str]:
    """Return one sentence for each flag of the leading quantities, with the finding and its
    remedy.
    """
    sentences = []
    for flag in dict.fromkeys(flag for m in suspect for flag in m.flags):
        flagged = [m for m in suspect if flag in m.flags]
        findings = [
            note.partition(": ")[2]
            for m in flagged
            for note in m.notes
            if note.startswith(f"{flag}: ")
        ]
        quantities = ", ".join(dict.fromkeys(m.quantity for m in flagged))
        sentences.append(f"{quantities}: {findings[0] if findings else FLAGS[flag]} ({flag})")
    return sentences


def leading_figures(figures: Sequence[Figure]) -> tuple[Figure, ...]:
    """Return the figures of the first page besides the MTF."""
    chosen = []
    for kinds in FIGURES:
        of_kinds = [
            figure for kind in kinds for figure in figures if figure.kind == kind and figure.svg
        ]
        chosen += of_kinds[:1]
    return tuple(chosen)


def downloads(session: Session, result: Result) -> tuple[tuple[str, str], ...]:
    """Return file name and data URI of the numbers as CSV and JSON, and as EMVA 1288 XML where it
    applies.
    """
    files = [
        ("measurements.csv", _data_uri("text/csv", table_of_files({session.name: result}))),
        ("measurements.json", _data_uri("application/json", as_json(result, session.name))),
    ]
    summary = emva_summary(result)
    if summary is not None and not summary["reason"]:
        files.append(("emva1288.xml", _data_uri("application/xml", emva_xml(result, session.name))))
    return tuple(files)


def _data_uri(kind: str, text: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(text.encode()).decode('ascii')}"


def context(
    session: Session, result: Result, figures: Sequence[Figure], validation: "Validation | None"
) -> dict[str, Any]:
    """Return what the template of the first page shows."""
    rows = sheet(session, result)
    return {
        "verdict": verdict(session, result, validation),
        "sheet": rows,
        "sheet_title": "Image intensifier data sheet"
        if is_tube(session, result)
        else "EMVA 1288 data sheet",
        "to_standard": any(row.departure for row in rows),
        "leading_figures": leading_figures(figures),
        "downloads": downloads(session, result),
    }
