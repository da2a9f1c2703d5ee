"""The report as a PDF, by WeasyPrint where it is installed."""

from pathlib import Path

from charact.report.style import PAPER_INK
from labdata.errors import BadInput


def write_pdf(html: str, out: Path) -> Path:
    """Write a report's HTML as PDF.

    Parameters
    ----------
    html
        The page.
    out
        The PDF file.

    Raises
    ------
    BadInput
        If WeasyPrint, or Pango that it needs, is not installed.
    """
    try:
        from weasyprint import HTML
    except (ImportError, OSError) as error:
        raise BadInput(
            f"--pdf needs WeasyPrint and Pango (pip install 'charact[pdf]'; apt install libpango-1.0-0 "
            f"libpangoft2-1.0-0), got: {str(error).splitlines()[0]}"
        ) from error
    # Folds cannot be opened on paper.
    HTML(string=html.replace("<details", "<details open").replace("currentColor", PAPER_INK)).write_pdf(str(out))
    return out
