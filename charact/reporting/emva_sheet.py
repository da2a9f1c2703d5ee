"""EMVA 1288 data sheet of a result: names, symbols and equations of Release 4.0 Linear, as a table
and as XML.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from charact import __version__
from charact.reporting.number_format import plus_minus, plus_minus_of, round_to_spread
from charact.reporting.tables import best
from labdata.errors import BadInput
from labdata.measurement import Interval, Measurement, Result

VARIANCE_PEAK = (
    "saturation is the peak of the temporal variance, as in Release 3.1; Release 4.0 takes the "
    "exposure at which 0.1 to 0.2 % of the pixels show the largest value"
)
NO_HIGH_PASS = (
    "the standard removes shading by a high-pass filter (8.1) and states row, column "
    "and pixel parts"
)


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One quantity of the standard."""

    quantity: str  # name of the measurement
    unit: str  # unit of the measurement
    name: str
    symbol: str
    clause: str  # equation or section of EMVA 1288 Release 4.0 Linear (16 June 2021)
    element: tuple[str, str]  # part and name in the results of the EMVA 1288 group's program
    shown_unit: str = ""  # unit of the standard; "": that of the measurement
    convert: Callable[[float], float] = lambda value: value  # monotone, from the measurement's unit
    departure: str = ""  # why the value is not to standard; "": it is


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


def _decibel(ratio: float) -> float:
    return 20.0 * float(np.log10(ratio))


SHEET = (
    Entry(
        quantity="quantum_efficiency",
        unit="%",
        name="Quantum efficiency",
        symbol="η",
        clause="eq. 52",
        element=("sensitivity", "QE"),
    ),
    Entry(
        quantity="responsivity",
        unit="DN/photon",
        name="Responsivity",
        symbol="R",
        clause="eq. 49",
        element=("sensitivity", "R"),
    ),
    Entry(
        quantity="system_gain",
        unit="DN/e-",
        name="System gain",
        symbol="K",
        clause="eq. 50",
        element=("sensitivity", "K"),
    ),
    Entry(
        quantity="system_gain",
        unit="DN/e-",
        name="Inverse of the system gain",
        symbol="1/K",
        clause="eq. 50",
        element=("sensitivity", "inverse_K"),
        shown_unit="e-/DN",
        convert=lambda gain: 1.0 / gain,
    ),
    Entry(
        quantity="read_noise",
        unit="e-",
        name="Temporal dark noise",
        symbol="σ_d",
        clause="eq. 53",
        element=("sensitivity", "sigma_d"),
    ),
    Entry(
        quantity="read_noise",
        unit="DN",
        name="Temporal dark noise",
        symbol="σ_y.dark",
        clause="eq. 53",
        element=("sensitivity", "sigma_y_dark"),
    ),
    Entry(
        quantity="snr_max",
        unit="1",
        name="Largest signal-to-noise ratio",
        symbol="SNR_max",
        clause="2.6",
        element=("sensitivity", "SNR_max"),
        departure=VARIANCE_PEAK,
    ),
    Entry(
        quantity="snr_max",
        unit="1",
        name="Largest signal-to-noise ratio",
        symbol="SNR_max.dB",
        clause="2.6",
        element=("sensitivity", "SNR_max_dB"),
        shown_unit="dB",
        convert=_decibel,
        departure=VARIANCE_PEAK,
    ),
    Entry(
        quantity="minimum_illumination",
        unit="photons/px",
        name="Absolute sensitivity threshold",
        symbol="μ_p.min",
        clause="eq. 26",
        element=("sensitivity", "u_p_min"),
        shown_unit="photons",
        departure="pixel non-uniformity counts as noise here",
    ),
    Entry(
        quantity="saturation_capacity",
        unit="e-",
        name="Saturation capacity",
        symbol="μ_e.sat",
        clause="2.7, 6.6",
        element=("sensitivity", "u_e_sat"),
        departure=VARIANCE_PEAK,
    ),
    Entry(
        quantity="dynamic_range",
        unit="1",
        name="Dynamic range",
        symbol="DR",
        clause="eq. 28",
        element=("sensitivity", "DR"),
        departure=VARIANCE_PEAK,
    ),
    Entry(
        quantity="dynamic_range",
        unit="1",
        name="Dynamic range",
        symbol="DR_dB",
        clause="eq. 28",
        element=("sensitivity", "DR_dB"),
        shown_unit="dB",
        convert=_decibel,
        departure=VARIANCE_PEAK,
    ),
    Entry(
        quantity="linearity_error",
        unit="%",
        name="Linearity error",
        symbol="LE",
        clause="6.9, eq. 63",
        element=("linearity", "LE"),
        departure="levels from 5 to 70 % of saturation and a line through the origin; the "
        "standard takes 5 to 95 % and a line with an offset",
    ),
    Entry(
        quantity="dark_current",
        unit="e-/s",
        name="Dark current",
        symbol="μ_I.mean",
        clause="7.1, eq. 29",
        element=("dark_current", "u_I_mean"),
    ),
    Entry(
        quantity="dark_doubling_temperature",
        unit="K",
        name="Doubling temperature of the dark current",
        symbol="T_d",
        clause="3.2",
        element=("dark_current", "T_d"),
    ),
    Entry(
        quantity="dsnu",
        unit="e-",
        name="Dark signal non-uniformity",
        symbol="DSNU_1288",
        clause="eq. 66",
        element=("spatial", "DSNU1288"),
        departure=NO_HIGH_PASS,
    ),
    Entry(
        quantity="prnu",
        unit="%",
        name="Photoresponse non-uniformity",
        symbol="PRNU_1288",
        clause="eq. 67",
        element=("spatial", "PRNU1288"),
        departure=NO_HIGH_PASS,
    ),
    Entry(
        quantity="defect_pixels",
        unit="px",
        name="Defect pixels",
        symbol="",
        clause="8.8",
        element=("defect_pixel", "defects"),
        departure=(
            "counted by the rule in the notes; the standard leaves the threshold to the application"
        ),
    ),
)


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
    entries = [(entry, best(result.find(entry.quantity, unit=entry.unit))) for entry in SHEET]
    return {
        "reason": "",
        "rows": [
            (entry, in_standard_unit(entry, m).text, m.status, m.flags) for entry, m in entries if m
        ],
        "left_out": list(dict.fromkeys(entry.name for entry, m in entries if m is None)),
    }


def in_standard_unit(entry: Entry, m: Measurement) -> StandardValue:
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
    for entry in SHEET:
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
