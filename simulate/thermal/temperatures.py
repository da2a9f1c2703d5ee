"""Surface temperatures of a scene: of its objects over a day, and of the pixels of a view at the
scene's time.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import resources

import numpy as np

from labdata import BadInput, from_mapping, read_toml
from labdata.camera.parameters import Parameter
from simulate.arrays import Array, Array32, Index
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.integrator_settings import workers
from simulate.radiance.integrator.sampling import SequenceSlice, low_discrepancy_points
from simulate.radiance.outdoor.build import build_surfaces
from simulate.radiance.outdoor.built_scene import BuiltScene
from simulate.radiance.outdoor.materials import MaterialSpec, Slab
from simulate.radiance.outdoor.poses import rotation_of
from simulate.radiance.outdoor.scene import OutdoorScene
from simulate.radiance.sky.moon import sun_spectrum
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.balance import GROUND_REFLECTANCE, LAST, Balance, Solution
from simulate.thermal.exposure import (
    Spots,
    Views,
    exposure_of,
    facets_of,
    precise_view,
    sun_cosines,
)
from simulate.thermal.slab import ZERO_C
from simulate.thermal.thresholds import LIMITS
from simulate.thermal.weather import DAY_STEPS, weather_of

# Slab of panes that name none.
GLASS = "window-glass"


@cache
def library() -> dict[str, Slab]:
    """Return the slabs that ship by their names."""
    with resources.as_file(resources.files("simulate.thermal") / "library.toml") as path:
        tables = read_toml(path)["slab"]
    return {
        name: from_mapping(table | {"label": name}, Slab, where="library.toml")
        for name, table in tables.items()
    }


def slab_of(scene: OutdoorScene, surface: MaterialSpec) -> Slab:
    """Return the slab of a material of a scene, its absorptivity known.

    Raises
    ------
    BadInput
        If the material has no slab, or names one that neither the scene nor the library has.

    Notes
    -----
    Where the scene states the material's reflectance by numbers, the absorptivity is 1 minus that
    reflectance over the sun's spectrum, unless the scene's slab states it; elsewhere that of the
    slab.
    """
    described = {slab.label: slab for slab in scene.slab}
    name = (
        surface.slab
        or surface.material.slab
        or (None if surface.pane_transmittance is None else GLASS)
    )
    if name is None:
        raise BadInput(
            f"a material must have a slab for its temperature, got {surface.label!r} without one; "
            f"give slab = one of {', '.join(sorted({*described, *library()}))}, or describe one "
            "in [[slab]]"
        )
    if name not in described and name not in library():
        raise BadInput(
            f"slab must be one of {', '.join(sorted({*described, *library()}))}, got {name!r} of "
            f"{surface.label!r}"
        )
    slab = described.get(name) or library()[name]
    if slab.absorptivity is not None and (name in described or surface.reflectance is None):
        return slab
    return replace(slab, absorptivity=_absorptivity(surface))


def _absorptivity(surface: MaterialSpec) -> Parameter:
    """1 minus the reflectance over the sun's spectrum; tables end before the sun does and are
    constant from there.
    """
    sun = sun_spectrum()
    nm = np.asarray(sun.wavelength_nm)
    reflectance = np.trapezoid(
        surface.material.reflectance_at(nm) * sun.density, nm
    ) / np.trapezoid(sun.density, nm)
    return Parameter(
        value=float(1.0 - reflectance),
        standing="derived",
        source=f"reflectance of {surface.label!r} over the sun from {nm[0]:.0f} to {nm[-1]:.0f} "
        f"nm, its table constant beyond {surface.material.wavelength_nm[-1]:.0f} nm",
    )


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of a scene.

    Parameters
    ----------
    balance, solution
        What acts on its facets, and their temperatures.
    at_rest, returns
        Of a scene whose objects have moved since its time: the temperatures of that time, and
        rotation (facet, 3, 3) and shift (facet, 3), m, by which points on each facet return to
        where they were.
    """

    balance: Balance
    solution: Solution
    at_rest: "Temperatures | None" = None
    returns: tuple[Array, Array] | None = None

    def moved(self, scene: OutdoorScene) -> "Temperatures":
        """Return the temperatures of the scene with its objects in other poses for some seconds.

        Surfaces keep their temperatures, those that an object had heated or shaded among them. The
        light that facets reflect onto each other stays as before.
        """
        poses = {scene_object.label: scene_object for scene_object in scene.object}
        pairs = [(scene_object, poses[scene_object.label]) for scene_object in self.balance.things]
        if all(
            replace(rest_pose, keyframe=()) == replace(pose_now, keyframe=())
            for rest_pose, pose_now in pairs
        ):
            return self
        rotation = np.array(
            [rotation_of(rest_pose) @ rotation_of(pose_now).T for rest_pose, pose_now in pairs]
        )
        rest_m, now_m = (
            np.array([pose.position_m for pose in poses]) for poses in zip(*pairs, strict=True)
        )
        shift_m = rest_m - np.einsum("fij,fj->fi", rotation, now_m)
        clear = build_surfaces(scene)
        surfaces = clear if clear.panes is None else build_surfaces(scene, opaque=True)
        facets = replace(self.balance.facets, surfaces=surfaces, shades=clear.tracer)
        balance = replace(self.balance, facets=facets)
        return Temperatures(balance, self.solution, at_rest=self, returns=(rotation, shift_m))

    def means_c(self) -> tuple[list[float], Array, dict[str, Array]]:
        """Return the temperatures of the day before the scene's time, by hours.

        Returns
        -------
        hours, air_c, surfaces_c
            25 hours of local time; the air's temperature, C; mean over the area of each
            OBJECT:MATERIAL, C.
        """
        weather, facets = self.balance.weather, self.balance.facets
        steps = np.maximum(len(weather) - 1 - LIMITS.steps_of_hour * np.arange(24, -1, -1), 0)
        times = [weather.times[step] for step in steps]
        hours = [round(time.hour + time.minute / 60.0 + time.second / 3600.0, 4) for time in times]
        means = {}
        for name in dict.fromkeys(facets.names):
            mask = np.array([facet_name == name for facet_name in facets.names])
            faces = self.solution.faces_k[steps][:, mask]
            means[name] = np.average(faces, axis=1, weights=facets.area_m2[mask]) - ZERO_C
        return hours, weather.air_k[steps] - ZERO_C, means

    def last_sd_k(self) -> dict[str, float]:
        """Return the standard deviation of the last mean of each OBJECT:MATERIAL, K.

        Notes
        -----
        Each input of `UNCERTAINTY` is off alike everywhere, so that its effect is averaged with its
        sign; different inputs are independent. What was left out counts in full.
        """
        facets = self.balance.facets
        left_out_k = 1e-3 * sum(effect.influence for effect in self.solution.left_out)
        sd_of_name = {}
        for name in dict.fromkeys(facets.names):
            mask = np.array([facet_name == name for facet_name in facets.names])
            errors, area = self.solution.errors_k.values(), facets.area_m2[mask]
            effects_k = [float(np.average(error[mask], weights=area)) for error in errors]
            free = self.solution.kernel[:, mask].any()
            sd_of_name[name] = math.hypot(*effects_k, left_out_k if free else 0.0)
        return sd_of_name

    def map_k(
        self, viewpoint: Viewpoint, progress: Callable[[float], None] = lambda fraction: None
    ) -> Array32:
        """Return the temperatures of the middles of a view's pixels at the scene's time, NaN for
        the sky, K.

        Notes
        -----
        A pixel's point differs from its facet by what it sees of sun, sky and surfaces. Kernels
        make these fluxes a temperature, from the facet as it is and from the same in the shade,
        weighted by how near each one is.
        """
        _ = (self.at_rest or self)._references
        parts, starts = [], list(range(0, viewpoint.shape[0], LIMITS.rows))
        with workers(min(2, os.cpu_count() or 1)) as run:
            for part in run(lambda row: self._rows(viewpoint, row), starts):
                parts.append(part)
                progress(len(parts) / len(starts))
        return np.concatenate(parts)

    def _rows(self, viewpoint: Viewpoint, start: int) -> Array32:
        surfaces, stop = self.balance.facets.surfaces, min(start + LIMITS.rows, viewpoint.shape[0])
        row, col = np.mgrid[start:stop, : viewpoint.shape[1]].reshape(2, -1)
        origin, direction = viewpoint.rays(row + 0.5, col + 0.5)
        hit = surfaces.tracer.hits(origin, direction)
        rays = hit.rays
        spots = Spots.on(
            surfaces, hit.face[rays], origin[rays] + hit.range_m[rays, None] * direction[rays]
        )
        kelvin = np.full(len(row), np.nan, np.float32)
        sequence = low_discrepancy_points(row[rays], col[rays], LIMITS.pixel_rays, [start])
        kelvin[rays] = self.spots_k(
            self.balance.facets.of_faces(hit.face[rays]),
            spots,
            precise_view(surfaces, spots, sequence),
        )
        return kelvin.reshape(stop - start, -1)

    def spots_k(self, facet: Index, spots: Spots, views: Views) -> Array:
        """Return the temperatures of spots on facets (spot,) at the scene's time by what they see,
        shape (spot,), K.
        """
        if self.at_rest is not None and self.returns is not None:
            rotation, shift = (values[facet] for values in self.returns)
            rest_spots = Spots(
                start_m=np.einsum("sij,sj->si", rotation, spots.start_m) + shift,
                normal=np.einsum("sij,sj->si", rotation, spots.normal),
            )
            sequence = SequenceSlice.random(
                len(facet), LIMITS.pixel_rays, np.random.default_rng(len(facet))
            )
            views = precise_view(self.at_rest.balance.facets.surfaces, rest_spots, sequence)
            return self.at_rest.spots_k(facet, rest_spots, views)
        facets, slots = (
            self.balance.facets,
            np.arange(LIMITS.slot_steps // 2, DAY_STEPS, LIMITS.slot_steps),
        )
        spot, face, weight_of_ray, _ = views.surfaces()
        seen_facet = facets.of_faces(face)
        sun = self.balance.weather.sun[LAST][slots]
        is_up = np.flatnonzero(sun[:, 2] > 0.0)
        lit = sun_cosines(facets.shades, spots, sun[is_up])
        kelvin, weight = [], []
        for reference in self._references:
            change = (
                np.einsum("sr,sr->s", reference.rings[facet], views.rings)
                + reference.off_scene[facet] * views.off_scene
            )
            change += (
                np.bincount(
                    spot, weight_of_ray * reference.surfaces[facet[spot], seen_facet], len(facet)
                )
                - reference.due_k[facet]
            )
            change += np.einsum("ts,ts->s", reference.sun[np.ix_(is_up, facet)], lit)
            kelvin.append(reference.last_k[facet] + change)
            weight.append(1.0 / (change**2 + LIMITS.near_k**2))
        return np.average(kelvin, axis=0, weights=weight)

    @cached_property
    def _references(self) -> "tuple[_Reference, ...]":
        solution, lit = self.solution, self.balance.exposure.lit
        pairs = (
            (solution.faces_k[-1], solution.kernel, lit),
            (solution.shaded_k, solution.shaded_kernel, 0.0 * lit),
        )
        return tuple(self._reference(*pair) for pair in pairs)

    def _reference(self, last_k: Array, kernel: Array, lit: Array) -> "_Reference":
        balance, weather, exposure = self.balance, self.balance.weather, self.balance.exposure
        heating, emissivity = balance.heating, balance.emissivity
        direct = (
            (kernel * weather.direct_w_m2[LAST, None])
            .reshape(-1, LIMITS.slot_steps, kernel.shape[1])
            .sum(axis=1)
        )
        sunlight = balance.reflectivity * (balance.sunlight + balance.sunlight_by_reflection)[LAST]
        longwave = balance.radiosity(self.solution.faces_k[LAST])
        ground = (
            GROUND_REFLECTANCE * weather.global_w_m2[LAST],
            STEFAN_BOLTZMANN * weather.air_k[LAST] ** 4,
        )
        sun = heating * direct
        sky = heating[:, None] * (kernel.T @ weather.diffuse_w_m2[LAST, None])
        rings = sky + emissivity[:, None] * (kernel.T @ balance.rings[LAST])
        surfaces = heating[:, None] * (kernel.T @ sunlight) + emissivity[:, None] * (
            kernel.T @ longwave
        )
        off_scene = heating * (kernel.T @ ground[0]) + emissivity * (kernel.T @ ground[1])
        due_k = (
            (rings * exposure.rings).sum(axis=1)
            + (surfaces * exposure.sees).sum(axis=1)
            + off_scene * exposure.off_scene
        )
        due_k += (
            sun
            * lit[
                np.arange(LIMITS.slot_steps // 2, DAY_STEPS, LIMITS.slot_steps) // LIMITS.sun_steps
            ]
        ).sum(axis=0)
        return _Reference(
            last_k=last_k, due_k=due_k, sun=sun, rings=rings, surfaces=surfaces, off_scene=off_scene
        )


@dataclass(frozen=True, kw_only=True)
class _Reference:
    """Last temperatures of facets, and what raises them, K.

    Parameters
    ----------
    last_k, due_k
        The temperature, and what of it is due to all that the facet sees, shape (facet,).
    sun
        By the sun in each slot of the day at a cosine of 1, shape (slot, facet).
    rings, surfaces, off_scene
        By all that comes from each ring of the sky (facet, ring), from each facet (facet, facet)
        and from the ground where the scene ends (facet,), were it all that is seen.
    """

    last_k: Array
    due_k: Array
    sun: Array
    rings: Array
    surfaces: Array
    off_scene: Array


def temperatures_of(
    scene: OutdoorScene, *, tolerance_mk: float = LIMITS.tolerance_mk, seed: int = 0
) -> Temperatures:
    """Return the surface temperatures of a scene.

    Parameters
    ----------
    scene
        A scene out of doors with a place, weather, and materials that have slabs.
    tolerance_mk
        What terms left out may change at the scene's time, mK.
    seed
        Seed of the points and rays by which facets see sun, sky and each other.

    Raises
    ------
    BadInput
        If the scene lacks a place, weather with wind, or the slab of a material; if its weather
        file does not suit.
    """
    weather, clear = weather_of(scene), BuiltScene(scene).surfaces
    surfaces = clear if clear.panes is None else build_surfaces(scene, opaque=True)
    if not len(surfaces.mesh.faces):
        raise BadInput(
            f"a scene must have an object with a surface for temperatures, got none in "
            f"{scene.name!r}"
        )
    by_label = {surface.label: surface for surface in scene.material}
    slabs = {name: slab_of(scene, by_label[name]) for name in surfaces.materials}
    objects, facets = (
        {scene_object.label: scene_object for scene_object in scene.object},
        facets_of(surfaces, clear.tracer),
    )
    assert scene.weather is not None
    balance = Balance(
        facets=facets,
        exposure=exposure_of(
            facets, weather.sun[LAST][:: LIMITS.sun_steps], np.random.default_rng(seed)
        ),
        slabs=tuple(slabs[surfaces.materials[number]] for number in facets.material),
        things=tuple(objects[surfaces.objects[number]] for number in facets.object),
        weather=weather,
        state=scene.weather,
    )
    return Temperatures(balance, balance.solve(tolerance_mk))
