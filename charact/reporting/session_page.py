"""The report page: one HTML file without network requests, also as PDF."""

import base64
import mimetypes
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from charact.reporting import figure_registry, front_page, tables
from charact.reporting.bloom_images import add_extent_data
from charact.reporting.comparison import limits_section
from charact.reporting.corner import corner_svg, varying
from charact.reporting.emva_sheet import SHEET_ALONE, emva_summary
from charact.reporting.mtf_curves import mtf_svgs
from charact.reporting.report_images import aspect_of, representative
from charact.reporting.style import PAPER_INK, report_style
from charact.reporting.truth import Truth, compare_with_truth
from labdata import FLAGS, BadInput, Posterior, Result, Session, has_tube, write_atomically
from labdata.file_io import require_regular
from labdata.limits import OVERRIDDEN

if TYPE_CHECKING:
    from charact.validation import Validation

# Evidence that is drawn on the pictures, and that other quantities are computed from.
NOT_FIGURES = ("layout", "noise-power")


def write(
    session: Session,
    result: Result,
    out: str | Path,
    *,
    validation: "Validation | None" = None,
    truth: Truth | None = None,
    purpose: front_page.PurposeOf | None = None,
    pdf: bool = False,
) -> Path:
    """Write the report of a session as one self-contained HTML file.

    Parameters
    ----------
    session, result
        The session: its frames, conditions and sensor; and its measurements.
    out
        The HTML file.
    validation
        A `charact.validation.Validation`, or None.
    truth
        True values by quantity (of a virtual bench), or None; see
        `charact.reporting.compare_with_truth`.
    purpose
        What the session must be enough for; None: that which its frames show.
    pdf
        Also write a PDF next to it.

    Returns
    -------
    Path
        The HTML file.

    Raises
    ------
    BadInput
        If a PDF is requested and WeasyPrint is missing.
    """
    out = Path(out)
    html = page(session, result, validation=validation, truth=truth, purpose=purpose)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, html.encode())
    if pdf:
        write_pdf(html, out.with_suffix(".pdf"))
    return out


def page(
    session: Session,
    result: Result,
    *,
    validation: "Validation | None" = None,
    truth: Truth | None = None,
    purpose: front_page.PurposeOf | None = None,
) -> str:
    """Return the report as HTML."""
    section = None
    with report_style():
        if validation is not None:
            from charact.reporting.validation import validation_section

            section = validation_section(validation, aspect_of(session))
        frequency = front_page.unit_of(session)
        figures = [
            figure_registry.figure_of(name, data, frequency)
            for name, data in add_extent_data(session, result).items()
            if name not in (*NOT_FIGURES, *SHEET_ALONE)
        ]
        mtf_figures = mtf_svgs(session, result, truth, frequency)
    return template_of("report.html.j2").render(
        session=session,
        logo=logo_of(session),
        bases=tables.bases(front_page.leading(session, result)),
        made=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        verdicts=tables.verdicts(result),
        **front_page.context(session, result, figures, validation, purpose),
        limits=limits_section(session),
        groups=tables.quantity_groups(result),
        comparison=compare_with_truth(result, truth or {}),
        mtf_figures=mtf_figures,
        figures={
            part: [f for f in figures if f.section == part]
            for part in ("mtf", "noise", "bloom", "other")
        },
        emva=emva_summary(result),
        pictures=representative(session, result.measurements, result.evidence.get("layout")),
        validation=section,
        posteriors=posteriors(result),
        stacks=tables.stack_table(session),
        sensor_rows=tables.sensor_rows(session.camera) if has_tube(session.camera) else (),
        sensor_facts=tables.sensor_facts(session.camera) if has_tube(session.camera) else (),
        overridden=[note for note in session.notes if note.startswith(OVERRIDDEN)],
        left_out=list(
            dict.fromkeys(note for note in session.notes if not note.startswith(OVERRIDDEN))
        ),
        provenance=tables.provenance(result.measurements),
        charted=tables.chart_rows(result),
    )


def logo_of(session: Session) -> str:
    """Return the logo of a session's report as a data URI, "" without one."""
    if session.about.logo is None:
        return ""
    path = session.folder / session.about.logo
    kind = mimetypes.guess_type(path.name)[0] or ""
    if not kind.startswith("image/"):
        raise BadInput(f"`logo` must be a picture (.png, .jpg, .svg), got {path.name!r}")
    require_regular(path, "`logo`")
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"


def fragment(result: Result) -> str:
    """Return the table of quantities and the MTF figure as an HTML fragment, for a notebook."""
    return template_of("fragment.html.j2").render(
        groups=tables.quantity_groups(result),
        verdicts=tables.verdicts(result),
        mtf_figures=mtf_svgs(None, result),
    )


def template_of(name: str) -> Any:
    """Return a template of this package, with escaping."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("charact.reporting", "templates")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def posteriors(result: Result) -> list[dict[str, Any]]:
    """Return corner plot and sampling diagnostics of every distinct posterior of the
    measurements.
    """
    owners: dict[tuple[Any, ...], tuple[str, Posterior]] = {}
    for m in result.measurements:
        if m.posterior is not None and len(m.posterior.draws):
            title = ", ".join(part for part in (m.method, m.stack) if part)
            owners.setdefault(
                (m.posterior.names, m.posterior.draws.tobytes()), (title, m.posterior)
            )
    return [
        {
            "title": title,
            "svg": corner_svg(posterior, title),
            "health": _health(posterior),
            "flags": [(flag, FLAGS[flag]) for flag in posterior.flags],
            "left_out": [
                name for i, name in enumerate(posterior.names) if i not in varying(posterior)
            ],
        }
        for title, posterior in owners.values()
    ]


def _health(p: Posterior) -> str:
    """Return the sampling diagnostics of a posterior."""
    parts = [f"{len(p.draws)} draws by {p.sampler}, seed {p.seed}"]
    if p.acceptance is not None:
        parts.append(f"acceptance {p.acceptance:.2f}")
    if p.r_hat.size:
        parts.append(f"largest split R-hat {p.r_hat.max():.3f}")
    if p.autocorrelation_time.size:
        parts.append(f"longest autocorrelation time {p.autocorrelation_time.max():.0f} steps")
    if p.effective_sample_size.size:
        parts.append(f"smallest effective sample size {p.effective_sample_size.min():.0f}")
    return ", ".join(parts) + "."


def write_pdf(html: str, out: Path) -> Path:
    """Write a report as PDF; raise BadInput if WeasyPrint or Pango is not installed."""
    try:
        from weasyprint import HTML
    except (ImportError, OSError) as error:
        raise BadInput(
            "`pdf` needs WeasyPrint and Pango (pip install 'charact[pdf]'; apt install "
            f"libpango-1.0-0 libpangoft2-1.0-0), got: {str(error).splitlines()[0]}"
        ) from error
    # All folds are open. WeasyPrint draws no picture that another SVG element defines.
    pictures = dict(re.findall(r'<image id="(frame-\d+)"([^>]*/>)', html))
    html = re.sub(r'<use href="#(frame-\d+)"/>', lambda use: f"<image{pictures[use[1]]}", html)
    html = html.replace("<details", "<details open").replace("currentColor", PAPER_INK)
    HTML(string=html).write_pdf(str(out))
    return out
