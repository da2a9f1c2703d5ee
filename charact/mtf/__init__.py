"""MTF of edges, bars and points: importing this package registers its methods."""

from charact.mtf import (
    bars_coltman,
    bars_contrast,
    bars_forward,
    edge_forward,
    edge_parametric,
    edge_slanted,
    point_forward,
    point_spread,
)
from charact.mtf.measuring import measure
from charact.mtf.several import measure_all

__all__ = [
    "bars_coltman",
    "bars_contrast",
    "bars_forward",
    "edge_forward",
    "edge_parametric",
    "edge_slanted",
    "measure",
    "measure_all",
    "point_forward",
    "point_spread",
]
