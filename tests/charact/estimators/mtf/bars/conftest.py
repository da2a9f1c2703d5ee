"""The frames of bars beside these tests, and the charts of the finders' tests, are imported by
name.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "target_detection")]
