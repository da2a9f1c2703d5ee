"""Report of a session as one self-contained HTML file, with a comparison to the truth where it is known."""

from charact.report.page import fragment, page, write
from charact.report.truth import Truth, TruthComparison, compare_with_truth

__all__ = ["Truth", "TruthComparison", "compare_with_truth", "fragment", "page", "write"]
