"""MTF of edges, bars and points: importing this package registers its methods."""

from charact.mtf import edge_forward, edge_slanted
from charact.mtf.measuring import measure

__all__ = ["edge_forward", "edge_slanted", "measure"]
