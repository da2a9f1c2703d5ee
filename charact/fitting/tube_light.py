"""Light of pulses in the fields of a camera with a tube.

With the fractions a of the light and the times t of the components of the decay, a pulse u before
the end of its field T leaves E = exp(-u/t) of a to later fields, of which the i-th shows (1 - q)
q^(i-1), q = exp(-T/t): l_0 = 1 - sum a E. Arrivals are even over the gate g at the start of the
field, so that the mean of E is (t/g) (exp(-(T - g)/t) - exp(-T/t)), and that of E E' the same with
1/t + 1/t'.
"""

import numpy as np

from charact.fitting.last_values import of_last_values
from charact.frames.image_lag import decay_components
from charact.observables import Values
from labdata import Array


@of_last_values()
def field_products(values: Values, gate_s: float, fields: int) -> Array:
    """Return the mean over arrival times of sum_i l_i l_(i+j) for j = 0 ... fields - 1, shape (n,
    fields); l_i is the fraction of a pulse's light in the i-th field after it. The first is the
    fraction of a field's scintillation variance that remains with phosphor decay.
    """
    light_fraction, once, twice, keep = _fraction_in_later(values, gate_s)
    pair_products = light_fraction[:, :, None] * light_fraction[:, None, :] * twice
    out = np.empty((len(light_fraction), fields))
    out[:, 0] = 1.0 - 2.0 * np.sum(light_fraction * once, axis=1) + pair_products.sum(axis=(1, 2))
    # What is left of both components, once for each field after the first.
    lasting = (
        pair_products
        * (1.0 - keep)[:, :, None]
        * (1.0 - keep)[:, None, :]
        / (1.0 - keep[:, :, None] * keep[:, None, :])
    )
    out[:, 0] += lasting.sum(axis=(1, 2))
    first_later = (1.0 - keep) * (light_fraction * once - pair_products.sum(axis=1))
    for lag in range(1, fields):
        out[:, lag] = np.sum(
            first_later * keep ** (lag - 1) + lasting.sum(axis=1) * keep**lag, axis=1
        )
    return out


def field_light(values: Values, gate_s: float, fields: int) -> Array:
    """Return the mean fractions l_0 ... of a pulse's light in its field and later ones, shape (n,
    fields).
    """
    light_fraction, once, _, keep = _fraction_in_later(values, gate_s)
    later = (light_fraction * once)[:, None] * keep[:, None] ** np.arange(fields)[:, None]
    return -np.diff(later.sum(axis=2), axis=1, prepend=1.0)


def _fraction_in_later(values: Values, gate_s: float) -> tuple[Array, Array, Array, Array]:
    """Return the fractions a of the components, the means of E and E E', and q; shape (n,
    component), but E E' (n, component, component).
    """
    field_s = 1.0 / values["video.field_rate_hz"][:, None]
    weights, times_ms = decay_components(values)
    tau = times_ms * 1e-3
    light = weights * tau
    light_fraction, rate = (light / light.sum(axis=0)).T, 1.0 / tau.T
    open_s = np.minimum(gate_s, field_s)

    def fraction(rate: Array, open_s: Array, field_s: Array) -> Array:
        return (np.exp(-(field_s - open_s) * rate) - np.exp(-field_s * rate)) / (open_s * rate)

    twice = fraction(rate[:, :, None] + rate[:, None, :], open_s[:, :, None], field_s[:, :, None])
    return light_fraction, fraction(rate, open_s, field_s), twice, np.exp(-field_s * rate)
