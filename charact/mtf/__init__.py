"""MTF of edges, bars, points and the noise of flats: importing this package registers its methods."""

from charact.mtf.bars import coltman as bars_coltman
from charact.mtf.bars import contrast as bars_contrast
from charact.mtf.bars import forward as bars_forward
from charact.mtf.edge import exponential as edge_exponential
from charact.mtf.edge import forward as edge_forward
from charact.mtf.edge import free as edge_free
from charact.mtf.edge import gradient as edge_gradient
from charact.mtf.edge import parametric as edge_parametric
from charact.mtf.edge import slanted as edge_slanted
from charact.mtf.measuring import measure
from charact.mtf.noise_spectrum import flats as noise_spectrum
from charact.mtf.noise_spectrum.flats import measure_flats
from charact.mtf.point import forward as point_forward
from charact.mtf.point import parametric as point_parametric
from charact.mtf.point import spread as point_spread
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
