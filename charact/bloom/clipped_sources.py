"""Signal of clipped sources, estimated from the halo and wings around them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.posterior_psf import FrameGrid, PosteriorPsf, profiles

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Maximum number of pixels in the fit of a group of sources.
MOST_PIXELS = 4000


@dataclass(frozen=True, kw_only=True)
class Guess:
    """Assumed shape of a clipped source: a point at the centre of some pixels, or a uniform patch."""

    shape: str
    illuminated_pixels: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Pixels that determine the signal of a group of neighbouring sources."""

    places: NDArray[np.int64]
    signal: Array
    sd: Array
    floor: Array
    subsampling: int


def surroundings(
    regions: list[NDArray[np.int64]], signal: NDArray, clipped: Mask, lattice: FrameGrid, reach: float, margin: int,
    *, noise_dn: NDArray, clip_dn: float,
) -> Surroundings:  # fmt: skip
    """Select the unclipped pixels near any source of the group, and the clipped ones as lower limits."""
    from scipy import ndimage

    spoilt = np.asarray(ndimage.binary_dilation(clipped, np.ones((2 * margin + 1,) * 2, bool)), bool)
    away = np.ones(signal.shape, bool)
    for region in regions:
        _, col = lattice.middle(region)
        away.ravel()[region] = False
        spoilt[:, np.abs(np.arange(signal.shape[1]) - col) <= 2] = True
    near = np.asarray(ndimage.distance_transform_edt(away, sampling=(lattice.pitch_ratio, 1.0))) < reach
    open_px = np.flatnonzero(near & ~spoilt)
    step = -(-len(open_px) // MOST_PIXELS) if len(open_px) else 1
    open_px = open_px[::step]
    shut = np.concatenate(regions)
    shut = shut[:: max(1, len(shut) // (MOST_PIXELS // 4))]
    places = np.concatenate([open_px, shut])
    values = np.asarray(signal, float).ravel()[places]
    floor = np.concatenate([np.zeros(len(open_px), bool), np.ones(len(shut), bool)])
    steep = np.hypot(*np.gradient(np.asarray(signal, float))).ravel()[places] * (1.0 - floor.astype(float))
    # Relative PSF error well above the noise, 5 %, and position error on steep flanks, 0.25 px.
    sd = np.sqrt(noise_dn.ravel()[places] ** 2 + (0.05 * values) ** 2 + (0.25 * steep) ** 2)
    return Surroundings(places=places, signal=np.where(floor, clip_dn, values), sd=sd, floor=floor.astype(float),
                        subsampling=step)  # fmt: skip


def tables(spread: PosteriorPsf, lattice: FrameGrid) -> tuple[Array, Array]:
    """PSF against distance and transfer function against frequency, of every draw."""
    return profiles(spread), spread.transfer(lattice.frequency)


def templates(
    guesses: list[Guess], tables: tuple[Array, Array], draw: int, lattice: FrameGrid, around: Surroundings
) -> Array:
    """Signal of one unit of every source in the surrounding pixels, shape (pixel, source)."""
    laid = [
        lattice.point_image(lattice.middle(guess.illuminated_pixels), tables[0][draw], around.places)
        if guess.shape == "point"
        else lattice.patch(guess.illuminated_pixels, tables[1][draw]).ravel()[around.places]
        for guess in guesses
    ]
    return np.stack(laid, axis=1).astype(np.float64)


@dataclass(frozen=True, kw_only=True)
class ClippedSourceFit:
    """Signal of the sources of a group, DN px, its standard uncertainty, and the misfit (median-based and rms)."""

    light: Array
    sd: Array
    misfit: float
    rms: float


def fit(templates: Array, around: Surroundings) -> ClippedSourceFit:
    """Weighted least squares with a common background; a clipped pixel counts only where the model is below full scale.

    Residuals beyond two standard deviations are down-weighted (Huber), since a scene has other content.
    """
    design = np.concatenate([templates, np.ones((len(templates), 1))], axis=1)
    scale = np.abs(design).max(axis=0)
    weight = (around.floor == 0) / around.sd
    best = np.zeros(design.shape[1])
    for _ in range(8):
        best = np.linalg.lstsq(design / scale * weight[:, None], around.signal * weight, rcond=None)[0]
        pull = (design / scale @ best - around.signal) / around.sd
        counted = (around.floor == 0) | (pull < 0)
        weight = counted / around.sd * np.minimum(1.0, np.sqrt(2.0 / np.maximum(np.abs(pull), 1e-9)))
    # Up to half of the pixels may show other content of the scene.
    misfit = 1.4826 * float(np.median(np.abs(pull[counted])))
    rms = float(np.sqrt(np.mean(np.minimum(pull[counted] ** 2, 100.0))))
    normal = (design / scale * weight[:, None]).T @ (design / scale * weight[:, None])
    # About ten pixels have correlated noise.
    covariance = np.linalg.pinv(normal) * 10.0 * max(misfit, 0.3) ** 2
    return ClippedSourceFit(
        light=(best / scale)[:-1], sd=(np.sqrt(np.diag(covariance)) / scale)[:-1], misfit=misfit, rms=rms
    )


# Standard errors required for a source's signal.
SEEN = 5.0
LEAST_PIXELS = 40
# Maximum width of an overflow streak, px.
STREAK_PX = 7


@dataclass(frozen=True, kw_only=True)
class ClippedSource:
    """Source that the frame clips.

    `row`, `col`: centre, px; `clipped_px`: number of its clipped pixels; `shape`: "point" or "patch"; `light_dn_px`:
    signal without glare, DN times pixels, of every draw of the PSF, shape (draw,); NaN where unknown; `reason`: refusal
    reason; empty where known; `region`, `lit`: flat indices of its clipped pixels, and of those assumed to be
    illuminated.
    """

    row: float
    col: float
    clipped_px: int
    shape: str
    light_dn_px: Array
    reason: str
    region: NDArray[np.int64]
    illuminated_pixels: NDArray[np.int64]

    @property
    def has_known_signal(self) -> bool:
        """Whether its signal is known."""
        return not self.reason


def find_clipped_sources(
    signal: NDArray, clipped: Mask, spread: PosteriorPsf, lattice: FrameGrid, *, noise_dn: NDArray, clip_dn: float,
    rng: np.random.Generator,
) -> tuple[ClippedSource, ...]:  # fmt: skip
    """Find the clipped sources of a frame and estimate their signal for every draw of the PSF.

    `signal`: frame above dark, shape (row, col), DN; `clipped`: pixels at full scale, shape (row, col); `spread`: draws
    of the camera's PSF; `lattice`: grid of the frame; `noise_dn`: standard deviation of every pixel's noise, shape
    (row, col), DN; `clip_dn`: full scale above dark, DN; `rng`: generator of the noise in the estimated signal.
    """
    found = list(_regions(clipped))
    reach = 0.5 * float(np.median(spread.halo_diameter_px)) + 8.0
    out: list[ClippedSource] = []
    for group in _groups(found, reach, lattice):
        out += _sources_of_group([found[number] for number in group], signal, clipped, spread, lattice, reach,
                     noise_dn=noise_dn, clip_dn=clip_dn, rng=rng)  # fmt: skip
    return tuple(out)


def _regions(clipped: Mask) -> Iterator[NDArray[np.int64]]:
    """Pixels of every connected clipped region, flat indices."""
    from scipy import ndimage

    # Noise splits the rim of a clipped region: pixels within 2 px belong to one source.
    wide = ndimage.binary_dilation(clipped, np.ones((2 * 2 + 1,) * 2, bool))
    labels, count = ndimage.label(wide)  # pyright: ignore[reportGeneralTypeIssues]
    labels = np.where(clipped, labels, 0)
    order = np.argsort(labels, axis=None, kind="stable")
    ends = np.cumsum(np.bincount(labels.ravel(), minlength=count + 1))
    for one in range(1, count + 1):
        yield order[ends[one - 1] : ends[one]]


def _groups(regions: list[NDArray[np.int64]], reach: float, lattice: FrameGrid) -> Iterator[list[int]]:
    """Indices of regions with overlapping surroundings."""
    middles = [lattice.middle(region) for region in regions]
    left = set(range(len(regions)))
    while left:
        group, fresh = [], [left.pop()]
        while fresh:
            one = fresh.pop()
            group.append(one)
            near = [n for n in left if lattice.apart(middles[one], middles[n]) < 2 * reach]
            left -= set(near)
            fresh += near
        yield sorted(group)


def _sources_of_group(
    regions: list[NDArray[np.int64]],
    signal: NDArray,
    clipped: Mask,
    spread: PosteriorPsf,
    lattice: FrameGrid,
    reach: float,
    *,
    noise_dn: NDArray,
    clip_dn: float,
    rng: np.random.Generator,
) -> list[ClippedSource]:
    """Sources of one group with their signal: from the halo alone, else also from the wings near the core."""
    found: list[ClippedSource] = []
    # First without the steep flank, where the core width matters; if the halo is too faint, with all but noisy
    # pixels.
    for margin in (4, 1):
        around = surroundings(regions, signal, clipped, lattice, reach, margin, noise_dn=noise_dn, clip_dn=clip_dn)
        found = _with_light(regions, spread, lattice, around, rng)
        if all(source.has_known_signal for source in found):
            break
    return found


def _with_light(
    regions: list[NDArray[np.int64]],
    spread: PosteriorPsf,
    lattice: FrameGrid,
    around: Surroundings,
    rng: np.random.Generator,
) -> list[ClippedSource]:
    """Sources of one group with their signal, from given surroundings."""
    halo_px = 0.5 * float(np.median(spread.halo_diameter_px))
    first = [_possible(region, around, lattice, halo_px) for region in regions]
    reason = _reason(regions, first, around, lattice)
    guesses = [
        Guess(shape=shape or "point", illuminated_pixels=region) for shape, region in zip(first, regions, strict=True)
    ]
    if reason:
        return [_unknown(r, g, reason, spread, lattice) for r, g in zip(regions, guesses, strict=True)]
    centre = tables(spread.centre(), lattice)
    best = fit(templates(guesses, centre, 0, lattice, around), around)
    for one, region in enumerate(regions):
        point = best if guesses[one].shape == "point" else None
        for patch in _patches(region, lattice):
            other = [*guesses[:one], patch, *guesses[one + 1 :]]
            found = fit(templates(other, centre, 0, lattice, around), around)
            if point is not None and _alike(point, found, one):
                reason = "its surroundings fit a point source with halo and a uniform patch about equally well"
            if found.rms < best.rms:
                guesses, best = other, found
    if best.misfit > 2.5:
        reason = f"its surroundings deviate from the PSF by {best.misfit:.1f} times the noise and model error"
    if reason:
        return [_unknown(r, g, reason, spread, lattice) for r, g in zip(regions, guesses, strict=True)]
    return _with_draws(regions, guesses, spread, lattice, around, rng)


def _alike(point: ClippedSourceFit, patch: ClippedSourceFit, one: int) -> bool:
    """Whether two guesses fit about equally well but differ in the source's signal."""
    low, high = sorted((point.light[one], patch.light[one]))
    better, worse = sorted((point.rms, patch.rms))
    return high > 1.3 * low and worse < 1.6 * max(better, 1.0)


def _patches(region: NDArray[np.int64], lattice: FrameGrid) -> Iterator[Guess]:
    """Uniform patches as large as the clipped pixels and smaller, since blur clips pixels next to a bright patch."""
    from scipy import ndimage

    rows, cols = np.divmod(region, lattice.shape[1])
    mask = np.zeros((np.ptp(rows) + 3, np.ptp(cols) + 3), bool)
    mask[rows - rows.min() + 1, cols - cols.min() + 1] = True
    for smaller in range(2 + 1):
        down, across = np.nonzero(ndimage.binary_erosion(mask, iterations=smaller) if smaller else mask)
        if len(down) < 9:
            return
        lit = (down + rows.min() - 1) * lattice.shape[1] + across + cols.min() - 1
        yield Guess(shape="patch", illuminated_pixels=lit)


def _possible(region: NDArray[np.int64], around: Surroundings, lattice: FrameGrid, halo_px: float) -> str:
    """Possible shape: a point if its halo is visible, a patch if it is wider than a halo."""
    rows, cols = np.divmod(around.places[around.floor == 0], lattice.shape[1])
    row, col = lattice.middle(region)
    inside = np.hypot((rows - row) * lattice.pitch_ratio, cols - col) < halo_px - 2.0
    if inside.sum() * around.subsampling >= LEAST_PIXELS:
        return "point"
    return "patch" if _longest(region, lattice) > 1.3 * 2.0 * halo_px else ""


def _longest(region: NDArray[np.int64], lattice: FrameGrid) -> float:
    """Longer side of the bounding box of some pixels, column pitches, streak excluded."""
    from scipy import ndimage

    rows, cols = np.divmod(region, lattice.shape[1])
    mask = np.zeros((np.ptp(rows) + 1, np.ptp(cols) + 1), bool)
    mask[rows - rows.min(), cols - cols.min()] = True
    down, across = np.nonzero(ndimage.binary_opening(mask, np.ones((STREAK_PX, STREAK_PX), bool)))
    return float(max((np.ptp(down) + 1) * lattice.pitch_ratio, np.ptp(across) + 1)) if len(down) else 0.0


def _with_draws(
    regions: list[NDArray[np.int64]],
    guesses: list[Guess],
    spread: PosteriorPsf,
    lattice: FrameGrid,
    around: Surroundings,
    rng: np.random.Generator,
) -> list[ClippedSource]:
    """Signal of every source for every draw of the PSF, with its noise error."""
    known = tables(spread, lattice)
    draws = range(len(spread))
    fits = [fit(templates(guesses, known, draw, lattice, around), around) for draw in draws]
    light = np.array([one.light + one.sd * rng.standard_normal(len(one.light)) for one in fits])
    clear = np.array([one.light / np.maximum(one.sd, 1e-12) for one in fits])
    out = []
    for one, (region, guess) in enumerate(zip(regions, guesses, strict=True)):
        seen = float(np.median(clear[:, one]))
        if seen < SEEN:
            reason = f"its halo is {seen:.1f} standard errors above its surroundings, at least {SEEN:g} needed"
            out.append(_unknown(region, guess, reason, spread, lattice))
            continue
        row, col = lattice.middle(region)
        out.append(
            ClippedSource(
                row=row,
                col=col,
                clipped_px=len(region),
                shape=guess.shape,
                reason="",
                illuminated_pixels=guess.illuminated_pixels,
                region=region,
                light_dn_px=np.maximum(light[:, one], 0.0),
            )
        )
    return out


def _unknown(
    region: NDArray[np.int64], guess: Guess, reason: str, spread: PosteriorPsf, lattice: FrameGrid
) -> ClippedSource:
    row, col = lattice.middle(region)
    return ClippedSource(
        row=row,
        col=col,
        clipped_px=len(region),
        shape=guess.shape,
        illuminated_pixels=guess.illuminated_pixels,
        region=region,
        light_dn_px=np.full(len(spread), np.nan),
        reason=reason,
    )


def _reason(regions: list[NDArray[np.int64]], shapes: list[str], around: Surroundings, lattice: FrameGrid) -> str:
    """Refusal reason for a group, or an empty string."""
    if any(lattice.at_border(region) for region in regions):
        return "it touches the border of the frame"
    if (count := int((around.floor == 0).sum())) < LEAST_PIXELS:
        return f"only {count} pixels around it are unclipped, at least {LEAST_PIXELS} needed"
    return "" if all(shapes) else "all of its halo is clipped"
