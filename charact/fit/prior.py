"""What is believed of a sensor before its frames are looked at: the ranges of its description."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fit.predicted_quantities import Values
from labdata.camera_description import Parameter
from labdata.sensor import Sensor

Array = NDArray[np.float64]

# Shares and probabilities end at 1.
_AT_MOST_ONE = (
    "photocathode.halo_fraction",
    "photocathode.halo_elastic_share",
    "microchannel_plate.detection_probability",
    "tube.post_gain_share",
    "taper.transmission",
    "ccd.quantum_efficiency",
)

# Factors of products and powers: drawn as logarithms, so that a product that the data know is a straight ridge.
_FACTORS = (
    "photocathode.luminous_sensitivity_ua_per_lm",
    "photocathode.ebi_lm_per_cm2",
    "microchannel_plate.detection_probability",
    "microchannel_plate.pulse_height_shape",
    "tube.luminous_gain",
    "tube.mtf_frequency_lp_per_mm",
    "tube.post_gain_share",
    "taper.demagnification",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "video.conversion_gain_dn_per_e",
    "ccd.read_noise_e",
)

# What bends the response as 1 + c / parameter: drawn as -1/parameter, in which the bend is straight.
_LIMITS = ("microchannel_plate.strip_current_ua_per_cm2",)

# Half of a Gaussian's 95 % interval in standard deviations.
HALF_WIDTH95_SD = 1.959964


@dataclass(frozen=True, kw_only=True)
class SensorPrior:
    """Independent priors: halves of two Gaussians that meet at the value, so that low..high hold 95 %.

    Parameters
    ----------
    names
        Paths of the parameters asked.
    power
        What a parameter's coordinate is, shape (parameter,): 1 the parameter, 0 its logarithm, -1 its negative inverse.
    centre, sd_below, sd_above
        Coordinate of the value and the two widths, shape (parameter,).
    bounds
        Of the coordinates, where a number loses its meaning, shape (parameter, 2).
    """

    names: tuple[str, ...]
    power: NDArray[np.int64]
    centre: Array
    sd_below: Array
    sd_above: Array
    bounds: Array

    @property
    def sd(self) -> Array:
        """Standard deviation of each coordinate's prior before the cut, shape (parameter,).

        Notes
        -----
        Halves of the widths a and b with a common height have the variance (1 - 2/pi)(b - a)^2 + a b.
        """
        below, above = self.sd_below, self.sd_above
        return np.sqrt((1.0 - 2.0 / np.pi) * (above - below) ** 2 + below * above)

    def log_density(self, coordinates: Array) -> Array:
        """Return the logarithm of the prior, not normalised, of coordinates (n, parameter): -inf outside bounds."""
        away = coordinates - self.centre
        z = away / np.where(away < 0, self.sd_below, self.sd_above)
        inside = np.all((coordinates >= self.bounds[:, 0]) & (coordinates <= self.bounds[:, 1]), axis=1)
        return np.where(inside, -0.5 * np.sum(z**2, axis=1), -np.inf)

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Return coordinates drawn from the prior, shape (count, parameter)."""
        shape = (count, len(self.names))
        out = np.full(shape, np.nan)
        while np.isnan(out).any():
            above = rng.random(shape) < self.sd_above / (self.sd_below + self.sd_above)
            away = np.abs(rng.standard_normal(shape)) * np.where(above, self.sd_above, -self.sd_below)
            fresh = self.centre + away
            inside = (fresh >= self.bounds[:, 0]) & (fresh <= self.bounds[:, 1])
            out = np.where(np.isnan(out) & inside, fresh, out)
        return out

    def parameters(self, coordinates: Array) -> Array:
        """Return the parameters at coordinates, shape (n, parameter)."""
        logarithmic, inverse = self.power == 0, self.power == -1
        exponential = np.exp(np.where(logarithmic, coordinates, 0.0))
        turned = -1.0 / np.where(inverse, coordinates, -1.0)
        return np.where(logarithmic, exponential, np.where(inverse, turned, coordinates))


def prior_of(sensor: Sensor, asked: tuple[str, ...]) -> SensorPrior:
    """Return the prior of the asked parameters that a sensor's ranges state; an exact one is not asked.

    Parameters
    ----------
    sensor
        The description whose low..high hold each parameter with 95 % probability.
    asked
        Paths of the parameters that the session's data speak of.
    """
    known = sensor.parameters()
    rows = [(path, *_row(path, known[path])) for path in asked if _has_range(known[path])]
    numbers = np.array([row[1:] for row in rows], float).reshape(-1, 6)
    return SensorPrior(
        names=tuple(row[0] for row in rows),
        power=numbers[:, 0].astype(int),
        centre=numbers[:, 1],
        sd_below=numbers[:, 2],
        sd_above=numbers[:, 3],
        bounds=numbers[:, 4:6],
    )


def values_of_description(sensor: Sensor) -> Values:
    """Return every parameter's own value, shape (1,)."""
    values = {path: np.array([float(parameter)]) for path, parameter in sensor.parameters().items()}
    order = sensor.video.filter_order
    return values if order is None else {**values, "video.filter_order": np.array([float(order)])}


def _has_range(parameter: Parameter) -> bool:
    return parameter.low is not None and parameter.high is not None and parameter.high > parameter.low


def _row(path: str, parameter: Parameter) -> tuple[int, float, float, float, float, float]:
    """Return the power of the coordinate, its centre, its two widths and its bounds.

    A value on an end of its own range takes a little of the other side.
    """
    low, value, high = float(parameter.low or 0.0), float(parameter.value), float(parameter.high or 0.0)
    floor, ceiling = 0.0 if low == 0 else 0.02 * value, 1.0 if path in _AT_MOST_ONE else np.inf
    power = 0 if path in _FACTORS and low > 0 else -1 if path in _LIMITS and low > 0 else 1
    if power < 1:
        ends = np.array([floor, low, value, high, min(ceiling, 1e3 * value)])
        floor, low, value, high, ceiling = (np.log(ends) if power == 0 else -1.0 / ends).tolist()
    least = 0.1 * (high - low) / HALF_WIDTH95_SD
    below, above = max((value - low) / HALF_WIDTH95_SD, least), max((high - value) / HALF_WIDTH95_SD, least)
    return power, value, below, above, floor, ceiling
