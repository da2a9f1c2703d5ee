"""Where a source is: found among noise, then set to the middle of a contour that neither cut cores nor streaks pull."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.bloom.extent import contour_at
from charact.bloom.source_view import SourceView

Array = NDArray[np.float64]

# Width of the smoothing that finds a source, px, and of its near surroundings in widths of the smoothing.
SMOOTHING_PX = 1.5
SURROUNDINGS = 3.0
# Every other row and column tells a median as well.
THIN = 2
# Rounding leaves a background without noise: its steps are the least spread, DN.
LEAST_SPREAD_DN = 0.05
# Farthest that the middle of a contour may lie from where the source was found, px.
FARTHEST_PX = 10.0
# Places nearer than this are one, px; a source that stands out by less than so many errors has no place of its own.
NEAR_PX, CLEAR = 1.5, 16.0
# A source besides the brightest: its height over full scale and in standard errors, and how far apart it lies, px.
OTHER_SHARE, OTHER_ERRORS, APART_PX = 0.04, 16.0, 6
# It falls off to every side by this share of its height within its own radius and this distance, px.
FALLS_SHARE, FALLS_PX = 0.4, 4.0
DIRECTIONS = 16


@dataclass(frozen=True, kw_only=True)
class SourcePosition:
    """Where a frame shows a point source, px.

    Parameters
    ----------
    row, col
        Its middle, px.
    significance
        How many standard deviations it stands above its surroundings.
    cut
        Whether its peak is at the highest code, so that one source may pass for another.
    settled
        Whether it is the middle of a whole contour.
    """

    row: float
    col: float
    significance: float
    cut: bool = False
    settled: bool = False


@dataclass(frozen=True, kw_only=True)
class Contrast:
    """A mean frame smoothed, its difference from its near surroundings, and that difference's spread, DN."""

    smooth: Array
    difference: Array
    spread: float


def contrast_of(image: Array) -> Contrast:
    """Return what makes sources of a few pixels stand out."""
    from scipy import ndimage

    smooth = np.asarray(ndimage.gaussian_filter(image, SMOOTHING_PX))
    difference = smooth - np.asarray(ndimage.gaussian_filter(image, SURROUNDINGS * SMOOTHING_PX))
    some = difference[::THIN, ::THIN]
    spread = 1.4826 * float(np.median(np.abs(some - np.median(some))))
    return Contrast(smooth=smooth, difference=difference, spread=max(spread, LEAST_SPREAD_DN))


def brightest(image: Array, region: tuple[int, int, int, int] | None) -> SourcePosition:
    """Return the place that stands out most, set to the middle of the light that hangs together with it."""
    from scipy import ndimage

    found = contrast_of(image)
    window = np.zeros(image.shape, bool)
    if region is None:
        window[:] = True
    else:
        row, col, height, width = region
        window[row : row + height, col : col + width] = True
    top = np.unravel_index(int(np.argmax(np.where(window, found.difference, -np.inf))), image.shape)
    significance = float(found.difference[top] / found.spread)
    floor = float(np.median(image[::THIN, ::THIN]))
    above = found.smooth > floor + 0.5 * (found.smooth[top] - floor)
    labels = np.asarray(ndimage.label(above)[0])  # pyright: ignore[reportIndexIssue]
    rows, cols = np.nonzero(labels == labels[top]) if labels[top] else (np.array([top[0]]), np.array([top[1]]))
    # Medians: a streak has few pixels beside the blob, and lies even about it.
    return SourcePosition(row=float(np.median(rows)), col=float(np.median(cols)), significance=significance)


def middle(view: SourceView, row: float, col: float) -> tuple[float, float, bool] | None:
    """Return the middle of the contour halfway up to the peak or the highest code, and whether all of it serves.

    None where there is no contour.

    What sectors say that a streak or another source pulls is left out, and cut codes lie inside the contour.
    """
    profile = view.profile[1]
    floor = float(np.median(profile))
    level = floor + 0.5 * (min(float(profile[:2].max()), view.top) - floor)
    found = contour_at(view, level) if level > 0 else None
    if found is None:
        return None
    contour, whole = found
    down, along = contour.shift()
    if np.hypot(down, along) > FARTHEST_PX:
        return None
    return row + down / view.polar.row_pitch, col + along, whole


def is_bright_at(image: Array, own: SourcePosition, other: SourcePosition) -> bool:
    """Whether another place is no farther than a pixel or two, or as bright as the source found here."""
    if np.hypot(own.row - other.row, own.col - other.col) < NEAR_PX or own.significance < CLEAR:
        return True
    floor = float(np.median(image[::THIN, ::THIN]))
    here, there = (_patch(image, place) - floor for place in (own, other))
    return there > 0.7 * here


def _patch(image: Array, place: SourcePosition) -> float:
    """Mean of the pixels next to a place."""
    row, col = round(place.row), round(place.col)
    return float(image[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2].mean())


def others(image: Array, place: SourcePosition, span_dn: float, row_pitch: float) -> tuple[SourcePosition, ...]:
    """Return further sources in a frame, brightest first: spots that fall off to every side, unlike rims and streaks.

    Parameters
    ----------
    image
        Mean frame, shape (row, col), DN.
    place
        The source already known.
    span_dn
        Full scale over dark, DN.
    row_pitch
        Row pitch over column pitch.
    """
    from skimage.feature import peak_local_max

    found = contrast_of(image)
    least = max(OTHER_SHARE * span_dn, OTHER_ERRORS * found.spread)
    peaks = peak_local_max(found.difference, min_distance=APART_PX, threshold_abs=least, exclude_border=False)
    own = np.hypot((peaks[:, 0] - place.row) * row_pitch, peaks[:, 1] - place.col)
    held = [
        SourcePosition(row=float(row), col=float(col), significance=float(found.difference[row, col] / found.spread))
        for (row, col), apart in zip(peaks, own, strict=True)
        if apart > APART_PX
        and _falls_off(found.smooth, int(row), int(col), float(found.difference[row, col]), row_pitch)
    ]
    return tuple(sorted(held, key=lambda one: -one.significance))


def _falls_off(smooth: Array, row: int, col: int, height: float, row_pitch: float) -> bool:
    """Whether the light around a peak is lower in every direction."""
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    reach = FALLS_PX + SMOOTHING_PX
    rows = np.rint(row + reach * np.sin(angle) / row_pitch).astype(int)
    cols = np.rint(col + reach * np.cos(angle)).astype(int)
    inside = (rows >= 0) & (rows < smooth.shape[0]) & (cols >= 0) & (cols < smooth.shape[1])
    return bool(np.all(smooth[row, col] - smooth[rows[inside], cols[inside]] > FALLS_SHARE * height))
