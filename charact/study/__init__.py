"""The study harness: registered methods against cases of known truth, charted for speed and mapped for failure."""

from charact.study.failure_map import Stability, stability
from charact.study.harness import Case, Row, Summary, run, summary
from charact.study.quantities import STUDIES
from charact.study.speed_accuracy import Chart, chart

__all__ = ["STUDIES", "Case", "Chart", "Row", "Stability", "Summary", "chart", "run", "stability", "summary"]
