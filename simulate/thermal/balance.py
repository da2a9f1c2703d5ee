"""Heat balance of the facets of a scene over the weather, with what was left out and could have changed it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simulate.economy import Effect
from simulate.radiance.blackbody import STEFAN_BOLTZMANN
from simulate.radiance.world.description.objects import Object
from simulate.radiance.world.description.scene import Scene
from simulate.radiance.world.description.slab import Slab
from simulate.thermal.clear_day import sky_radiance
from simulate.thermal.convection import ZERO_C, Exchange, vapour_pressure_pa
from simulate.thermal.exposure import RING_SINE, Exposure, Facets
from simulate.thermal.slab import Columns, Forcing, kernels, march, periodic_start
from simulate.thermal.weather import DAY_STEPS, Weather

Array = NDArray[np.float64]
# What lies below the horizon where a scene ends: reflectance of usual ground; it has the air's temperature.
GROUND_REFLECTANCE = 0.2
# Steps between directions of the sun, by which its shadows are found.
SUN_STEPS = 3
# Irradiance of the full moon in the zenith, W m-2.
FULL_MOON_W_M2 = 0.003
MAX_PASSES = 8
# Facets that see other surfaces by less than one ray of so many take these as at the air's temperature.
COVERED = 1000.0


@dataclass(frozen=True, kw_only=True)
class Body:
    """What a facet is in the balance.

    Parameters
    ----------
    slab
        Its slab, absorptivity known.
    thing
        The object it belongs to.
    """

    slab: Slab
    thing: Object

    @property
    def prescribed(self) -> bool:
        """Whether its temperature is prescribed by its object or its slab."""
        return self.slab.prescribed or self.thing.temperature_c is not None or self.thing.above_air_k is not None

    def prescribed_k(self, weather: Weather) -> Array:
        """Return the prescribed temperature, shape (step,), K."""
        slab, thing = self.slab, self.thing
        if thing.temperature_c is not None or (thing.above_air_k is None and slab.temperature_c is not None):
            constant = slab.temperature_c if thing.temperature_c is None else thing.temperature_c
            return np.full(len(weather), ZERO_C + float(constant or 0.0))
        if thing.above_air_k is not None or slab.above_air_k is not None:
            above = slab.above_air_k if thing.above_air_k is None else thing.above_air_k
            return weather.air_k + float(above or 0.0)
        return np.full(len(weather), weather.air_k.mean() + float(slab.above_mean_air_k or 0.0))

    def heat(self, weather: Weather) -> Array:
        """Return the heat from within at each step, shape (step,), W m-2."""
        if self.thing.heat_hours is None:
            return np.full(len(weather), self.thing.heat_w_m2)
        start, end = self.thing.heat_hours
        hour = np.array([time.hour + time.minute / 60.0 + time.second / 3600.0 for time in weather.times])
        on = (hour - start) % 24.0 < ((end - start) % 24.0 or 24.0)
        return np.where(on, self.thing.heat_w_m2, 0.0)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Temperatures of facets.

    Parameters
    ----------
    facets, bodies, exposure, weather
        What they are, see, and what acted on them.
    faces_k
        At the end of each step of the weather, shape (step, facet), K.
    effects, left_out
        What each term changes at the last time, and what those left out could have changed, mK at the facet where that
        is most.
    kernel
        Effect of the flux at each step of the last day on the last temperature, 0 for prescribed ones, shape
        (`DAY_STEPS`, facet), K per W m-2.
    sky, surrounding, reflected
        Of the last day: pi times the radiance of each ring of the sky, shape (step, ring); longwave and sunlight that
        come from other surfaces, as if these filled the hemisphere, shape (step, facet), W m-2.
    """

    facets: Facets
    bodies: tuple[Body, ...]
    exposure: Exposure
    weather: Weather
    faces_k: Array
    effects: tuple[Effect, ...]
    left_out: tuple[Effect, ...]
    kernel: Array
    sky: Array
    surrounding: Array
    reflected: Array

    @property
    def lasting(self) -> slice:
        """The steps of the last day."""
        return slice(len(self.weather) - DAY_STEPS, None)


def bodies_of(scene: Scene, facets: Facets, slabs: dict[str, Slab]) -> tuple[Body, ...]:
    """Return what each facet is, by the slabs of the scene's materials."""
    things = {thing.label: thing for thing in scene.object}
    surfaces = facets.surfaces
    return tuple(
        Body(slab=slabs[surfaces.materials[material]], thing=things[surfaces.objects[number]])
        for number, material in zip(facets.object, facets.material, strict=True)
    )


def solve(
    facets: Facets, bodies: tuple[Body, ...], exposure: Exposure, weather: Weather, scene: Scene, tolerance_mk: float
) -> Solution:
    """Return the temperatures of facets.

    Parameters
    ----------
    facets, bodies, exposure, weather
        The scene's surfaces and what acts on them; `exposure.lit` at every `SUN_STEPS`-th step of the last day.
    scene
        Its weather names the law of convection.
    tolerance_mk
        What a further pass of neighbours, and a second reflection of the sun, may change at the scene's time, mK.

    Notes
    -----
    The first pass takes neighbours at the air's temperature, each further one at their own. Each shrinks the error by
    no more than (1 - F) h_r/(h_r + h).
    """
    return _Balance(facets, bodies, exposure, weather, scene, 1e-3 * tolerance_mk).solved()


@dataclass(frozen=True)
class _Balance:
    """The terms of the balance."""

    facets: Facets
    bodies: tuple[Body, ...]
    exposure: Exposure
    weather: Weather
    scene: Scene
    tolerance_k: float

    @cached_property
    def free(self) -> NDArray[np.int64]:
        """Facets whose temperature is solved for."""
        return np.flatnonzero([not body.prescribed for body in self.bodies])

    @cached_property
    def emissivity(self) -> Array:
        return np.array([float(body.slab.emissivity) for body in self.bodies])

    @cached_property
    def absorptivity(self) -> Array:
        return np.array([float(body.slab.absorptivity or 0.0) for body in self.bodies])

    @cached_property
    def dry(self) -> Array:
        """Fraction of the absorbed sun that does not evaporate water."""
        return np.array([1.0 - float(body.slab.latent_fraction) for body in self.bodies])

    @cached_property
    def heat(self) -> Array:
        return np.stack([body.heat(self.weather) for body in self.bodies], axis=1)

    @cached_property
    def lit(self) -> Array:
        """Cosine of the sun where it shines at each step, shape (step, facet): each day that of the last one."""
        known = self.exposure.lit
        at = np.arange(DAY_STEPS) / SUN_STEPS
        low = at.astype(np.int64)
        part = (at - low)[:, None]
        day = known[low] * (1.0 - part) + known[np.minimum(low + 1, len(known) - 1)] * part
        return np.tile(day, (len(self.weather) // DAY_STEPS, 1))

    @cached_property
    def rings(self) -> Array:
        """Pi times the radiance of each ring of the sky, shape (step, ring)."""
        weather = self.weather
        emissivity = weather.longwave_w_m2 / (STEFAN_BOLTZMANN * weather.air_k**4)
        return sky_radiance(emissivity, weather.air_k, weather.dew_point_k, RING_SINE)

    @cached_property
    def sunlight(self) -> Array:
        """Sunlight straight from sun and sky, shape (step, facet), W m-2."""
        return self.weather.direct_w_m2[:, None] * self.lit + self.weather.diffuse_w_m2[:, None] * self.exposure.sky

    @cached_property
    def reflected(self) -> Array:
        """Sunlight by way of one reflection, shape (step, facet), W m-2."""
        beyond = GROUND_REFLECTANCE * self.weather.global_w_m2[:, None] * self.exposure.beyond
        return self._by_neighbours(self.sunlight) + beyond

    def _by_neighbours(self, light: Array) -> Array:
        return ((1.0 - self.absorptivity) * light) @ self.exposure.sees.T

    def longwave(self, faces_k: Array) -> tuple[Array, Array]:
        """Return longwave from the sky and from neighbours at their temperatures, shape (step, facet), W m-2."""
        exposure, air = self.exposure, STEFAN_BOLTZMANN * self.weather.air_k[:, None] ** 4
        sky = self.rings @ exposure.rings.T
        own = STEFAN_BOLTZMANN * faces_k**4
        # What a neighbour mirrors is as if it saw the sky that it sees, and else surfaces of its own temperature.
        mirrored = sky + (1.0 - exposure.sky) * own
        radiosity = self.emissivity * own + (1.0 - self.emissivity) * mirrored
        return sky, radiosity @ exposure.sees.T + air * exposure.beyond

    def flux(self, faces_k: Array, more_sun: Array | float = 0.0) -> Array:
        """Return all that facets absorb, shape (step, facet), W m-2."""
        sky, neighbours = self.longwave(faces_k)
        sun = self.absorptivity * self.dry * (self.sunlight + self.reflected + more_sun)
        return sun + self.emissivity * (sky + neighbours) + self.heat

    def forcing(self, flux: Array, *, condensation: bool = True) -> Forcing:
        """Return what acts on the free facets."""
        weather, state, free = self.weather, self.scene.weather, self.free
        assert state is not None
        exchange = Exchange(
            law=state.convection,
            constant_w_m2_k=state.convection_w_m2_k or 0.0,
            wind_coefficient=np.array([float(self.bodies[facet].slab.wind_coefficient) for facet in free]),
            upward=self.facets.normal[free, 2],
            condensation=condensation,
        )
        return Forcing(
            flux_w_m2=flux[:, free],
            air_k=weather.air_k[:, None],
            wind_m_s=weather.wind_m_s[:, None],
            vapour_pa=vapour_pressure_pa(weather.dew_point_k)[:, None],
            pressure_hpa=weather.pressure_hpa[:, None],
            emissivity=self.emissivity[free],
            exchange=exchange,
        )

    def faces(self, columns: Columns, flux: Array, before: Array) -> Array:
        """Return temperatures of all facets under a flux: periodic over the first day, then stepped."""
        forcing, found = self.forcing(flux), np.array(before)
        first, start = periodic_start(columns, forcing.part(slice(0, DAY_STEPS)))
        found[:DAY_STEPS, self.free] = first
        if len(flux) > DAY_STEPS:
            found[DAY_STEPS:, self.free] = march(columns, forcing.part(slice(DAY_STEPS, None)), start)
        return found

    def solved(self) -> Solution:
        """Return the solution."""
        weather, free = self.weather, self.free
        at_air = np.repeat(weather.air_k[:, None], len(self.bodies), axis=1)
        for facet in np.setdiff1d(np.arange(len(self.bodies)), free):
            at_air[:, facet] = self.bodies[facet].prescribed_k(weather)
        kernel = np.zeros((DAY_STEPS, len(self.bodies)))
        if not len(free):
            return self._solution(at_air, kernel, (), ())
        columns = Columns.of([self.bodies[facet].slab for facet in free])
        twice: Array | float = 0.0
        flux = self.flux(at_air)
        faces = self.faces(columns, flux, at_air)
        kernel[:, free] = self._kernels(columns, flux, faces)
        second = self._by_neighbours(self.reflected)
        by_two = self._effect(kernel, self.absorptivity * self.dry * second)
        if by_two > self.tolerance_k:
            twice = second
        passes = 1
        while True:
            new = self.flux(faces, twice)
            shrink, rest = self._shrink(faces), self._effect(kernel, new - flux)
            rest /= 1.0 - shrink
            if rest <= self.tolerance_k or passes == MAX_PASSES:
                break
            flux, passes = new, passes + 1
            faces = self.faces(columns, flux, faces)
        kernel[:, free] = self._kernels(columns, flux, faces)
        kept = self._kept(kernel, faces, flux, at_air)
        left = {f"neighbours at their own temperatures, pass {passes + 1} and further": rest}
        (left if by_two <= self.tolerance_k else kept)["sunlight by two reflections"] = by_two
        left["moonlight, if the moon were full"] = (
            float((self.absorptivity * kernel.sum(axis=0)).max()) * FULL_MOON_W_M2
        )
        tables = (
            {name: Effect(name=name, influence=1e3 * size) for name, size in table.items()} for table in (kept, left)
        )
        effects, left_out = (tuple(table.values()) for table in tables)
        return self._solution(faces, kernel, effects, left_out)

    def _kernels(self, columns: Columns, flux: Array, faces: Array) -> Array:
        last = slice(len(flux) - DAY_STEPS, None)
        return kernels(columns, self.forcing(flux).part(last), faces[last][:, self.free])

    def _effect(self, kernel: Array, flux: Array) -> float:
        """Largest change of a facet's last temperature by a flux, K."""
        return float(np.abs((kernel * flux[-DAY_STEPS:]).sum(axis=0)).max())

    def _shrink(self, faces: Array) -> float:
        """Bound on the change of a pass over that of the one before it."""
        slope = self.forcing(faces).loss(faces[-DAY_STEPS:][:, self.free], slice(-DAY_STEPS, None))[1]
        radiative = 4.0 * STEFAN_BOLTZMANN * self.emissivity[self.free] * faces[-DAY_STEPS:][:, self.free] ** 3
        return float(((1.0 - self.exposure.sky[self.free]) * (radiative / slope).max(axis=0)).max())

    def _kept(self, kernel: Array, faces: Array, flux: Array, at_air: Array) -> dict[str, float]:
        """What each term changes, K."""
        steps, free = slice(-DAY_STEPS, None), self.free
        sky, neighbours = self.longwave(faces)
        even = self.weather.longwave_w_m2[:, None] * self.exposure.sky
        wet = np.zeros_like(flux)
        losses = [self.forcing(flux, condensation=on).loss(faces[steps][:, free], steps)[0] for on in (True, False)]
        wet[steps, free] = losses[0] - losses[1]
        sun = self.absorptivity * (self.sunlight + self.reflected)
        terms = {
            "sun and its shadows of the last day and before": self.absorptivity * self.dry * self.sunlight,
            "sky by its directions, not its mean": self.emissivity * (sky - even),
            "neighbours at their own temperatures, not the air's": self.emissivity
            * (neighbours - self.longwave(at_air)[1]),
            "sunlight by one reflection": self.absorptivity * self.dry * self.reflected,
            "evaporation": sun * (1.0 - self.dry),
            "condensation": wet,
            "heat sources": self.heat,
        }
        return {name: self._effect(kernel, term) for name, term in terms.items()}

    def _solution(
        self, faces: Array, kernel: Array, effects: tuple[Effect, ...], left_out: tuple[Effect, ...]
    ) -> Solution:
        last = slice(-DAY_STEPS, None)
        covered = 1.0 - self.exposure.sky
        open_sky = covered < 1.0 / COVERED
        _, neighbours = self.longwave(faces)
        air = STEFAN_BOLTZMANN * self.weather.air_k[last, None] ** 4
        ground = GROUND_REFLECTANCE * self.weather.global_w_m2[last, None]
        divisor = np.where(open_sky, 1.0, covered)
        return Solution(
            facets=self.facets,
            bodies=self.bodies,
            exposure=self.exposure,
            weather=self.weather,
            faces_k=faces,
            effects=effects,
            left_out=left_out,
            kernel=kernel,
            sky=self.rings[last],
            surrounding=np.where(open_sky, air, neighbours[last] / divisor),
            reflected=np.where(open_sky, ground, self.reflected[last] / divisor),
        )
