"""MTF of edges, bars, points and the noise of flats."""

from charact.mtf.dispatch import measure, measure_flats
from charact.mtf.multiple_targets import measure_all

__all__ = ["measure", "measure_all", "measure_flats"]
