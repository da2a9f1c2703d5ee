"""The study harness: registered methods against cases of known truth, charted for speed and mapped
for failure.
"""

from charact.study.harness import Case, CaseResult, MethodSummary, run, summary
from charact.study.speed_accuracy import Chart, chart
from charact.study.stability_sweep import Stability, stability
from charact.study.study_registry import STUDIES

__all__ = [
    "STUDIES",
    "Case",
    "CaseResult",
    "Chart",
    "MethodSummary",
    "Stability",
    "chart",
    "run",
    "stability",
    "summary",
]
