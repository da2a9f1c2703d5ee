"""How curved a camera's response may be, before a target is looked at and after: y = u + c u (1 - u), u from 0 to 1."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Before the data: the probability that a response is curved, and by how much then, as a standard deviation.
CURVED, CURVED_SD = 0.25, 0.2


def curvatures(response: tuple[float, float], noise_ln_odds: float, rng: np.random.Generator, count: int) -> Array:
    """Return draws of a response's curvature, 0 where it is straight.

    Parameters
    ----------
    response
        Curvature that a target asks for, and its error, dimensionless; below 0 the response steepens.
    noise_ln_odds
        Ln of how much likelier the noise is under a curved response.
    rng
        Draws.
    count
        How many.

    Notes
    -----
    A straight response is weighed against one whose curvature is normal about none (Savage-Dickey ratio).
    """
    found, error = response[0], max(response[1], 1e-9)
    apart = np.hypot(error, CURVED_SD)
    ln_odds = np.log(CURVED / (1.0 - CURVED) * error / apart) + 0.5 * ((found / error) ** 2 - (found / apart) ** 2)
    ln_odds += noise_ln_odds
    curved = rng.random(count) < 1.0 / (1.0 + np.exp(-np.clip(ln_odds, -50.0, 50.0)))
    drawn = found * (CURVED_SD / apart) ** 2 + error * CURVED_SD / apart * rng.standard_normal(count)
    return np.where(curved, drawn, 0.0)
