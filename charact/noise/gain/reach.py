"""How far to reach for a covariance gain: further leaves out less and is less certain; the data say where to stop.

A window of lags that ends too soon, a superpixel that is too small and frequencies that lie too far from 0 all leave
out part of the covariance. Each step doubles the reach. What is still left out is charged to the interval as a share of
what the last step brought: with wings exp(-(f/fc)^n), n = 1.2, the rest is 0.8 of it (n = 2: a third).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.noise.gain.fit import Fit
from charact.noise.gain.summary import Summary
from labdata.errors import BadInput

Array = NDArray[np.float64]

# Share of the last step's change that further steps may still bring.
REST = 0.8


def settled(values: Array, covariance: Array) -> tuple[float, float]:
    """Return the value at the reach of least error, and its standard error with what is left out charged to it.

    Parameters
    ----------
    values
        Covariance over signal at each reach, the shortest first, shape (reach,), DN.
    covariance
        Their sampling covariance, shape (reach, reach), DN^2.

    Raises
    ------
    BadInput
        If there are fewer than two reaches.
    """
    if len(values) < 2:
        raise BadInput(f"images must have room for two reaches of the covariance at least, got {len(values)}")
    own = np.diag(covariance)
    of_step = own[1:] + own[:-1] - 2.0 * np.diag(covariance, 1)
    # A step that brought nothing by chance may still have brought its standard error.
    brought = np.maximum(np.diff(values) ** 2, of_step)
    total = own[1:] + REST**2 * brought
    best = int(np.argmin(total))
    return float(values[1 + best]), float(np.sqrt(total[best]))


def with_power(fit: Fit, summary: Summary, power_dn: float, sd_dn: float, *, seed: int) -> Fit:
    """Return a fit with another covariance over signal and its standard error, all lags in time summed, DN.

    The form of the blur stays as fitted: levels are compared under it, and K is told from k F^2 by it.
    """
    posterior = fit.posterior
    power = power_dn + sd_dn * np.random.default_rng([seed, 8]).standard_normal(len(posterior.draws))
    ratio = power / posterior["power"]
    draws = posterior.draws.copy()
    for name in ("covariance_gain", "power"):
        draws[:, posterior.names.index(name)] *= ratio
    draws[:, posterior.names.index("blur_factor")] /= ratio
    model_dn = fit.model_dn * power_dn / float(np.median(posterior["power"]))
    return replace(fit, posterior=replace(posterior, draws=draws), model_dn=model_dn)
