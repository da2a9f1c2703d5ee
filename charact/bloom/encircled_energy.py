"""Radii that hold half and nine tenths of a source's light, summed over the rings of one frame that nothing cut."""

import numpy as np
from numpy.typing import NDArray

from charact.bloom.background import Background
from charact.bloom.extent import DRAWS
from charact.bloom.polar import SECTORS
from charact.bloom.source_view import SourceView

Array = NDArray[np.float64]

SHARES = (0.5, 0.9)
# Farthest ring that is summed, px: beyond it a halo has ended, and the background's error grows with the area.
REACH_PX = 45.0
# Within this radius the light is followed between pixels, in steps and directions, px.
NEAR_PX, STEP_PX, ANGLES = 12, 0.25, 48
# Share of full scale above which pixels may have been cut, and standard error of the whole light that is too much.
CUT_SHARE = 0.97
LEAST_KNOWN = 0.1


def ring_energy_radii(view: SourceView, background: Background, *, seed: int) -> dict[float, Array] | str:
    """Return draws of the radius that holds each of `SHARES`, column pitches; or why there are none.

    Parameters
    ----------
    view
        Mean frame as seen from the source.
    background
        Light that is not the source's.
    seed
        Seed of the draws.

    Notes
    -----
    The whole light is that inside the largest ring of the frame, or within `REACH_PX`: wings beyond are not counted,
    and the error of the background counts over the whole area.
    """
    top = float((view.signal[view.polar.radius < view.rings.radius[-1]]).max())
    if top > CUT_SHARE * view.top:
        return "the source's core is cut at the highest code, so that its light is not known: a fainter level tells it"
    if not background.even:
        return "the light still falls at the border of the frame: a wider frame holds the source's light"
    border = (view.polar.radius[edge].min() for edge in (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1]))
    rings = max(int(min(*border, REACH_PX)), 1)
    rng = np.random.default_rng(seed)
    rng = np.random.default_rng(seed)
    sd = view.noise.sd(view.profile[1]) / np.sqrt(view.noise.frames)
    area = np.diff(np.pi * np.arange(rings + 1.0) ** 2)
    mean = view.rings.mean()[:rings]
    noise = view.rings.draws(sd, DRAWS, rng, np.ones(SECTORS, bool))[:, :rings] - mean
    noise -= background.sd_dn * rng.standard_normal((DRAWS, 1))
    radius, held = _cumulative_light(view, mean - background.level_dn, area, background.level_dn)
    off = np.concatenate([np.zeros((DRAWS, 1)), np.cumsum(noise * area, axis=1)], axis=1)
    draws = held + np.array([np.interp(radius, np.arange(rings + 1.0), one) for one in off])
    whole = draws[:, -1]
    if np.std(whole) > LEAST_KNOWN * np.mean(whole):
        return (
            f"the source's light is known to {np.std(whole) / abs(np.mean(whole)):.0%} only: more frames would tell it"
        )
    return {share: np.array([_first(one / one[-1], radius, share) for one in draws]) for share in SHARES}


def _cumulative_light(view: SourceView, light: Array, area: Array, floor: float) -> tuple[Array, Array]:
    """Radii and the light inside them: near the source between pixels, by a cubic spline, and by rings beyond."""
    from scipy import ndimage

    near = min(NEAR_PX, len(light))
    fine = np.arange(0.0, near + STEP_PX / 2, STEP_PX)
    angle = 2.0 * np.pi * (np.arange(ANGLES) + 0.5) / ANGLES
    middle = fine[1:] - 0.5 * STEP_PX
    row, col = _centre(view)
    places = [row + middle[:, None] * np.sin(angle) / view.polar.row_pitch, col + middle[:, None] * np.cos(angle)]
    profile = ndimage.map_coordinates(view.signal, places, order=3, mode="nearest").mean(axis=1) - floor
    inner = np.concatenate([[0.0], np.cumsum(2.0 * np.pi * middle * STEP_PX * profile)])
    outer = inner[-1] + np.cumsum((light * area)[near:])
    return np.concatenate([fine, np.arange(near + 1.0, len(light) + 1.0)]), np.concatenate([inner, outer])


def _centre(view: SourceView) -> tuple[float, float]:
    """Where the view looks from, px."""
    return float(-view.polar.dy[0, 0] / view.polar.row_pitch), float(-view.polar.dx[0, 0])


def _first(held: Array, radius: Array, share: float) -> float:
    """Radius at which the light held first reaches a share; between radii it grows as the area."""
    at = max(int(np.argmax(held >= share)), 1)
    part = (share - held[at - 1]) / max(held[at] - held[at - 1], 1e-12)
    return float(np.sqrt(radius[at - 1] ** 2 + np.clip(part, 0.0, 1.0) * (radius[at] ** 2 - radius[at - 1] ** 2)))
