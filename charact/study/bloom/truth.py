"""What should be found of a point source far too bright: extents of its noiseless picture, and of its light."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from charact.study.bloom.camera import noiseless_frame
from charact.study.bloom.light import halo_share_between
from charact.study.bloom.source import GLARE_SIDE_PX, BloomScene, optics_of, radial_halo, radial_light

Array = NDArray[np.float64]

# Farthest radius at which the light is summed, and step of the sum, px.
FAR_PX, STEP_PX = 200.0, 0.1
# Parts of a pixel that count by themselves where a contour has no closed form.
PARTS = 4
# The halo's plateau and its rim, in radii of the halo.
PLATEAU, RIM = (0.3, 0.7), (0.75, 1.1)
# Radius that holds the core, in its standard deviations.
CORE_SIGMAS = 4.0


def truth(scene: BloomScene, overload: float, *, faintest: float | None = None) -> dict[str, float]:
    """Return what should be found, by the names of the quantities, for a source that stands still.

    `scene`, `overload`: the source and its level; `faintest`: as of `charact.study.bloom.camera.stack`.

    Returns `bloom_diameter`, `bloom_diameter_background`, `bloom_diameter_clip` (column pitches; 0: not reached): of
    the connected region around the source at half of full scale, at twice the background, and at the highest code;
    `streak_length` (rows of its column at half of full scale), `overflow_length` (rows filled to the limit),
    `saturated_area` (whole pixels that hang together with the source), `bloom_ellipticity` (of the region at half of
    full scale), `halo_diameter`, `halo_fraction`, `halo_plateau`, `halo_rim`, `encircled_radius_50`,
    `encircled_radius_90` (of the linear light without glare), `core_compression`, `veiling_glare` (%),
    `smear_fraction`. Shares are of the light that falls on the frame.
    """
    picture = noiseless_frame(scene, overload, faintest=faintest)
    half = scene.dark_dn + 0.5 * scene.span_dn
    levels = {
        "bloom_diameter": half,
        "bloom_diameter_background": scene.dark_dn + 2.0 * scene.background_dn,
        "bloom_diameter_clip": scene.full_scale_dn - 0.5,
    }
    column = picture[:, round(scene.centre[1])]
    limit = np.inf if scene.full_well_dn is None else scene.full_well_dn * scene.drain_ratio
    return {
        **{name: diameter(scene, overload, level, picture) for name, level in levels.items()},
        "streak_length": float((column >= half).sum()),
        "overflow_length": float((column - scene.dark_dn >= 0.999 * limit).sum()),
        "saturated_area": _pixels(scene, picture, scene.full_scale_dn - 0.5),
        "bloom_ellipticity": _ellipticity(scene, picture, half, _dry(scene, overload, picture)),
        "core_compression": _compression(scene, overload),
        "smear_fraction": scene.smear_fraction,
        **halo_truth(scene),
        **{f"encircled_radius_{share:.0f}": _radius_of_energy(scene, share / 100.0) for share in (50.0, 90.0)},
    }


def diameter(scene: BloomScene, overload: float, level_dn: float, picture: Array) -> float:
    """Return the diameter of the circle of equal area to the connected region around the source, column pitches."""
    if _is_round(scene, picture):
        radius, density = _radial(optics_of(scene))
        light = scene.row_pitch * scene.source_dn(overload) * (density + scene.glare_fraction / GLARE_SIDE_PX**2)
        over = np.log(np.maximum(light, 1e-300) / max(level_dn - scene.dark_dn - scene.background_dn, 1e-9))
        last = int(np.argmax(over < 0)) - 1
        if over[0] < 0:
            return 0.0
        if last >= 0 and radius[last + 1] < _to_border(scene):
            return float(2.0 * (radius[last] + STEP_PX * over[last] / (over[last] - over[last + 1])))
    return diameter_of_picture(scene, level_dn, picture, _dry(scene, overload, picture))


def diameter_of_picture(scene: BloomScene, level_dn: float, picture: Array, dry: Array | None = None) -> float:
    """Return that diameter of any picture of the scene, by parts of its pixels; `dry` is it before wells overflow."""
    area = _region(scene, picture, level_dn, dry).sum() / PARTS**2 * scene.row_pitch
    return float(2.0 * np.sqrt(area / np.pi))


@lru_cache(maxsize=64)
def _radial(optics: BloomScene) -> tuple[Array, Array]:
    """Radii and light of a source of volume 1."""
    radius = np.arange(0.0, FAR_PX, STEP_PX)
    return radius, radial_light(optics, radius)


def _to_border(scene: BloomScene) -> float:
    """Distance of the source from the nearest border of the frame, column pitches."""
    row, col = scene.centre
    down = min(row, scene.rows - 1 - row) * scene.row_pitch
    return float(min(down, col, scene.cols - 1 - col))


def _is_round(scene: BloomScene, picture: Array) -> bool:
    """Whether nothing but the light shapes the picture."""
    wrong = scene.second_distance_px is not None or bool(_full(scene, picture).any())
    return not (wrong or scene.plate_saturation_dn is not None or scene.smear_fraction > 0 or scene.agc)


def _full(scene: BloomScene, picture: Array) -> NDArray[np.bool_]:
    """Pixels filled to the brim."""
    if scene.full_well_dn is None:
        return np.zeros(picture.shape, bool)
    return picture - scene.dark_dn >= 0.999 * scene.full_well_dn * scene.drain_ratio


def _dry(scene: BloomScene, overload: float, picture: Array) -> Array:
    """The picture before wells overflow."""
    return noiseless_frame(replace(scene, full_well_dn=None), overload) if _full(scene, picture).any() else picture


def _region(scene: BloomScene, picture: Array, level_dn: float, dry: Array | None) -> NDArray[np.bool_]:
    """Parts of pixels at or above a level that hang together with the source.

    Between pixels the log is smooth; pixels that charge reached along their column count as wholes.
    """
    from scipy import ndimage

    level, dry = np.log(max(level_dn - scene.dark_dn, 1e-6)), picture if dry is None else dry
    log = np.log(np.maximum(dry - scene.dark_dn, 1e-6))
    fine = np.asarray(ndimage.zoom(log, PARTS, order=3, mode="nearest", grid_mode=True))
    reached = (picture >= level_dn) & (picture > dry)
    above = (fine >= level) | np.kron(reached, np.ones((PARTS, PARTS), bool))
    labels = np.asarray(ndimage.label(above)[0])  # pyright: ignore[reportIndexIssue]
    row, col = (round(PARTS * (at + 0.5) - 0.5) for at in scene.centre)
    inside = 0 <= row < labels.shape[0] and 0 <= col < labels.shape[1]
    return (labels == labels[row, col]) & above if inside and labels[row, col] else np.zeros_like(above)


def _pixels(scene: BloomScene, picture: Array, level_dn: float) -> float:
    """Pixels at or above a level that hang together with that of the source."""
    from scipy import ndimage

    labels = np.asarray(ndimage.label(picture >= level_dn)[0])  # pyright: ignore[reportIndexIssue]
    row, col = (min(max(round(at), 0), size - 1) for at, size in zip(scene.centre, labels.shape, strict=True))
    return float((labels == labels[row, col]).sum()) if labels[row, col] else 0.0


def _ellipticity(scene: BloomScene, picture: Array, level_dn: float, dry: Array) -> float:
    """Minor over major axis of the ellipse with the region's second moments; nan without a region.

    A round source that runs into the border is called round.
    """
    if _is_round(scene, picture):
        return 1.0
    down, along = np.nonzero(_region(scene, picture, level_dn, dry))
    if len(down) < 2:
        return float("nan")
    low, high = np.linalg.eigvalsh(np.cov(scene.row_pitch * down, along))
    return float(np.sqrt(low / high))


def _compression(scene: BloomScene, overload: float) -> float:
    """Light inside four standard deviations of the core over that of a camera without MCP saturation."""
    if scene.plate_saturation_dn is None:
        return 1.0
    calm = replace(scene, full_well_dn=None, smear_fraction=0.0, agc=False)
    saturated, unsaturated = (noiseless_frame(one, overload) for one in (calm, replace(calm, plate_saturation_dn=None)))
    row, col = scene.centre
    down = (np.arange(scene.rows) - row)[:, None] * scene.row_pitch
    near = np.hypot(down, (np.arange(scene.cols) - col)[None, :]) < CORE_SIGMAS * scene.core_sigma_px
    dark = scene.dark_dn + scene.background_dn
    return float((saturated[near] - dark).sum() / (unsaturated[near] - dark).sum())


def halo_truth(scene: BloomScene) -> dict[str, float]:
    """Return the numbers of the halo and of the glare, as shares of the light that falls on the frame.

    The plateau is that of the halo before any blur; the rim that of the blurred one over it.
    """
    glare = scene.glare_fraction * min(1.0, scene.rows * scene.row_pitch * scene.cols / GLARE_SIDE_PX**2)
    seen = 1.0 - scene.glare_fraction + glare
    shares = {"veiling_glare": 100.0 * glare / seen, "halo_fraction": scene.halo_fraction / seen}
    if scene.halo_fraction <= 0:
        return shares
    half, plateau = 0.5 * scene.halo_diameter_px, plateau_per_px2(scene)
    rim = radial_halo(scene, np.arange(RIM[0] * half, RIM[1] * half, STEP_PX)).max()
    return shares | {
        "halo_diameter": scene.halo_diameter_px,
        "halo_plateau": shares["halo_fraction"] * plateau,
        "halo_rim": float(rim) / plateau,
    }


def plateau_per_px2(scene: BloomScene) -> float:
    """Return the mean density of the halo's light between 0.3 and 0.7 of its radius, before any blur."""
    first, last = (0.5 * scene.halo_diameter_px * share for share in PLATEAU)
    share = halo_share_between(*PLATEAU, scene.halo_elastic_share)
    return share / (np.pi * (last**2 - first**2))


def _radius_of_energy(scene: BloomScene, share: float) -> float:
    """Radius that holds a share of the light without glare, column pitches; inf beyond 200 px."""
    radius, density = _radial(optics_of(scene))
    ring = 2.0 * np.pi * radius * density * STEP_PX / (1.0 - scene.glare_fraction)
    held = np.cumsum(ring) - 0.5 * ring
    return float(np.interp(share, held, radius, right=np.inf))
