"""The MTF of measured and simulated edges by one and the same method."""

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.validation.predictive import Features
from labdata.frames import FrameStack

Array = NDArray[np.float64]

METHOD = "edge-slanted"
# Up to 0.8 of the sampling limit.
FREQUENCY_CY_PER_PX = np.arange(0.05, 0.4001, 0.05)
# Errors of neighbouring points of a curve go together over about this distance.
CORRELATION_CY_PER_PX = 0.08
FREEDOM = 9


def mtf_features(frames: NDArray, context: Context) -> Features | None:
    """Return the MTF at FREQUENCY_CY_PER_PX with the method's own errors, or None where the method refuses."""
    from charact import mtf

    found = mtf.measure("edge", FrameStack(data=frames), method=METHOD, context=context)
    line = next(iter(found.curves.values()), None)
    if line is None or line.interval68 is None:
        return None
    value, low, high = (
        np.interp(FREQUENCY_CY_PER_PX, line.frequency_cy_per_px, y) for y in (line.value, *line.interval68)
    )
    sd = np.maximum((high - low) / (2.0 * 0.994458), 1e-4)
    apart = np.abs(FREQUENCY_CY_PER_PX[:, None] - FREQUENCY_CY_PER_PX[None, :])
    return Features(value=value, covariance=np.outer(sd, sd) * np.exp(-apart / CORRELATION_CY_PER_PX), freedom=FREEDOM)
