"""The report of a session: one self-contained HTML file, and the truth beside the measured where it is known."""

from charact.report.page import fragment, page, write
from charact.report.truth import Truth, TruthComparison, compare_with_truth

__all__ = ["Truth", "TruthComparison", "compare_with_truth", "fragment", "page", "write"]
