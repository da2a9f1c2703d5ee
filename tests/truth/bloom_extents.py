"""What should be found of a point source far too bright: extents of its noiseless picture, and of
its light.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tests.truth.bloom import noiseless_frame
from tests.truth.bloom_light import (
    GLARE_SIDE_PX,
    BloomScene,
    halo_share_between,
    optics_of,
    radial_halo,
    radial_light,
)

Array = NDArray[np.float64]

# Farthest radius at which the light is summed, and step of the sum, px.
FAR_PX, STEP_PX = 200.0, 0.1
# Parts of a pixel that count by themselves where a contour has no closed form.
PARTS = 4
# The halo's plateau and its rim, in radii of the halo.
PLATEAU, RIM = (0.3, 0.7), (0.75, 1.1)


def truth(scene: BloomScene, overload: float, *, faintest: float | None = None) -> dict[str, float]:
    """Return what should be found, by the names of the quantities, for a source that stands still.

    `faintest` is that of `tests.truth.bloom.stack`. Diameters (column pitches; 0: not
    reached) are those of the connected region around the source; encircled radii are of the linear
    light without glare, fractions of the light that falls on the frame.
    """
    picture = noiseless_frame(scene, overload, faintest=faintest)
    # The picture before wells overflow.
    unspilled = picture
    if (
        scene.full_well_dn is not None
        and (picture - scene.dark_dn >= 0.999 * scene.full_well_dn).any()
    ):
        unspilled = noiseless_frame(replace(scene, full_well_dn=None), overload)
    half = scene.dark_dn + 0.5 * scene.span_dn
    levels = {
        "bloom_diameter": half,
        "bloom_diameter_background": scene.dark_dn + 2.0 * scene.background_dn,
        "bloom_diameter_clip": scene.full_scale_dn - 0.5,
    }
    return {
        **{
            name: _diameter(scene, overload, level, picture, unspilled)
            for name, level in levels.items()
        },
        "streak_length": float((picture[:, round(scene.centre[1])] >= half).sum()),
        "saturated_area": float(_around(picture >= scene.full_scale_dn - 0.5, scene.centre).sum()),
        "bloom_ellipticity": _ellipticity(scene, picture, half, unspilled),
        "core_compression": _compression(scene, overload),
        "smear_fraction": scene.smear_fraction,
        **_halo_truth(scene),
        **{
            f"encircled_radius_{percent:.0f}": _radius_of_energy(scene, percent / 100.0)
            for percent in (50.0, 90.0)
        },
    }


def _diameter(
    scene: BloomScene, overload: float, level_dn: float, picture: Array, unspilled: Array
) -> float:
    """Diameter of the circle of equal area to the connected region around the source, column
    pitches.
    """
    if _is_round(scene, picture is not unspilled):
        radius, density = _radial(optics_of(scene))
        light = (
            scene.row_pitch
            * scene.source_dn(overload)
            * (density + scene.glare_fraction / GLARE_SIDE_PX**2)
        )
        over = np.log(
            np.maximum(light, 1e-300) / max(level_dn - scene.dark_dn - scene.background_dn, 1e-9)
        )
        last = int(np.argmax(over < 0)) - 1
        if over[0] < 0:
            return 0.0
        row, col = scene.centre
        to_border = min(
            row * scene.row_pitch,
            (scene.rows - 1 - row) * scene.row_pitch,
            col,
            scene.cols - 1 - col,
        )
        if last >= 0 and radius[last + 1] < to_border:
            return float(
                2.0 * (radius[last] + STEP_PX * over[last] / (over[last] - over[last + 1]))
            )
    area = _region(scene, picture, level_dn, unspilled).sum() / PARTS**2 * scene.row_pitch
    return float(2.0 * np.sqrt(area / np.pi))


@lru_cache(maxsize=64)
def _radial(optics: BloomScene) -> tuple[Array, Array]:
    """Radii and light of a source of volume 1."""
    radius = np.arange(0.0, FAR_PX, STEP_PX)
    return radius, radial_light(optics, radius)


def _is_round(scene: BloomScene, overflows: bool) -> bool:
    """Whether nothing but the light shapes the picture."""
    shaped = scene.second_distance_px is not None or overflows
    return not (
        shaped or scene.plate_saturation_dn is not None or scene.smear_fraction > 0 or scene.agc
    )


def _region(
    scene: BloomScene, picture: Array, level_dn: float, unspilled: Array
) -> NDArray[np.bool_]:
    """Parts of pixels at or above a level that hang together with the source.

    Between pixels the log is smooth; pixels that charge reached along their column count as wholes.
    """
    from scipy import ndimage

    log = np.log(np.maximum(unspilled - scene.dark_dn, 1e-6))
    fine = np.asarray(ndimage.zoom(log, PARTS, order=3, mode="nearest", grid_mode=True))
    reached = (picture >= level_dn) & (picture > unspilled)
    mask = (fine >= np.log(max(level_dn - scene.dark_dn, 1e-6))) | np.kron(
        reached, np.ones((PARTS, PARTS), bool)
    )
    row, col = scene.centre
    return _around(mask, (PARTS * (row + 0.5) - 0.5, PARTS * (col + 0.5) - 0.5))


def _around(mask: NDArray[np.bool_], centre: tuple[float, float]) -> NDArray[np.bool_]:
    """The part of a mask that hangs together with a place."""
    from scipy import ndimage

    labels = np.asarray(ndimage.label(mask)[0])  # pyright: ignore[reportIndexIssue]
    row, col = (
        min(max(round(at), 0), size - 1) for at, size in zip(centre, labels.shape, strict=True)
    )
    return (labels == labels[row, col]) & mask


def _ellipticity(scene: BloomScene, picture: Array, level_dn: float, unspilled: Array) -> float:
    """Minor over major axis of the ellipse with the region's second moments; nan without a region.

    A round source that runs into the border is called round.
    """
    if _is_round(scene, picture is not unspilled):
        return 1.0
    down, along = np.nonzero(_region(scene, picture, level_dn, unspilled))
    if len(down) < 2:
        return float("nan")
    low, high = np.linalg.eigvalsh(np.cov(scene.row_pitch * down, along))
    return float(np.sqrt(low / high))


def _compression(scene: BloomScene, overload: float) -> float:
    """Light inside four standard deviations of the core over that of a camera without MCP
    saturation.
    """
    if scene.plate_saturation_dn is None:
        return 1.0
    linear_sensor = replace(scene, full_well_dn=None, smear_fraction=0.0, agc=False)
    saturated, unsaturated = (
        noiseless_frame(plate, overload)
        for plate in (linear_sensor, replace(linear_sensor, plate_saturation_dn=None))
    )
    rows, cols = np.indices(saturated.shape)
    radius = np.hypot((rows - scene.centre[0]) * scene.row_pitch, cols - scene.centre[1])
    # Radius that holds the core, in its standard deviations.
    core, dark = radius < 4.0 * scene.core_sigma_px, scene.dark_dn + scene.background_dn
    return float((saturated[core] - dark).sum() / (unsaturated[core] - dark).sum())


def _halo_truth(scene: BloomScene) -> dict[str, float]:
    """Numbers of the halo and of the glare, as fractions of the light that falls on the frame.

    The plateau is that of the halo before any blur; the rim that of the blurred one over it.
    """
    glare = scene.glare_fraction * min(
        1.0, scene.rows * scene.row_pitch * scene.cols / GLARE_SIDE_PX**2
    )
    on_frame = 1.0 - scene.glare_fraction + glare
    shares = {
        "veiling_glare": 100.0 * glare / on_frame,
        "halo_fraction": scene.halo_fraction / on_frame,
    }
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
    """Return the mean density of the halo's light between 0.3 and 0.7 of its radius, before any
    blur.
    """
    first, last = (0.5 * scene.halo_diameter_px * radius_fraction for radius_fraction in PLATEAU)
    return halo_share_between(*PLATEAU, scene.halo_elastic_share) / (np.pi * (last**2 - first**2))


def _radius_of_energy(scene: BloomScene, fraction: float) -> float:
    """Radius that holds a share of the light without glare, column pitches; inf beyond 200 px."""
    radius, density = _radial(optics_of(scene))
    ring = 2.0 * np.pi * radius * density * STEP_PX / (1.0 - scene.glare_fraction)
    encircled = np.cumsum(ring) - 0.5 * ring
    return float(np.interp(fraction, encircled, radius, right=np.inf))
