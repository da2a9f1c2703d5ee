"""Adapter to the Embree library that embreex ships: scenes, and compiled loops over ray packets.

The calls of embreex itself hold the interpreter lock, so that threads wait for each other; the
compiled loops here call the library without the lock.
"""

import ctypes
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from typing import Any
from weakref import finalize

import llvmlite.binding
import numba
import numpy as np
from numba.core import types
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.arrays import Array, Array32, Index, Mask

# Constants of Embree 4's C interface: kinds of geometry and of buffers, and formats.
TRIANGLES, INSTANCE, INDEX, VERTEX, UINT3, FLOAT3, ROWS_3X4 = 0, 121, 0, 1, 0x5003, 0x9003, 0x9134
# Rays are traced in packets of 16, seven times as fast as single rays. A packet is aligned to 64
# bytes; its rows of 4-byte numbers are those of `RTCRay16`, then those of `RTCHit16`, and last the
# mask of valid rays.
BITS, ALIGNED = 4, 64
PACKET = 1 << BITS
ORIGIN, DIRECTION, REACH, MASK, TRIANGLE, GEOMETRY, COPY, VALID, ROWS = (
    0,
    4,
    8,
    9,
    17,
    18,
    19,
    22,
    23,
)
NONE = -1
COMPILED = {"nogil": True, "cache": True, "error_model": "numpy"}
# For functions that are called for each ray: passing arrays and counting references would cost more
# than the work.
INLINED = {**COMPILED, "forceinline": True}
# A face number holds the row of the triangle in its low bits, and above these bits the number of
# its copy.
COPY_BITS = 32
ROW = (1 << COPY_BITS) - 1
# A corner and the unit normal of each triangle, each of shape (row, 3). Of each copy (number 0 is
# the mesh without copies): row of its first triangle, rotation times scale (copy, 3, 3),
# translation (copy, 3) and scale.
Planes = tuple[Array, ...]


@cache
def _library() -> ctypes.CDLL:
    try:
        libraries = [file for file in files("embreex") or () if file.name.startswith("libembree4")]
    except PackageNotFoundError:
        libraries = []
    if not libraries:
        raise BadInput(
            "rays need the library libembree4 that embreex 4.4 ships, got an embreex without it"
        )
    path = str(libraries[0].locate())
    llvmlite.binding.load_library_permanently(path)
    library = ctypes.CDLL(path)
    handle, number, size = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
    for name, result, arguments in (
        ("rtcNewDevice", handle, [ctypes.c_char_p]),
        ("rtcNewScene", handle, [handle]),
        ("rtcNewGeometry", handle, [handle, ctypes.c_int]),
        (
            "rtcSetNewGeometryBuffer",
            handle,
            [handle, ctypes.c_int, number, ctypes.c_int, size, size],
        ),
        ("rtcGetDeviceProperty", size, [handle, ctypes.c_int]),
        ("rtcSetGeometryInstancedScene", None, [handle, handle]),
        ("rtcSetGeometryTransform", None, [handle, number, ctypes.c_int, handle]),
        ("rtcCommitGeometry", None, [handle]),
        ("rtcAttachGeometry", number, [handle, handle]),
        ("rtcReleaseGeometry", None, [handle]),
        ("rtcCommitScene", None, [handle]),
        ("rtcReleaseScene", None, [handle]),
        ("rtcGetDeviceError", ctypes.c_int, [handle]),
    ):
        call = getattr(library, name)
        call.restype, call.argtypes = result, arguments
    return library


@cache
def _device() -> int:
    device = _library().rtcNewDevice(None)
    # Property 0 is the version, 40400 for 4.4.0; the layout of packets and the constants above are
    # those of 4.
    version = _library().rtcGetDeviceProperty(device, 0)
    if version // 10000 != 4:
        raise BadInput(f"rays need Embree 4, got version {version}")
    return device


@dataclass(frozen=True, kw_only=True, eq=False)
class Copied:
    """A mesh with many copies, stored once."""

    vertices_m: Array  # shape (vertex, 3)
    faces: Index  # shape (face, 3)
    turn: Array  # rotation times scale of each copy, shape (copy, 3, 3)
    shift_m: Array  # and then translation, shape (copy, 3)


class EmbreeScene:
    """Triangles in an Embree acceleration structure.

    Parameters
    ----------
    vertices_m
        Shape (vertex, 3), m.
    faces
        Shape (face, 3).
    centre_m
        Origin of Embree's coordinates, which are in single precision, shape (3,), m.
    copied
        Meshes with copies; the copies of a mesh use one acceleration structure.
    """

    def __init__(
        self,
        vertices_m: Array,
        faces: NDArray[np.integer],
        centre_m: Array,
        copied: tuple[Copied, ...] = (),
    ) -> None:
        library, device = _library(), _device()
        scene = library.rtcNewScene(device)
        _attach(scene, _triangles(vertices_m - centre_m, faces))
        for mesh in copied:
            copied_scene = library.rtcNewScene(device)
            _attach(copied_scene, _triangles(mesh.vertices_m, mesh.faces))
            library.rtcCommitScene(copied_scene)
            poses = np.concatenate(
                [mesh.turn, (mesh.shift_m - centre_m)[:, :, None]], axis=2
            ).astype(np.float32)
            for pose in poses:
                copy = library.rtcNewGeometry(device, INSTANCE)
                library.rtcSetGeometryInstancedScene(copy, copied_scene)
                library.rtcSetGeometryTransform(copy, 0, ROWS_3X4, pose.ctypes.data)
                _attach(scene, copy)
            library.rtcReleaseScene(copied_scene)
        library.rtcCommitScene(scene)
        error = library.rtcGetDeviceError(device)
        if error:
            raise BadInput(
                f"Embree must be able to take {len(faces)} triangles, got its error {error}"
            )
        self.address: int = scene
        self.centre_m = centre_m
        finalize(self, library.rtcReleaseScene, scene)

    def hits(self, planes: Planes, origin: Array, direction: Array) -> tuple[Index, Array]:
        """Return the triangle that each ray (ray, 3) hits first, -1 for none, and its distance,
        each of shape (ray,).

        Distances are those of the triangles' planes in double precision.
        """
        face, range_m = np.empty(len(origin), np.int64), np.empty(len(origin))
        _trace_hits(
            self.address,
            self.centre_m,
            planes,
            (origin, direction),
            new_packets(PACKET),
            face,
            range_m,
        )
        return face, range_m

    def is_occluded(self, origin: Array, direction: Array, length_limit: Array) -> Mask:
        """Return whether rays hit a surface within a number of direction lengths, shape (ray,)."""
        occluded = np.empty(len(origin), np.bool_)
        _trace_occlusions(
            self.address,
            self.centre_m,
            (origin, direction, length_limit),
            new_packets(PACKET),
            occluded,
        )
        return occluded


def _triangles(vertices_m: Array, faces: NDArray[np.integer]) -> int:
    """Return a geometry of triangles."""
    library = _library()
    mesh = library.rtcNewGeometry(_device(), TRIANGLES)
    for kind, shape, values in (
        (VERTEX, FLOAT3, np.ascontiguousarray(vertices_m, np.float32)),
        (INDEX, UINT3, np.ascontiguousarray(faces, np.uint32)),
    ):
        buffer = library.rtcSetNewGeometryBuffer(mesh, kind, 0, shape, 12, len(values))
        ctypes.memmove(buffer, values.ctypes.data, values.nbytes)
    return mesh


def _attach(scene: int, geometry: int) -> None:
    library = _library()
    library.rtcCommitGeometry(geometry)
    library.rtcAttachGeometry(scene, geometry)
    library.rtcReleaseGeometry(geometry)


_intersect: Any = types.ExternalFunction("rtcIntersect16", types.void(*(types.uintp,) * 4))
_occluded: Any = types.ExternalFunction("rtcOccluded16", types.void(*(types.uintp,) * 4))


def new_packets(rays: int) -> Array32:
    """Return empty ray packets: one row for each number and one column for each ray."""
    packet_count = -(-rays // PACKET)
    room = np.zeros(packet_count * ROWS * PACKET + ALIGNED // 4, np.float32)
    start = -room.ctypes.data % ALIGNED // 4
    packets = room[start : start + packet_count * ROWS * PACKET].reshape(packet_count, ROWS, PACKET)
    packets.view(np.int32)[:, MASK] = NONE
    return packets


@numba.njit(**INLINED)
def set_ray(packets, slot, centre, origin, direction, length_limit):
    """Set one ray; its length is in units of its direction."""
    packet, lane = slot >> BITS, slot & (PACKET - 1)
    for axis in range(3):
        packets[packet, ORIGIN + axis, lane] = origin[axis] - centre[axis]
        packets[packet, DIRECTION + axis, lane] = direction[axis]
    packets[packet, REACH, lane] = length_limit


@numba.njit(**INLINED)
def intersect(scene, packets, ray_count):
    """Trace the first `ray_count` rays; `triangle_of` returns their hits."""
    for packet in range((ray_count + PACKET - 1) >> BITS):
        rays = _prepare_packet(packets, packet, ray_count)
        _intersect(rays + 4 * VALID * PACKET, scene, rays, 0)


@numba.njit(**INLINED)
def trace_occlusion(scene, packets, ray_count):
    """Trace the first `ray_count` shadow rays; `is_ray_occluded` returns the results."""
    for packet in range((ray_count + PACKET - 1) >> BITS):
        rays = _prepare_packet(packets, packet, ray_count)
        _occluded(rays + 4 * VALID * PACKET, scene, rays, 0)


@numba.njit(**INLINED)
def _prepare_packet(packets, packet, ray_count):
    """Reset a packet with its mask of valid rays, and return its address."""
    number = packets.view(np.int32)
    for lane in range(PACKET):
        number[packet, VALID, lane] = -1 if (packet << BITS) + lane < ray_count else 0
        number[packet, GEOMETRY, lane] = NONE
    return packets.ctypes.data + 4 * ROWS * PACKET * packet


@numba.njit(**INLINED)
def triangle_of(packets, slot, planes):
    """Return the face that a ray hit, -1 for none."""
    number, packet, lane = packets.view(np.int32), slot >> BITS, slot & (PACKET - 1)
    if number[packet, GEOMETRY, lane] == NONE:
        return np.int64(-1)
    triangle, copy = np.int64(number[packet, TRIANGLE, lane]), np.int64(number[packet, COPY, lane])
    # Copies are Embree's geometries from 1; geometry 0 is the mesh without copies.
    return triangle if copy == NONE else (copy << COPY_BITS) + planes[2][copy] + triangle


@numba.njit(**INLINED)
def plane_of(planes, face):
    """Return a corner and the unit normal of a face."""
    row, copy = face & ROW, face >> COPY_BITS
    a, b, c = planes[0][row, 0], planes[0][row, 1], planes[0][row, 2]
    u, v, w = planes[1][row, 0], planes[1][row, 1], planes[1][row, 2]
    if copy == 0:
        return (a, b, c), (u, v, w)
    turn, shift, size = planes[3][copy], planes[4][copy], planes[5][copy]
    corner = (
        turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c + shift[0],
        turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c + shift[1],
        turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c + shift[2],
    )
    return corner, (
        (turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w) / size,
        (turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w) / size,
        (turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w) / size,
    )


@numba.njit(**INLINED)
def is_ray_occluded(packets, slot):
    """Return whether a shadow ray is occluded."""
    return packets[slot >> BITS, REACH, slot & (PACKET - 1)] < 0.0


@numba.njit(**INLINED)
def meet_plane(planes, face, origin, direction):
    """Return the distance along a ray to a face's plane in double precision, the slope on its
    normal, and that.
    """
    corner, normal = plane_of(planes, face)
    height, slope = 0.0, 0.0
    for axis in range(3):
        height += (corner[axis] - origin[axis]) * normal[axis]
        slope += direction[axis] * normal[axis]
    # A ray within the plane, or with the plane behind it by rounding, starts on the triangle.
    length = height / slope
    return (max(length, 0.0) if np.isfinite(length) else 0.0), slope, normal


@numba.njit(**COMPILED)
def _trace_hits(scene, centre, planes, rays, packets, face, range_m):
    origin, direction = rays
    for first in range(0, len(face), PACKET):
        ray_count = min(PACKET, len(face) - first)
        for slot in range(ray_count):
            set_ray(packets, slot, centre, origin[first + slot], direction[first + slot], np.inf)
        intersect(scene, packets, ray_count)
        for slot in range(ray_count):
            i = first + slot
            face[i], range_m[i] = triangle_of(packets, slot, planes), np.inf
            if face[i] >= 0:
                range_m[i] = meet_plane(planes, face[i], origin[i], direction[i])[0]


@numba.njit(**COMPILED)
def _trace_occlusions(scene, centre, rays, packets, occluded):
    origin, direction, length_limit = rays
    for first in range(0, len(occluded), PACKET):
        ray_count = min(PACKET, len(occluded) - first)
        for slot in range(ray_count):
            set_ray(
                packets,
                slot,
                centre,
                origin[first + slot],
                direction[first + slot],
                length_limit[first + slot],
            )
        trace_occlusion(scene, packets, ray_count)
        for slot in range(ray_count):
            occluded[first + slot] = is_ray_occluded(packets, slot)
