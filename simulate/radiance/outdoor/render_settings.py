"""Render settings: bands, rays, bounces and sources for the error that a sensor tolerates.

A pilot run at a few points computes every source and every bounce as a separate component. The
influence of a component is its rms signal over the sensor's noise floor, in the sixteenth of the
frame where that is largest; components whose influences are together below a fraction of the
tolerance are neglected. Another fraction limits the spectral error of the bands, the rest is the
rms Monte Carlo error of the rendering. Influences are estimates from the pilot's points, not
bounds: a small object that the pilot missed may have more.
"""

from dataclasses import dataclass

import numpy as np

from simulate.arrays import Array
from simulate.effect_selection import EffectSelection, OptionalEffect, select_effects
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.camera_rays import radiance_along
from simulate.radiance.integrator.integrator_settings import (
    KNOWN,
    IntegratorSettings,
    RenderSensor,
    SamplingSettings,
)
from simulate.radiance.integrator.outgoing_radiance import bounce_order
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.outdoor.built_scene import BuiltScene


@dataclass(frozen=True, kw_only=True)
class RenderLimits:
    """Parameters of the pilot run, and the division of the error between its causes."""

    # Points of the pilot, camera and gather rays of each; bounces with components of their own, and
    # most bounces.
    pilot_points: int = 1600
    pilot_rays: int = 2
    pilot_gather_rays: int = 4
    pilot_bounces: int = 4
    pilot_max_bounces: int = 24
    # Regions of the frame, down and across, in which influences are computed separately.
    regions: int = 4
    # Fractions of the tolerance for neglected components, for bands, and for the Monte Carlo error.
    neglect_fraction: float = 0.4
    band_fraction: float = 0.2
    monte_carlo_fraction: float = 0.6
    # Tolerance below which the fine irradiance cache is used, as a fraction of the noise floor;
    # shorter side of the smallest frame with a cache, px: twice the largest smoothing window.
    fine_cache_tolerance: float = 0.1
    min_cached_frame_px: int = 64
    # Limits of the spectral error of any source's signal; the largest is that of the pilot.
    # Brightest pixels, per cent, which saturate any sensor and do not affect the choice of bands.
    min_spectral_error: float = 0.0005
    max_spectral_error: float = 0.005
    saturated_percent: float = 0.5
    # Most rays of a pixel, and of a rendering beyond the fewest of each pixel: about a minute on
    # two cores.
    max_rays: int = 4096
    total_rays: int = 3_000_000
    # With few bounces the last ones carry little light: early Russian roulette takes a fifth of the
    # time.
    early_roulette_depth: int = 1
    # Exact renderings: most rays of a pixel, Monte Carlo error, first bounce with Russian roulette,
    # and most bounces.
    exact_max_rays: int = 32768
    exact_noise_fraction: float = 0.05
    exact_roulette_depth: int = 3
    exact_bounces: int = 200
    # Cost of a source and of a bounce, s for a million rays and ten bands, measured on one core.
    source_cost_s: float = 0.25
    bounce_cost_s: float = 1.5


RENDER_LIMITS = RenderLimits()
LAST_BOUNCE = f"bounce {RENDER_LIMITS.pilot_bounces} and further"


@dataclass(frozen=True, kw_only=True)
class MonteCarloTolerance:
    """Allowed Monte Carlo variance of pixels by their signal: a fraction of the sensor's noise
    floor, rms.
    """

    eye: RenderSensor
    noise_floor_fraction: float

    def __call__(self, signal: Array) -> Array:
        return (self.noise_floor_fraction * self.eye.noise_floor(signal)) ** 2


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Settings of a rendering."""

    wavelength_nm: Array  # bands, shape (band,), nm
    spectral_error: float  # largest relative error of any source's signal because of the bands
    # Numbers of rays, and integrator settings.
    rays: SamplingSettings
    effort: IntegratorSettings
    # retained and neglected components, influences relative to the noise floor
    plan: EffectSelection
    sensor_name: str  # name of the sensor
    exact: bool = False  # whether nothing is neglected

    @property
    def chance(self) -> float:
        """Fraction of the noise floor that the Monte Carlo error is, rms over the rendering."""
        return (
            self.rays.error_limit.noise_floor_fraction
            if isinstance(self.rays.error_limit, MonteCarloTolerance)
            else 0.0
        )

    def text(self) -> str:
        """Return the settings as text."""
        fewest_rays, most_rays, error_fraction, bounces = (
            self.rays.min_rays,
            self.rays.max_rays,
            self.chance,
            f"{self.effort.max_bounces}",
        )
        if self.effort.max_bounces >= RENDER_LIMITS.exact_bounces:
            bounces = "to the end, by chance"
        return "\n".join(
            (
                f"light, relative to the noise of {self.sensor_name}:",
                self.plan.text("rms where it is most"),
                f"{len(self.wavelength_nm)} bands from {self.wavelength_nm[0]:.0f} to "
                f"{self.wavelength_nm[-1]:.0f} nm, which change no source's signal by more than "
                f"{100.0 * self.spectral_error:.2g} %",
                f"{fewest_rays} to {most_rays} rays a pixel, rms Monte Carlo error "
                f"{100.0 * error_fraction:.2g} % of the noise "
                f"(or {100.0 * KNOWN * error_fraction:.2g} % of the signal where that is more)",
                f"bounces followed: {bounces}",
            )
        )

    def document(self) -> dict:
        """Return the settings as plain values, for a file."""
        return {
            **self.plan.document(),
            "wavelength_nm": self.wavelength_nm.tolist(),
            "spectral_error": self.spectral_error,
            "bounces": self.effort.max_bounces,
            "bounces_by_chance_from": self.effort.roulette_depth,
            "rays": {
                "fewest": self.rays.min_rays,
                "edge": self.rays.edge,
                "most": self.rays.max_rays,
                "gathered": self.rays.gather_rays,
                "shared": self.rays.cache_rays,
            },
            "exact": self.exact,
        }


@dataclass(frozen=True)
class PilotEstimate:
    """Radiance components at a few points of a frame.

    Reflected light of a lamp or disc, or the part of the bounces occluded from the sky, belongs
    both to the bounce and to the source: neglecting either removes it.
    """

    signal: Array  # of each point, or of each pixel that contains several, shape (point,)
    parts: dict[str, Array]  # signal of each component by ray, shape (point, ray)
    shape: tuple[int, int]  # points (down, across)


def choose_render_settings(
    site: BuiltScene, view: Viewpoint, eye: RenderSensor, tolerance: float, seed: int
) -> tuple[RenderSettings, SpectralScene]:
    """Choose the settings of a rendering for a sensor, and return the scene on the chosen bands.

    The tolerance is the total rms error by neglected components and Monte Carlo noise, as a
    fraction of a pixel's noise floor.
    """
    limits = RENDER_LIMITS
    scene = site.on(site.bands(eye.response_nm, eye.response, limits.max_spectral_error))
    pilot = trial(scene, view, eye, seed)
    selection = select_effects(
        _effects(pilot, eye, view, scene.bands), limits.neglect_fraction * tolerance
    )
    bright_signal = (
        float(np.percentile(pilot.signal, 100.0 - limits.saturated_percent))
        if len(pilot.signal)
        else 0.0
    )
    error = (
        limits.band_fraction
        * tolerance
        * float(eye.noise_floor(bright_signal, smooth=True))
        / max(bright_signal, 1e-30)
    )
    error = float(np.clip(error, limits.min_spectral_error, limits.max_spectral_error))
    if error < limits.max_spectral_error:
        scene = site.on(site.bands(eye.response_nm, eye.response, error))
    plan = EffectSelection(tolerance=tolerance, kept=selection.kept, left_out=selection.left_out)
    return RenderSettings(
        wavelength_nm=scene.bsdfs.wavelength_nm,
        spectral_error=error,
        rays=SamplingSettings(
            max_rays=limits.max_rays,
            total_rays=limits.total_rays,
            cache_rays=SamplingSettings().cache_rays
            if min(view.shape) >= limits.min_cached_frame_px
            else None,
            refine=tolerance < limits.fine_cache_tolerance,
            error_limit=MonteCarloTolerance(
                eye=eye, noise_floor_fraction=limits.monte_carlo_fraction * tolerance
            ),
        ),
        effort=_effort(plan),
        plan=plan,
        sensor_name=eye.name,
    ), scene


def exact(
    site: BuiltScene, view: Viewpoint, eye: RenderSensor, seed: int
) -> tuple[RenderSettings, SpectralScene]:
    """Return settings that neglect nothing, and the scene on their bands: a slow reference."""
    limits = RENDER_LIMITS
    scene = site.on(site.bands(eye.response_nm, eye.response, limits.min_spectral_error))
    effects = _effects(trial(scene, view, eye, seed), eye, view, scene.bands)
    return RenderSettings(
        wavelength_nm=scene.bsdfs.wavelength_nm,
        spectral_error=limits.min_spectral_error,
        rays=SamplingSettings(
            min_rays=4,
            edge=64,
            max_rays=limits.exact_max_rays,
            cache_rays=None,
            error_limit=MonteCarloTolerance(
                eye=eye, noise_floor_fraction=limits.exact_noise_fraction
            ),
        ),
        effort=IntegratorSettings(
            max_bounces=limits.exact_bounces, roulette_depth=limits.exact_roulette_depth
        ),
        plan=EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=()),
        sensor_name=eye.name,
        exact=True,
    ), scene


def trial(scene: SpectralScene, view: Viewpoint, eye: RenderSensor, seed: int) -> PilotEstimate:
    """Return the radiance components at points spread over a frame."""
    limits, rng, (rows, columns) = RENDER_LIMITS, np.random.default_rng([seed, 2]), view.shape
    n_columns = np.sqrt(limits.pilot_points * columns / rows)
    shape = max(1, int(n_columns * rows / columns)), max(1, int(n_columns))
    grid = np.meshgrid(
        *((np.arange(n) + 0.5) * side / n for n, side in zip(shape, view.shape, strict=True)),
        indexing="ij",
    )
    position = np.stack([axis.ravel() for axis in grid])
    # Several points in a pixel count as one.
    pixel = np.arange(position.shape[1])
    if min(shape[0] / rows, shape[1] / columns) >= 1.0:
        (row, col), shape = position.astype(np.int64), view.shape
        pixel = row * columns + col
    count = np.bincount(pixel, minlength=shape[0] * shape[1])[:, None]

    def means(signal: Array) -> Array:
        """Return mean signals of each counted point, separately by first and second rays, shape
        (point, ray).
        """
        ray_signals = signal.reshape(-1, limits.pilot_rays).astype(float)
        return (
            np.stack(
                [np.bincount(pixel, ray, minlength=len(count)) for ray in ray_signals.T], axis=1
            )
            / count
        )

    cell_px = np.minimum(1.0, np.array(view.shape) / [len(grid[0]), grid[0].shape[1]])[:, None]
    row, col = (
        np.repeat(position, limits.pilot_rays, axis=1)
        + (rng.random((2, len(pixel) * limits.pilot_rays)) - 0.5) * cell_px
    )
    origin, direction = view.rays(row, col)
    weight = eye.weight(scene.bsdfs.wavelength_nm)
    effort = IntegratorSettings(
        max_bounces=limits.pilot_max_bounces, roulette_depth=limits.pilot_bounces
    )
    components = radiance_along(
        scene, origin, direction, effort, rng, gather_rays=limits.pilot_gather_rays, split=True
    ).by_name
    by_name = {name: means(light @ weight) for name, light in components.items()}
    signal = np.asarray(
        sum(by_name.values(), start=np.zeros((len(count), limits.pilot_rays)))
    ).mean(axis=1)
    signals: dict[str, Array] = {}
    for name, light in by_name.items():
        for component in _parts_of(name, (*scene.lighting.names, "hidden sky")):
            signals[component] = signals.get(component, 0.0) + light
    if scene.air.is_present and scene.lighting.lamps:
        # Lamp light that air takes before it reaches surfaces: the same rays with and without air.
        with_air, without_air = (
            radiance_along(
                scene,
                origin,
                direction,
                IntegratorSettings(max_bounces=0, sky_shadowing=False, path_air=path_air),
                np.random.default_rng([seed, 3]),
                gather_rays=1,
            ).total()
            for path_air in (True, False)
        )
        signals["air before surfaces"] = means((without_air - with_air) @ weight)
    return PilotEstimate(signal, signals, shape)


def _parts_of(name: str, sources: tuple[str, ...]) -> tuple[str, ...]:
    """Return the components that light belongs to: its bounce, and its source if that may be
    neglected.
    """
    order, source = bounce_order(name)
    if order == 0:
        return (name,)
    bounce = LAST_BOUNCE if order >= RENDER_LIMITS.pilot_bounces else f"bounce {order}"
    return (bounce, source) if source in sources else (bounce,)


def _effects(
    pilot: PilotEstimate, eye: RenderSensor, view: Viewpoint, bands: int
) -> list[OptionalEffect]:
    """Return effects of the components: influence and cost."""
    noise = eye.noise_floor(pilot.signal, smooth=True)[:, None]
    million = view.shape[0] * view.shape[1] * SamplingSettings().min_rays * 1e-6 * bands / 10.0
    influence = {
        name: _influence(signal / noise, pilot.shape)
        for name, signal in pilot.parts.items()
        if name not in ("in view", "sky")
    }
    # A bounce needs all lower bounces.
    orders = [f"bounce {order}" for order in range(1, RENDER_LIMITS.pilot_bounces)] + [LAST_BOUNCE]
    for order, next_order in zip(orders[-2::-1], orders[:0:-1], strict=True):
        if next_order in influence:
            influence[order] = max(influence.get(order, 0.0), influence[next_order])
    return [
        OptionalEffect(
            name=name,
            influence=amount,
            setup_s=million
            * (
                RENDER_LIMITS.bounce_cost_s
                if name.startswith("bounce") or name == "hidden sky"
                else RENDER_LIMITS.source_cost_s
            ),
        )
        for name, amount in influence.items()
    ]


def _influence(component: Array, shape: tuple[int, int]) -> float:
    """Return the rms of a component (point, ray) over the region where it is largest.

    The mean square is that of the product of two rays of the same point, which is not biased by
    Monte Carlo noise as the square of their mean would be.
    """
    square = (component[:, 0] * component[:, 1]).reshape(shape)
    rows = np.array_split(square, RENDER_LIMITS.regions)
    regions = [
        region
        for row in rows
        for region in np.array_split(row, RENDER_LIMITS.regions, axis=1)
        if region.size
    ]
    return float(np.sqrt(max(0.0, *(region.mean() for region in regions))))


def _effort(plan: EffectSelection) -> IntegratorSettings:
    orders = [
        int(effect.name.split()[1]) for effect in plan.kept if effect.name.startswith("bounce ")
    ]
    neglected = plan.names
    max_order = max(orders, default=0)
    is_unlimited = max_order >= RENDER_LIMITS.pilot_bounces
    return IntegratorSettings(
        max_bounces=RENDER_LIMITS.exact_bounces if is_unlimited else max_order,
        sky_shadowing="hidden sky" not in neglected,
        path_air="air before surfaces" not in neglected,
        neglected=frozenset(neglected),
        roulette_depth=RENDER_LIMITS.exact_roulette_depth
        if is_unlimited
        else RENDER_LIMITS.early_roulette_depth,
    )
