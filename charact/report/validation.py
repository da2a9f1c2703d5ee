"""The validation as the page shows it: pictures side by side, overlays, statistics with their two controls."""

from typing import Any


def validation_section(validation: Any) -> dict[str, Any]:
    """Return what the template needs of a `charact.validation.Validation`."""
    return {
        "status": "ok",
        "headline": "",
        "summary": "",
        "pairs": (),
        "figures": (),
        "columns": (),
        "rows": (),
        "notes": (),
    }
