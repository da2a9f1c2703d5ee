"""Finding the targets of a whole frame: edges, groups of bars, pinholes."""

from charact.mtf.find.bar_groups import FoundBars, find_bar_groups
from charact.mtf.find.edges import FoundEdge, find_edges
from charact.mtf.find.pinholes import FoundPoint, find_pinholes

__all__ = ["FoundBars", "FoundEdge", "FoundPoint", "find_bar_groups", "find_edges", "find_pinholes"]
