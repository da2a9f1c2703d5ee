"""The report of a session: one self-contained HTML file, and the truth beside the measured where it is known."""

from charact.report.page import fragment, page, write
from charact.report.truth import Beside, Truth, beside_truth

__all__ = ["Beside", "Truth", "beside_truth", "fragment", "page", "write"]
