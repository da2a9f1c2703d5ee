"""MTF of edges, bar targets, point sources and flat-field noise."""

from charact.estimators.mtf.dispatch import measure, measure_all, measure_flats

__all__ = ["measure", "measure_all", "measure_flats"]
