"""A transfer of free shape: smooth in the logarithm of frequency and falling, with no form of its own beyond that."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.mtf.blur_models.one_dimensional import EXPONENT, EXPONENT_PRIOR, HALF_FREQUENCY

Array = NDArray[np.float64]

# Waves of the departure from a straight line, over this range of frequency, and the scale of their amplitudes.
WAVES = tuple(range(2, 8))
RANGE_CY_PER_PX = (0.02, 1.0)
AMPLITUDE_SD = 1.5
AMPLITUDE_BOUND = 6.0


@dataclass(frozen=True)
class NonparametricBlur:
    """-ln H = ln 2 exp(s), s a free smooth function of ln f.

    Notes
    -----
    s = n ln(f/f2) + sum of a_k cos(k pi t)/k^2, t the place of ln f in its range: with normal amplitudes a smoothing
    spline, whose second derivative is penalised. Without them it is the form exp(-ln 2 (f/f2)^n).
    """

    name = "free"

    @property
    def parameters(self) -> dict[str, tuple[str, tuple[float, float]]]:
        """Unit and bounds of each parameter by name."""
        low, high = np.log(HALF_FREQUENCY)
        waves = {f"wave_{k}": ("1", (-AMPLITUDE_BOUND, AMPLITUDE_BOUND)) for k in WAVES}
        return {"ln_half_frequency": ("ln(cy/px)", (float(low), float(high))), "exponent": ("1", EXPONENT), **waves}

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([bound for _, bound in self.parameters.values()])

    def start(self, half_frequency_cy_per_px: float) -> Array:
        """Return a point from which to climb."""
        return np.array([np.log(half_frequency_cy_per_px), 1.5, *np.zeros(len(WAVES))])

    def modulus(self, theta: Array, frequency: Array) -> Array:
        """Return the transfer, shape (n, parameter) and (f,) or (n, f) -> (n, f)."""
        place = np.log(np.maximum(frequency, 1e-9))
        low, high = np.log(RANGE_CY_PER_PX)
        bend = _waves(np.pi * np.clip((place - low) / (high - low), 0.0, 1.0), theta[:, 2:])
        line = theta[:, 1:2] * (place - theta[:, :1])
        return np.exp(-np.log(2.0) * np.exp(np.minimum(line + bend, 7.0)))

    def log_prior(self, theta: Array) -> Array:
        """Return ln of the prior density, -inf outside the bounds."""
        bounds = self.bounds
        inside = np.all((theta >= bounds[:, 0]) & (theta <= bounds[:, 1]), axis=1)
        mean, sd = EXPONENT_PRIOR
        normal = -0.5 * ((theta[:, 1] - mean) / sd) ** 2 - np.log(sd)
        waves = -0.5 * np.sum((theta[:, 2:] / AMPLITUDE_SD) ** 2, axis=1) - len(WAVES) * np.log(AMPLITUDE_SD)
        return np.where(inside, normal + waves - 0.5 * (1 + len(WAVES)) * np.log(2.0 * np.pi), -np.inf)


def _waves(angle: Array, amplitude: Array) -> Array:
    """Return the sum of a_k cos(k angle)/k^2, each cosine from the two before it."""
    one = np.cos(angle)
    before, now, total = np.ones_like(one), one, np.zeros(np.broadcast_shapes(one.shape, (len(amplitude), 1)))
    for k in range(2, WAVES[-1] + 1):
        before, now = now, 2.0 * one * now - before
        total = total + amplitude[:, k - WAVES[0], None] * now / k**2
    return total
