"""Laws of convection against their tables, and plates on which dew forms."""

import numpy as np
import pytest

from simulate.radiance import STEFAN_BOLTZMANN
from simulate.thermal import Columns, Exchange, periodic_start, vapour_pressure_pa
from tests.simulate.thermal.slabs import STEEL, forcing_of, slab_of

AIR, DIFFERENCE = np.array([285.0]), np.array([2.0, 5.0, 10.0])


def coefficient(law, *, upward=1.0, excess=DIFFERENCE, wind=0.0, constant=0.0):
    exchange = Exchange(
        law=law,
        constant_w_m2_k=constant,
        wind_coefficient=np.full(3, 5.0),
        upward=np.full(3, float(upward)),
        condensation=False,
    )
    dry = np.zeros(1), np.full(1, 1013.0)
    flux, slope = exchange.loss(AIR + excess, AIR, np.array([float(wind)]), *dry)
    step = 1e-5
    further, _ = exchange.loss(AIR + excess + step, AIR, np.array([float(wind)]), *dry)
    assert slope == pytest.approx((further - flux) / step, rel=1e-4)
    return flux / excess


@pytest.mark.parametrize(
    ("upward", "sign", "h"),
    [
        (1.0, -1.0, (0.96, 1.30, 1.64)),
        (1.0, 1.0, (1.92, 2.60, 3.27)),
        (-1.0, -1.0, (1.92, 2.60, 3.27)),
        (-1.0, 1.0, (0.96, 1.30, 1.64)),
        (0.0, 1.0, (1.65, 2.24, 2.82)),
    ],
)
def test_natural_convection_is_weak_where_air_is_stable(upward, sign, h):
    assert coefficient("buoyant", upward=upward, excess=sign * DIFFERENCE) == pytest.approx(
        h, rel=0.01
    )


def test_wind_adds_by_each_law():
    assert coefficient("mcadams", wind=2.0) == pytest.approx(13.3)
    assert coefficient("watmuff", wind=2.0) == pytest.approx(8.8)
    assert coefficient("constant", wind=2.0, constant=4.0) == pytest.approx(4.0)
    assert coefficient("buoyant", wind=2.0) - coefficient("buoyant") == pytest.approx(10.0)


# Air at 12.2 C, dew point 10 C, sky of emissivity .774: temperatures dry and with condensation.
@pytest.mark.parametrize(("h", "dry", "wet"), [(13.3, 7.9, 8.9), (6.0, 5.0, 7.0), (3.0, 2.0, 4.4)])
def test_dew_warms_an_insulated_plate(h, dry, wet):
    flux = np.full((288, 1), 0.9 * 0.7743 * STEFAN_BOLTZMANN * 285.35**4)
    for vapour, celsius in ((0.0, dry), (float(vapour_pressure_pa(283.15)), wet)):
        forcing = forcing_of(flux, 285.35, emissivity=0.9, h=h, vapour_pa=vapour)
        face, _ = periodic_start(Columns.of([slab_of(STEEL)]), forcing)
        assert face[-1, 0] - 273.15 == pytest.approx(celsius, abs=0.1)
