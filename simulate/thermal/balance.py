"""Heat balance of the facets of a scene, with the influence of retained and neglected terms."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from simulate.arrays import Array, Index
from simulate.effect_selection import OptionalEffect
from simulate.radiance.outdoor.materials import Slab
from simulate.radiance.outdoor.scene import Object
from simulate.radiance.outdoor.scene import Weather as State
from simulate.radiance.spectrum import STEFAN_BOLTZMANN
from simulate.thermal.clear_day import sky_radiance
from simulate.thermal.exposure import RING_SINE, Exposure, Facets
from simulate.thermal.slab import (
    ZERO_C,
    Columns,
    Exchange,
    Forcing,
    kernels,
    march,
    periodic_start,
    vapour_pressure_pa,
)
from simulate.thermal.thresholds import LIMITS, UNCERTAINTY
from simulate.thermal.weather import DAY_STEPS, Weather

# Reflectance of the ground beyond the scene, which has the temperature of the air.
GROUND_REFLECTANCE = 0.2
# Irradiance of the full moon in the zenith, W m-2.
FULL_MOON_W_M2 = 0.003
LAST = slice(-DAY_STEPS, None)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Temperatures of facets.

    Parameters
    ----------
    faces_k
        At the end of each step of the weather, shape (step, facet), K.
    kernel
        Effect of the flux at each step of the last day on the last temperature, 0 for prescribed
        ones, shape (`DAY_STEPS`, facet), K per W m-2.
    shaded_k, shaded_kernel
        Last temperature (facet,), K, and kernel of the same facets without direct sun.
    effects, left_out
        What terms change at the last time, and what those left out could have changed: mK, at the
        facet where most.
    errors_k
        Change of the last temperature by one standard deviation of each input (`UNCERTAINTY`),
        shape (facet,), K.
    """

    faces_k: Array
    kernel: Array
    shaded_k: Array
    shaded_kernel: Array
    effects: tuple[OptionalEffect, ...] = ()
    left_out: tuple[OptionalEffect, ...] = ()
    errors_k: dict[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Balance:
    """Heat fluxes of facets.

    Parameters
    ----------
    facets, exposure
        Facets and their view factors; `exposure.lit` at every `LIMITS.sun_steps`-th step of the
        last day.
    slabs, things
        Slab, with its absorptivity, and object of each.
    weather, state
        The weather, and the scene's table of it, which names the law of convection.
    """

    facets: Facets
    exposure: Exposure
    slabs: tuple[Slab, ...]
    things: tuple[Object, ...]
    weather: Weather
    state: State

    @cached_property
    def emissivity(self) -> Array:
        """Shape (facet,)."""
        return np.array([float(slab.emissivity) for slab in self.slabs])

    @cached_property
    def absorptivity(self) -> Array:
        """Shape (facet,)."""
        return np.array([float(slab.absorptivity or 0.0) for slab in self.slabs])

    @cached_property
    def reflectivity(self) -> Array:
        """Fraction of sunlight that is reflected, shape (facet,)."""
        transmittance = np.array([float(slab.transmittance) for slab in self.slabs])
        return np.maximum(1.0 - self.absorptivity - transmittance, 0.0)

    @cached_property
    def heating(self) -> Array:
        """Fraction of sunlight that heats, not reflected and not spent on evaporation, shape
        (facet,).
        """
        return self.absorptivity * (
            1.0 - np.array([float(slab.latent_fraction) for slab in self.slabs])
        )

    @cached_property
    def rings(self) -> Array:
        """Pi times the longwave radiance of each ring of the sky, shape (step, ring), W m-2."""
        weather = self.weather
        emissivity = weather.longwave_w_m2 / (STEFAN_BOLTZMANN * weather.air_k**4)
        return sky_radiance(emissivity, weather.air_k, weather.dew_point_k, RING_SINE)

    @cached_property
    def direct_sunlight(self) -> Array:
        """Sunlight straight from the sun, shape (step, facet), W m-2; shadows of each day are those
        of the last one.
        """
        step, sun_steps = np.arange(DAY_STEPS) / LIMITS.sun_steps, np.arange(len(self.exposure.lit))
        lit = np.stack([np.interp(step, sun_steps, facet) for facet in self.exposure.lit.T], axis=1)
        return self.weather.direct_w_m2[:, None] * np.tile(lit, (len(self.weather) // DAY_STEPS, 1))

    @cached_property
    def sunlight(self) -> Array:
        """Sunlight straight from sun and sky, shape (step, facet), W m-2."""
        return self.direct_sunlight + self.weather.diffuse_w_m2[:, None] * self.exposure.sky

    @cached_property
    def sunlight_by_reflection(self) -> Array:
        """Sunlight by way of one reflection, shape (step, facet), W m-2."""
        from_ground = (
            GROUND_REFLECTANCE * self.weather.global_w_m2[:, None] * self.exposure.off_scene
        )
        return self._reflect(self.sunlight) + from_ground

    def longwave(self, faces_k: Array) -> tuple[Array, Array]:
        """Return longwave from the sky and from surfaces of given temperatures, shape (step,
        facet), W m-2.
        """
        exposure, steps = self.exposure, slice(len(self.weather) - len(faces_k), None)
        ground = STEFAN_BOLTZMANN * self.weather.air_k[steps, None] ** 4 * exposure.off_scene
        return self.rings[steps] @ exposure.rings.T, self.radiosity(
            faces_k
        ) @ exposure.sees.T + ground

    def radiosity(self, faces_k: Array) -> Array:
        """Return longwave that facets emit and mirror, at temperatures of the last steps, shape
        (step, facet), W m-2.

        They reflect the visible sky, and otherwise surfaces at their own temperature.
        """
        emitted, steps = (
            STEFAN_BOLTZMANN * faces_k**4,
            slice(len(self.weather) - len(faces_k), None),
        )
        incoming = self.rings[steps] @ self.exposure.rings.T + (1.0 - self.exposure.sky) * emitted
        return self.emissivity * emitted + (1.0 - self.emissivity) * incoming

    def solve(self, tolerance_mk: float) -> Solution:
        """Return the temperatures of facets.

        Parameters
        ----------
        tolerance_mk
            What further passes of neighbours, and a second reflection of the sun, may change at the
            last time, mK.

        Notes
        -----
        The first pass takes neighbours at the temperature of the air, each further one at their
        own. Each shrinks the error by no less than (1 - F) h_r/(h_r + h).
        """
        tolerance = 1e-3 * tolerance_mk
        rules = [self._rule_temperature_k(facet) for facet in range(len(self.facets))]
        at_air = np.stack([self.weather.air_k if rule is None else rule for rule in rules], axis=1)
        free = np.flatnonzero([rule is None for rule in rules])
        kernel = np.zeros((DAY_STEPS, len(rules)))
        if not len(free):
            errors = {"prescribed temperature": self._sd_of_prescribed_k()}
            return Solution(
                faces_k=at_air,
                kernel=kernel,
                shaded_k=at_air[-1],
                shaded_kernel=kernel,
                errors_k=errors,
            )
        columns = Columns.of([self.slabs[facet] for facet in free])
        second, additional = self._reflect(self.sunlight_by_reflection), 0.0
        faces, flux, passes = at_air, self._flux(at_air), 1
        while True:
            forcing = self._forcing(free, flux)
            faces = np.array(at_air)
            faces[:, free] = _face_temperatures(columns, forcing)
            if passes == 1:
                kernel[:, free] = kernels(columns, forcing.part(LAST), faces[LAST][:, free])
                by_two = _effect(kernel, self.heating * second)
                additional = second if by_two > tolerance else 0.0
            next_flux = self._flux(faces) + self.heating * additional
            radiative = 4.0 * STEFAN_BOLTZMANN * (self.emissivity * faces[-1] ** 3)[free]
            shrink = (
                (1.0 - self.exposure.sky[free]) * radiative / forcing.loss(faces[-1, free], -1)[1]
            )
            remaining_k = _effect(kernel, next_flux - flux) / (1.0 - float(shrink.max()))
            if remaining_k <= tolerance or passes == LIMITS.max_neighbour_passes:
                break
            flux, passes = next_flux, passes + 1
        kernel[:, free] = kernels(columns, forcing.part(LAST), faces[LAST][:, free])
        terms = {
            name: _effect(kernel, term)
            for name, term in self._terms(free, flux, faces, at_air).items()
        }
        neglected = {
            f"neighbours at their own temperatures, pass {passes + 1} and further": remaining_k,
            "moonlight, were the moon full": _effect(
                kernel, np.full((DAY_STEPS, 1), FULL_MOON_W_M2)
            ),
        }
        (neglected if by_two <= tolerance else terms)["sunlight by two reflections"] = by_two
        effects, left_out = (
            tuple(OptionalEffect(name=name, influence=1e3 * size) for name, size in table.items())
            for table in (terms, neglected)
        )
        errors = self._errors_k(free, columns, forcing, faces, kernel)
        forcing = self._forcing(free, flux - self.heating * self.direct_sunlight)
        shaded, shaded_kernel = np.array(at_air), np.zeros_like(kernel)
        shaded[:, free] = _face_temperatures(columns, forcing)
        shaded_kernel[:, free] = kernels(columns, forcing.part(LAST), shaded[LAST][:, free])
        return Solution(
            faces_k=faces,
            kernel=kernel,
            shaded_k=shaded[-1],
            shaded_kernel=shaded_kernel,
            effects=effects,
            left_out=left_out,
            errors_k=errors,
        )

    def _errors_k(
        self,
        free: Index,
        columns: Columns,
        forcing: Forcing,
        faces: Array,
        kernel: Array,
    ) -> dict[str, Array]:
        """Change of the last temperatures by one standard deviation of each input: linear by
        kernels, K.

        Neighbours change too, by as much over the whole day as at its end.
        """
        sky, neighbours = self.longwave(faces[LAST])
        sun = (self.sunlight + self.sunlight_by_reflection)[LAST]
        convection = np.zeros((DAY_STEPS, len(self.slabs)))
        convection[:, free] = forcing.convection(faces[LAST][:, free], LAST)
        latent_fraction = np.array([float(slab.latent_fraction) for slab in self.slabs])
        net_longwave = sky + neighbours - STEFAN_BOLTZMANN * faces[LAST] ** 4
        fluxes = {
            "longwave of the sky": self.emissivity
            * self.exposure.sky
            * self.weather.longwave_sd_w_m2,
            "convection": -UNCERTAINTY.convection * convection,
            "absorptivity": UNCERTAINTY.absorptivity * (1.0 - latent_fraction) * sun,
            "emissivity": UNCERTAINTY.emissivity * net_longwave,
        }
        errors_by_input = {name: (kernel * flux).sum(axis=0) for name, flux in fluxes.items()}
        factor = 1.0 + UNCERTAINTY.inertia
        heavier = replace(
            columns, capacity=factor * columns.capacity, conductance=factor * columns.conductance
        )
        errors_by_input["thermal inertia"] = np.zeros(len(self.slabs))
        errors_by_input["thermal inertia"][free] = (
            _face_temperatures(heavier, forcing)[-1] - faces[-1, free]
        )
        errors_by_input["prescribed temperature"] = self._sd_of_prescribed_k()
        slope = 4.0 * STEFAN_BOLTZMANN * self.emissivity * np.mean(faces[LAST] ** 3, axis=0)
        of_neighbours = (self.emissivity * kernel.sum(axis=0))[:, None] * self.exposure.sees * slope
        propagation = np.linalg.inv(np.eye(len(slope)) - of_neighbours)
        return {name: propagation @ error for name, error in errors_by_input.items()}

    def _sd_of_prescribed_k(self) -> Array:
        """Standard deviation of temperatures that slabs prescribe with 95 % bounds, else 0, shape
        (facet,), K.
        """
        sd_k = np.zeros(len(self.slabs))
        for facet, (slab, scene_object) in enumerate(zip(self.slabs, self.things, strict=True)):
            prescribed = slab.temperature_c or slab.above_air_k or slab.above_mean_air_k
            is_prescribed = (
                scene_object.temperature_c is not None or scene_object.above_air_k is not None
            )
            if (
                prescribed is not None
                and not is_prescribed
                and prescribed.low is not None
                and prescribed.high is not None
            ):
                sd_k[facet] = (prescribed.high - prescribed.low) / (2.0 * 1.96)
        return sd_k

    def _rule_temperature_k(self, facet: int) -> Array | None:
        """The temperature that an object or else its slab prescribes, shape (step,), K; None where
        it is free.
        """
        slab, scene_object, air = self.slabs[facet], self.things[facet], self.weather.air_k
        for rules in (scene_object, slab):
            if rules.temperature_c is not None:
                return np.full(len(air), ZERO_C + float(rules.temperature_c))
            if rules.above_air_k is not None:
                return air + float(rules.above_air_k)
        return (
            None
            if slab.above_mean_air_k is None
            else np.full(len(air), air.mean() + float(slab.above_mean_air_k))
        )

    @cached_property
    def _heat(self) -> Array:
        """Heat from within, shape (step, facet), W m-2."""
        hour = np.array(
            [time.hour + time.minute / 60.0 + time.second / 3600.0 for time in self.weather.times]
        )
        heat_w_m2 = np.zeros((len(hour), len(self.things)))
        for facet, scene_object in enumerate(self.things):
            start, end = scene_object.heat_hours or (0.0, 24.0)
            heat_w_m2[(hour - start) % 24.0 < ((end - start) % 24.0 or 24.0), facet] = (
                scene_object.heat_w_m2
            )
        return heat_w_m2

    def _reflect(self, light: Array) -> Array:
        """Irradiance of facets by the reflection of light from each other."""
        return (self.reflectivity * light) @ self.exposure.sees.T

    def _flux(self, faces_k: Array) -> Array:
        sky, neighbours = self.longwave(faces_k)
        return (
            self.heating * (self.sunlight + self.sunlight_by_reflection)
            + self.emissivity * (sky + neighbours)
            + self._heat
        )

    def _forcing(self, free: Index, flux: Array, *, condensation: bool = True) -> Forcing:
        weather = self.weather
        return Forcing(
            flux_w_m2=flux[:, free],
            air_k=weather.air_k[:, None],
            wind_m_s=weather.wind_m_s[:, None],
            vapour_pa=vapour_pressure_pa(weather.dew_point_k)[:, None],
            pressure_hpa=weather.pressure_hpa[:, None],
            emissivity=self.emissivity[free],
            exchange=Exchange(
                law=self.state.convection,
                constant_w_m2_k=self.state.convection_w_m2_k or 0.0,
                wind_coefficient=np.array(
                    [float(self.slabs[facet].wind_coefficient) for facet in free]
                ),
                upward=self.facets.normal[free, 2],
                condensation=condensation,
            ),
        )

    def _terms(self, free: Index, flux: Array, faces: Array, at_air: Array) -> dict[str, Array]:
        """Fluxes of the terms that are kept, last day or all of it, W m-2."""
        sky, neighbours = self.longwave(faces[LAST])
        condensed, last_k = np.zeros((DAY_STEPS, len(self.slabs))), faces[LAST][:, free]
        losses = [
            self._forcing(free, flux, condensation=condensation).loss(last_k, LAST)[0]
            for condensation in (True, False)
        ]
        condensed[:, free] = losses[0] - losses[1]
        isotropic_sky = self.weather.longwave_w_m2[LAST, None] * self.exposure.sky
        return {
            "sun, with its shadows": self.heating * self.sunlight,
            "sunlight by one reflection": self.heating * self.sunlight_by_reflection,
            "sky by its directions, not its mean": self.emissivity * (sky - isotropic_sky),
            "neighbours at their own temperatures": self.emissivity
            * (neighbours - self.longwave(at_air[LAST])[1]),
            "evaporation": (self.absorptivity - self.heating)
            * (self.sunlight + self.sunlight_by_reflection),
            "condensation": condensed,
            "heat sources": self._heat,
        }


def _face_temperatures(columns: Columns, forcing: Forcing) -> Array:
    """Temperatures of faces (step, surface), K: periodic over the first day, then stepped."""
    initial, start = periodic_start(columns, forcing.part(slice(0, DAY_STEPS)))
    if len(forcing) == DAY_STEPS:
        return initial
    return np.concatenate([initial, march(columns, forcing.part(slice(DAY_STEPS, None)), start)[0]])


def _effect(kernel: Array, flux: Array) -> float:
    """Largest change of a facet's last temperature by a flux, K."""
    return float(np.abs((kernel * flux[LAST]).sum(axis=0)).max())
