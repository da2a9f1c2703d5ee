"""EMVA 1288 data sheet of a result: names, symbols and equations of Release 4.0 Linear, as a table
and as XML.
"""

from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

from charact import __version__
from charact.reporting.tables import best
from labdata.data_sheet import BY_VARIANCE, sheet_rows
from labdata.errors import BadInput
from labdata.measurement import Interval, Measurement, Result
from labdata.number_format import plus_minus, plus_minus_of, round_to_spread
from labdata.quantity import StandardRow

# Figure data that says which frames a part of the sheet lacks.
LACKS = {
    "sensitivity": "photon-transfer",
    "linearity": "photon-transfer",
    "spatial": "spectrograms",
    "dark_current": "dark-current",
}
# Figures of the sheet, in the order of the standard.
FIGURES = (
    "photon-transfer",
    "linearity",
    "signal-to-noise-ratio",
    "dark-current",
    "spectrograms",
    "profiles",
    "defect-histograms",
)
# Those that stand on no other page.
SHEET_ALONE = FIGURES[-3:]
OF_LIGHT = "photons_per_px of the flats is not known; add it to their conditions"
OF_GAIN = "no gain of this session; add flats up to saturation and darks of their exposures"


@dataclass(frozen=True, kw_only=True)
class StandardValue:
    """A value in the unit of the standard."""

    value: float
    interval95: Interval | None
    unit: str
    number: str  # value ± its 95 % interval

    @property
    def text(self) -> str:
        """Value ± its 95 % interval and the unit."""
        return self.number if self.unit == "1" else f"{self.number} {self.unit}"


@dataclass(frozen=True, kw_only=True)
class SheetRow:
    """A row of the sheet."""

    entry: StandardRow
    text: str  # value ± its 95 % interval and the unit; "" if it was not measured
    status: str
    flags: tuple[str, ...]
    departure: str  # why it is not to the standard, or not measured, with the frames to add; ""
    m: Measurement | None

    @property
    def part(self) -> str:
        """The part of the sheet that the row belongs to."""
        return self.entry.element[0]


def emva_summary(result: Result) -> dict[str, Any] | None:
    """Return the EMVA 1288 summary: its rows, or why it does not apply.

    None for a result without gain. The standard assumes white noise. With correlated noise, as of
    an intensifier, the variance does not count electrons, and no quantity is given; where the
    covariance sum corrects for it, the number of the standard stands in a remark.
    """
    slope, corrected = (
        [m for m in result.find(name) if m.value is not None]
        for name in ("system_gain", "covariance_gain")
    )
    if not slope and not corrected:
        return None
    if not slope or (not corrected and all("correlated-noise" in m.flags for m in slope)):
        return {
            "reason": "EMVA 1288 assumes white noise; the noise of this camera is correlated "
            "between pixels (as of an intensifier). The photon transfer curve would give a gain "
            "too low by the blur factor, and wrong values in electrons. Use the covariance gain "
            "above."
        }
    return {"reason": "", "rows": [_sheet_row(entry, result) for entry in sheet_rows()]}


def _sheet_row(entry: StandardRow, result: Result) -> SheetRow:
    """Return a row with its value, or the reason why there is none."""
    m = best(result.find(entry.quantity, unit=entry.unit))
    if m is not None:
        figure = result.evidence.get(LACKS.get(entry.element[0], ""), {})
        text, departure = in_standard_unit(entry, m).text, str(figure.get("missing", ""))
        of_standard = (note for note in m.notes if note.startswith(BY_VARIANCE))
        entry = replace(entry, remark=next(of_standard, entry.remark))
        return SheetRow(
            entry=entry, text=text, status=m.status, flags=m.flags, departure=departure, m=m
        )
    refused = ["; ".join((m.reason, *m.notes)) for m in result.find(entry.quantity) if m.reason]
    reason = refused[0] if refused else OF_LIGHT if result.find("read_noise") else OF_GAIN
    return SheetRow(entry=entry, text="", status="refused", flags=(), departure=reason, m=None)


def in_standard_unit(entry: StandardRow, m: Measurement) -> StandardValue:
    """Return value and 95 % interval in the unit of the standard; a monotone conversion carries the
    interval over.
    """
    assert m.value is not None
    unit = entry.shown_unit or m.unit
    if not entry.shown_unit:
        return StandardValue(
            value=m.value, interval95=m.interval95, unit=unit, number=plus_minus(m)
        )
    known = m.interval95 is not None and min(m.interval95) > 0.0
    low, high = sorted(entry.convert(end) for end in m.interval95 or ()) if known else (None, None)
    interval = None if low is None or high is None else (low, high)
    value = entry.convert(m.value)
    number = round_to_spread(value) if interval is None else plus_minus_of(value, *interval)
    return StandardValue(value=value, interval95=interval, unit=unit, number=number)


def require_summary(result: Result) -> dict[str, Any]:
    """Return the summary; BadInput if the standard does not apply."""
    summary = emva_summary(result)
    if summary is None or summary["reason"]:
        raise BadInput(
            "an EMVA 1288 sheet needs a gain by white noise, got "
            + (
                "none: measure flats and darks first"
                if summary is None
                else "correlated noise (of an intensifier)"
            )
        )
    return summary


def emva_xml(result: Result, title: str) -> str:
    """Return the EMVA 1288 quantities of a result as XML.

    Elements are those that the program of the EMVA 1288 group writes and reads: parts, quantities
    by their names there, and of each its short name, symbol, unit and value; besides them clause,
    limits of the 95 % interval, status, remark, and why it is not to the standard. A number that
    was not measured is "nan". Histograms have bins, values and model.

    Raises
    ------
    BadInput
        If the standard does not apply: no gain, or noise that is correlated between pixels.
    """
    root = ElementTree.Element(
        "EMVA1288", {"title": title, "program": f"charact {__version__}", "release": "4.0 Linear"}
    )
    for row in require_summary(result)["rows"]:
        entry = row.entry
        shown = None if row.m is None else in_standard_unit(entry, row.m)
        low, high = (shown and shown.interval95) or (None, None)
        _add(
            root,
            *entry.element,
            short=entry.name,
            symbol=entry.symbol,
            unit=entry.shown_unit or entry.unit,
            value=repr(float("nan") if shown is None else shown.value),
            low95=None if low is None else repr(low),
            high95=None if high is None else repr(high),
            clause=entry.clause,
            status=row.status,
            remark=entry.remark,
            not_to_standard=row.departure,
        )
    histograms = result.evidence.get("defect-histograms", {})
    for name, unit in (("DSNU", "dn"), ("PRNU", "percent")) if histograms else ():
        parent = _add(root, "defect_pixel", f"histogram_{name}", short=f"{name} histogram")
        data = ElementTree.SubElement(parent, "data")
        for tag, key in (
            ("bins", f"deviation_{unit}"),
            ("values", f"pixels_of_{name.lower()}"),
            ("model", f"normal_of_{name.lower()}"),
        ):
            values = histograms[key]
            ElementTree.SubElement(data, tag).text = " ".join(map(repr, values))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add(
    root: ElementTree.Element, part: str, name: str, **children: str | None
) -> ElementTree.Element:
    """Add a quantity with its children to its part; empty ones are left out."""
    parent = root.find(part)
    parent = ElementTree.SubElement(root, part) if parent is None else parent
    element = ElementTree.SubElement(parent, name)
    for tag, text in {"section": part, **children}.items():
        if text:
            ElementTree.SubElement(element, tag).text = text
    return element
