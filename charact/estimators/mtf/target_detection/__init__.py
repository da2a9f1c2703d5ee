"""Finding the targets of a whole frame: edges, groups of bars, pinholes."""

from charact.estimators.mtf.target_detection.bar_groups import DetectedBarGroup, find_bar_groups
from charact.estimators.mtf.target_detection.edges import DetectedEdge, find_edges
from charact.estimators.mtf.target_detection.pinholes import DetectedPoint, find_pinholes

__all__ = [
    "DetectedBarGroup",
    "DetectedEdge",
    "DetectedPoint",
    "find_bar_groups",
    "find_edges",
    "find_pinholes",
]
