"""Small scenes for tests of light transport: shapes put together, lit, and asked what light they
get.
"""

import numpy as np
from numpy.typing import NDArray

from simulate.radiance.brdf import Brdf, Lambert, grey
from simulate.radiance.geometry import Mesh, collect_surfaces
from simulate.radiance.integrator import (
    Air,
    BsdfSet,
    DiscLight,
    IntegratorSettings,
    LampLight,
    Lighting,
    Panels,
    SpectralScene,
    black,
    environment_map,
    outgoing_radiance,
)
from simulate.radiance.lamps import Isotropic

NM = np.array([500.0, 600.0])
UP = (0.0, 0.0, 1.0)
DIRECT = IntegratorSettings(max_bounces=0)
# The sky that is equally bright everywhere, and the one that is three times as bright overhead.
UNIFORM = lambda way: np.ones((2, len(way)))  # noqa: E731
OVERCAST = lambda way: np.ones((2, 1)) * (1.0 + 2.0 * way[:, 2]) / 3.0  # noqa: E731


def staged(parts, rho, *, glow=None, sky=None, lamps=(), discs=()) -> SpectralScene:
    """Return a stage of (object, material, mesh) with a reflectance or a BRDF by material and a
    glow by material.
    """
    found = collect_surfaces(parts)
    brdfs: tuple[Brdf, ...] = tuple(
        Lambert(reflectance=grey(rho[name])) if isinstance(rho[name], float) else rho[name]
        for name in found.materials
    )
    names = list(glow or {})
    of_material = np.array(
        [names.index(name) if name in names else -1 for name in found.materials], np.int64
    )
    spectra = np.array([[value, value] for value in (glow or {}).values()], np.float32).reshape(
        -1, 2
    )
    lighting = Lighting(
        environment_map=environment_map.environment_map(sky) if sky else black(2),
        lamps=lamps,
        discs=discs,
        panels=Panels.of(found, of_material[found.material_of], spectra) if glow else None,
    )
    return SpectralScene(surfaces=found, bsdfs=BsdfSet.of(brdfs, NM), lighting=lighting, air=Air())


def at(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    """Return a mesh moved."""
    return Mesh(mesh.vertices_m + np.array([x, y, z]), mesh.faces)


def inside_out(mesh: Mesh) -> Mesh:
    """Return a mesh whose other side is outside."""
    return Mesh(mesh.vertices_m, mesh.faces[:, ::-1])


def upright(mesh: Mesh) -> Mesh:
    """Return a mesh turned about x so that what faced up faces south, -y."""
    return Mesh(mesh.vertices_m @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float), mesh.faces)


def lamp(position, intensity=1.0, radius=1e-3) -> LampLight:
    """Return an isotropic lamp."""
    spectrum = np.full(2, 4.0 * np.pi * intensity, np.float32)
    place = np.asarray(position, float)
    return LampLight(
        name="lamp",
        position_m=place,
        radius_m=radius,
        spectrum=spectrum,
        distribution=Isotropic(),
        frame=np.eye(3),
    )


def disc_light(direction, radius_rad=0.00465, irradiance=1.0) -> DiscLight:
    """Return a sun."""
    towards = np.asarray(direction, float) / np.linalg.norm(direction)
    spectrum = np.full(2, irradiance, np.float32)
    return DiscLight(
        name="sun", direction=towards, angular_radius_rad=radius_rad, irradiance=spectrum
    )


def irradiance(
    stage: SpectralScene,
    places,
    normal,
    *,
    seed=1,
    effort=DIRECT,
    rays=16,
    sky_control_fraction=1.0,
) -> NDArray[np.floating]:
    """Return the irradiance of places (place, 3) on surfaces with a normal, looked at along it,
    shape (place,).
    """
    places = np.atleast_2d(np.asarray(places, float))
    normals = np.broadcast_to(np.asarray(normal, float), places.shape)
    hit = stage.surfaces.tracer.hits(places + 1e-2 * normals, -normals)
    share = np.full(len(places), sky_control_fraction, np.float32)
    points = stage.bsdfs.points(stage.surfaces, hit.face, places, -normals, share)
    light = outgoing_radiance.outgoing_radiance(
        stage, points, effort, np.random.default_rng(seed), rays=rays
    ).total()[:, 0]
    return light / stage.bsdfs.rho_by_pi[points.material, 0]


def agree(found: NDArray[np.floating], exact: float, relative: float = 0.005) -> None:
    """Assert that a mean is exact within 0.5 % or three standard errors, and that these are no
    excuse.
    """
    mean, error = float(np.mean(found)), float(np.std(found) / np.sqrt(len(found)))
    print(
        f"{mean:.6g} for {exact:.6g}: {100.0 * (mean / exact - 1.0):+.3f} %, standard error "
        f"{100 * error / exact:.3f} %"
    )
    assert abs(mean - exact) <= max(relative * exact, 3.0 * error)
    assert error < 0.02 * exact
