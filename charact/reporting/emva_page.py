"""EMVA 1288 data sheet as a page of its own, HTML or PDF: rows, and figures of the standard."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from charact import __version__
from charact.frames.rounding import QUANTISATION_DN2
from charact.reporting.emva_sheet import FIGURES, emva_xml, require_summary
from charact.reporting.figure_registry import figure_of
from charact.reporting.session_page import template_of, write_pdf
from charact.reporting.style import report_style
from charact.reporting.tables import best
from labdata.file_io import write_atomically
from labdata.measurement import Result
from labdata.session import Session


def sheet_page(session: Session, result: Result) -> str:
    """Return the data sheet as HTML: the rows, and the figures of the standard."""
    rows = require_summary(result)["rows"]
    with report_style():
        data = {**result.evidence, "signal-to-noise-ratio": _snr_data(result)}
        figures = [figure_of(name, data[name]) for name in FIGURES if data.get(name)]
    return template_of("emva_sheet.html.j2").render(
        session=session,
        made=datetime.now(UTC).strftime("%Y-%m-%d"),
        program=f"charact {__version__}",
        rows=rows,
        figures=figures,
        conditions=_conditions(session),
    )


def _snr_data(result: Result) -> dict[str, Any]:
    """Return what the figure of the signal-to-noise ratio shows; empty without known photons."""
    names = {
        "threshold_photons": ("sensitivity_threshold", "photons/px"),
        "saturation_photons": ("saturation_exposure", "photons/px"),
        "quantum_efficiency": ("quantum_efficiency", "%"),
        "read_noise": ("read_noise", "e-"),
        "system_gain": ("system_gain", "DN/e-"),
    }
    known = {key: best(result.find(name, unit=unit)) for key, (name, unit) in names.items()}
    values = {key: m.value for key, m in known.items() if m is not None and m.value is not None}
    lit, noise = (result.evidence.get(name) for name in ("linearity", "photon-transfer"))
    if len(values) < len(names) or not lit or not noise:
        return {}
    pattern = {
        key: getattr(best(result.find(f"{key}_1288", unit=unit)), "value", None) or 0.0
        for key, unit in (("dsnu", "e-"), ("prnu", "%"))
    }
    names_of_levels = ((lit, "photons"), (lit, "signal_dn"), (noise, "variance_dn2"))
    levels = np.array([data[name] for data, name in names_of_levels])
    light, signal, variance = levels[:, levels[0] <= values["saturation_photons"]]
    rounding_e2 = QUANTISATION_DN2 / values["system_gain"] ** 2
    return {
        **values,
        "photons": light,
        "snr": signal / np.sqrt(np.maximum(variance, QUANTISATION_DN2)),
        "electrons_per_photon": values["quantum_efficiency"] / 100.0,
        "dark_e2": values["read_noise"] ** 2 + rounding_e2,
        "dsnu_e": pattern["dsnu"],
        "prnu": pattern["prnu"] / 100.0,
    }


def _conditions(session: Session) -> list[tuple[str, str]]:
    """Return title and value of what the session says of the camera and its frames."""
    flats, darks = session.of_kind("flat"), session.of_kind("dark")
    stated = [entry.conditions for entry in (*flats, *darks)]
    known = [("Camera", "" if session.camera is None else session.camera.name)]
    known += [("Bits", "" if session.bit_depth is None else str(session.bit_depth))]
    for title, name, unit in (
        ("Wavelength", "wavelength_nm", "nm"),
        ("Temperature", "temperature_c", "°C"),
        ("Gain", "camera_gain_db", "dB"),
        ("Exposure", "exposure_s", "s"),
        ("Light", "photons_per_px", "photons/px"),
    ):
        values = [value for c in stated if (value := getattr(c, name)) is not None]
        ends = dict.fromkeys(f"{end:.4g}" for end in (min(values), max(values))) if values else ()
        known.append((title, f"{' to '.join(ends)} {unit}" if values else ""))
    counted = f"{len(flats)} of flats, {len(darks)} of darks"
    return [(title, value or "not stated") for title, value in (*known, ("Stacks", counted))]


def write_sheet(session: Session, result: Result, out: str | Path) -> Path:
    """Write the data sheet of a result as the ending of the file says: .html, .pdf, else XML.

    Raises
    ------
    BadInput
        If the standard does not apply, or a PDF is asked for and WeasyPrint is missing.
    """
    out = Path(out)
    if out.suffix == ".pdf":
        return write_pdf(sheet_page(session, result), out)
    page = sheet_page if out.suffix == ".html" else lambda s, r: emva_xml(r, s.name)
    write_atomically(out, page(session, result).encode())
    return out
