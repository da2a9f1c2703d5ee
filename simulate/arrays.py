"""Array types of the simulation by their numbers; shapes stand where arrays are described."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Array32 = NDArray[np.float32]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
