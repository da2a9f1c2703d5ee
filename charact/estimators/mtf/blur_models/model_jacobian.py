"""Forms of the point spread with their slopes, compiled: one transfer and its change with every
parameter at once.

`families` has the same forms for many points at a time; a fit asks for one point, a hundred times.
"""

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from charact.estimators.mtf.blur_models.one_dimensional import AIRY_HALF, MIN_LN, BlurModel
from charact.estimators.mtf.blur_models.pupil_table import PupilTable as PupilTable
from charact.estimators.mtf.blur_models.pupil_table import (
    pupil_and_slopes,
    pupil_curves,
    pupil_table,
)
from charact.estimators.mtf.blur_models.transfer import (
    MoffatTable,
    disc_at,
    disc_table,
    moffat_at,
    moffat_table,
    sine_integral_at,
    sine_table,
)

Array = NDArray[np.float64]
Tables = tuple[MoffatTable, Array, Array, PupilTable]

CORES = {"gaussian": 0, "exponential": 1, "moffat": 2, "airy": 3, "pupil": 4}
EXTENDED = {"halo": 0, "disc": 1, "glare": 2, "veil": 3}
LN2 = float(np.log(2.0))
# A pupil's table and curves where the form is another.
NO_TABLE = np.zeros(0), np.zeros(0), np.zeros((0, 0, 0)), np.zeros((0, 0))
NO_PUPIL = np.zeros((0, 0)), np.zeros(0)


def kind_of(family: BlurModel) -> tuple[int, int, float]:
    """Return the numbers of a form's core and of its light beyond it, -1 for none, and the widest
    of its sizes, px.
    """
    if family.wide is None:
        return CORES[family.core], -1, 1.0
    return CORES[family.core], EXTENDED[family.wide.name], float(family.wide.size_px[1])


@lru_cache(maxsize=2)
def tables(*, pupils: bool = False) -> Tables:
    """Return what the forms are looked up in: Moffat's transfer, Si, a disc's transfer and slope,
    and pupils'.
    """
    return moffat_table(), sine_table(), disc_table(), pupil_table() if pupils else NO_TABLE


@njit(cache=True)
def model_and_jacobian(kind: tuple, theta: Array, frequency: Array, tables: Tables) -> Array:
    """Return a form's transfer and its slopes with its parameters, shape (parameter + 1, f).

    Parameters
    ----------
    kind
        As `kind_of` tells.
    theta
        The form's parameters, shape (parameter,).
    frequency
        Shape (f,), cycles per pixel.
    tables
        As `tables` gives.
    """
    core, component, widest_px = kind
    out = np.empty((theta.size + 1, frequency.size))
    cores = 3 if core == 4 else 2 if core == 1 or core == 2 else 1
    curves, halves = pupil_curves(theta[1], theta[2], tables[3]) if core == 4 else NO_PUPIL
    for j in range(frequency.size):
        if core == 4:
            value, rise, by_shape, by_other_shape = pupil_and_slopes(
                frequency[j] * np.exp(-theta[0]), curves, halves
            )
            by_half = -rise
        else:
            value, by_half, by_shape = _core(core, theta, frequency[j], tables)
            by_other_shape = 0.0
        out[0, j], out[1, j] = value, by_half
        if cores > 1:
            out[2, j] = by_shape
        if cores > 2:
            out[3, j] = by_other_shape
        if component < 0:
            continue
        size = theta[cores + 1]
        unit = size / widest_px if component == 3 else 1.0
        other = theta[cores + 2] if component == 0 else 0.0
        component_value, by_size, by_other = _component(
            component, size, other, frequency[j], tables
        )
        fraction = theta[cores] * unit
        factor = 1.0 - fraction + fraction * component_value
        for k in range(cores + 1):
            out[k, j] *= factor
        out[cores + 1, j] = value * unit * (component_value - 1.0)
        turned = fraction * by_size
        if component == 3:
            turned += theta[cores] / widest_px * (component_value - 1.0)
        out[cores + 2, j] = value * turned
        if component == 0:
            out[cores + 3, j] = value * fraction * by_other
    return out


@njit(cache=True)
def _core(core: int, theta: Array, frequency: float, tables: Tables) -> tuple[float, float, float]:
    """Return a core's transfer and its slopes with ln of the half frequency and with its
    exponent.
    """
    ratio = np.log(frequency) - theta[0]
    if core == 3:
        v = AIRY_HALF * np.exp(ratio)
        if v >= 1.0:
            return 0.0, 0.0, 0.0
        height = np.sqrt(1.0 - v**2)
        return (np.arccos(v) - v * height) * 2.0 / np.pi, v * height * 4.0 / np.pi, 0.0
    if core == 2:
        ln, rise, by_exponent = moffat_at(ratio, theta[1], tables[0])
        if ln < MIN_LN:
            return np.exp(MIN_LN), 0.0, 0.0
        value = np.exp(ln)
        return value, -value * rise, value * by_exponent
    exponent = 2.0 if core == 0 else theta[1]
    fall = -LN2 * np.exp(exponent * ratio)
    if fall < MIN_LN:
        return np.exp(MIN_LN), 0.0, 0.0
    value = np.exp(fall)
    return value, -value * fall * exponent, value * fall * ratio


@njit(cache=True)
def _component(
    component: int, size: float, other: float, frequency: float, tables: Tables
) -> tuple[float, float, float]:
    """Return the transfer of light beyond the core and its slopes with its size and its other
    parameter.
    """
    if component == 2:
        turn = (2.0 * np.pi * frequency) ** 2
        value = 1.0 / (1.0 + turn * size**2)
        return value, -2.0 * turn * size * value**2, 0.0
    if component == 3:
        turn = 2.0 * (np.pi * frequency) ** 2
        value = np.exp(-turn * size**2)
        return value, -2.0 * turn * size * value, 0.0
    x = np.pi * size * frequency
    if component == 1:
        value, slope = disc_at(x, tables[2])
        return value, slope * np.pi * frequency, 0.0
    sinc = np.sin(x) / x
    uniform = sine_integral_at(x, tables[1]) / x
    slope = (other * (np.cos(x) - sinc) + (1.0 - other) * (sinc - uniform)) / size
    return other * sinc + (1.0 - other) * uniform, slope, sinc - uniform
