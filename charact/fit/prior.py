"""Priors of sensor parameters from a description's ranges, and of their degenerate products."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fit.predicted_quantities import Values, excess_noise_factor
from labdata.camera_description import Parameter
from labdata.sensor import Sensor
from labdata.solid_state import SolidStateCamera

Array = NDArray[np.float64]
VisibleCamera = Sensor | SolidStateCamera

# Fractions and probabilities with the upper bound 1.
_AT_MOST_ONE = (
    "photocathode.halo_fraction",
    "photocathode.halo_elastic_share",
    "microchannel_plate.detection_probability",
    "tube.post_gain_share",
    "taper.transmission",
    "ccd.quantum_efficiency",
)
# Factors of products and powers: drawn as logarithms, in which a constrained product is a straight ridge.
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
    "ccd.pitch_x_um",
)
# A parameter whose range spans more than this factor is a scale: drawn as its logarithm.
SCALE_RATIO = 5.0
# Parameters that enter as 1 + c / parameter: drawn as -1/parameter, in which the dependence is linear.
_LIMITS = ("microchannel_plate.strip_current_ua_per_cm2",)
# Half of a Gaussian's 95 % interval in standard deviations.
HALF_WIDTH95_SD = 1.959964


@dataclass(frozen=True, kw_only=True)
class SensorPrior:
    """Independent priors: two half-Gaussians that meet at the value, so that low..high contain 95 %."""

    names: tuple[str, ...]  # paths of the parameters
    # coordinate of a parameter, shape (parameter,): 1 the parameter, 0 its logarithm, -1 its negative inverse
    power: NDArray[np.int64]
    # centre, sd_below, sd_above: coordinate of the value and the two widths, shape (parameter,)
    centre: Array
    sd_below: Array
    sd_above: Array
    bounds: Array  # bounds of the coordinates, shape (parameter, 2)

    @property
    def sd(self) -> Array:
        """Standard deviation of each coordinate's prior before truncation, shape (parameter,).

        Half-Gaussians of the widths a and b with equal height have the variance (1 - 2/pi)(b - a)^2 + a b.
        """
        below, above = self.sd_below, self.sd_above
        return np.sqrt((1.0 - 2.0 / np.pi) * (above - below) ** 2 + below * above)

    def log_density(self, coordinates: Array) -> Array:
        """Return the log-prior, not normalised, of coordinates (n, parameter): -inf outside bounds."""
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

    def coordinates(self, parameters: Array) -> Array:
        """Return the coordinates of parameters, shape (n, parameter)."""
        logarithms = np.log(np.where(self.power == 0, parameters, 1.0))
        turned = -1.0 / np.where(self.power == -1, parameters, -1.0)
        return np.where(self.power == 0, logarithms, np.where(self.power == -1, turned, parameters))


def prior_of(sensor: VisibleCamera, requested: tuple[str, ...]) -> SensorPrior:
    """Return the prior of the requested parameters that have a range.

    `sensor`: sensor description whose low..high contain each parameter with 95 % probability; `requested`: paths of the
    parameters on which the session's data depend; those that the camera lacks are left out.
    """
    known = sensor.parameters()
    ranges = {path: (known[path].low, known[path].high) for path in requested if path in known}
    ranged = [path for path, (low, high) in ranges.items() if low is not None and high is not None and high > low]
    rows = [(path, *_row(path, known[path])) for path in ranged]
    numbers = np.array([row[1:] for row in rows], float).reshape(-1, 6)
    return SensorPrior(
        names=tuple(row[0] for row in rows), power=numbers[:, 0].astype(int), centre=numbers[:, 1],
        sd_below=numbers[:, 2], sd_above=numbers[:, 3], bounds=numbers[:, 4:6],
    )  # fmt: skip


def values_of_description(sensor: VisibleCamera) -> Values:
    """Return the description's value of every parameter and count that a prediction needs, shape (1,)."""
    counts = {"video.filter_order": sensor.video.filter_order, "video.rows_per_pixel": 1 + sensor.video.interlaced}
    if isinstance(sensor, SolidStateCamera):
        counts["register.stages"] = sensor.register.stages
    numbers = sensor.parameters() | {path: count for path, count in counts.items() if count is not None}
    return {path: np.array([float(number)]) for path, number in numbers.items()}


def _row(path: str, parameter: Parameter) -> tuple[int, float, float, float, float, float]:
    """Return the power of the coordinate, its centre, its two widths and its bounds.

    A value at an end of its range extends a little beyond.
    """
    low, value, high = float(parameter.low or 0.0), float(parameter.value), float(parameter.high or 0.0)
    floor, ceiling = 0.0 if low == 0 else -np.inf if low < 0 else 0.02 * value, 1.0 if path in _AT_MOST_ONE else np.inf
    scale = path in _FACTORS or high > SCALE_RATIO * low
    power = 1 if low <= 0 else -1 if path in _LIMITS else 0 if scale else 1
    if power < 1:
        ends = np.array([floor, low, value, high, min(ceiling, 1e3 * value)])
        floor, low, value, high, ceiling = (np.log(ends) if power == 0 else -1.0 / ends).tolist()
    least = 0.1 * (high - low) / HALF_WIDTH95_SD
    below, above = max((value - low) / HALF_WIDTH95_SD, least), max((high - value) / HALF_WIDTH95_SD, least)
    return power, value, below, above, floor, ceiling


PRIOR_DRAWS = 4000
CANDIDATES = 200


@dataclass(frozen=True, kw_only=True)
class Product:
    """Product of parameters that the data determine."""

    carrier: str  # path of the parameter that is drawn as the product
    partners: tuple[str, ...]  # paths of the other factors
    factor: Callable[[Values], Array]  # factor of the partners, from their values, shape (n,)


PRODUCTS = (
    Product(
        carrier="tube.luminous_gain",
        partners=("taper.transmission", "ccd.quantum_efficiency", "video.conversion_gain_dn_per_e"),
        factor=lambda values: (
            values["taper.transmission"] * values["ccd.quantum_efficiency"] * values["video.conversion_gain_dn_per_e"]
        ),
    ),
    Product(
        carrier="photocathode.luminous_sensitivity_ua_per_lm",
        partners=("microchannel_plate.detection_probability", "microchannel_plate.pulse_height_shape"),
        factor=lambda values: 1.0 / excess_noise_factor(values),
    ),
)


def products_of(sensor: VisibleCamera, requested: tuple[str, ...]) -> tuple[Product, ...]:
    """Return the products whose carrier and partners are all requested and have ranges."""
    known = sensor.parameters()
    return tuple(
        product
        for product in PRODUCTS
        if {product.carrier, *product.partners} <= set(requested)
        and all(known[path].low is not None for path in (product.carrier, *product.partners))
    )


def widen_to_products(sensor: VisibleCamera, products: tuple[Product, ...]) -> VisibleCamera:
    """Return the description in which every carrier has the range of its product."""
    return sensor.with_parameters({product.carrier: _whole(sensor, product) for product in products})


def distribute_product(
    sensor: VisibleCamera, product: Product, carried: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Distribute drawn products over carrier and partners, shape (draw,) each.

    For each product one of many prior draws of the partners is selected, with the probability of the remaining carrier
    value under its prior.
    """
    partners, prior = _partners(sensor, product, rng, CANDIDATES * 20)
    relative = _relative(sensor, product, partners)
    own = prior_of(sensor, (product.carrier,))
    pick = np.empty(len(carried), int)
    for index, whole in enumerate(carried):
        tried = rng.integers(len(relative), size=CANDIDATES)
        left = (whole / relative[tried])[:, None]
        weight = own.log_density(np.log(left) if own.power[0] == 0 else left)
        weight = np.exp(weight - weight.max())
        pick[index] = tried[rng.choice(CANDIDATES, p=weight / weight.sum())]
    return {product.carrier: carried / relative[pick], **{path: partners[path][pick] for path in prior.names}}


def divide_product(sensor: VisibleCamera, product: Product, whole: float) -> dict[str, float]:
    """Return carrier and partners of a product where their joint prior is largest."""
    from charact.posterior import find_maximum

    prior, own = prior_of(sensor, product.partners), prior_of(sensor, (product.carrier,))

    def carrier_of(coordinates: Array) -> Array:
        partners = dict(zip(prior.names, prior.parameters(coordinates).T, strict=True))
        return (whole / _relative(sensor, product, partners))[:, None]

    def density(coordinates: Array) -> Array:
        inside = np.isfinite(prior.log_density(coordinates))
        left = carrier_of(np.where(inside[:, None], coordinates, prior.centre))
        return np.where(inside, prior.log_density(coordinates) + own.log_density(own.coordinates(left)), -np.inf)

    best = prior.centre
    if np.isfinite(density(best[None])[0]):
        best, _ = find_maximum(density, best, prior.bounds)
    partners = dict(zip(prior.names, prior.parameters(best[None])[0].tolist(), strict=True))
    return {product.carrier: float(carrier_of(best[None])[0, 0]), **partners}


def _whole(sensor: VisibleCamera, product: Product) -> Parameter:
    """Return the carrier with the 95 % range of its product, with the partners' values as unity."""
    rng = np.random.default_rng(0)
    partners, _ = _partners(sensor, product, rng, PRIOR_DRAWS)
    carrier = prior_of(sensor, (product.carrier,))
    own = carrier.parameters(carrier.draw(rng, PRIOR_DRAWS))[:, 0]
    low, high = np.quantile(own * _relative(sensor, product, partners), (0.025, 0.975))
    before = sensor.parameters()[product.carrier]
    return Parameter(
        value=before.value, low=min(float(low), before.value), high=max(float(high), before.value),
        standing=before.standing, source=before.source,
    )  # fmt: skip


def _partners(
    sensor: VisibleCamera, product: Product, rng: np.random.Generator, count: int
) -> tuple[dict[str, Array], SensorPrior]:
    """Return prior draws of the partners by path."""
    prior = prior_of(sensor, product.partners)
    drawn = prior.parameters(prior.draw(rng, count))
    return dict(zip(prior.names, drawn.T, strict=True)), prior


def _relative(sensor: VisibleCamera, product: Product, partners: dict[str, Array]) -> Array:
    """Return the partners' factor over that of their values."""
    known = sensor.parameters()
    values = {path: np.array([float(known[path])]) for path in product.partners}
    return product.factor({**values, **partners}) / product.factor(values)
