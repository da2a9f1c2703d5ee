"""Render settings: bands, rays, bounces and sources for the error that a sensor tolerates.

A pilot run at a few points computes every source and every bounce as a separate component. The influence of a component
is its rms signal over the sensor's noise floor, in the sixteenth of the frame where that is largest; components whose
influences are together below a fraction of the tolerance are neglected. Another fraction limits the spectral error of
the bands, the rest is the rms Monte Carlo error of the rendering. Influences are estimates from the pilot's points, not
bounds: a small object that the pilot missed may have more.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulate.effect_selection import EffectSelection, OptionalEffect, select_effects
from simulate.radiance.geometry.viewpoint import Viewpoint
from simulate.radiance.integrator.adaptive_sampling import SamplingSettings
from simulate.radiance.integrator.integrator_settings import IntegratorSettings
from simulate.radiance.integrator.outgoing_radiance import radiance_along
from simulate.radiance.integrator.render_sensor import KNOWN, RenderSensor
from simulate.radiance.integrator.shading_request import bounce_order
from simulate.radiance.integrator.spectral_scene import SpectralScene
from simulate.radiance.outdoor.built_scene import BuiltScene


@dataclass(frozen=True, kw_only=True)
class RenderLimits:
    """Parameters of the pilot run, and the division of the error between its causes."""

    # Points of the pilot, camera and gather rays of each; bounces with components of their own, and most bounces.
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
    # Tolerance below which the fine irradiance cache is used, as a fraction of the noise floor; shorter side of the
    # smallest frame with a cache, px: twice the largest smoothing window.
    fine_cache_tolerance: float = 0.1
    min_cached_frame_px: int = 64
    # Limits of the spectral error of any source's signal; the largest is that of the pilot. Brightest pixels, per cent,
    # which saturate any sensor and do not affect the choice of bands.
    min_spectral_error: float = 0.0005
    max_spectral_error: float = 0.005
    saturated_percent: float = 0.5
    # Most rays of a pixel, and of a rendering beyond the fewest of each pixel: about a minute on two cores.
    max_rays: int = 4096
    total_rays: int = 3_000_000
    # With few bounces the last ones carry little light: early Russian roulette takes a fifth of the time.
    early_roulette_depth: int = 1
    # Exact renderings: most rays of a pixel, Monte Carlo error, first bounce with Russian roulette, and most bounces.
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
    """Allowed Monte Carlo variance of pixels, as a function of their signal.

    Parameters
    ----------
    eye
        Name of the sensor.
    noise_floor_fraction
        Fraction of the noise floor that the Monte Carlo error is, rms over the rendering.
    """

    eye: RenderSensor
    noise_floor_fraction: float

    def __call__(self, signal: NDArray[np.floating]) -> NDArray[np.floating]:
        return (self.noise_floor_fraction * self.eye.noise_floor(signal)) ** 2


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Settings of a rendering.

    Parameters
    ----------
    wavelength_nm
        Bands, shape (band,), nm.
    spectral_error
        Largest relative error of any source's signal because of the bands.
    rays, effort
        Numbers of rays, and integrator settings.
    plan
        Retained and neglected components, influences relative to the noise floor.
    sensor_name
        Name of the sensor.
    exact
        Whether nothing is neglected.
    """

    wavelength_nm: NDArray[np.float64]
    spectral_error: float
    rays: SamplingSettings
    effort: IntegratorSettings
    plan: EffectSelection
    sensor_name: str
    exact: bool = False

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
        few, most, chance = self.rays.min_rays, self.rays.max_rays, self.chance
        follows = self.effort
        bounces = (
            "to the end, by chance" if follows.max_bounces >= RENDER_LIMITS.exact_bounces else f"{follows.max_bounces}"
        )
        return "\n".join(
            (
                f"light, by what {self.sensor_name} would notice of it:",
                self.plan.text("rms where it is most"),
                f"{len(self.wavelength_nm)} bands from {self.wavelength_nm[0]:.0f} to {self.wavelength_nm[-1]:.0f} nm, "
                f"which change no source's signal by more than {100.0 * self.spectral_error:.2g} %",
                f"{few} to {most} rays a pixel, so that chance adds {100.0 * chance:.2g} % of the "
                f"noise (or {100.0 * KNOWN * chance:.2g} % of the signal, where that is more), root mean square",
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

    Parameters
    ----------
    signal
        Signal of each point, or of each pixel that contains several, shape (point,).
    parts
        Signal of each component by ray, shape (point, ray), by name. Reflected light of a lamp or disc, or the part of
        the bounces occluded from the sky, belongs both to the bounce and to the source: neglecting either removes it.
    shape
        Points (down, across).
    """

    signal: NDArray[np.floating]
    parts: dict[str, NDArray[np.floating]]
    shape: tuple[int, int]


def choose_render_settings(
    site: BuiltScene, view: Viewpoint, eye: RenderSensor, tolerance: float, seed: int
) -> tuple[RenderSettings, SpectralScene]:
    """Choose the settings of a rendering for a sensor, and return the scene on the chosen bands.

    Parameters
    ----------
    site, view
        The scene and the camera.
    eye
        The sensor's response and noise.
    tolerance
        Total rms error by neglected components and Monte Carlo noise, as a fraction of a pixel's noise floor.
    seed
        Seed of the pilot.
    """
    stage = site.on(site.bands(eye.response_nm, eye.response, RENDER_LIMITS.max_spectral_error))
    tried = trial(stage, view, eye, seed)
    chosen = select_effects(_effects(tried, eye, view, stage.bands), RENDER_LIMITS.neglect_fraction * tolerance)
    bright = float(np.percentile(tried.signal, 100.0 - RENDER_LIMITS.saturated_percent)) if len(tried.signal) else 0.0
    error = float(
        np.clip(
            RENDER_LIMITS.band_fraction * tolerance * float(eye.noise_floor(bright, smooth=True)) / max(bright, 1e-30),
            RENDER_LIMITS.min_spectral_error,
            RENDER_LIMITS.max_spectral_error,
        )
    )
    if error < RENDER_LIMITS.max_spectral_error:
        stage = site.on(site.bands(eye.response_nm, eye.response, error))
    plan = EffectSelection(tolerance=tolerance, kept=chosen.kept, left_out=chosen.left_out)
    return RenderSettings(
        wavelength_nm=stage.bsdfs.wavelength_nm,
        spectral_error=error,
        rays=SamplingSettings(
            max_rays=RENDER_LIMITS.max_rays,
            total_rays=RENDER_LIMITS.total_rays,
            cache_rays=_n_cache_rays(view),
            refine=tolerance < RENDER_LIMITS.fine_cache_tolerance,
            error_limit=MonteCarloTolerance(
                eye=eye, noise_floor_fraction=RENDER_LIMITS.monte_carlo_fraction * tolerance
            ),
        ),
        effort=_effort(plan),
        plan=plan,
        sensor_name=eye.name,
    ), stage


def _n_cache_rays(view: Viewpoint) -> int | None:
    """Return the first rays of a cache node; None for a frame smaller than the largest smoothing window."""
    return SamplingSettings().cache_rays if min(view.shape) >= RENDER_LIMITS.min_cached_frame_px else None


def exact(site: BuiltScene, view: Viewpoint, eye: RenderSensor, seed: int) -> tuple[RenderSettings, SpectralScene]:
    """Return settings that neglect nothing, and the scene on their bands: a slow reference."""
    stage = site.on(site.bands(eye.response_nm, eye.response, RENDER_LIMITS.min_spectral_error))
    effects = _effects(trial(stage, view, eye, seed), eye, view, stage.bands)
    return RenderSettings(
        wavelength_nm=stage.bsdfs.wavelength_nm,
        spectral_error=RENDER_LIMITS.min_spectral_error,
        rays=SamplingSettings(
            min_rays=4,
            edge=64,
            max_rays=RENDER_LIMITS.exact_max_rays,
            cache_rays=None,
            error_limit=MonteCarloTolerance(eye=eye, noise_floor_fraction=RENDER_LIMITS.exact_noise_fraction),
        ),
        effort=IntegratorSettings(
            max_bounces=RENDER_LIMITS.exact_bounces, roulette_depth=RENDER_LIMITS.exact_roulette_depth
        ),
        plan=EffectSelection(tolerance=0.0, kept=tuple(effects), left_out=()),
        sensor_name=eye.name,
        exact=True,
    ), stage


def trial(stage: SpectralScene, view: Viewpoint, eye: RenderSensor, seed: int) -> PilotEstimate:
    """Return the radiance components at points spread over a frame."""
    rng = np.random.default_rng([seed, 2])
    place = _Places.over(view)
    row, col = place.draw(rng)
    origin, towards = view.rays(row, col)
    weight = eye.weight(stage.bsdfs.wavelength_nm)
    found = radiance_along(
        stage,
        origin,
        towards,
        IntegratorSettings(max_bounces=RENDER_LIMITS.pilot_max_bounces, roulette_depth=RENDER_LIMITS.pilot_bounces),
        rng,
        gather_rays=RENDER_LIMITS.pilot_gather_rays,
        split=True,
    ).found
    by_name = {name: place.means(light @ weight) for name, light in found.items()}
    signal = np.asarray(
        sum(by_name.values(), start=np.zeros((int(np.prod(place.shape)), RENDER_LIMITS.pilot_rays)))
    ).mean(axis=1)
    parts: dict[str, NDArray[np.floating]] = {}
    for name, light in by_name.items():
        for part in _parts_of(name, (*stage.lighting.names, "hidden sky")):
            parts[part] = parts.get(part, 0.0) + light
    if stage.air.absorbs and stage.lighting.lamps:
        between = _air_between(stage, origin, towards, seed) @ weight
        parts["air before surfaces"] = place.means(between)
    return PilotEstimate(signal, parts, place.shape)


@dataclass(frozen=True)
class _Places:
    """Points on a regular grid over a frame, shape (point,); several points in a pixel count as one."""

    row: NDArray[np.floating]
    col: NDArray[np.floating]
    spread: tuple[float, float]
    pixel: NDArray[np.int64]
    shape: tuple[int, int]

    @classmethod
    def over(cls, view: Viewpoint) -> "_Places":
        rows, columns = view.shape
        across = np.sqrt(RENDER_LIMITS.pilot_points * columns / rows)
        many = (max(1, int(across * rows / columns)), max(1, int(across)))
        row, col = (
            axis.ravel()
            for axis in np.meshgrid(
                *((np.arange(n) + 0.5) * side / n for n, side in zip(many, view.shape, strict=True)), indexing="ij"
            )
        )
        spread = min(1.0, rows / many[0]), min(1.0, columns / many[1])
        if min(many[0] / rows, many[1] / columns) < 1.0:
            return cls(row, col, spread, np.arange(len(row)), many)
        return cls(row, col, spread, row.astype(np.int64) * columns + col.astype(np.int64), view.shape)

    def draw(self, rng: np.random.Generator) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Draw rows and columns of `RENDER_LIMITS.pilot_rays` rays around each point, (point and ray,)."""
        jitter = rng.random((2, len(self.row) * RENDER_LIMITS.pilot_rays)) - 0.5
        row, col = (
            np.repeat(axis, RENDER_LIMITS.pilot_rays) + apart * spread
            for axis, apart, spread in zip((self.row, self.col), jitter, self.spread, strict=True)
        )
        return row, col

    def means(self, signal: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return mean signals of each counted point, separately by first and second rays, shape (point, ray)."""
        each = signal.reshape(-1, RENDER_LIMITS.pilot_rays).astype(float)
        count = np.bincount(self.pixel, minlength=int(np.prod(self.shape)))
        total = [np.bincount(self.pixel, ray, minlength=len(count)) for ray in each.T]
        return np.stack(total, axis=1) / count[:, None]


def _parts_of(name: str, sources: tuple[str, ...]) -> tuple[str, ...]:
    """Return the components that light belongs to: its bounce, and its source if that may be neglected."""
    order, source = bounce_order(name)
    if order == 0:
        return (name,)
    last = LAST_BOUNCE if order >= RENDER_LIMITS.pilot_bounces else f"bounce {order}"
    return (last, source) if source in sources else (last,)


def _air_between(
    stage: SpectralScene, origin: NDArray[np.floating], towards: NDArray[np.floating], seed: int
) -> NDArray[np.float32]:
    """Return the lamp light that air attenuates before it reaches surfaces: the same rays with and without air."""
    with_air, without = (
        radiance_along(
            stage,
            origin,
            towards,
            IntegratorSettings(max_bounces=0, sky_shadowing=False, path_air=between),
            np.random.default_rng([seed, 3]),
            gather_rays=1,
        ).total()
        for between in (True, False)
    )
    return without - with_air


def _effects(tried: PilotEstimate, eye: RenderSensor, view: Viewpoint, bands: int) -> list[OptionalEffect]:
    """Return effects of the components: influence and cost."""
    grain = eye.noise_floor(tried.signal, smooth=True)[:, None]
    million = view.shape[0] * view.shape[1] * SamplingSettings().min_rays * 1e-6 * bands / 10.0
    influence = {
        name: _influence(part / grain, tried.shape)
        for name, part in tried.parts.items()
        if name not in ("in view", "sky")
    }
    # A bounce needs all lower bounces.
    orders = [f"bounce {order}" for order in range(1, RENDER_LIMITS.pilot_bounces)] + [LAST_BOUNCE]
    for order, further in zip(orders[-2::-1], orders[:0:-1], strict=True):
        if further in influence:
            influence[order] = max(influence.get(order, 0.0), influence[further])
    return [
        OptionalEffect(name=name, influence=amount, setup_s=million * _cost(name)) for name, amount in influence.items()
    ]


def _influence(part: NDArray[np.floating], shape: tuple[int, int]) -> float:
    """Return the rms of a component (point, ray) over the region where it is largest.

    Notes
    -----
    The mean square is that of the product of two rays of the same point, which is not biased by Monte Carlo noise as
    the square of their mean would be.
    """
    square = (part[:, 0] * part[:, 1]).reshape(shape)
    count = RENDER_LIMITS.regions
    regions = [
        region.mean()
        for rows in np.array_split(square, count)
        for region in np.array_split(rows, count, axis=1)
        if region.size
    ]
    return float(np.sqrt(max(0.0, *regions)))


def _is_gathered(name: str) -> bool:
    return name.startswith("bounce") or name == "hidden sky"


def _cost(name: str) -> float:
    return RENDER_LIMITS.bounce_cost_s if _is_gathered(name) else RENDER_LIMITS.source_cost_s


def _effort(plan: EffectSelection) -> IntegratorSettings:
    orders = [int(effect.name.split()[1]) for effect in plan.kept if effect.name.startswith("bounce ")]
    out = plan.names
    followed = max(orders, default=0)
    to_the_end = followed >= RENDER_LIMITS.pilot_bounces
    return IntegratorSettings(
        max_bounces=RENDER_LIMITS.exact_bounces if to_the_end else followed,
        sky_shadowing="hidden sky" not in out,
        path_air="air before surfaces" not in out,
        neglected=frozenset(out),
        roulette_depth=RENDER_LIMITS.exact_roulette_depth if to_the_end else RENDER_LIMITS.early_roulette_depth,
    )
