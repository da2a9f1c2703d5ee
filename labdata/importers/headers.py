"""Conditions of frames that the headers of their files state."""

import re
from collections.abc import Mapping
from typing import Any

from labdata.conditions import Conditions
from labdata.importers.thresholds import MOST_EXPOSURES, POSSIBLE, POSSIBLE_SETTING

#: Conditions and notes
Stated = tuple[Conditions, tuple[str, ...]]
NOTHING: Stated = (Conditions(), ())

TIMES_S = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
# Factors of the units in which a text may state a condition
UNITS = {
    "exposure_s": TIMES_S,
    "gate_ns": {unit: 1e9 * factor for unit, factor in TIMES_S.items()},
    "camera_gain_db": {"db": 1.0},
    "em_gain": {"": 1.0, "x": 1.0},
    "mcp_v": {"v": 1.0},
    "temperature_c": {"c": 1.0, "°c": 1.0, "degc": 1.0},
}
# Words for a condition in texts of cameras, in lower case without blanks and marks
WORDS = {
    "exposure": "exposure_s",
    "exposuretime": "exposure_s",
    "integrationtime": "exposure_s",
    "gate": "gate_ns",
    "gatewidth": "gate_ns",
    "gatetime": "gate_ns",
    "gain": "camera_gain_db",
    "cameragain": "camera_gain_db",
    "emgain": "em_gain",
    "mcp": "mcp_v",
    "mcpvoltage": "mcp_v",
    "temperature": "temperature_c",
    "sensortemperature": "temperature_c",
    "cameratemperature": "temperature_c",
}
# Words whose unit the FITS convention of camera software states (SBFITSEXT 1.0)
OF_FITS = {"exptime": ("exposure_s", "s"), "ccdtemp": ("temperature_c", "c")}
KEY = re.compile(r"(.+?)(?:[ _]*[_ (\[]([^\W\d_]{1,4}|°C)[)\]]?)?")
QUANTITY = re.compile(r"\s*([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)\s*([^\W\d_]{0,4}|°C)\s*")


def stated(exposures: float = 1.0, **values: float | None) -> Stated:
    """Return the conditions of a header, without values that none of them can have.

    Parameters
    ----------
    exposures
        Exposures that the camera software added up in each frame. Exposure and gate are those of
        the sum.
    values
        Conditions by name.
    """
    kept: dict[str, Any] = {}
    for name, number in values.items():
        lowest, highest = POSSIBLE.get(name, POSSIBLE_SETTING)
        if number is not None and lowest <= number <= highest:
            kept[name] = number
    if not 1 < exposures < MOST_EXPOSURES:
        return Conditions(**kept), ()
    for name in {"exposure_s", "gate_ns"} & set(kept):
        kept[name] *= exposures
    return Conditions(**kept), (
        f"each frame is the sum of {exposures:g} exposures by its header: exposure_s, gate_ns and "
        "read noise are those of the sum",
    )


def number_of(text: object) -> float | None:
    """Return the number of a text, or None; anything that is no text has none."""
    try:
        return float(text) if isinstance(text, str | bytes) else None
    except ValueError:
        return None


def stated_in_text(pairs: Mapping[str, str]) -> Stated:
    """Return the conditions that keys and values of a text state with their units.

    The unit stands behind the number, "10 ms", or in the key, "exposure_ms", "Gate (ns)"; a number
    without one is not used, and a note reports it.
    """
    values: dict[str, float] = {}
    notes = []
    for key, text in pairs.items():
        matched = KEY.fullmatch(key.strip())
        word, unit = ("", None) if matched is None else matched.groups()
        full_word, word = (re.sub(r"[\W_]", "", part).lower() for part in (key, word))
        name, unit = OF_FITS.get(full_word) or (WORDS.get(word) or WORDS.get(full_word), unit or "")
        quantity = QUANTITY.fullmatch(text)
        if name is None or quantity is None:
            continue
        factor = UNITS[name].get((quantity[2] or unit).lower())
        if factor is None:
            notes.append(f"{key!r} of the file's text, {text!r}, has no unit of {name}: not used")
        else:
            values[name] = factor * float(quantity[1])
    conditions, _ = stated(**values)
    return conditions, tuple(notes)
