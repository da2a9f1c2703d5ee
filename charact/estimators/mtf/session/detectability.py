"""Noise-equivalent quanta, and the detectability of a disc, from an edge and flats.

    NEQ(f) = S^2 MTF(f)^2 / NPS(f),   d'^2 = int |D(f)|^2 NEQ(f) d^2 f

S: mean signal of the flats; NPS: power of their temporal noise, DN^2 px^2; D: transform of the
contrast of the object, px^2. d' is that of the ideal observer, who whitens the noise and knows the
object and its place (Dainty and Shaw, Image Science, 1974, 5.4 and 8; ICRU Report 54, 1996).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import charact
from charact.estimators.mtf.curve import PINNED, quantiles
from charact.estimators.mtf.session.constraints import ConstraintSource, sources
from charact.estimators.mtf.session.thresholds import DETECTABILITY
from charact.method import Context
from labdata import Array, Provenance, Result, Session
from labdata.conditions import GAINS
from labdata.measurement import QUANTILES, measurement_from_draws

METHOD = "noise-equivalent-quanta"
# Settings that edge and flats must share, where both state them.
SHARED = (*GAINS, "gate_ns", "exposure_s")


def add_detectability(
    session: Session, result: Result, kinds: Mapping[str, str], context: Context
) -> Result:
    """Return the result with NEQ and d' of each edge that was taken at the settings of the flats.

    `result`: curves of edges and the noise power of flats above their darks; `kinds`: kind of each
    target by its label.
    """
    noise = result.evidence.get("noise-power")
    if noise is None or noise["signal_dn"] is None:
        return result
    of_flats = session.stack(noise["flats"][0]).conditions
    for source in sources(result, kinds):
        of_edge = session.stack(source.target).conditions
        pairs = [(getattr(of_edge, name), getattr(of_flats, name)) for name in SHARED]
        if source.kind == "edge" and all(None in pair or pair[0] == pair[1] for pair in pairs):
            result += _of_edge(source, noise, context)
    return result


def _of_edge(source: ConstraintSource, noise: Mapping[str, Any], context: Context) -> Result:
    """Return NEQ and d' of one edge, from draws of its MTF and of the noise power."""
    (curve, angle_deg), rng = source.curves[0], np.random.default_rng([context.seed, 31])
    frequency, size = curve.frequency_cy_per_px, DETECTABILITY.draws
    if curve.draws is not None:
        mtf = curve.draws[rng.integers(len(curve.draws), size=size)]
    else:  # errors of all frequencies taken as one: the widest interval of an integral
        low, high = curve.interval68 if curve.interval68 is not None else 2 * [curve.value]
        mtf = curve.value + 0.5 * (high - low) * rng.standard_normal((size, 1))
    looks, power = (np.array(noise[key]) for key in ("looks", "power_dn2"))
    # Power per DN of signal: NPS over S.
    drawn = power * rng.gamma(looks, size=(size, power.size)) / looks
    cells = np.stack([noise["column_cy_per_px"], noise["row_cy_per_px"]], axis=1)
    direction = np.abs([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    nearest = _nearest(cells, frequency[:, None] * direction, DETECTABILITY.cells)
    along = drawn[:, nearest].mean(axis=2)
    signal_dn, flats = float(noise["signal_dn"]), ", ".join(noise["flats"])
    neq = signal_dn * mtf**2 / along
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    fields: dict[str, Any] = {
        "method": METHOD,
        "stack": source.target,
        "region": source.of.region,
        "orientation_deg": source.of.orientation_deg,
        "provenance": provenance,
    }
    at_signal = f"at the mean signal {signal_dn:.4g} DN of {flats}; noise in time"
    quanta = [
        measurement_from_draws(
            "neq",
            "1/px",
            [np.interp(f, frequency, draw) for draw in neq],
            frequency_cy_per_px=f,
            notes=(f"{at_signal}.",),
            **fields,
        )
        for f in PINNED
    ]
    diameter_px, contrast = context.disc
    weights = _disc_power(cells, frequency, diameter_px)
    squares = signal_dn * contrast**2 * np.einsum("dk,dk->d", mtf**2, (1.0 / drawn) @ weights.T)
    observer = (
        f"Disc of {diameter_px:g} px and contrast {contrast:g} {at_signal}; ideal observer, who "
        "whitens the noise; the MTF of this direction is taken for all."
    )
    detectability = measurement_from_draws(
        "detectability", "1", np.sqrt(squares), notes=(observer,), **fields
    )
    low, value, high = quantiles(neq, (QUANTILES[0], 0.5, QUANTILES[-1]))
    figure = {
        "frequency_cy_per_px": frequency.tolist(),
        "neq_per_px": value.tolist(),
        "interval95": [low.tolist(), high.tolist()],
        "the_curves_say": observer.removesuffix("."),
    }
    return Result(
        measurements=(*quanta, detectability),
        evidence={f"noise-equivalent quanta:{source.target}": {"figure": "neq", **figure}},
    )


def _nearest(cells: Array, at: Array, count: int) -> NDArray[np.intp]:
    """Return the indices of the cells next to frequencies, shape (f, 2) -> (f, count)."""
    distance = np.sum((at[:, None] - cells) ** 2, axis=2)
    return np.argpartition(distance, count, axis=1)[:, :count]


def _disc_power(cells: Array, frequency: Array, diameter_px: float) -> Array:
    """Return the integral of the square of a disc's transform over the parts of the plane of
    frequencies that are next to a cell and to a radial frequency, shape (f, cell), px^2.

    The transform is (pi d^2 / 4) 2 J1(pi d f) / (pi d f).
    """
    from scipy.spatial import KDTree
    from scipy.special import j1

    step = DETECTABILITY.step_cy_per_px
    axis = np.arange(0.5 * step, 0.5, step)
    plane = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    radius = np.hypot(*plane.T)
    argument = np.pi * diameter_px * radius
    square = (0.25 * np.pi * diameter_px**2 * 2.0 * j1(argument) / argument) ** 2
    ring = np.rint(radius / (frequency[1] - frequency[0])).astype(int)
    seen = ring < frequency.size
    index = ring[seen] * len(cells) + KDTree(cells).query(plane[seen])[1]
    # One quadrant stands for four.
    total = np.bincount(index, 4.0 * step**2 * square[seen], frequency.size * len(cells))
    return total.reshape(frequency.size, len(cells)).astype(np.float64)
