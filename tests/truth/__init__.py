"""True scenes, their frames and sessions: closed forms that share no formula with the packages."""

from tests.truth.bars import BarScene, StripScene
from tests.truth.blur import Array, BlurOf, TrueBlur, level_crossing
from tests.truth.camera_effects import correlate_noise
from tests.truth.charts import BarChart, Bars, TiltedSquares, noisy
from tests.truth.edge import EdgeScene, edge_spread
from tests.truth.photoelectron_targets import PulsedBars, PulseEdge
from tests.truth.photon_spots import Spot, SpotCamera
from tests.truth.point import PointScene
from tests.truth.sessions import session_in_memory, stack_in_memory

__all__ = [
    "Array",
    "BarChart",
    "BarScene",
    "Bars",
    "BlurOf",
    "EdgeScene",
    "PointScene",
    "PulseEdge",
    "PulsedBars",
    "Spot",
    "SpotCamera",
    "StripScene",
    "TiltedSquares",
    "TrueBlur",
    "correlate_noise",
    "edge_spread",
    "level_crossing",
    "noisy",
    "session_in_memory",
    "stack_in_memory",
]
