"""Priors of sensor parameters from a description's ranges, and products that data determine."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fitting.predicted_quantities import excess_noise_factor
from charact.fitting.thresholds import LIMITS
from charact.frames.image_lag import DECAY_FRACTIONS
from charact.observables import Values
from labdata.camera.description import Camera
from labdata.camera.parameters import Parameter

Array = NDArray[np.float64]

# Fractions and probabilities with the upper bound 1.
_AT_MOST_ONE = (
    "photocathode.halo_fraction",
    *DECAY_FRACTIONS,
    "photocathode.halo_elastic_share",
    "microchannel_plate.detection_probability",
    "tube.post_gain_share",
    "taper.transmission",
    "ccd.quantum_efficiency",
)
# A curvature of the response that a description may state.
_MOST_CURVED = {"readout.compression_fraction": 0.2}
# Factors of products and powers: drawn as logarithms, in which a constrained product is a straight
# ridge.
FACTORS = (
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
    "ccd.pitch_x_um",
)
# A parameter whose range spans more than this factor is a scale: drawn as its logarithm.
SCALE_RATIO = 5.0
# Half of a Gaussian's 95 % interval in standard deviations.
HALF_WIDTH95_SD = 1.959964


@dataclass(frozen=True, kw_only=True)
class SensorPrior:
    """Independent priors: two half-Gaussians that meet at the value, so that low..high contain 95
    %.
    """

    names: tuple[str, ...]  # paths of the parameters
    # coordinate of a parameter, shape (parameter,): 1 the parameter, 0 its logarithm
    power: NDArray[np.int64]
    # centre, sd_below, sd_above: coordinate of the value and the two widths, shape (parameter,)
    centre: Array
    sd_below: Array
    sd_above: Array
    bounds: Array  # bounds of the coordinates, shape (parameter, 2)

    @property
    def sd(self) -> Array:
        """Standard deviation of each coordinate's prior before truncation, shape (parameter,).

        Half-Gaussians of the widths a and b with equal height have the variance (1 - 2/pi)(b - a)^2
        + a b.
        """
        sd_below, sd_above = self.sd_below, self.sd_above
        return np.sqrt((1.0 - 2.0 / np.pi) * (sd_above - sd_below) ** 2 + sd_below * sd_above)

    def residuals(self, coordinates: Array) -> Array:
        """Return the departures of coordinates (n, parameter) from the centre in units of the
        widths.
        """
        departures = coordinates - self.centre
        return departures / np.where(departures < 0, self.sd_below, self.sd_above)

    def of_scores(self, scores: Array) -> Array:
        """Return the coordinates of normal scores (n, parameter): the quantile of a coordinate in
        its prior is that of the score in the standard normal law.

        Of the widths a below and b above the centre the half-Gaussians hold a/(a + b) and b/(a +
        b); from logarithms of both tails, as data may lie far out in either.
        """
        from scipy.special import log_ndtr, ndtr, ndtri_exp

        widths = np.stack([self.sd_below, self.sd_above])
        halves = 2.0 * widths / widths.sum(axis=0)
        cut = halves * ndtr(-np.abs(self.bounds.T - self.centre) / widths)
        mass = np.log1p(-cut.sum(axis=0))
        with np.errstate(divide="ignore"):
            tails = [
                np.logaddexp(np.log(cut_tail), mass + log_ndtr(side)) - np.log(half)
                for cut_tail, side, half in zip(cut, (scores, -scores), halves, strict=True)
            ]
        below, above = (ndtri_exp(np.minimum(tail, -np.log(2.0))) for tail in tails)
        return self.centre + self.sd_below * below - self.sd_above * above

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """Return coordinates drawn from the prior, shape (count, parameter)."""
        shape = (count, len(self.names))
        out = np.full(shape, np.nan)
        while np.isnan(out).any():
            is_above = rng.random(shape) < self.sd_above / (self.sd_below + self.sd_above)
            departures = np.abs(rng.standard_normal(shape)) * np.where(
                is_above, self.sd_above, -self.sd_below
            )
            fresh = self.centre + departures
            within_bounds = (fresh >= self.bounds[:, 0]) & (fresh <= self.bounds[:, 1])
            out = np.where(np.isnan(out) & within_bounds, fresh, out)
        return out

    def parameters(self, coordinates: Array) -> Array:
        """Return the parameters at coordinates, shape (n, parameter)."""
        exponential = np.exp(np.where(self.power == 0, coordinates, 0.0))
        return np.where(self.power == 0, exponential, coordinates)

    def coordinates(self, parameters: Array) -> Array:
        """Return the coordinates of parameters, shape (n, parameter)."""
        logarithms = np.log(np.where(self.power == 0, parameters, 1.0))
        return np.where(self.power == 0, logarithms, parameters)


def prior_of(sensor: Camera, requested: tuple[str, ...]) -> SensorPrior:
    """Return the prior of the requested parameters that have a range.

    `sensor`: sensor description whose low..high contain each parameter with 95 % probability;
    `requested`: paths of the parameters on which the session's data depend; those that the camera
    lacks are left out.
    """
    known = sensor.parameters()
    ranges = {path: (known[path].low, known[path].high) for path in requested if path in known}
    ranged = [
        path
        for path, (low, high) in ranges.items()
        if low is not None and high is not None and high > low
    ]
    rows = [(path, *_row(path, known[path])) for path in ranged]
    numbers = np.array([row[1:] for row in rows], float).reshape(-1, 6)
    return SensorPrior(
        names=tuple(row[0] for row in rows),
        power=numbers[:, 0].astype(int),
        centre=numbers[:, 1],
        sd_below=numbers[:, 2],
        sd_above=numbers[:, 3],
        bounds=numbers[:, 4:6],
    )


def values_of_description(sensor: Camera) -> Values:
    """Return the description's value of every parameter and count that a prediction needs, shape
    (1,).
    """
    counts = {
        "video.filter_order": sensor.video.filter_order,
        "video.rows_per_pixel": 1 + sensor.video.interlaced,
    }
    if sensor.register is not None:
        counts["register.stages"] = sensor.register.stages
    numbers = sensor.parameters() | {
        path: count for path, count in counts.items() if count is not None
    }
    return {path: np.array([float(number)]) for path, number in numbers.items()}


def rounds_its_darks(sensor: Camera) -> bool:
    """Whether the read noise may be too small against a quantisation step for rounding to be
    additive noise.
    """
    least_e = sensor.ccd.read_noise_e.low or float(sensor.ccd.read_noise_e)
    return least_e * float(sensor.video.conversion_gain_dn_per_e) <= LIMITS.least_noise_dn


def _row(path: str, parameter: Parameter) -> tuple[int, float, float, float, float, float]:
    """Return the power of the coordinate, its centre, its two widths and its bounds.

    A value at an end of its range extends a little beyond.
    """
    low, value, high = (
        float(parameter.low or 0.0),
        float(parameter.value),
        float(parameter.high or 0.0),
    )
    floor, ceiling = (
        0.0 if low == 0 else -np.inf if low < 0 else 0.02 * low,
        1.0 if path in _AT_MOST_ONE else _MOST_CURVED.get(path, np.inf),
    )
    floor = max(floor, -_MOST_CURVED.get(path, np.inf))
    scale = path in FACTORS or high > SCALE_RATIO * low
    power = 1 if low <= 0 else 0 if scale else 1
    if power == 0:
        ends = np.array([floor, low, value, high, min(ceiling, 1e3 * value)])
        floor, low, value, high, ceiling = np.log(ends).tolist()
    least_sd = 0.1 * (high - low) / HALF_WIDTH95_SD
    sd_below, sd_above = (
        max((value - low) / HALF_WIDTH95_SD, least_sd),
        max((high - value) / HALF_WIDTH95_SD, least_sd),
    )
    return power, value, sd_below, sd_above, floor, ceiling


@dataclass(frozen=True, kw_only=True)
class Combination:
    """Product of parameters that data determine better than each of its factors."""

    paths: tuple[str, ...]  # paths of the factors, first the one that the product is named after
    product: Callable[[Values], Array]  # product of the factors, from values of shape (n,)


COMBINATIONS = (
    Combination(
        paths=(
            "tube.luminous_gain",
            "taper.transmission",
            "ccd.quantum_efficiency",
            "video.conversion_gain_dn_per_e",
        ),
        product=lambda values: (
            values["tube.luminous_gain"]
            * values["taper.transmission"]
            * values["ccd.quantum_efficiency"]
            * values["video.conversion_gain_dn_per_e"]
        ),
    ),
    Combination(
        paths=(
            "photocathode.luminous_sensitivity_ua_per_lm",
            "microchannel_plate.detection_probability",
            "microchannel_plate.pulse_height_shape",
        ),
        product=lambda values: (
            values["photocathode.luminous_sensitivity_ua_per_lm"] / excess_noise_factor(values)
        ),
    ),
)
