"""Constraints that the targets of a session place on one MTF.

A curve drawn from a posterior of two or three parameters contains two or three independent numbers, whatever the
number of frequencies. They are its principal components, with their standard uncertainties.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.mtf.session.thresholds import THRESHOLDS
from labdata.measurement import Curve, Measurement, Result

Array = NDArray[np.float64]

# Frequencies that are looked at, cycles per pixel of the curve, and the least MTF that is.
FREQUENCIES = np.arange(0.04, 0.481, 0.04)
# Half of a 68 % interval in standard deviations.
HALF68_SD = 0.994458
POST_GAIN = {"mtf_post_gain": 0.0, "mtf_post_gain_vertical": 90.0}


@dataclass(frozen=True, kw_only=True)
class MtfConstraint:
    """What one target says.

    Parameters
    ----------
    target
        Label of the stack, with the region where it holds several.
    kind
        "edge", "bars", "point" or "noise spectrum".
    frequency
        Cycles per column pitch, shape (f,).
    angle_rad
        Direction of each from the rows' direction, shape (f,).
    weights
        Combinations of the MTF at these frequencies that it tells, shape (combination, f).
    value, sd
        Of each combination, shape (combination,), dimensionless.
    within
        Whether it is normalised to a window narrower than the halo.
    """

    target: str
    kind: str
    frequency: Array
    angle_rad: Array
    weights: Array
    value: Array
    sd: Array
    within: bool = False

    def residual(self, mtf: Array) -> Array:
        """Return (value - model)/sd for MTFs at its frequencies, shape (n, f) -> (n, combination)."""
        return (self.value - mtf @ self.weights.T) / self.sd


@dataclass(frozen=True, kw_only=True)
class ConstraintSource:
    """A measurement of edge or point that vouches for its curves, and the curves along rows or any one direction."""

    target: str
    kind: str
    of: Measurement
    curves: tuple[tuple[Curve, float], ...]


def constraints_from(
    result: Result, kinds: Mapping[str, str], context: Context
) -> tuple[list[MtfConstraint], list[MtfConstraint]]:
    """Return the constraints of valid targets on the MTF, and the bounds by the post-gain MTF of flats.

    Parameters
    ----------
    result
        Measurements and curves of one session.
    kinds
        Kind of each stack ("edge", "bars", "point") by its label.
    context
        The camera, for its pitches.
    """
    curves = [one for source in sources(result, kinds) if (one := _curve_constraint(source, context)) is not None]
    bars = [_bar_constraint(m) for m in result.find("mtf") if _is_valid(m) and kinds.get(m.stack or "") == "bars"]
    bounds = [_post_gain_bound(curve, POST_GAIN[name], context) for name, curve in _post_gain_curves(result)]
    return [*curves, *bars], [one for one in bounds if one is not None]


def sources(result: Result, kinds: Mapping[str, str]) -> Iterator[ConstraintSource]:
    """Every edge and point whose MTF50 is sound, with its curves and their directions in degrees."""
    seen = set()
    for m in result.find("mtf50"):
        kind = kinds.get(m.stack or "")
        if kind not in ("edge", "point") or not _is_valid(m) or (m.stack, m.region) in seen:
            continue
        seen.add((m.stack, m.region))
        region = "" if m.region is None else ":{},{},{},{}".format(*m.region)
        places = (f":{m.stack}", f"{region}:{m.stack}", f":{m.stack}{region}")
        ways = {"mtf": 0.0 if kind == "point" else (m.orientation_deg or 0.0), "mtf_vertical": 90.0}
        held = {
            name: curve for name in ways for place in places if (curve := result.curves.get(name + place)) is not None
        }
        if held:
            yield ConstraintSource(
                target=f"{m.stack}",
                kind=kind,
                of=m,
                curves=tuple((curve, ways[name]) for name, curve in held.items()),
            )


def _is_valid(m: Measurement) -> bool:
    return m.status == "ok" and m.value is not None and m.interval68 is not None


def _curve_constraint(source: ConstraintSource, context: Context) -> MtfConstraint | None:
    """Principal components of the curves of one target, taken together."""
    if any(curve.draws is None for curve, _ in source.curves):
        return _single_value_constraint(source, context)
    parts, frequencies, angles = [], [], []
    for curve, angle_deg in source.curves:
        assert curve.draws is not None
        values = _interpolate_draws(FREQUENCIES, curve.frequency_cy_per_px, curve.draws)
        used = values.mean(axis=0) > THRESHOLDS.min_mtf
        parts.append(values[:, used])
        frequencies.append(FREQUENCIES[used] / pitches(source.kind, angle_deg, context))
        angles.append(np.full(int(used.sum()), np.deg2rad(angle_deg)))
    draws = np.concatenate(parts, axis=1)
    if draws.shape[1] < 1 or not np.isfinite(draws).all():
        return None
    variance, axes = np.linalg.eigh(np.atleast_2d(np.cov(draws.T)))
    kept = variance > THRESHOLDS.min_component**2 * variance[-1]
    weights = axes[:, kept].T
    return MtfConstraint(
        target=source.target,
        kind=source.kind,
        frequency=np.concatenate(frequencies),
        angle_rad=np.concatenate(angles),
        weights=weights,
        value=weights @ draws.mean(axis=0),
        sd=np.sqrt(variance[kept] + THRESHOLDS.model_sd**2),
        within=_excludes_halo(source, context),
    )


def _interpolate_draws(wanted: Array, frequency: Array, draws: Array) -> Array:
    """Values of drawn curves at wanted frequencies, shape (draw, wanted)."""
    right = np.clip(np.searchsorted(frequency, wanted), 1, len(frequency) - 1)
    share = (wanted - frequency[right - 1]) / (frequency[right] - frequency[right - 1])
    return draws[:, right - 1] * (1.0 - share) + draws[:, right] * share


def _single_value_constraint(source: ConstraintSource, context: Context) -> MtfConstraint | None:
    """One value of a curve without draws, that nearest to one half: how its errors go together is not known."""
    curve, angle_deg = source.curves[0]
    if curve.interval68 is None:
        return None
    values = np.interp(FREQUENCIES, curve.frequency_cy_per_px, curve.value)
    low, high = (np.interp(FREQUENCIES, curve.frequency_cy_per_px, line) for line in np.asarray(curve.interval68))
    best = int(np.argmin(np.abs(values - 0.5)))
    sd = (high[best] - low[best]) / (2.0 * HALF68_SD)
    return MtfConstraint(
        target=source.target,
        kind=source.kind,
        frequency=FREQUENCIES[best : best + 1] / pitches(source.kind, angle_deg, context),
        angle_rad=np.array([np.deg2rad(angle_deg)]),
        weights=np.ones((1, 1)),
        value=values[best : best + 1],
        sd=np.array([np.hypot(sd, THRESHOLDS.model_sd)]),
        within=_excludes_halo(source, context),
    )


def pitches(kind: str, angle_deg: float, context: Context) -> float:
    """Return the column pitches in the pixel of a curve: an edge that lies along rows is counted in row pitches."""
    return context.pitch_ratio if kind == "edge" and is_vertical(angle_deg) else 1.0


def is_vertical(angle_deg: float) -> bool:
    """Tell whether a direction is nearer to the columns' than to the rows'."""
    return abs((angle_deg % 180.0) - 90.0) < 45.0


def _excludes_halo(source: ConstraintSource, context: Context) -> bool:
    """Whether an edge's window is narrower than the camera's halo, so that its light is all the light there is."""
    if context.sensor is None or source.kind != "edge" or source.of.region is None:
        return False
    from charact.mtf.known_transfer import halo_diameters_px

    transposed = is_vertical(source.of.orientation_deg or 0.0)
    across = source.of.region[2 if transposed else 3]
    return across < 1.2 * halo_diameters_px(context, transposed=transposed)[1]


def _bar_constraint(m: Measurement) -> MtfConstraint:
    low, high = m.interval68 or (np.nan, np.nan)
    return MtfConstraint(
        target=m.stack or "bars",
        kind="bars",
        frequency=np.array([m.frequency_cy_per_px]),
        angle_rad=np.array([np.deg2rad(m.orientation_deg or 0.0)]),
        weights=np.ones((1, 1)),
        value=np.array([m.value]),
        sd=np.array([np.hypot((high - low) / (2.0 * HALF68_SD), THRESHOLDS.model_sd)]),
    )


def _post_gain_curves(result: Result) -> Iterator[tuple[str, Curve]]:
    if all(m.status == "ok" for m in result.find("post_gain_mtf50")):
        yield from ((name, result.curves[name]) for name in POST_GAIN if name in result.curves)


def _post_gain_bound(curve: Curve, angle_deg: float, context: Context) -> MtfConstraint | None:
    """The transfer behind the gain where it is nearest to one half: the whole MTF cannot lie above it."""
    if curve.interval68 is None:
        return None
    inside = curve.frequency_cy_per_px > 0
    best = int(np.argmin(np.where(inside, np.abs(curve.value - 0.5), np.inf)))
    low, high = np.asarray(curve.interval68)[:, best]
    return MtfConstraint(
        target="flats" if angle_deg == 0.0 else "flats, vertical",
        kind="noise spectrum",
        frequency=curve.frequency_cy_per_px[best : best + 1] / (context.pitch_ratio if angle_deg else 1.0),
        angle_rad=np.array([np.deg2rad(angle_deg)]),
        weights=np.ones((1, 1)),
        value=curve.value[best : best + 1],
        sd=np.array([np.hypot((high - low) / (2.0 * HALF68_SD), THRESHOLDS.model_sd)]),
    )
