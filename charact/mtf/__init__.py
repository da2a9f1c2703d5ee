"""MTF of edges, bars and points: importing this package registers its methods."""

from charact.mtf import edge_forward
from charact.mtf.measuring import measure

__all__ = ["edge_forward", "measure"]
