"""Bands on the pixels of the first one: warp by the geometry of the cameras, then by the shift that
is left.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from charact.fusion.bands import Band, display_plane
from charact.fusion.checks import measure_shift
from charact.fusion.geometry import CameraGeometry, Placement, are_posed, place_pixels
from charact.fusion.noise_law import blur_px_of
from charact.fusion.sources import Source
from charact.fusion.thresholds import FUSION
from labdata.errors import BadInput


def align_bands(
    bands: Sequence[Band],
    sources: Sequence[Source],
    *,
    distance_m: float | None = None,
    registered: bool = False,
) -> tuple[list[Band], list[Placement | None]]:
    """Return bands on the pixels of the first one, and the place of these in each frame (None:
    unmoved).

    `sources`: where the bands are from; `distance_m`: distance at which all is taken to lie, None:
    range of each pixel where it is known, else infinite; `registered`: whether the shift that
    geometry leaves is neither measured nor corrected. Frames of unlike size with a lens unknown are
    BadInput.

    A shift is corrected where the 95 % intervals of `residual_shift` lie beyond
    `FUSION.flagged_shift_px`, but not if poses are known: they are closer than a shift measured
    from edges that two bands do not share. Geometry and shift are one interpolation.
    """
    fixed, aligned = bands[0], [bands[0]]
    placements: list[Placement | None] = [None]
    for band, source in zip(bands[1:], sources[1:], strict=True):
        placement, notes = place_source(sources[0], source, distance_m)
        placed = band if placement is None else move_band(band, placement)
        posed = are_posed(sources[0].geometry, source.geometry)
        if not (registered or posed):
            shift = measure_shift(*(display_plane(shown, bloom=True) for shown in (fixed, placed)))
            if shift.least_px > FUSION.flagged_shift_px:
                placement = (placement or _identity(band)).shifted(shift.shift_px)
                placed = move_band(band, placement)
                across, down = shift.shift_px
                notes = (
                    *notes,
                    f"{band.name} was moved by its measured shift of {down:.2f} rows and "
                    f"{across:.2f} columns",
                )
        aligned.append(replace(placed, notes=(*placed.notes, *notes)))
        placements.append(placement)
    return aligned, placements


def place_source(
    fixed: Source, moving: Source, distance_m: float | None = None
) -> tuple[Placement | None, tuple[str, ...]]:
    """Return the place of fixed pixels in a moving frame, None if the frames are on one grid, and
    notes on the way.
    """
    fixed_geometry, moving_geometry = fixed.geometry, moving.geometry
    same_grid = fixed.stack.shape[1:] == moving.stack.shape[1:]
    if (
        fixed_geometry is None
        or moving_geometry is None
        or (same_grid and not are_posed(fixed_geometry, moving_geometry))
    ):
        if not same_grid:
            sizes = " and ".join(
                f"{source.name} {source.stack.shape[1]} x {source.stack.shape[2]}"
                for source in (fixed, moving)
            )
            known = "unless both lenses are known (sensor, imager)"
            raise BadInput(f"bands must have the same rows and columns {known}, got {sizes}")
        if distance_m is not None:
            raise BadInput(
                "range_m needs the poses of both cameras, as in the truth of a simulated session"
            )
        return None, (
            f"{moving.name}: warp and parallax were left out: poses of the cameras are unknown",
        )
    placement = place_pixels(fixed_geometry, moving_geometry, distance_m=distance_m)
    if placement.outside.all():
        raise BadInput(
            f"the fields of view must overlap, got none of {fixed.name} in {moving.name}"
        )
    return placement, (_way(fixed_geometry, moving_geometry, distance_m, moving.name, placement),)


def _way(
    fixed: CameraGeometry,
    moving: CameraGeometry,
    distance_m: float | None,
    name: str,
    placed: Placement,
) -> str:
    """Return the sentence on how a frame was placed."""
    if fixed.position_m is None or moving.position_m is None:
        way = (
            "the focal lengths alone: parallel axes in one place; parallax was left out, for "
            "poses are unknown"
        )
    elif distance_m is not None:
        way = f"poses and lenses, all at {distance_m:g} m"
    elif fixed.range_m is None:
        way = "poses and lenses, all at infinity: parallax was left out, for the range is unknown"
    else:
        way = "poses, lenses and the range of each pixel"
    lost = (
        f"{100.0 * placed.outside.mean():.2g} % outside its field, "
        f"{100.0 * placed.occluded.mean():.2g} % occluded"
    )
    return f"{name} was placed by {way}; {lost}"


def _identity(band: Band) -> Placement:
    row, col = np.indices(band.image.shape).astype(float)
    none = np.zeros(band.image.shape, bool)
    return Placement(col=col, row=row, outside=none, occluded=none)


def move_band(band: Band, placement: Placement) -> Band:
    """Return a band at the places of another frame's pixels, with the noise that the warp
    leaves.
    """
    rows, cols = band.image.shape
    distance = np.abs(placement.col - 0.5 * (cols - 1)), np.abs(placement.row - 0.5 * (rows - 1))
    off_frame = (distance[0] > 0.5 * cols) | (distance[1] > 0.5 * rows)
    no_data = placement.unseen | off_frame
    if band.no_data is not None:
        no_data = no_data | (placement.warp(band.no_data.astype(np.float32)) > 0.5)
    law = band.noise
    if law is not None:
        power, factor = placement.noise_change
        blur = blur_px_of(min(factor, 1.0))
        shot, read = (float(np.hypot(blur_px, blur)) for blur_px in (law.blur_px, law.read_blur_px))
        law = replace(law.scaled(power), blur_px=shot, read_blur_px=read)
    return replace(band, image=placement.warp(band.image), noise=law, no_data=no_data)


def common_field(placements: Sequence[Placement | None]) -> tuple[int, int, int, int] | None:
    """Return ROW, COL, HEIGHT, WIDTH of the pixels that lie inside all frames; None: all pixels do.

    From the whole frame, the side with the largest share of pixels outside is moved inwards until
    there is none.
    """
    outside = [placement.outside for placement in placements if placement is not None]
    if not outside or not (lost := np.logical_or.reduce(outside)).any():
        return None
    top, left, bottom, right = 0, 0, *lost.shape
    while top < bottom and left < right and (part := lost[top:bottom, left:right]).any():
        sides = [part[0].mean(), part[-1].mean(), part[:, 0].mean(), part[:, -1].mean()]
        # A side without pixels outside stays; pixels outside within the frame are reached from the
        # nearest side.
        worst = int(np.argmax(sides))
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    if bottom - top < 16 or right - left < 16:
        raise BadInput(
            "the fields of view must have 16 rows and columns in common: `whole` fuses the "
            "whole frame"
        )
    return top, left, bottom - top, right - left


def crop_bands(bands: Sequence[Band], region: tuple[int, int, int, int] | None) -> list[Band]:
    """Return bands cut to the region that all show, the first with a note of it; None: uncut."""
    if region is None:
        return list(bands)
    cut = [crop_band(band, region) for band in bands]
    note = "ROW,COL,HEIGHT,WIDTH {},{},{},{} of {}, the field of view in common (`whole` keeps all)"
    notes = (*cut[0].notes, note.format(*region, bands[0].name))
    return [replace(cut[0], notes=notes), *cut[1:]]


def crop_band(band: Band, region: tuple[int, int, int, int]) -> Band:
    """Return a band cut to ROW, COL, HEIGHT, WIDTH."""
    row, col, height, width = region
    cut = np.s_[row : row + height, col : col + width]
    bloom = band.bloom
    if bloom is not None:
        sources = [replace(lamp, row=lamp.row - row, col=lamp.col - col) for lamp in bloom.sources]
        in_view = [
            lamp
            for lamp in sources
            if not lamp.has_known_signal or (0 <= lamp.row < height and 0 <= lamp.col < width)
        ]
        bloom = replace(
            bloom,
            fraction=bloom.fraction[cut],
            sd=bloom.sd[cut],
            blooming_dn=bloom.blooming_dn[cut],
            clipped=bloom.clipped[cut],
            near_border=bloom.near_border[cut],
            sources=tuple(in_view),
        )
    no_data = None if band.no_data is None or not band.no_data[cut].any() else band.no_data[cut]
    return replace(band, image=band.image[cut], bloom=bloom, no_data=no_data)
