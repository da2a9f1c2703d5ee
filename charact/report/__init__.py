"""Report of a session as one self-contained HTML file, with a comparison to the truth where it is
known.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from charact.callable_package import make_callable

if TYPE_CHECKING:
    from charact.report.session_page import fragment, page, write
    from charact.report.truth import Truth, TruthComparison, compare_with_truth

__all__ = ["Truth", "TruthComparison", "compare_with_truth", "fragment", "page", "write"]

make_callable(__name__)


def __getattr__(name: str) -> Any:
    """Import the page and its figures on first use: tables and formats need neither."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = "session_page" if name in ("fragment", "page", "write") else "truth"
    return getattr(import_module(f"charact.report.{module}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
