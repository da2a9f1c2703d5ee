"""Constraints that the targets of a session place on one MTF.

A curve drawn from a posterior of two or three parameters contains two or three independent numbers,
whatever the number of frequencies. They are its principal components, with their standard
uncertainties.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from charact.estimators.mtf.session.thresholds import HALF68_SD, THRESHOLDS
from charact.method import Context
from labdata import Array
from labdata.camera.description import has_tube
from labdata.measurement import Curve, Interval, Measurement, Result

# Frequencies at which curves are compared, cycles per pixel of the curve.
FREQUENCIES = np.arange(0.04, 0.481, 0.04)
POST_GAIN = {"mtf_post_gain": 0.0, "mtf_post_gain_vertical": 90.0}


@dataclass(frozen=True, kw_only=True)
class MtfConstraint:
    """Combinations of the MTF that one target measures, with standard uncertainties.

    Frequencies (f,) are cycles per column pitch; `weights` has the shape (combination, f);
    `excludes_halo`: normalised to a window narrower than the halo.
    """

    target: str
    kind: str
    frequency: Array
    angle_rad: Array
    weights: Array
    value: Array
    sd: Array
    excludes_halo: bool = False

    @classmethod
    def of_value(
        cls,
        target: str,
        kind: str,
        frequency: float,
        angle_deg: float,
        value: float,
        interval68: Interval,
        *,
        excludes_halo: bool = False,
    ) -> "MtfConstraint":
        """Return the constraint of one value of the MTF."""
        return cls(
            target=target,
            kind=kind,
            frequency=np.array([frequency]),
            angle_rad=np.array([np.deg2rad(angle_deg)]),
            weights=np.ones((1, 1)),
            value=np.array([value]),
            excludes_halo=excludes_halo,
            sd=np.array(
                [np.hypot((interval68[1] - interval68[0]) / (2.0 * HALF68_SD), THRESHOLDS.model_sd)]
            ),
        )

    def residual(self, mtf: Array) -> Array:
        """Return (value - model)/sd for MTFs at its frequencies, shape (n, f) -> (n,
        combination).
        """
        return (self.value - mtf @ self.weights.T) / self.sd


@dataclass(frozen=True, kw_only=True)
class ConstraintSource:
    """A valid MTF50 of an edge or point, with its curves and their directions in degrees."""

    target: str
    kind: str
    of: Measurement
    curves: tuple[tuple[Curve, float], ...]


def constraints_from(
    result: Result, kinds: Mapping[str, str], context: Context
) -> tuple[list[MtfConstraint], list[MtfConstraint]]:
    """Return the constraints of valid targets on the MTF, and the bounds by the post-gain MTF of
    flats.
    """
    curves = [
        constraint
        for source in sources(result, kinds)
        if (constraint := _curve_constraint(source, context)) is not None
    ]
    bars = [
        MtfConstraint.of_value(
            m.stack or "bars",
            "bars",
            m.frequency_cy_per_px or 0.0,
            m.orientation_deg or 0.0,
            m.value or 0.0,
            m.interval68 or (np.nan, np.nan),
        )
        for m in result.find("mtf")
        if _is_valid(m) and kinds.get(m.stack or "") == "bars"
    ]
    if any(m.status != "ok" for m in result.find("post_gain_mtf50")):
        return [*curves, *bars], []
    bounds = [
        _post_gain_bound(result.curves[name], angle, context)
        for name, angle in POST_GAIN.items()
        if name in result.curves
    ]
    return [*curves, *bars], [constraint for constraint in bounds if constraint is not None]


def sources(result: Result, kinds: Mapping[str, str]) -> Iterator[ConstraintSource]:
    """Yield every edge and point with a valid MTF50 and its curves."""
    visited = set()
    for m in result.find("mtf50"):
        kind = kinds.get(m.stack or "")
        if kind not in ("edge", "point") or not _is_valid(m) or (m.stack, m.region) in visited:
            continue
        visited.add((m.stack, m.region))
        region = "" if m.region is None else ":{},{},{},{}".format(*m.region)
        suffixes = (f":{m.stack}", f"{region}:{m.stack}", f":{m.stack}{region}")
        directions = {
            "mtf": 0.0 if kind == "point" else (m.orientation_deg or 0.0),
            "mtf_vertical": 90.0,
        }
        curve_of_name = {
            name: curve
            for name in directions
            for suffix in suffixes
            if (curve := result.curves.get(name + suffix)) is not None
        }
        if curve_of_name:
            curves = tuple((curve, directions[name]) for name, curve in curve_of_name.items())
            yield ConstraintSource(target=f"{m.stack}", kind=kind, of=m, curves=curves)


def _is_valid(m: Measurement) -> bool:
    return m.status == "ok" and m.value is not None and m.interval68 is not None


def _curve_constraint(source: ConstraintSource, context: Context) -> MtfConstraint | None:
    """Return the principal components of the curves of one target, taken together."""
    if any(curve.draws is None for curve, _ in source.curves):
        return _single_value_constraint(source, context)
    parts, frequencies, angles = [], [], []
    for curve, angle_deg in source.curves:
        values = interpolate_draws(FREQUENCIES, curve)
        is_measured = values.mean(axis=0) > THRESHOLDS.min_mtf
        parts.append(values[:, is_measured])
        frequencies.append(FREQUENCIES[is_measured] / pitches(source.kind, angle_deg, context))
        angles.append(np.full(int(is_measured.sum()), np.deg2rad(angle_deg)))
    draws = np.concatenate(parts, axis=1)
    if draws.shape[1] < 1 or not np.isfinite(draws).all():
        return None
    variance, axes = np.linalg.eigh(np.atleast_2d(np.cov(draws.T)))
    components = variance > THRESHOLDS.min_component**2 * variance[-1]
    weights = axes[:, components].T
    return MtfConstraint(
        target=source.target,
        kind=source.kind,
        frequency=np.concatenate(frequencies),
        angle_rad=np.concatenate(angles),
        weights=weights,
        value=weights @ draws.mean(axis=0),
        sd=np.sqrt(variance[components] + THRESHOLDS.model_sd**2),
        excludes_halo=_excludes_halo(source, context),
    )


def interpolate_draws(wanted: Array, curve: Curve) -> Array:
    """Return the draws of a curve at frequencies, shape (draw, frequency)."""
    assert curve.draws is not None
    frequency = curve.frequency_cy_per_px
    right = np.clip(np.searchsorted(frequency, wanted), 1, len(frequency) - 1)
    fraction = (wanted - frequency[right - 1]) / (frequency[right] - frequency[right - 1])
    return curve.draws[:, right - 1] * (1.0 - fraction) + curve.draws[:, right] * fraction


def _single_value_constraint(source: ConstraintSource, context: Context) -> MtfConstraint | None:
    """Return the value nearest to one half of a curve without draws, whose error correlation is
    unknown.
    """
    curve, angle_deg = source.curves[0]
    if curve.interval68 is None:
        return None
    lines = np.array(
        [
            np.interp(FREQUENCIES, curve.frequency_cy_per_px, line)
            for line in (curve.value, *curve.interval68)
        ]
    )
    best = int(np.argmin(np.abs(lines[0] - 0.5)))
    value, low, high = lines[:, best].tolist()
    frequency = FREQUENCIES[best] / pitches(source.kind, angle_deg, context)
    excludes_halo = _excludes_halo(source, context)
    return MtfConstraint.of_value(
        source.target,
        source.kind,
        frequency,
        angle_deg,
        value,
        (low, high),
        excludes_halo=excludes_halo,
    )


def pitches(kind: str, angle_deg: float, context: Context) -> float:
    """Return the column pitches in the pixel of a curve: an edge that lies along rows is counted in
    row pitches.
    """
    return context.pitch_ratio if kind == "edge" and is_vertical(angle_deg) else 1.0


def is_vertical(angle_deg: float) -> bool:
    """Whether a direction is nearer to the columns' than to the rows'."""
    return abs((angle_deg % 180.0) - 90.0) < 45.0


def _excludes_halo(source: ConstraintSource, context: Context) -> bool:
    """Whether an edge's window is narrower than the camera's halo, whose light is then not
    counted.
    """
    if not has_tube(context.camera) or source.kind != "edge" or source.of.region is None:
        return False
    from charact.estimators.mtf.known_transfer import halo_diameters_px

    transposed = is_vertical(source.of.orientation_deg or 0.0)
    across = source.of.region[2 if transposed else 3]
    return across < 1.2 * halo_diameters_px(context, transposed=transposed)[1]


def _post_gain_bound(curve: Curve, angle_deg: float, context: Context) -> MtfConstraint | None:
    """Return the post-gain MTF where it is nearest to one half: the whole MTF cannot lie above
    it.
    """
    if curve.interval68 is None:
        return None
    positive = curve.frequency_cy_per_px > 0
    best = int(np.argmin(np.where(positive, np.abs(curve.value - 0.5), np.inf)))
    low, high = np.asarray(curve.interval68)[:, best].tolist()
    frequency = curve.frequency_cy_per_px[best] / (context.pitch_ratio if angle_deg else 1.0)
    target = "flats, vertical" if angle_deg else "flats"
    return MtfConstraint.of_value(
        target, "noise spectrum", frequency, angle_deg, curve.value[best], (low, high)
    )
