"""The study harness: registered methods against cases of known truth, charted for speed and mapped for failure."""

from charact.study.chart import Chart, chart
from charact.study.harness import Case, Row, Summary, run, summary
from charact.study.quantities import STUDIES
from charact.study.stability import Stability, stability

__all__ = ["STUDIES", "Case", "Chart", "Row", "Stability", "Summary", "chart", "run", "stability", "summary"]
