"""MTF of edges, bars, points and the noise of flats."""

from charact.mtf.measuring import measure, measure_flats
from charact.mtf.several import measure_all

__all__ = ["measure", "measure_all", "measure_flats"]
