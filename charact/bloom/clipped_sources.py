"""The light of sources that a frame clips, told from the halo and the wings that they leave around them.

A clipped pixel says only "at least so much". The pixels around it that are not clipped hold the source's halo, whose
shape the spread knows: their brightness is the source's light. Each source is tried as a point in the middle of its
clipped pixels and as an even patch as large as they are; the one that fits what is around it better is taken.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.clipped_source_fit import ClippedSourceFit, Guess, Surroundings, fit, surroundings, tables, templates
from charact.bloom.lattice import FrameGrid
from charact.bloom.posterior_psf import PosteriorPsf

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Pixels beside clipped ones that are left out: first the whole steep flank, on which little tells the light from the
# core's width; where the halo alone is too faint, only those spoilt by noise near the highest code.
MARGINS_PX = (4, 1)
# Clipped pixels so near each other belong to one source: noise tears the rim of a clipped region.
JOINED_PX = 2
# A source's surroundings reach this far beyond its halo, px.
BEYOND_PX = 8.0
# Standard errors that a source's light needs, and the largest rms misfit, in what noise and model allow.
SEEN, MISFIT = 5.0, 2.5
# A point and a patch that fit within this factor of each other, but differ by that one in their light, tell nothing.
AMBIGUOUS, UNLIKE = 1.6, 1.3
LEAST_PIXELS, LEAST_PATCH_PX = 40, 9
# The halo shows where it is at least so far inside its edge, px; a patch is at least so many halos wide.
INSIDE_PX, WIDER = 2.0, 1.3
# Width that overflow has at most, px.
STREAK_PX = 7
# By so many px a lit patch may be smaller than what it clips.
SMALLER_PX = 2


@dataclass(frozen=True, kw_only=True)
class ClippedSource:
    """A source that the frame clips.

    Parameters
    ----------
    row, col
        Its middle, px.
    clipped_px
        Pixels that it clips.
    shape
        "point" or "patch".
    light_dn_px
        Its light without its glare, DN times pixels, of every draw of the spread, shape (draw,); NaN where it could not
        be told.
    reason
        Why not; empty where it could.
    region, lit
        Numbers of its clipped pixels in the flattened frame, and of those taken to be lit.
    """

    row: float
    col: float
    clipped_px: int
    shape: str
    light_dn_px: Array
    reason: str
    region: NDArray[np.int64]
    lit: NDArray[np.int64]

    @property
    def known(self) -> bool:
        """Whether its light could be told."""
        return not self.reason


def find_clipped_sources(
    signal: NDArray, clipped: Mask, spread: PosteriorPsf, lattice: FrameGrid, *, noise_dn: NDArray, clip_dn: float,
    rng: np.random.Generator,
) -> tuple[ClippedSource, ...]:  # fmt: skip
    """Find the clipped sources of a frame and tell their light for every draw of the spread.

    Parameters
    ----------
    signal
        Frame over dark, shape (row, col), DN.
    clipped
        Its pixels at the highest code, shape (row, col).
    spread
        Draws of the camera's spread.
    lattice
        Distances on the frame.
    noise_dn
        Standard deviation of every pixel's noise, shape (row, col), DN.
    clip_dn
        Highest code over dark, DN.
    rng
        Generator of the error that noise leaves in the light.
    """
    found = list(_regions(clipped))
    reach = 0.5 * float(np.median(spread.halo_diameter_px)) + BEYOND_PX
    out: list[ClippedSource] = []
    for group in _groups(found, reach, lattice):
        out += _sources_of_group([found[number] for number in group], signal, clipped, spread, lattice, reach,
                     noise_dn=noise_dn, clip_dn=clip_dn, rng=rng)  # fmt: skip
    return tuple(out)


def _regions(clipped: Mask) -> Iterator[NDArray[np.int64]]:
    """Pixels of every connected clipped region, flat."""
    from scipy import ndimage

    wide = ndimage.binary_dilation(clipped, np.ones((2 * JOINED_PX + 1,) * 2, bool))
    labels, count = ndimage.label(wide)  # pyright: ignore[reportGeneralTypeIssues]
    labels = np.where(clipped, labels, 0)
    order = np.argsort(labels, axis=None, kind="stable")
    ends = np.cumsum(np.bincount(labels.ravel(), minlength=count + 1))
    for one in range(1, count + 1):
        yield order[ends[one - 1] : ends[one]]


def _groups(regions: list[NDArray[np.int64]], reach: float, lattice: FrameGrid) -> Iterator[list[int]]:
    """Numbers of regions whose surroundings overlap."""
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
    regions: list[NDArray[np.int64]], signal: NDArray, clipped: Mask, spread: PosteriorPsf, lattice: FrameGrid, reach: float, *,
    noise_dn: NDArray, clip_dn: float, rng: np.random.Generator,
) -> list[ClippedSource]:  # fmt: skip
    """The sources of one group with their light: from the halo alone, else from the wings near the core as well."""
    found: list[ClippedSource] = []
    for margin in MARGINS_PX:
        around = surroundings(regions, signal, clipped, lattice, reach, margin, noise_dn=noise_dn, clip_dn=clip_dn)
        found = _with_light(regions, spread, lattice, around, rng)
        if all(source.known for source in found):
            break
    return found


def _with_light(
    regions: list[NDArray[np.int64]],
    spread: PosteriorPsf,
    lattice: FrameGrid,
    around: Surroundings,
    rng: np.random.Generator,
) -> list[ClippedSource]:
    """The sources of one group with their light, told from given surroundings."""
    halo_px = 0.5 * float(np.median(spread.halo_diameter_px))
    first = [_possible(region, around, lattice, halo_px) for region in regions]
    reason = _reason(regions, first, around, lattice)
    guesses = [Guess(shape=shape or "point", lit=region) for shape, region in zip(first, regions, strict=True)]
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
                reason = "what is around it fits a point behind its halo and a lit patch about as well"
            if found.rms < best.rms:
                guesses, best = other, found
    if best.misfit > MISFIT:
        reason = f"what is around it departs from the spread by {best.misfit:.1f} times what noise and model allow"
    if reason:
        return [_unknown(r, g, reason, spread, lattice) for r, g in zip(regions, guesses, strict=True)]
    return _with_draws(regions, guesses, spread, lattice, around, rng)


def _alike(point: ClippedSourceFit, patch: ClippedSourceFit, one: int) -> bool:
    """Whether two guesses at a source fit about as well and yet differ in its light."""
    low, high = sorted((point.light[one], patch.light[one]))
    better, worse = sorted((point.rms, patch.rms))
    return high > UNLIKE * low and worse < AMBIGUOUS * max(better, 1.0)


def _patches(region: NDArray[np.int64], lattice: FrameGrid) -> Iterator[Guess]:
    """Lit patches as large as the clipped pixels and smaller: blur clips pixels beside a bright patch, too."""
    from scipy import ndimage

    rows, cols = np.divmod(region, lattice.shape[1])
    mask = np.zeros((np.ptp(rows) + 3, np.ptp(cols) + 3), bool)
    mask[rows - rows.min() + 1, cols - cols.min() + 1] = True
    for smaller in range(SMALLER_PX + 1):
        down, across = np.nonzero(ndimage.binary_erosion(mask, iterations=smaller) if smaller else mask)
        if len(down) < LEAST_PATCH_PX:
            return
        lit = (down + rows.min() - 1) * lattice.shape[1] + across + cols.min() - 1
        yield Guess(shape="patch", lit=lit)


def _possible(region: NDArray[np.int64], around: Surroundings, lattice: FrameGrid, halo_px: float) -> str:
    """What a source may be: a point if its halo shows beside what it clips, a patch if that is wider than a halo."""
    rows, cols = np.divmod(around.places[around.floor == 0], lattice.shape[1])
    row, col = lattice.middle(region)
    inside = np.hypot((rows - row) * lattice.pitch_ratio, cols - col) < halo_px - INSIDE_PX
    if inside.sum() * around.thinned >= LEAST_PIXELS:
        return "point"
    return "patch" if _longest(region, lattice) > WIDER * 2.0 * halo_px else ""


def _longest(region: NDArray[np.int64], lattice: FrameGrid) -> float:
    """Longer side of the box around some pixels, column pitches, without the narrow streak of an overflow."""
    from scipy import ndimage

    rows, cols = np.divmod(region, lattice.shape[1])
    mask = np.zeros((np.ptp(rows) + 1, np.ptp(cols) + 1), bool)
    mask[rows - rows.min(), cols - cols.min()] = True
    down, across = np.nonzero(ndimage.binary_opening(mask, np.ones((STREAK_PX, STREAK_PX), bool)))
    return float(max((np.ptp(down) + 1) * lattice.pitch_ratio, np.ptp(across) + 1)) if len(down) else 0.0


def _with_draws(
    regions: list[NDArray[np.int64]], guesses: list[Guess], spread: PosteriorPsf, lattice: FrameGrid, around: Surroundings,
    rng: np.random.Generator,
) -> list[ClippedSource]:  # fmt: skip
    """Light of every source for every draw of the spread, with the error that noise leaves."""
    known = tables(spread, lattice)
    draws = range(len(spread))
    fits = [fit(templates(guesses, known, draw, lattice, around), around) for draw in draws]
    light = np.array([one.light + one.sd * rng.standard_normal(len(one.light)) for one in fits])
    clear = np.array([one.light / np.maximum(one.sd, 1e-12) for one in fits])
    out = []
    for one, (region, guess) in enumerate(zip(regions, guesses, strict=True)):
        seen = float(np.median(clear[:, one]))
        if seen < SEEN:
            reason = f"its halo stands {seen:.1f} standard errors above its surroundings out of {SEEN:g} needed"
            out.append(_unknown(region, guess, reason, spread, lattice))
            continue
        row, col = lattice.middle(region)
        out.append(ClippedSource(row=row, col=col, clipped_px=len(region), shape=guess.shape, reason="", lit=guess.lit,
                          region=region, light_dn_px=np.maximum(light[:, one], 0.0)))  # fmt: skip
    return out


def _unknown(
    region: NDArray[np.int64], guess: Guess, reason: str, spread: PosteriorPsf, lattice: FrameGrid
) -> ClippedSource:
    row, col = lattice.middle(region)
    return ClippedSource(row=row, col=col, clipped_px=len(region), shape=guess.shape, lit=guess.lit, region=region,
                  light_dn_px=np.full(len(spread), np.nan), reason=reason)  # fmt: skip


def _reason(regions: list[NDArray[np.int64]], shapes: list[str], around: Surroundings, lattice: FrameGrid) -> str:
    """Why the light of a group cannot be told, or nothing."""
    if any(lattice.at_border(region) for region in regions):
        return "it touches the border of the frame"
    if (count := int((around.floor == 0).sum())) < LEAST_PIXELS:
        return f"only {count} pixels around it are not clipped, out of {LEAST_PIXELS} needed"
    return "" if all(shapes) else "all of its halo is clipped"
