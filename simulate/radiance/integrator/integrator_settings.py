"""Integrator settings: which light paths are followed, and the threads that follow them."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar


@dataclass(frozen=True, kw_only=True)
class SamplingLimits:
    """Sample counts, iteration limits and tolerances of the integrator and the renderer.

    Values without another source are a trade of time against variance in the scenes of `benchmarks.radiance`.
    """

    # Pilot run of the adaptive sampling: side of a tile, least tiles along the shorter side of a small frame, pilot
    # pixels of a tile and at its edges, and rays of each.
    pilot_tile_px: int = 8
    min_tiles: int = 16
    pilot_pixels: int = 4
    pilot_edge_pixels: int = 2
    pilot_rays: int = 2
    # Rays of the pilot over those that it allocates, most rounds, and least rays: rare bright rays need many.
    pilot_fraction: float = 0.1
    max_pilot_rounds: int = 1024
    min_pilot_rays: int = 4096
    # Variance of the mean of n rays at an edge over v n^(-3/2): 1.3 where a straight line crosses a pixel, more where
    # several edges meet or the pilot missed one; measured in the scenes of `benchmarks.radiance`.
    edge_variance_factor: float = 2.0
    # Largest growth of a pixel's rays in a turn, least addition as 1/n of its rays, and steps of their number.
    max_ray_growth: int = 4
    min_growth_divisor: int = 8
    ray_steps_per_doubling: int = 2
    # Irradiance cache: pixels between nodes; for fine nodes least ray origins and most rays from each, because the
    # number of origins limits the accuracy in a penumbra.
    cache_step_px: int = 2
    min_ray_origins: int = 4
    max_rays_per_origin: int = 8
    # Candidate half widths of the smoothing window, and half widths over which its error and single-ray variances are
    # averaged, nodes.
    smoothing_half_widths: tuple[int, ...] = (0, 1, 2, 4, 8)
    error_half_width: int = 2
    variance_half_width: int = 8
    # Most turns of gather rays, largest growth of a node's rays in a turn, and rays of a batch.
    max_cache_turns: int = 6
    max_cache_growth: int = 8
    cache_batch_rays: int = 64_000
    # Fraction of the allowed variance for the cache, which costs most; the rest is for the camera rays.
    cache_variance_fraction: float = 0.8
    # Camera rays with their gather rays in a batch, most turns, and slices of a pixel's rays that give its variance.
    batch_rays: int = 48_000
    max_turns: int = 12
    variance_slices: int = 8
    # Factors on the gather rays of pixels outside the cache: larger where only sky shadowing is computed.
    uncached_ray_factor: int = 2
    sky_shadow_ray_factor: int = 8
    # Control-variate fraction of the sky: side of a tile, px, pixels of each and rays of each pixel.
    control_tile_px: int = 4
    control_pixels: int = 2
    control_rays: int = 4
    # Points that the camera does not see sample one lamp at random if there are more than this.
    max_sampled_lamps: int = 2
    # Mean square over squared mean of the sky radiance from which it is importance-sampled.
    min_sky_contrast: float = 2.0
    # Panes along a ray, light beyond is lost; and panes at which a camera ray is split into both continuations.
    max_panes: int = 64
    max_pane_splits: int = 3
    # Visible discs: corners of the polygon, rays for a covered pixel, and for a disc at least and at most.
    disc_corners: int = 128
    disc_rays_per_pixel: int = 64
    min_disc_rays: int = 1024
    max_disc_rays: int = 65536
    # Covered fractions below this part of the largest are rounding errors.
    coverage_rounding: float = 1e-9
    # Decimals to which planes of panes must agree, and half length of the ray that finds a pane in its plane, m.
    plane_decimals: int = 6
    pane_test_length_m: float = 1e-3


LIMITS = SamplingLimits()


class Named(Protocol):
    """A light with a name."""

    @property
    def name(self) -> str:
        """Its name."""
        ...


Light = TypeVar("Light", bound=Named)


@dataclass(frozen=True, kw_only=True)
class IntegratorSettings:
    """Which light paths are followed.

    Parameters
    ----------
    max_bounces
        Most reflections by other surfaces between a source and the surface that the camera sees. Longer paths are
        neglected, so that the bias is never positive.
    sky_shadowing
        Whether objects occlude the sky; without this and without bounces there is no final gather.
    path_air
        Whether air attenuates light between lamps and the surfaces that the camera sees.
    neglected
        Names of neglected lamps and discs.
    roulette_depth
        First bounce with Russian roulette; None: never.
    """

    max_bounces: int = 1
    sky_shadowing: bool = True
    path_air: bool = True
    neglected: frozenset[str] = frozenset()
    roulette_depth: int | None = None

    @property
    def gathers(self) -> bool:
        """Whether there is a final gather."""
        return self.sky_shadowing or self.max_bounces > 0

    def active_lights(self, lights: tuple[Light, ...]) -> tuple[Light, ...]:
        """Return the lights that are not neglected."""
        return tuple(light for light in lights if light.name not in self.neglected)


# Applies a function to a list of jobs, and yields the results in their order.
Run = Callable[[Callable[[Any], Any], list[Any]], Iterator[Any]]


def one_by_one(do: Callable[[Any], Any], things: list[Any]) -> Iterator[Any]:
    """Run jobs one after the other."""
    return map(do, things)


@contextmanager
def workers(threads: int) -> Iterator[Run]:
    """Yield a runner with `threads` threads, which end with the block."""
    if threads < 2:
        yield one_by_one
        return
    pool = ThreadPoolExecutor(threads, thread_name_prefix="light")
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)
