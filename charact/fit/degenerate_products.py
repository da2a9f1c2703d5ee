"""Products of parameters: where frames show only a product, one factor carries it and the others ride along.

The level of a flat knows luminous gain x transmission x quantum efficiency x DN per electron, and none of them alone.
The product is drawn in place of its carrier, with the other factors at their values; afterwards each draw is shared
out again among the factors as their priors allow.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.fit.predicted_quantities import Values, excess_noise_factor
from charact.fit.prior import SensorPrior, prior_of
from labdata.camera_description import Parameter
from labdata.sensor import Sensor

Array = NDArray[np.float64]

PRIOR_DRAWS = 4000
CANDIDATES = 200


@dataclass(frozen=True, kw_only=True)
class Product:
    """A product that the data know.

    Parameters
    ----------
    carrier
        Path of the parameter that carries it.
    partners
        Paths of the factors that ride along.
    factor
        What the partners multiply the carrier with, from their values, shape (n,).
    """

    carrier: str
    partners: tuple[str, ...]
    factor: Callable[[Values], Array]


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


def products_of(sensor: Sensor, asked: tuple[str, ...]) -> tuple[Product, ...]:
    """Return the products whose carrier and partners are all asked and have ranges."""
    known = sensor.parameters()
    return tuple(
        product
        for product in PRODUCTS
        if {product.carrier, *product.partners} <= set(asked)
        and all(known[path].low is not None for path in (product.carrier, *product.partners))
    )


def widen_to_products(sensor: Sensor, products: tuple[Product, ...]) -> Sensor:
    """Return the description in which every carrier has the range of its whole product."""
    return sensor.with_parameters({product.carrier: _whole(sensor, product) for product in products})


def distribute_product(sensor: Sensor, product: Product, carried: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Return draws of carrier and partners whose products are the carried ones, shape (draw,) each.

    Of many prior draws of the partners, one is taken for each product with the probability that the carrier's own
    prior gives to what is left for it.
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


def _whole(sensor: Sensor, product: Product) -> Parameter:
    """Return the carrier with the 95 % range of its product, the partners' values counted as 1."""
    rng = np.random.default_rng(0)
    partners, _ = _partners(sensor, product, rng, PRIOR_DRAWS)
    carrier = prior_of(sensor, (product.carrier,))
    own = carrier.parameters(carrier.draw(rng, PRIOR_DRAWS))[:, 0]
    low, high = np.quantile(own * _relative(sensor, product, partners), (0.025, 0.975))
    before = sensor.parameters()[product.carrier]
    return Parameter(
        value=before.value,
        low=min(float(low), before.value),
        high=max(float(high), before.value),
        standing=before.standing,
        source=before.source,
    )


def _partners(
    sensor: Sensor, product: Product, rng: np.random.Generator, count: int
) -> tuple[dict[str, Array], SensorPrior]:
    """Return prior draws of the partners by path."""
    prior = prior_of(sensor, product.partners)
    drawn = prior.parameters(prior.draw(rng, count))
    return dict(zip(prior.names, drawn.T, strict=True)), prior


def _relative(sensor: Sensor, product: Product, partners: dict[str, Array]) -> Array:
    """Return the partners' factor over that of their values."""
    known = sensor.parameters()
    values = {path: np.array([float(known[path])]) for path in product.partners}
    return product.factor({**values, **partners}) / product.factor(values)
