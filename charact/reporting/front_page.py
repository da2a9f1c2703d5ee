"""First page of a report: the verdict in a sentence, the data sheet, and the figures that show
it.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from charact.comparison import Specification
from charact.reporting.emva_sheet import emva_summary, emva_xml
from charact.reporting.exports import as_json, table_of_files
from charact.reporting.figure_registry import Figure
from charact.reporting.frequency_unit import NEEDS, PICTURE_HEIGHTS, FrequencyUnit, unit_title
from charact.reporting.summary import setting_of
from charact.verdict.purpose import MARKS, Purpose, is_tube, leading_of, purpose_of
from labdata import BadInput, Measurement, Result, Session, has_tube
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
    "sitf",
    "netd",
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
    ("noise-against-gain", "photon-transfer", "signal-transfer", "noise-by-gain", "snr-light"),
    ("bloom-series", "lit-edge", "point-profile", "edge-spread", "bars"),
)
PurposeOf = Purpose | Specification


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


def leading(session: Session, result: Result) -> tuple[Measurement, ...]:
    """Return the measurement of each quantity and unit of the data sheet that stands for all."""
    leading_measurements: list[Measurement | None] = []
    for quantity in TUBE_SHEET if is_tube(session, result) else CAMERA_SHEET:
        of_quantity = [m for m in result.find(quantity) if m.value is not None]
        if quantity == "bloom_diameter":  # one for each exposure of the source: that of the longest
            of_quantity.sort(key=lambda m: m.value or 0.0, reverse=True)
        leading_measurements += [
            leading_of(m for m in of_quantity if m.unit == unit)
            for unit in dict.fromkeys(m.unit for m in of_quantity)
        ]
    return tuple(m for m in leading_measurements if m is not None)


def sheet(session: Session, result: Result) -> tuple[SheetRow, ...]:
    """Return the rows of the data sheet, frequencies in the user's unit; those of EMVA 1288 have
    its names.
    """
    unit, standard = unit_of(session), None if is_tube(session, result) else emva_summary(result)
    entries = standard["rows"] if standard and not standard["reason"] else ()
    # That of the standard stands for both.
    named = {row.entry.quantity.partition("_1288")[0] for row in entries if row.text}
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
            title=f"{row.entry.name} {row.entry.symbol}".strip(),
            name=row.entry.quantity,
            value=row.text,
            status=row.status,
            flags=row.flags,
            departure=row.departure,
        )
        for row in entries
        if row.text and not row.entry.detail
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
    """Return the unit of frequencies on the page: as stated, else that of the cathode, or cycles
    per pixel.
    """
    unit = session.about.units or ("lp/mm-cathode" if has_tube(session.camera) else "cy/px")
    if unit in NEEDS and session.camera is None:
        raise BadInput(f"`units` {unit} needs a sensor description: sensor in session.toml")
    rows = session.stacks[0].read().shape[1] if unit in PICTURE_HEIGHTS else None
    return FrequencyUnit.of(session.camera, unit=unit, rows=rows)


def _value(m: Measurement, unit: FrequencyUnit) -> str:
    assert m.value is not None
    if m.unit != "cy/px":
        return plus_minus(m) + ("" if m.unit == "1" else f" {m.unit}")
    value, name = unit(m.value, m)
    name = unit_title(name)
    if m.interval95 is None:
        return f"{round_to_spread(value)} {name}"
    low, high = (unit(end, m)[0] for end in m.interval95)
    return f"{plus_minus_of(value, low, high)} {name}"


def verdict(
    session: Session,
    result: Result,
    validation: "Validation | None",
    purpose: PurposeOf | None = None,
) -> Verdict:
    """Return the verdict on the purpose and, where there is one, on the validation."""
    decision = (purpose or purpose_of(session, result)).decide(session, result)
    heading, status = decision.heading, decision.status
    reasons = tuple(why for why in decision.because if why not in heading)
    if validation is not None and validation.verdict == "differs":
        return _difference(validation, (heading, *reasons))
    if validation is not None and validation.verdict == "undecided":
        from charact.reporting.validation_text import doubts_of, unseen_sentences

        reasons = (*doubts_of(validation), *unseen_sentences(validation), *reasons)
        if status == "ok":
            heading, status = f"{heading}; the fitted sensor is undecided", "suspect"
    elif validation is not None and status == "ok":
        heading += "; simulated frames agree with the measured ones"
    return Verdict(status=status, heading=heading, reasons=reasons)


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


def _sheet_of(session: Session, result: Result) -> str:
    """Return whose data sheet the first page holds."""
    if is_tube(session, result):
        return "Image intensifier"
    return "Infrared camera" if any(m.value for m in result.find("sitf")) else "EMVA 1288"


def context(
    session: Session,
    result: Result,
    figures: Sequence[Figure],
    validation: "Validation | None",
    purpose: PurposeOf | None = None,
) -> dict[str, Any]:
    """Return what the template of the first page shows."""
    rows = sheet(session, result)
    return {
        "verdict": verdict(session, result, validation, purpose),
        "sheet": rows,
        "sheet_title": f"{_sheet_of(session, result)} data sheet",
        "to_standard": any(row.departure for row in rows),
        "leading_figures": leading_figures(figures),
        "downloads": downloads(session, result),
    }
