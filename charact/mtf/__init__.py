"""MTF of edges, bar targets, point sources and flat-field noise."""

from charact.callable_package import make_callable
from charact.mtf.dispatch import measure, measure_all, measure_flats

__all__ = ["measure", "measure_all", "measure_flats"]

make_callable(__name__)
