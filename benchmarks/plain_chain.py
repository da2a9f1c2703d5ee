"""The intensified chain as one would write it in plain NumPy and OpenCV: what our speed is held
against.
"""

import numpy as np
from numpy.typing import NDArray

# Blur of half a pixel before the gain, of three quarters behind it.
BEFORE_PX, AFTER_PX = 0.5, 0.75
CHARGE_E, FULL_WELL_E, READ_E, TOP_DN = 736.0, 50000.0, 50.0, 255.0


class PlainChain:
    """A scene whose mean is blurred once; a call draws a frame.

    Parameters
    ----------
    scene
        Mean photoelectrons per pixel, shape (row, col).
    charge_e
        CCD electrons per photoelectron.
    """

    def __init__(self, scene: NDArray[np.floating], charge_e: float = CHARGE_E) -> None:
        import cv2

        self._mean = cv2.GaussianBlur(scene.astype(np.float32), (0, 0), BEFORE_PX)
        self._charge_e = charge_e
        self._rng = np.random.default_rng(1)
        self._shown = np.zeros(scene.shape, np.float32)

    def frame(self) -> NDArray[np.uint8]:
        """Detected photoelectrons, exponential pulses, blur, decay, charge noise, well, filter,
        noise, digitiser.
        """
        import cv2

        rng = self._rng
        events = rng.poisson(0.62 * self._mean)
        pulses = (
            rng.standard_gamma(events, dtype=np.float32)
            if events.any()
            else events.astype(np.float32)
        )
        light = cv2.GaussianBlur(pulses * np.float32(self._charge_e / 0.62), (0, 0), AFTER_PX)
        self._shown = np.float32(0.64) * light + np.float32(0.36) * self._shown
        charge = self._shown + np.sqrt(self._shown) * rng.standard_normal(light.shape, np.float32)
        np.minimum(charge, np.float32(FULL_WELL_E), out=charge)
        charge += np.float32(READ_E) * rng.standard_normal(light.shape, np.float32)
        line = cv2.filter2D(charge, -1, np.array([[0.1, 0.3, 0.6]], np.float32))
        codes = np.rint(line * np.float32((TOP_DN - 12.0) / FULL_WELL_E) + np.float32(12.0))
        return np.clip(codes, 0.0, TOP_DN).astype(np.uint8)
