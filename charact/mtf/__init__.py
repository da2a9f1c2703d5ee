"""MTF of edges, bars, points and the noise of flats: importing this package registers its methods."""

from charact.mtf import (
    bars_coltman,
    bars_contrast,
    bars_forward,
    edge_exponential,
    edge_forward,
    edge_free,
    edge_gradient,
    edge_parametric,
    edge_slanted,
    noise_spectrum,
    point_forward,
    point_parametric,
    point_spread,
)
from charact.mtf.measuring import measure
from charact.mtf.noise_spectrum import measure_flats
from charact.mtf.several import measure_all

__all__ = [
    "bars_coltman",
    "bars_contrast",
    "bars_forward",
    "edge_exponential",
    "edge_forward",
    "edge_free",
    "edge_gradient",
    "edge_parametric",
    "edge_slanted",
    "measure",
    "measure_all",
    "measure_flats",
    "noise_spectrum",
    "point_forward",
    "point_parametric",
    "point_spread",
]
