"""Signal of clipped sources, estimated from the halo and wings around them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.posterior_psf import FrameGrid, PosteriorPsf, profiles, radial
from charact.frames.robust import robust_sd
from labdata import Array, Mask

Pixels = NDArray[np.int64]

# Maximum number of pixels in the fit of a group of sources, and minimum number of unclipped ones.
MOST_PIXELS, LEAST_PIXELS = 4000, 40
# Standard errors required for a source's signal.
SEEN = 5.0
# Maximum width of an overflow streak, px.
STREAK_PX = 7


@dataclass(frozen=True, kw_only=True)
class ClippedSource:
    """Source that the frame clips.

    `row`, `col`: centre, px; `shape`: "point" or "patch"; `region`, `illuminated_pixels`: flat
    indices of its clipped pixels, and of those assumed to be illuminated; `light_dn_px`: signal
    without glare, DN times pixels, of every draw of the PSF, shape (draw,), NaN where unknown;
    `reason`: refusal reason, empty where known.
    """

    row: float
    col: float
    shape: str
    region: Pixels
    illuminated_pixels: Pixels
    light_dn_px: Array
    reason: str = ""

    @property
    def has_known_signal(self) -> bool:
        """Whether its signal is known."""
        return not self.reason


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Pixels that determine the signal of a group of neighbouring sources; clipped ones (`floor`)
    as lower limits.
    """

    pixels: Pixels
    signal: Array
    sd: Array
    floor: Mask
    subsampling: int


@dataclass(frozen=True, kw_only=True)
class ClippedSourceFit:
    """Signal of the sources of a group, DN px, its standard uncertainty, and the misfit
    (median-based and rms).
    """

    light: Array
    sd: Array
    misfit: float
    rms: float


def find_clipped_sources(
    signal: NDArray,
    clipped: Mask,
    spread: PosteriorPsf,
    grid: FrameGrid,
    *,
    noise_dn: NDArray,
    clip_dn: float,
    rng: np.random.Generator,
) -> tuple[ClippedSource, ...]:
    """Find the clipped sources of a frame and estimate their signal for every draw of the PSF.

    `signal`: frame above dark, shape (row, col), DN, with its pixels' noise `noise_dn` and full
    scale `clip_dn`.
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial.distance import cdist

    regions = _regions(clipped)
    reach_px = 0.5 * float(np.median(spread.halo_diameter_px)) + 8.0
    middles = np.array([grid.middle(region) for region in regions]) * (grid.pitch_ratio, 1.0)
    count, group = connected_components(cdist(middles, middles) < 2 * reach_px, directed=False)
    out: list[ClippedSource] = []
    for group_number in range(count):
        group_regions, group_sources = (
            [regions[number] for number in np.flatnonzero(group == group_number)],
            [],
        )
        # First without the steep flank, where the core width matters; if the halo is too faint,
        # with all but noisy pixels.
        for margin in (4, 1):
            around = _surroundings(
                group_regions, signal, clipped, grid, reach_px, margin, noise_dn, clip_dn
            )
            group_sources = _sources(group_regions, spread, grid, around, rng)
            if all(source.has_known_signal for source in group_sources):
                break
        out += group_sources
    return tuple(out)


def _regions(clipped: Mask) -> list[Pixels]:
    """Pixels of every connected clipped region, flat indices."""
    from scipy import ndimage

    # Noise splits the rim of a clipped region: pixels within 2 px belong to one source.
    dilated = ndimage.binary_dilation(clipped, np.ones((5, 5), bool))
    labels = np.where(clipped, np.asarray(ndimage.label(dilated)[0]), 0)  # pyright: ignore[reportIndexIssue]
    pixels_by_label = ndimage.value_indices(labels, ignore_value=0)
    return [
        np.ravel_multi_index(region, clipped.shape) for _, region in sorted(pixels_by_label.items())
    ]  # pyright: ignore


def _surroundings(
    regions: list[Pixels],
    signal: NDArray,
    clipped: Mask,
    grid: FrameGrid,
    reach_px: float,
    margin: int,
    noise_dn: NDArray,
    clip_dn: float,
) -> Surroundings:
    """Select the unclipped pixels near any source of the group, and the clipped ones as lower
    limits.
    """
    from scipy import ndimage

    spoilt = np.asarray(
        ndimage.binary_dilation(clipped, np.ones((2 * margin + 1,) * 2, bool)), bool
    )
    for region in regions:
        spoilt[:, np.abs(np.arange(signal.shape[1]) - grid.middle(region)[1]) <= 2] = True
    shut = np.concatenate(regions)
    unclipped_pixels = np.flatnonzero(grid.within(shut, reach_px * (1.0 - 1e-12)) & ~spoilt)
    step = max(1, -(-len(unclipped_pixels) // MOST_PIXELS))
    unclipped_pixels, shut = (
        unclipped_pixels[::step],
        shut[:: max(1, len(shut) // (MOST_PIXELS // 4))],
    )
    pixels = np.concatenate([unclipped_pixels, shut])
    floor = np.arange(len(pixels)) >= len(unclipped_pixels)
    values = np.asarray(signal, float).ravel()[pixels]
    steep = np.where(floor, 0.0, np.hypot(*np.gradient(np.asarray(signal, float))).ravel()[pixels])
    # Relative PSF error well above the noise, 5 %, and position error on steep flanks, 0.25 px.
    sd = np.sqrt(noise_dn.ravel()[pixels] ** 2 + (0.05 * values) ** 2 + (0.25 * steep) ** 2)
    return Surroundings(
        pixels=pixels, signal=np.where(floor, clip_dn, values), sd=sd, floor=floor, subsampling=step
    )


def _sources(
    regions: list[Pixels],
    spread: PosteriorPsf,
    grid: FrameGrid,
    around: Surroundings,
    rng: np.random.Generator,
) -> list[ClippedSource]:
    """Sources of one group with their signal, from given surroundings."""
    unknown = np.full(len(spread), np.nan)
    halo_px = 0.5 * float(np.median(spread.halo_diameter_px))
    shapes = [_possible_shape(region, around, grid, halo_px) for region in regions]
    sources = [
        ClippedSource(
            row=row,
            col=col,
            shape=shape or "point",
            region=region,
            illuminated_pixels=region,
            light_dn_px=unknown,
        )
        for (row, col), shape, region in zip(
            map(grid.middle, regions), shapes, regions, strict=True
        )
    ]
    reason = _reason(regions, shapes, around, grid)
    if not reason:
        sources, reason = _choose_shapes(sources, spread.centre(), grid, around)
    if reason:
        return [replace(source, reason=reason) for source in sources]
    known = profiles(spread), spread.transfer(grid.frequency)
    fits = [
        _fit(_templates(sources, known, draw, grid, around), around) for draw in range(len(spread))
    ]
    light = np.array([fit.light + fit.sd * rng.standard_normal(len(fit.light)) for fit in fits])
    clear = np.median([fit.light / np.maximum(fit.sd, 1e-12) for fit in fits], axis=0)
    return [
        replace(source, light_dn_px=np.maximum(of, 0.0))
        if significance >= SEEN
        else replace(
            source,
            reason=(
                f"its halo is {significance:.1f} standard errors above its surroundings, at least "
                f"{SEEN:g} needed"
            ),
        )
        for source, of, significance in zip(sources, light.T, clear, strict=True)
    ]


def _possible_shape(region: Pixels, around: Surroundings, grid: FrameGrid, halo_px: float) -> str:
    """Possible shape: a point if its halo is visible, a patch if it is wider than a halo."""
    within_halo = grid.distance(*grid.middle(region), around.pixels[~around.floor]) < halo_px - 2.0
    if within_halo.sum() * around.subsampling >= LEAST_PIXELS:
        return "point"
    from scipy import ndimage

    mask, _ = _mask_of(region, grid, 0)
    down, across = np.nonzero(ndimage.binary_opening(mask, np.ones((STREAK_PX, STREAK_PX), bool)))
    longest = max((np.ptp(down) + 1) * grid.pitch_ratio, np.ptp(across) + 1) if len(down) else 0.0
    return "patch" if longest > 1.3 * 2.0 * halo_px else ""


def _reason(regions: list[Pixels], shapes: list[str], around: Surroundings, grid: FrameGrid) -> str:
    """Refusal reason for a group, or an empty string."""
    rows, cols = np.divmod(np.concatenate(regions), grid.shape[1])
    if (
        (rows == 0) | (cols == 0) | (rows == grid.shape[0] - 1) | (cols == grid.shape[1] - 1)
    ).any():
        return "it touches the border of the frame"
    if (count := int((~around.floor).sum())) < LEAST_PIXELS:
        return f"only {count} pixels around it are unclipped, at least {LEAST_PIXELS} needed"
    return "" if all(shapes) else "all of its halo is clipped"


def _choose_shapes(
    sources: list[ClippedSource], centre: PosteriorPsf, grid: FrameGrid, around: Surroundings
) -> tuple[list[ClippedSource], str]:
    """Sources with the shapes that fit best, and a refusal reason where these are ambiguous or fit
    poorly.
    """
    known, reason = (profiles(centre), centre.transfer(grid.frequency)), ""
    best = _fit(_templates(sources, known, 0, grid, around), around)
    for index, source in enumerate(sources):
        point = best if source.shape == "point" else None
        for patch in _patches(source, grid):
            other = [*sources[:index], patch, *sources[index + 1 :]]
            patch_fit = _fit(_templates(other, known, 0, grid, around), around)
            if point is not None and _alike(point, patch_fit, index):
                reason = (
                    "its surroundings fit a point source with halo and a uniform patch about "
                    "equally well"
                )
            if patch_fit.rms < best.rms:
                sources, best = other, patch_fit
    if best.misfit > 2.5:
        reason = (
            f"its surroundings deviate from the PSF by {best.misfit:.1f} times the noise and "
            f"model error"
        )
    return sources, reason


def _alike(point: ClippedSourceFit, patch: ClippedSourceFit, index: int) -> bool:
    """Whether two shapes fit about equally well but differ in the source's signal."""
    low, high = sorted((point.light[index], patch.light[index]))
    better, worse = sorted((point.rms, patch.rms))
    return high > 1.3 * low and worse < 1.6 * max(better, 1.0)


def _patches(source: ClippedSource, grid: FrameGrid) -> Iterator[ClippedSource]:
    """Uniform patches as large as the clipped pixels and smaller, since blur clips pixels next to a
    bright patch.
    """
    from scipy import ndimage

    mask, (first, first_col) = _mask_of(source.region, grid, 1)
    for smaller in range(3):
        down, across = np.nonzero(
            ndimage.binary_erosion(mask, iterations=smaller) if smaller else mask
        )
        if len(down) < 9:
            return
        yield replace(
            source,
            shape="patch",
            illuminated_pixels=(down + first) * grid.shape[1] + across + first_col,
        )


def _mask_of(region: Pixels, grid: FrameGrid, margin: int) -> tuple[Mask, tuple[int, int]]:
    """Mask of a region's bounding box with a margin, and its first row and column."""
    rows, cols = np.divmod(region, grid.shape[1])
    first, first_col = int(rows.min()) - margin, int(cols.min()) - margin
    mask = np.zeros((np.ptp(rows) + 1 + 2 * margin, np.ptp(cols) + 1 + 2 * margin), bool)
    mask[rows - first, cols - first_col] = True
    return mask, (first, first_col)


def _templates(
    sources: list[ClippedSource],
    tables: tuple[Array, Array],
    draw: int,
    grid: FrameGrid,
    around: Surroundings,
) -> Array:
    """Signal of one unit of every source in the surrounding pixels, shape (pixel, source)."""
    laid = [
        radial(grid.distance(source.row, source.col, around.pixels), tables[0][draw])
        * grid.pitch_ratio
        if source.shape == "point"
        else grid.patch(source.illuminated_pixels, tables[1][draw]).ravel()[around.pixels]
        for source in sources
    ]
    return np.stack(laid, axis=1).astype(np.float64)


def _fit(templates: Array, around: Surroundings) -> ClippedSourceFit:
    """Weighted least squares with a common background; a clipped pixel counts only where the model
    is below full scale.

    Residuals beyond two standard deviations are down-weighted (Huber), since a scene has other
    content.
    """
    design = np.concatenate([templates, np.ones((len(templates), 1))], axis=1)
    scale = np.abs(design).max(axis=0)
    weight, best = ~around.floor / around.sd, np.zeros(design.shape[1])
    for _ in range(8):
        best = np.linalg.lstsq(
            design / scale * weight[:, None], around.signal * weight, rcond=None
        )[0]
        pull = (design / scale @ best - around.signal) / around.sd
        counted = ~around.floor | (pull < 0)
        weight = (
            counted / around.sd * np.minimum(1.0, np.sqrt(2.0 / np.maximum(np.abs(pull), 1e-9)))
        )
    # Up to half of the pixels may show other content of the scene.
    misfit = robust_sd(pull[counted], 0.0)
    rms = float(np.sqrt(np.mean(np.minimum(pull[counted] ** 2, 100.0))))
    weighted = design / scale * weight[:, None]
    # About ten pixels have correlated noise.
    covariance = np.linalg.pinv(weighted.T @ weighted) * 10.0 * max(misfit, 0.3) ** 2
    return ClippedSourceFit(
        light=(best / scale)[:-1],
        sd=(np.sqrt(np.diag(covariance)) / scale)[:-1],
        misfit=misfit,
        rms=rms,
    )
