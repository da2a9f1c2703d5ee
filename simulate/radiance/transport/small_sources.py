"""Lamps, sun and moon in the picture: too small for rays to meet, they are laid on the pixels that they cover.

So are their images in panes of glass: a source mirrored by the plane of a pane, where the way there meets that pane.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.transport import direct
from simulate.radiance.transport.lights import DiscLight, LampLight
from simulate.radiance.transport.panes import Panes, mirrored
from simulate.radiance.transport.stage import Stage
from simulate.radiance.world.viewpoint import Viewpoint

Array = NDArray[np.floating]
# Places of each source that are looked at; its light is shared evenly among them.
PLACES = 1024
# Panes whose planes differ by less are one: directions of normals, and distances, m.
SAME = 6
# Ways to a pane end so far before and behind it, m, where it is asked whether there is one.
CLOSE_M = 1e-3


def add_small_sources(stage: Stage, view: Viewpoint, radiance: NDArray[np.float32]) -> None:
    """Add what the camera sees of lamps, sun and moon to the radiance of pixels, shape (pixel, band).

    Those whose light on surfaces is left out are seen all the same: what lights little may yet dazzle. A scanner sees
    them from where it begins.

    Notes
    -----
    A source of irradiance E at the lens adds E / solid angle of the pixel, shared by the places of its disc.
    """
    rng = np.random.default_rng(0)
    eye = np.asarray(view.position_m, float)
    for source in (*stage.lighting.discs, *stage.lighting.lamps):
        _lay(view, radiance, *_seen(stage, eye, _places(source, eye, rng), source))
        for image in _images(stage, eye, source, rng):
            _lay(view, radiance, *image)


def _places(source: DiscLight | LampLight, eye: Array, rng: np.random.Generator) -> Array:
    """Draw ways from the eye to places of a source, shape (place, 3): of a disc without length."""
    if isinstance(source, DiscLight):
        return direct.towards_disc(source, PLACES, rng)
    middle = source.position_m - eye
    frame = direct.frames((middle / np.linalg.norm(middle))[None])[0]
    radius, turn = source.radius_m * np.sqrt(rng.random(PLACES)), 2.0 * np.pi * rng.random(PLACES)
    return middle + radius[:, None] * (np.cos(turn)[:, None] * frame[0] + np.sin(turn)[:, None] * frame[1])


def _seen(stage: Stage, eye: Array, way: Array, source: DiscLight | LampLight) -> tuple[Array, NDArray[np.float32]]:
    """Return directions in which places of a source are seen, and the irradiance by each, shape (place, band)."""
    reach = None if isinstance(source, DiscLight) else direct.SHORT
    start = np.broadcast_to(eye, way.shape)
    clear = ~stage.surfaces.tracer.blocked(start, way, reach)
    start, way = start[clear], way[clear]
    unit = way / np.linalg.norm(way, axis=1, keepdims=True)
    light = np.tile(_irradiance(stage, source, eye), (len(way), 1))
    _weaken(stage.coats.panes, start, way, reach, light)
    return unit, light


def _irradiance(stage: Stage, source: DiscLight | LampLight, eye: Array) -> NDArray[np.float32]:
    """Irradiance by one place of a source, were nothing in the way but air, shape (band,)."""
    if isinstance(source, DiscLight):
        return source.irradiance / np.float32(PLACES)
    middle = source.position_m - eye
    distance = float(np.linalg.norm(middle))
    found = source.spectrum * np.float32(source.pattern(-middle[None] / distance)[0] / distance**2 / PLACES)
    return found * stage.air.through(np.array([distance]))[0] if stage.air.absorbs else found


def _weaken(panes: Panes | None, start: Array, way: Array, reach: float | None, light: NDArray[np.float32]) -> None:
    if panes is not None:
        which, left = panes.left(start, way, reach)
        light[which] *= left


def _lay(view: Viewpoint, radiance: NDArray[np.float32], towards: Array, light: NDArray[np.float32]) -> None:
    row, col, inside = view.places(towards)
    row, col = np.floor(row[inside]).astype(np.int64), np.floor(col[inside]).astype(np.int64)
    size_sr = view.solid_angle_sr(row + 0.5, col + 0.5)
    np.add.at(radiance, row * view.shape[1] + col, light[inside] / size_sr.astype(np.float32)[:, None])


@dataclass(frozen=True)
class _Plane:
    """A plane that holds panes: unit normal, distance from the origin along it, and the panes' triangles."""

    normal: Array
    offset_m: float
    faces: NDArray[np.int64]


def _planes(panes: Panes) -> list[_Plane]:
    normal = panes.tracer.normal
    offset = np.einsum("ij,ij->i", normal, panes.tracer.corner_m)
    first = np.argmax(np.abs(normal) > 10.0**-SAME, axis=1)
    sign = np.sign(normal[np.arange(len(normal)), first])
    keys = np.round(sign[:, None] * np.column_stack([normal, offset]), SAME)
    _, kind = np.unique(keys, axis=0, return_inverse=True)
    groups = [np.flatnonzero(kind.ravel() == number) for number in range(kind.max() + 1)]
    return [_Plane(normal[faces[0]], float(offset[faces[0]]), faces) for faces in groups]


def _images(
    stage: Stage, eye: Array, source: DiscLight | LampLight, rng: np.random.Generator
) -> Iterator[tuple[Array, NDArray[np.float32]]]:
    """Yield directions and irradiances, as `_seen`, of a source's images in panes."""
    panes = stage.coats.panes
    for plane in () if panes is None else _planes(panes):
        # The eye's own image looks at the source as the eye looks at the source's image.
        height = float(eye @ plane.normal) - plane.offset_m
        if isinstance(source, LampLight) and (source.position_m @ plane.normal - plane.offset_m) * height <= 0.0:
            continue
        image_eye = eye - 2.0 * height * plane.normal
        way = _places(source, image_eye, rng)
        rises = way @ plane.normal
        on = rises * height > 0.0
        way, share = way[on], height / rises[on]
        foot = image_eye + share[:, None] * way
        yield _image(stage, eye, foot, way, share, plane, source, _irradiance(stage, source, image_eye))


def _image(
    stage: Stage,
    eye: Array,
    foot: Array,
    way: Array,
    share: Array,
    plane: _Plane,
    source: DiscLight | LampLight,
    irradiance: NDArray[np.float32],
) -> tuple[Array, NDArray[np.float32]]:
    """Weaken places of an image that is seen at feet on a plane by all that is on both legs of its way."""
    panes, tracer = stage.coats.panes, stage.surfaces.tracer
    assert panes is not None
    ahead = way / np.linalg.norm(way, axis=1, keepdims=True)
    near = panes.met(foot - CLOSE_M * ahead, ahead, np.full(len(way), 2.0 * CLOSE_M))
    near_plane = np.isin(near.face, plane.faces)
    which, back = near.which[near_plane], near.mirrored[near_plane]
    foot, way, rest = foot[which], way[which], (1.0 - share[which])[:, None] * way[which]
    start = np.broadcast_to(eye, foot.shape)
    # Where the light leaves the pane it starts a little before it, on the eye's side.
    side = np.sign(np.einsum("ij,j->i", start - foot, plane.normal))[:, None] * plane.normal
    above = foot + CLOSE_M * side
    reach = None if isinstance(source, DiscLight) else direct.SHORT
    onward = way if isinstance(source, DiscLight) else rest
    clear = ~tracer.blocked(start, foot - start, direct.SHORT) & ~tracer.blocked(above, onward, reach)
    light = irradiance * back[clear]
    _weaken(panes, start[clear], above[clear] - start[clear], direct.SHORT, light)
    _weaken(panes, above[clear], onward[clear], reach, light)
    return mirrored(_unit(way[clear]), np.broadcast_to(plane.normal, way[clear].shape)), light


def _unit(ways: Array) -> Array:
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)
