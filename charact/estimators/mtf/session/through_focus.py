"""Best focus of a series of targets: MTF50 against the position of the focus.

    m(z)^p = a + b z + c z^2,  best focus z0 = -b / (2 c)

p = 1: a parabola; p = -1: a Lorentzian, m0 / (1 + ((z - z0) / w)^2); p = -2: the blur of defocus
added to the others in squares, as of Gaussians. Each is linear in its parameters; they are weighted
by their likelihood, as they have as many of them.
"""

from collections.abc import Mapping
from itertools import groupby

import numpy as np

import charact
from charact.estimators.mtf.session.constraints import sources
from charact.estimators.mtf.session.thresholds import FOCUS, HALF68_SD
from charact.inference.gauss_newton import weigh_by_evidence
from charact.method import Context
from labdata import Array, Conditions, Provenance, Result, make_refusal
from labdata.measurement import QUANTILES, measurement_from_draws

METHOD = "through-focus"


def through_focus(
    result: Result,
    kinds: Mapping[str, str],
    conditions: Mapping[str, Conditions],
    context: Context,
) -> Result:
    """Return the best focus of edges, and of points, along each direction, with its figure.

    `result`: MTF50 of targets; `kinds`, `conditions`: of each target by its label. A target whose
    MTF50 is not ok is left out.
    """
    along = {0: "along rows", 1: "along columns"}
    rows = sorted(
        (
            (source.kind, abs(((source.of.orientation_deg or 0.0) + 90.0) % 180.0 - 90.0) > 45.0),
            (focus_mm, source.of.value or 0.0, (high - low) / (2.0 * HALF68_SD)),
        )
        for source in sources(result, kinds)
        if (focus_mm := conditions[source.target].focus_mm) is not None
        for low, high in [source.of.interval68 or (0.0, 0.0)]
    )
    found = Result()
    for (kind, vertical), group in groupby(rows, key=lambda row: row[0]):
        position, mtf50, sd = np.array([row[1] for row in group]).T
        found += _best_focus(position, mtf50, sd, f"{kind} {along[vertical]}", context)
    return found


def _best_focus(position: Array, mtf50: Array, sd: Array, series: str, context: Context) -> Result:
    """Return the best focus of one series, or the refusal."""
    provenance = Provenance(version=charact.__version__, seed=context.seed)
    fields = {"method": METHOD, "provenance": provenance}
    figure = {
        "figure": "through-focus",
        "focus_mm": position.tolist(),
        "mtf50_cy_per_px": mtf50.tolist(),
        "sd_cy_per_px": sd.tolist(),
    }
    shown, ends = {f"focus:{series}": figure}, position[[0, -1]]

    def refused(reason: str) -> Result:
        reason = f"{series}: a series through focus must {reason}"
        refusal = make_refusal("best_focus", "mm", reason, **fields)
        return Result(measurements=(refusal,), evidence=shown)

    if (count := np.unique(position).size) < FOCUS.positions:
        return refused(f"have {FOCUS.positions} positions of focus, got {count}")
    if (sharpest := position[np.argmax(mtf50)]) in ends:
        return refused(f"pass its best focus, got the sharpest at its end, {sharpest:g} mm")
    grid = np.linspace(ends[0], ends[1], FOCUS.points)
    best, curves, spread = _draw(position, mtf50, sd, grid, context.seed)
    inside = (best > ends[0]) & (best < ends[1])
    if (certainty := float(np.mean(inside))) < QUANTILES[-1]:
        return refused(f"have its peak in the range, got a probability of {certainty:.2f}")
    low, middle, high = np.quantile(curves, (QUANTILES[0], 0.5, QUANTILES[-1]), axis=0)
    figure |= {"grid_mm": grid.tolist(), "value": middle.tolist()}
    figure |= {"interval95": [low.tolist(), high.tolist()]}
    note = f"{series}: MTF50 {middle.max():.3g} cy/px there; {len(position)} targets, {spread}."
    number = measurement_from_draws("best_focus", "mm", best[inside], notes=(note,), **fields)
    return Result(measurements=(number,), evidence=shown)


def _draw(
    position: Array, mtf50: Array, sd: Array, grid: Array, seed: int
) -> tuple[Array, Array, str]:
    """Return draws of the best focus, shape (draw,), and of MTF50 on a grid, shape (draw, grid),
    and how the targets scatter about the curve.
    """
    centre, half = position.mean(), 0.5 * np.ptp(position)
    design, on_grid = (np.vander((z - centre) / half, 3, increasing=True) for z in (position, grid))
    fits = []
    for power in FOCUS.powers:
        slope = abs(power) * mtf50 ** (power - 1.0) * sd
        root, *_ = np.linalg.lstsq(design / slope[:, None], np.eye(len(position)), rcond=None)
        theta = root @ (mtf50**power / slope)
        model = np.maximum(design @ theta, 1e-12) ** (1.0 / power)
        fits.append((float(np.sum(((mtf50 - model) / sd) ** 2)), power, theta, root))
    # Targets scatter by more than their noise where the focus is not exact.
    scatter = max(min(fits)[0] / (len(position) - 3), 1.0)
    rng, best, curves = np.random.default_rng([seed, 37]), [], []
    weights = weigh_by_evidence([-0.5 * chi2 / scatter for chi2, *_ in fits])
    for number, weight in weights:
        _, power, theta, root = fits[number]
        noise = rng.standard_normal((round(weight * FOCUS.draws), len(position)))
        drawn = theta + np.sqrt(scatter) * noise @ root.T
        # A curve of the other sign has no peak.
        curvature = np.where(power * drawn[:, 2] < 0.0, drawn[:, 2], np.nan)
        best.append(centre - half * drawn[:, 1] / (2.0 * curvature))
        curves.append(np.maximum(drawn @ on_grid.T, 1e-12) ** (1.0 / power))
    names = dict(zip(FOCUS.powers, ("a parabola", "a Lorentzian", "blurs in squares"), strict=True))
    chosen = names[fits[weights[0][0]][1]]
    text = f"{chosen}, scatter {np.sqrt(scatter):.2g} times the noise"
    return np.concatenate(best), np.concatenate(curves), text
