"""Settings of the integrator: light paths, numbers of rays, the sensor whose noise limits errors,
and threads.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulate.arrays import Array, Array32, Index, Mask
from simulate.radiance.cube import band_widths


@dataclass(frozen=True, kw_only=True)
class SamplingLimits:
    """Sample counts, iteration limits and tolerances of the integrator and the renderer.

    Values without another source are a trade of time against variance in the scenes of
    `benchmarks.radiance`.
    """

    # Largest growth of the rays of a pixel or cache node in a turn, and half widths over which
    # variances of single rays and errors are averaged, pixels or nodes.
    max_growth: int = 8
    variance_half_width: int = 8
    error_half_width: int = 2
    # Irradiance cache: pixels between nodes; for fine nodes least ray origins and most rays from
    # each, because the number of origins limits the accuracy in a penumbra; candidate half widths
    # of the smoothing window, nodes; most turns, and rays of a batch.
    cache_step_px: int = 2
    min_ray_origins: int = 4
    max_rays_per_origin: int = 8
    smoothing_half_widths: tuple[int, ...] = (0, 1, 2, 4, 8)
    max_cache_turns: int = 6
    cache_batch_rays: int = 64_000
    # Fraction of the allowed variance for the cache, which costs most; the rest is for the camera
    # rays.
    cache_variance_fraction: float = 0.8
    # Camera rays with their gather rays in a batch, most turns, and slices of a pixel's rays that
    # give its variance.
    batch_rays: int = 48_000
    max_turns: int = 12
    variance_slices: int = 8
    # Factors on the gather rays of pixels outside the cache: larger where only sky shadowing is
    # computed.
    uncached_ray_factor: int = 2
    sky_shadow_ray_factor: int = 8
    # Control-variate fraction of the sky: side of a tile, px, pixels of each and rays of each
    # pixel.
    control_tile_px: int = 4
    control_pixels: int = 2
    control_rays: int = 4
    # Points that the camera does not see sample one lamp at random if there are more than this.
    max_sampled_lamps: int = 2
    # Mean square over squared mean of the sky radiance from which it is importance-sampled.
    min_sky_contrast: float = 2.0
    # Panes along a ray, light beyond is lost; and panes at which a camera ray is split into both
    # continuations.
    max_panes: int = 64
    max_pane_splits: int = 3
    # Visible discs: corners of the polygon, rays for a covered pixel, and for a disc at least and
    # at most.
    disc_corners: int = 128
    disc_rays_per_pixel: int = 64
    min_disc_rays: int = 1024
    max_disc_rays: int = 65536
    # Covered fractions below this part of the largest are rounding errors.
    coverage_rounding: float = 1e-9
    # Decimals to which planes of panes must agree, and half length of the ray that finds a pane in
    # its plane, m.
    plane_decimals: int = 6
    pane_test_length_m: float = 1e-3


LIMITS = SamplingLimits()


@dataclass(frozen=True, kw_only=True)
class IntegratorSettings:
    """Which light paths are followed."""

    # Most reflections by other surfaces between a source and the surface that the camera sees.
    # Longer paths are neglected, so that the bias is never positive.
    max_bounces: int = 1
    # Whether objects occlude the sky; without this and without bounces there is no final gather.
    sky_shadowing: bool = True
    # whether air attenuates light between lamps and the surfaces that the camera sees
    path_air: bool = True
    neglected: frozenset[str] = frozenset()  # names of neglected lamps and discs
    roulette_depth: int | None = None  # first bounce with Russian roulette; None: never

    @property
    def gathers(self) -> bool:
        """Whether there is a final gather."""
        return self.sky_shadowing or self.max_bounces > 0

    def active_lights(self, lights: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the lights that are not neglected."""
        return tuple(light for light in lights if light.name not in self.neglected)


@dataclass(frozen=True, kw_only=True)
class SamplingSettings:
    """Number of rays."""

    # Fewest rays of a pixel (at least 2), of a pixel where objects or shadows meet, and most rays
    # of any pixel.
    min_rays: int = 2
    edge: int = 8
    max_rays: int = 32
    # most rays of all pixels together, apart from the fewest of each; None: no limit
    total_rays: int | None = None
    gather_rays: int = 2  # final-gather rays of each point that a camera ray hits
    # First and most gather rays of each node of the irradiance cache; None: no cache, every ray
    # gathers for itself, which is slower and makes no smoothness assumption.
    cache_rays: int | None = 8
    max_cache_rays: int = 512
    # Whether the cache has one node per pixel instead of one per four, and pixels in which surfaces
    # meet gather for themselves: for shadows narrower than two pixels, in twice the time. No effect
    # where only sky shadowing is computed.
    refine: bool = False
    # Allowed Monte Carlo variance of a pixel's signal, as a function of the signal: rays are added
    # until the mean of measured variance over limit is 1 over the rendering. None: each pixel gets
    # its fewest rays.
    error_limit: Callable[[Array], Array] | None = None


def excess_variance(variance: Array, signal: Array, error_limit: Callable[[Array], Array]) -> Array:
    """Return variances over those allowed; zero where none is, as in the dark, which no number of
    rays reaches.
    """
    limit = error_limit(np.maximum(signal, 0.0))
    return np.divide(
        variance, limit, out=np.zeros(limit.shape), where=(variance > 0.0) & (limit > 0.0)
    )


def local_mean(values: Array, group: Mask, half_width: int) -> Array:
    """Return means of values (row, col) over those of a group in squares around each."""
    from scipy.ndimage import uniform_filter

    group_density, total = (
        uniform_filter(grid, 2 * half_width + 1, mode="constant")
        for grid in (group.astype(float), np.where(group, values, 0.0))
    )
    return np.divide(total, group_density, out=np.zeros_like(total), where=group_density > 1e-9)


def additional_rays(
    excess: Array,
    rays: NDArray[np.integer],
    groups: tuple[Mask, ...],
    max_rays: int,
    total: float = np.inf,
) -> Index:
    """Return the additional rays of pixels or cache nodes by their measured variance, powers of two
    or zero.

    Parameters
    ----------
    excess
        Variance of each over its limit, shape (row, col).
    rays, max_rays, total
        Rays of each so far, shape (row, col), most rays of each and of all.
    groups
        Those that are alike, by masks of shape (row, col); others get none.

    Notes
    -----
    n proportional to the root of the single-ray variance v brings the mean of v/n to 1 with the
    fewest rays (Neyman, 1934). The estimate of v from few rays is used for at most
    `LIMITS.max_growth` times as many. The excess of those at the limit of rays is not compensated
    by others. Each uses at least the mean variance of its group nearby, because its rays may have
    missed rare bright light.
    """
    # Running sums leave small negative values where nothing varies.
    ray_variance, mask = np.clip(excess * rays, 0.0, max_rays), np.zeros(rays.shape, bool)
    for group in groups:
        group_mean = local_mean(ray_variance, group, LIMITS.variance_half_width)
        ray_variance, mask = (
            np.where(group, np.maximum(ray_variance, group_mean), ray_variance),
            mask | group,
        )
    root = np.sqrt(ray_variance[mask])
    current = rays[mask]
    if not current.size or (ray_variance[mask] / current).mean() <= 1.0 or current.sum() >= total:
        return np.zeros(rays.shape, np.int64)
    target = root * root.mean()
    target *= min(1.0, total / target.sum())
    increase = np.minimum(target, np.minimum(LIMITS.max_growth * current, max_rays)) - current
    # A single additional ray would give no variance.
    step = 2 ** np.maximum(np.round(np.log2(np.maximum(increase, 1.0))), 1.0).astype(np.int64)
    step = np.where(current + step > max_rays, step // 2, step)
    additional = np.zeros(rays.shape, np.int64)
    additional[mask] = np.where((increase >= 0.5 * current) & (step > 1), step, 0)
    return additional


# Differences are compared with the noise, or with this fraction of the signal where that is larger.
# At a tolerance of 10 % light is then correct to 1 %, better than lamps and materials are
# specified.
KNOWN = 0.1


@dataclass(frozen=True, kw_only=True)
class RenderSensor:
    """A sensor's response and noise."""

    # Signal of a pixel and exposure for each W m-2 sr-1 of radiance at wavelengths, linear between
    # them and zero outside, in any unit, such as photoelectrons.
    response_nm: tuple[float, ...]
    response: tuple[float, ...]
    # Variance of a pixel's signal in the dark, in that unit squared, and its growth with the
    # signal.
    dark_variance: float
    variance_per_signal: float
    # Factor by which blur after the pixels reduces the standard deviation of noise that is
    # independent between pixels.
    noise_averaging_factor: float = 1.0
    name: str = "sensor"  # name of the sensor

    def weight(self, wavelength_nm: ArrayLike) -> Array32:
        """Return the signal for spectral radiance in the bands of a grid, shape (band,), per W m-2
        sr-1 nm-1.
        """
        grid = np.asarray(wavelength_nm, float)
        response = np.interp(grid, self.response_nm, self.response, left=0.0, right=0.0)
        return (response * band_widths(grid)).astype(np.float32)

    def noise_floor(self, signal: ArrayLike, *, smooth: bool = False) -> Array:
        """Return the noise of a pixel in one frame, at least `KNOWN` of the signal: what
        differences are compared with.

        Differences that extend over many pixels (`smooth`) are not reduced by blur, but the noise
        is; random differences between pixels are reduced like the noise.
        """
        positive_signal = np.maximum(np.asarray(signal, float), 0.0)
        noise = np.sqrt(self.dark_variance + self.variance_per_signal * positive_signal)
        return np.maximum(
            noise * (self.noise_averaging_factor if smooth else 1.0), KNOWN * positive_signal
        )


# Applies a function to a list of jobs, and yields the results in their order.
Run = Callable[[Callable[[Any], Any], list[Any]], Iterator[Any]]


def one_by_one(job: Callable[[Any], Any], arguments: list[Any]) -> Iterator[Any]:
    """Run jobs one after the other."""
    return map(job, arguments)


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
