"""A scene built for rendering: its surfaces, sky, lamps and air on the bands of a rendering."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from labdata.errors import BadInput
from simulate.arrays import Array
from simulate.radiance.atmosphere import Atmosphere
from simulate.radiance.brdf.protocol import Brdf, read_measured
from simulate.radiance.geometry.surfaces import Surfaces
from simulate.radiance.integrator import environment_map
from simulate.radiance.integrator.light_sources import DiscLight, LampLight, Lighting, Panels
from simulate.radiance.integrator.sampling import shading_frames
from simulate.radiance.integrator.spectral_scene import Air, BsdfSet, Panes, SpectralScene
from simulate.radiance.lamps.distribution import BEAMS, Lamp, read_ies
from simulate.radiance.lamps.spectra import read_spectrum, spectrum
from simulate.radiance.outdoor.build import build_surfaces
from simulate.radiance.outdoor.materials import MaterialSpec
from simulate.radiance.outdoor.scene import LampPlacement, OutdoorScene, Weather
from simulate.radiance.sky.night_sky import NightSky, TownGlow
from simulate.radiance.spectrum import SourceSpectrum, spectral_grid


@dataclass(frozen=True)
class BuiltScene:
    """A scene with its surfaces and light sources."""

    scene: OutdoorScene  # its description

    @cached_property
    def surfaces(self) -> Surfaces:
        """All surfaces; raises BadInput if a lamp touches one."""
        surfaces = build_surfaces(self.scene)
        for post in self.scene.lamp:
            _refuse_touching(post, surfaces)
            if surfaces.panes is not None:
                _refuse_touching(post, surfaces.panes)
        return surfaces

    @cached_property
    def sky(self) -> NightSky | None:
        """The sky; None without a place."""
        location, weather, sky = self.scene.place, self.scene.weather, self.scene.sky
        if location is None:
            return None
        towns = tuple(TownGlow(**vars(town)) for town in sky.towns)
        fields = {
            "airglow": sky.airglow,
            "zodiacal": sky.zodiacal,
            "starlight": sky.starlight,
            "towns": towns,
        }
        night_sky = NightSky.at(
            location, location.moment, atmosphere=_atmosphere(weather), **fields
        )
        shining = {"moon": sky.moon, "sun": sky.sun}
        return replace(
            night_sky, bodies=tuple(body for body in night_sky.bodies if shining[body.name])
        )

    @cached_property
    def lamps(self) -> tuple[tuple[LampPlacement, Lamp], ...]:
        """Lamps with flux, and their light."""
        lamps = ((post, _lamp(self.scene, post)) for post in self.scene.lamp)
        return tuple((post, lamp) for post, lamp in lamps if lamp.flux.total() > 0.0)

    @cached_property
    def emitting_materials(self) -> tuple[tuple[str, SourceSpectrum], ...]:
        """Emitting materials and their radiance, W m-2 sr-1: of a Lambertian surface, exitance over
        pi.
        """
        return tuple(
            (
                surface.label,
                spectrum(surface.lamp, lumens=surface.glow_lm_per_m2).scale(1.0 / np.pi),
            )
            for surface in self.scene.material
            if surface.glow_lm_per_m2 > 0.0
        )

    def sources(self) -> tuple[SourceSpectrum, ...]:
        """Return the spectra of all sources."""
        natural = () if self.sky is None else self.sky.sources()
        lamps = tuple(lamp.flux for _, lamp in self.lamps)
        return (*natural, *lamps, *(glow for _, glow in self.emitting_materials))

    def bands(self, response_nm: ArrayLike, response: ArrayLike, tolerance: float) -> Array:
        """Return the bands for the sources, materials and a sensor, see `spectral_grid`."""
        used_labels = {
            self.surfaces.materials[number] for number in np.unique(self.surfaces.material_of)
        }
        used_labels |= set() if self.surfaces.panes is None else set(self.surfaces.panes.materials)
        spectra = [
            self._spectrum(surface)
            for surface in self.scene.material
            if surface.label in used_labels
        ]
        spectra = [(nm, reflectance) for nm, reflectance in spectra if len(nm) > 1]
        return spectral_grid(
            self.sources(), response_nm, response, tolerance=tolerance, spectra=spectra
        )

    def on(self, wavelength_nm: Array) -> SpectralScene:
        """Return the scene on bands."""
        grid = np.asarray(wavelength_nm, float)
        surfaces = self.surfaces
        by_label = {surface.label: surface for surface in self.scene.material}
        brdfs: tuple[Brdf, ...] = tuple(
            surface.material.brdf()
            if surface.measured is None
            else read_measured(self.scene.file(surface.measured))
            for surface in (by_label[name] for name in surfaces.materials)
        )
        bsdfs = BsdfSet.of(brdfs, grid)
        if surfaces.panes is not None:
            bsdfs = replace(bsdfs, panes=_panes(surfaces.panes, by_label, grid))
        air = Air()
        if self.sky is not None:
            air = Air.of(self.sky.air(), grid)
        elif self.scene.weather is not None:
            # Without a place air only attenuates.
            air = Air.of(_atmosphere(self.scene.weather), grid)
        return SpectralScene(surfaces=surfaces, bsdfs=bsdfs, lighting=self._lighting(grid), air=air)

    def with_light_of(self, scene: SpectralScene) -> SpectralScene:
        """Return the scene on the bands of another one that differs by the poses of its objects
        alone.
        """
        surfaces, bsdfs, grid = self.surfaces, scene.bsdfs, scene.bsdfs.wavelength_nm
        if surfaces.panes is not None:
            by_label = {surface.label: surface for surface in self.scene.material}
            bsdfs = replace(bsdfs, panes=_panes(surfaces.panes, by_label, grid))
        lighting = replace(scene.lighting, panels=self._panels(grid))
        return replace(scene, surfaces=surfaces, bsdfs=bsdfs, lighting=lighting)

    def _spectrum(self, surface: MaterialSpec) -> tuple[Sequence[float], Array]:
        """Return wavelengths and reflectance of a material's table; of a measured one the albedo at
        normal view.
        """
        if surface.pane_transmittance is not None:
            return surface.wavelength_nm, surface.let_through(np.asarray(surface.wavelength_nm))
        if surface.measured is None:
            return surface.material.wavelength_nm, surface.material.reflectance_at(
                surface.material.wavelength_nm
            )
        table = read_measured(self.scene.file(surface.measured))
        upright = table.albedo(np.array([[0.0, 0.0, 1.0]]), table.wavelength_nm)[:, 0]
        return tuple(float(nm) for nm in table.wavelength_nm), upright

    def _lighting(self, grid: Array) -> Lighting:
        sky = self.sky
        sky_map = (
            environment_map.black(len(grid))
            if sky is None
            else environment_map.environment_map(lambda direction: sky.radiance(direction, grid))
        )
        discs = () if sky is None else sky.discs()
        return Lighting(
            environment_map=sky_map,
            discs=tuple(
                DiscLight(
                    name=disc.name,
                    direction=np.asarray(disc.direction, float),
                    angular_radius_rad=disc.angular_radius_rad,
                    irradiance=disc.irradiance(grid).astype(np.float32),
                )
                for disc in discs
            ),
            lamps=tuple(_lamp_light(post, lamp, grid) for post, lamp in self.lamps),
            panels=self._panels(grid),
        )

    def _panels(self, grid: Array) -> Panels | None:
        if not self.emitting_materials:
            return None
        names = [name for name, _ in self.emitting_materials]
        kinds = np.array(
            [names.index(name) if name in names else -1 for name in self.surfaces.materials],
            np.int64,
        )
        spectra = np.array([glow.on(grid) for _, glow in self.emitting_materials], np.float32)
        return Panels.of(self.surfaces, kinds[self.surfaces.material_of], spectra)


def _panes(surfaces: Surfaces, by_label: dict[str, MaterialSpec], grid: Array) -> Panes:
    glass = [by_label[name] for name in surfaces.materials]
    return Panes(
        tracer=surfaces.tracer,
        kind_of_face=surfaces.material_of,
        transmittance=np.array([pane.let_through(grid) for pane in glass]),
        refractive_index=tuple(pane.glass_index for pane in glass),
    )


def _atmosphere(weather: Weather | None) -> Atmosphere:
    weather = weather or Weather()
    return Atmosphere(
        visibility_km=weather.visibility_km,
        relative_humidity=weather.relative_humidity,
        temperature_c=weather.temperature_c,
    )


def _lamp(scene: OutdoorScene, post: LampPlacement) -> Lamp:
    measured = read_ies(scene.file(post.beam)) if post.has_photometric_file else None
    distribution = BEAMS[post.beam](post) if measured is None else measured.table
    power = {
        "watts": post.watts,
        "lumens": measured.lumens if post.lumens is None and measured else post.lumens or 0.0,
    }
    if post.kind.endswith(".csv"):
        flux = read_spectrum(scene.file(post.kind), **power)
    else:
        flux = spectrum(
            post.kind,
            **power,
            temperature_k=post.temperature_k,
            near_infrared_share=post.near_infrared_share,
            wavelength_nm=post.wavelength_nm,
            width_nm=post.width_nm,
        )
    return Lamp(flux=flux, distribution=distribution)


def _lamp_light(post: LampPlacement, lamp: Lamp, grid: Array) -> LampLight:
    position = np.asarray(post.position_m, float)
    axis = (
        np.array([0.0, 0.0, -1.0])
        if post.aim_m is None
        else np.asarray(post.aim_m, float) - position
    )
    frame = _frame(axis / np.linalg.norm(axis), post.heading_deg)
    return LampLight(
        name=post.label,
        position_m=position,
        radius_m=post.radius_m,
        spectrum=lamp.flux.on(grid).astype(np.float32),
        distribution=lamp.distribution,
        frame=frame,
    )


def _frame(axis: Array, heading_deg: float) -> Array:
    """Return the axes of a lamp as rows: C0, C90 (counterclockwise from above for a lamp that
    shines down), axis.
    """
    heading = np.deg2rad(heading_deg)
    c0_axis = np.array([np.sin(heading), np.cos(heading), 0.0])
    c0_axis -= (c0_axis @ axis) * axis
    length = np.linalg.norm(c0_axis)
    if length < 1e-9:
        return shading_frames(axis[None])[0]
    c0_axis /= length
    return np.stack([c0_axis, np.cross(c0_axis, axis), axis])


def _refuse_touching(post: LampPlacement, surfaces: Surfaces) -> None:
    """Raise BadInput if a lamp's sphere touches a surface, which would occlude it in part."""
    centre = np.asarray(post.position_m, float)
    for corners, name in surfaces.triangles_near(centre, post.radius_m):
        import trimesh

        closest = trimesh.triangles.closest_point(
            corners, np.broadcast_to(centre, (len(corners), 3))
        )
        distance = np.linalg.norm(closest - centre, axis=1).min()
        if distance < post.radius_m:
            raise BadInput(
                f"a lamp must stand clear of surfaces by its radius of {post.radius_m:g} m, got "
                f"{post.label!r} {distance:.3g} m from {name!r}"
            )
