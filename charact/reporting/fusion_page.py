"""Page of fused pictures: bands, pictures, deviation, shares, marks and scores of several
methods.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO

import numpy as np
from numpy.typing import NDArray

from charact.fusion.fused import MARKS, Fused, codes_of
from charact.fusion.scores import Score
from charact.reporting.report_images import ReportImage
from charact.reporting.session_page import template_of
from labdata.flags import FLAGS

# Colours of marks, red, green, blue; later ones lie over earlier ones.
MARK_COLOURS = {
    "filled": (240, 160, 32),
    "clipped": (255, 77, 77),
    "occluded": (170, 90, 220),
    "no-band": (0, 0, 0),
}
Rows = Mapping[str, Sequence[Score]]


@dataclass(frozen=True, kw_only=True)
class MethodSection:
    """Pictures and status of one method."""

    name: str
    status: str
    noise: str
    filled: str
    shares: str
    pictures: tuple[ReportImage, ...]


def fusion_page(
    bands: Sequence[NDArray[np.uint8]],
    fused_by_method: Mapping[str, Fused],
    scores: Rows,
    truths: Rows,
    *,
    aspect: float = 1.0,
) -> str:
    """Return the page as one HTML file without network requests.

    Parameters
    ----------
    bands
        Bands as they were fused, codes of 8 bits, shape (row, col) each.
    fused_by_method, scores, truths
        Fused pictures, their scores, and scores against the truth (empty: none), by method.
    aspect
        Row pitch over column pitch.
    """
    first = next(iter(fused_by_method.values()))
    rows = [row for fused in fused_by_method.values() for row in fused.measurements]
    notes = dict.fromkeys(note for row in rows for note in row.notes)
    flags = list(dict.fromkeys(flag for row in rows for flag in row.flags))
    findings = [note for note in notes if note.split(":")[0] in flags]
    spans = [f"Black {low:.4g}, white {high:.4g}." for low, high in first.spans.values()]
    return template_of("fusion.html.j2").render(
        title=" and ".join(first.names),
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        status="suspect" if flags else "ok",
        flags=[(flag, FLAGS[flag]) for flag in flags],
        findings=findings,
        notes=[note for note in notes if note not in findings],
        bands=[
            _image(codes, name, span, aspect)
            for codes, name, span in zip(bands, first.names, spans, strict=True)
        ],
        methods=[
            _section(name, fused, bands[0], aspect) for name, fused in fused_by_method.items()
        ],
        tables=[
            _table("Scores of the literature", scores),
            *([_table("Against the truth", truths)] if truths else []),
        ],
    )


def _section(name: str, fused: Fused, visible: NDArray[np.uint8], aspect: float) -> MethodSection:
    values = {row.quantity: row.value for row in fused.measurements if row.value is not None}
    shares = [
        f"{row.stack} {100.0 * row.value:.0f} %"
        for row in fused.measurements
        if row.quantity == "fused_share" and row.value is not None
    ]
    pictures = [_image(fused.codes, name, "", aspect)]
    if fused.sd.size:
        sd = fused.sd if fused.sd.ndim == 2 else np.sqrt(np.mean(fused.sd**2, axis=-1))
        top = float(np.percentile(sd, 99.5))
        pictures.append(
            _image(
                codes_of(sd / max(top, 1e-12)), "Standard deviation", f"White {top:.2g}.", aspect
            )
        )
    if fused.share.size:
        top = float(np.percentile(fused.share[0], 99.5))
        shown = codes_of(fused.share[0] / max(top, 1e-12))
        pictures.append(
            _image(shown, f"Share of {fused.names[0]}", f"White {100.0 * top:.3g} %.", aspect)
        )
    pictures.append(_image(_marked(fused.marks, visible), "Marks", _legend(fused.marks), aspect))
    return MethodSection(
        name=name,
        status=fused.measurements[0].status,
        noise=f"{values.get('fused_noise', np.nan):.2g}",
        filled=f"{100.0 * values.get('fused_filled_area', 0.0):.2g} %",
        shares=", ".join(shares),
        pictures=tuple(pictures),
    )


def _marked(marks: NDArray[np.uint8], visible: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the visible band, dimmed, with marks in their colours."""
    shown = np.repeat(visible[..., None] // 2, 3, axis=-1)
    for name, colour in MARK_COLOURS.items():
        shown[(marks & MARKS[name]) > 0] = colour
    return shown


def _legend(marks: NDArray[np.uint8]) -> str:
    words = {"filled": "orange", "clipped": "red", "occluded": "violet", "no-band": "black"}
    parts = [
        f"{name} {100.0 * np.mean((marks & MARKS[name]) > 0):.2g} % ({words[name]})"
        for name in MARK_COLOURS
    ]
    registration_note = (
        " Not registered." if marks.any() and (marks & MARKS["unregistered"]).all() else ""
    )
    return f"{', '.join(parts)}.{registration_note}"


def _image(codes: NDArray[np.uint8], title: str, caption: str, aspect: float) -> ReportImage:
    """Return a picture of codes, grey or colour, as JPEG."""
    from PIL import Image

    content = BytesIO()
    Image.fromarray(codes).save(content, format="JPEG", quality=80)
    rows, cols = codes.shape[:2]
    data = base64.b64encode(content.getvalue()).decode("ascii")
    return ReportImage(
        title=title[:1].upper() + title[1:],
        caption=caption,
        data=data,
        rows=rows,
        cols=cols,
        aspect=aspect,
    )


def _table(title: str, rows: Rows) -> dict[str, object]:
    """Return a table of scores: quantities in columns, methods and the copy of the first band in
    rows.
    """
    first = next(iter(rows.values()))
    body = [
        (name, [(_text(row.value), _text(row.noise_control)) for row in scores])
        for name, scores in rows.items()
    ]
    body.append(("copy of the visible band", [(_text(row.copy_control), "") for row in first]))
    return {
        "title": title,
        "columns": [(row.quantity.replace("_", " "), row.unit) for row in first],
        "rows": body,
    }


def _text(value: float | None) -> str:
    return "undefined" if value is None else f"{value:.4g}"
