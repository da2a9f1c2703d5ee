"""EMVA 1288 data sheet of a result: names, symbols and equations of Release 4.0 Linear, as a table
and as XML.
"""

from dataclasses import dataclass, replace
from typing import Any
from xml.etree import ElementTree

from charact import __version__
from charact.reporting.tables import best
from labdata.errors import BadInput
from labdata.measurement import Interval, Measurement, Result
from labdata.number_format import plus_minus, plus_minus_of, round_to_spread
from labdata.quantity import QUANTITIES, StandardRow


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


def sheet_rows() -> list[StandardRow]:
    """Return the rows of the sheet in their order."""
    rows = (
        replace(row, quantity=name) for name, known in QUANTITIES.items() for row in known.standard
    )
    return sorted(rows, key=lambda row: row.order)


def emva_summary(result: Result) -> dict[str, Any] | None:
    """Return the EMVA 1288 summary: entries with value, status and flags, and names left out; or
    why it does not apply.

    None for a result without gain. The standard assumes white noise. With correlated noise, as of
    an intensifier, the variance does not count electrons, and no quantity is given.
    """
    gains = (*result.find("system_gain"), *result.find("covariance_gain"))
    if not any(m.value is not None for m in gains):
        return None
    if not any(
        m.value is not None and "correlated-noise" not in m.flags
        for m in result.find("system_gain")
    ):
        return {
            "reason": "EMVA 1288 assumes white noise; the noise of this camera is correlated "
            "between pixels (as of an intensifier). The photon transfer curve would give a gain "
            "too low by the blur factor, and wrong values in electrons. Use the covariance gain "
            "above."
        }
    entries = [
        (entry, best(result.find(entry.quantity, unit=entry.unit))) for entry in sheet_rows()
    ]
    return {
        "reason": "",
        "rows": [
            (entry, in_standard_unit(entry, m).text, m.status, m.flags) for entry, m in entries if m
        ],
        "left_out": list(dict.fromkeys(entry.name for entry, m in entries if m is None)),
    }


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


def emva_xml(result: Result, title: str) -> str:
    """Return the EMVA 1288 quantities of a result as XML.

    Every element has the quantity's name in the results of the EMVA 1288 group's program, the value
    as its text, and symbol, unit, clause of Release 4.0 Linear, limits of the 95 % interval,
    status, and what is not to standard as attributes.

    Raises
    ------
    BadInput
        If the standard does not apply: no gain, or noise that is correlated between pixels.
    """
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
    root = ElementTree.Element(
        "EMVA1288", {"title": title, "program": f"charact {__version__}", "release": "4.0 Linear"}
    )
    for entry in sheet_rows():
        m = best(result.find(entry.quantity, unit=entry.unit))
        if m is None or m.value is None:
            continue
        shown = in_standard_unit(entry, m)
        part, name = entry.element
        parent = root.find(part)
        parent = ElementTree.SubElement(root, part) if parent is None else parent
        attributes = {
            "symbol": entry.symbol,
            "unit": shown.unit,
            "clause": entry.clause,
            "status": m.status,
        }
        if shown.interval95 is not None:
            attributes |= {"low95": repr(shown.interval95[0]), "high95": repr(shown.interval95[1])}
        if entry.departure:
            attributes["not_to_standard"] = entry.departure
        ElementTree.SubElement(parent, name, attributes).text = repr(shown.value)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"
