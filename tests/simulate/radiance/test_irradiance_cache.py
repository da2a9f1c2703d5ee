"""Light that pixels share: as bright as analytic radiometry says, blurred by nothing, and sure of
its own error.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from simulate.radiance.geometry import Viewpoint, box, plane
from simulate.radiance.integrator import (
    IntegratorSettings,
    SamplingSettings,
    SpectralScene,
    build_irradiance_cache,
    integrator_settings,
    one_by_one,
    render_scene,
    workers,
)
from tests.simulate.radiance.staging import UNIFORM, at, lamp, staged, upright

WHITE = np.ones(2, np.float32)
HEIGHT_M = 1.0
# Straight down on a floor beside a long wall: 0.25 m to 3.9 m from it, a twentieth of a metre each
# pixel.
ABOVE = Viewpoint(
    position_m=(0.0, 2.1, 5.0), forward=(0, 0, -1), shape=(72, 60), focal_px=(100.0, 100.0)
)


def squared(share: float, signal: np.ndarray) -> np.ndarray:
    """Variance of an error that is a share of the signal."""
    return (share * signal) ** 2


def beside_a_wall() -> SpectralScene:
    wall = at(upright(plane(600, HEIGHT_M)), 0, 0, 0.5 * HEIGHT_M)
    return staged(
        [("floor", "floor", plane(600, 600)), ("wall", "wall", wall)],
        {"floor": 0.5, "wall": 0.0},
        sky=UNIFORM,
    )


def sky_seen(view: Viewpoint) -> np.ndarray:
    """Irradiance over pi at the middle of each pixel: 1 - (1 - x / sqrt(x^2 + H^2)) / 2 at x from
    the wall.
    """
    row, col = np.meshgrid(*(np.arange(n) + 0.5 for n in view.shape), indexing="ij")
    origin, towards = view.rays(row.ravel(), col.ravel())
    x = np.abs((origin - origin[:, 2:] / towards[:, 2:] * towards)[:, 1]).reshape(view.shape)
    return 1.0 - 0.5 * (1.0 - x / np.hypot(x, HEIGHT_M))


def test_a_floor_beside_a_long_wall_is_as_bright_as_the_sky_that_it_sees(seed):
    found = render_scene(
        beside_a_wall(),
        ABOVE,
        SamplingSettings(cache_rays=64),
        IntegratorSettings(max_bounces=0),
        weight=WHITE,
        seed=seed,
    )
    relative = found.cube.radiance[0] * 2.0 / sky_seen(ABOVE) - 1.0
    assert np.median(np.abs(relative)) < 0.005
    assert abs(relative.mean()) < 0.002
    # The slope is not smoothed away: the strip nearest to the wall is as dark as it should be, over
    # 40 seeds to 0.5 %, each within 1.4 %.
    assert abs(relative[-4:].mean()) < 0.015


def test_shared_light_knows_its_own_error(seed):
    stage, known, weight = beside_a_wall(), np.zeros(ABOVE.shape, np.float32), np.array([1.0, 0.0])

    def shared(rays: int):
        limits = {"rays": rays, "max_rays": rays}
        effort = IntegratorSettings(max_bounces=0)
        return build_irradiance_cache(
            stage,
            ABOVE,
            effort,
            known,
            **limits,
            error_limit=None,
            weight=weight,
            seed=seed,
            run=one_by_one,
        )

    found = shared(16)
    missed = found.change[..., 0] - np.pi * (
        sky_seen(ABOVE.smaller(integrator_settings.LIMITS.cache_step_px)) - 1.0
    )
    assert 0.25 < np.mean(missed**2) / found.variance.mean() < 4.0
    assert shared(128).variance.mean() < found.variance.mean() / 4.0


@pytest.mark.parametrize(("share", "fine"), [(0.01, False), (0.01, True)])
def test_what_few_rays_find_counts_for_the_whole(share, fine, seed):
    """A plate that one ray in 180 meets, of 4 from each node at first: those that missed it do not
    stop at that.

    Windows chosen by what nodes found, or further rays only for those that found something, would
    lose 30 %. Rays sent by what was found so far lose a hundredth (over 160 pictures .5 to .9 %).
    """
    parts = [("floor", "m", plane(20, 20)), ("plate", "m", at(plane(0.5, 0.5), 0.0, 0.0, 3.0))]
    stage, below = (
        staged(parts, {"m": 0.5}, sky=UNIFORM),
        replace(ABOVE, position_m=(0.0, 0.0, 2.0)),
    )
    known, weight = np.ones(below.shape, np.float32), np.array([1.0, 0.0])
    limits = {"rays": 4, "max_rays": 2048, "error_limit": partial(squared, share), "fine": fine}

    def lost(number: int) -> float:
        asked = {
            "sky_control_fraction": known,
            "weight": weight,
            "seed": 100 * seed + number,
            "run": one_by_one,
        }
        return (
            build_irradiance_cache(
                stage, below, IntegratorSettings(max_bounces=0), **limits, **asked
            )
            .change[..., 0]
            .mean()
            / np.pi
        )

    relative = (
        np.array([lost(number) for number in range(12)]) / -hidden_by_a_square(below, 0.5, 3.0)
        - 1.0
    )
    error = relative.std(ddof=1) / np.sqrt(len(relative))
    assert abs(relative.mean()) < 4.0 * error + 0.01
    assert error < 0.08


def hidden_by_a_square(view: Viewpoint, side_m: float, height_m: float) -> float:
    """Mean share of an even sky that a square over the origin hides from the floor that a camera
    sees straight down.

    Of a small patch at height h and distance r that is h**2 / r**4 / pi per square metre: a cosine
    at either end.
    """
    row, col = (np.arange(n) + 0.5 - n / 2.0 for n in view.shape)
    x, y = (axis * view.position_m[2] / view.focal_px[0] for axis in (col, row))
    patch = (np.arange(16) + 0.5) / 16.0 * side_m - side_m / 2.0
    apart = [(a[:, None] - patch) ** 2 for a in (x, y)]
    square = apart[0][:, :, None, None] + apart[1][None, None] + height_m**2
    return float((height_m**2 / square**2).mean() * side_m**2 / np.pi)


def test_a_pixel_on_a_shadows_slope_is_known_by_as_many_places_as_its_rays_allow(seed):
    """Within a pixel beside a kerb the sky seen runs from a half to all: its mean is known in
    closed form.
    """
    kerb_m, pixel_m = 0.02, 0.1
    kerb = at(upright(plane(600, kerb_m)), 0, 0, 0.5 * kerb_m)
    parts = [("floor", "floor", plane(600, 600)), ("kerb", "kerb", kerb)]
    stage = staged(parts, {"floor": 0.5, "kerb": 0.0}, sky=UNIFORM)
    # One column, so that nodes along the kerb cannot even each other out.
    view = replace(ABOVE, shape=(42, 1), focal_px=(50.0, 50.0))
    limits = {
        "rays": 1024,
        "max_rays": 1024,
        "error_limit": None,
        "weight": np.array([1.0, 0.0]),
        "fine": True,
    }

    def beside_the_kerb(one: int) -> float:
        known = np.ones(view.shape, np.float32)
        found = build_irradiance_cache(
            stage,
            view,
            IntegratorSettings(max_bounces=0),
            known,
            **limits,
            seed=one,
            run=one_by_one,
        )
        return 1.0 + found.change[-1, 0, 0] / np.pi

    exact = 0.5 + (np.hypot(pixel_m, kerb_m) - kerb_m) / (2.0 * pixel_m)
    missed = np.array([beside_the_kerb(seed + one) for one in range(12)]) - exact
    # From four places for each half it would be .029; so it is .007.
    assert np.sqrt(np.mean(missed**2)) < 0.015


def test_threads_change_no_byte(seed):
    parts = [("floor", "m", plane(40, 40)), ("box", "m", at(box(2, 2, 2), 0, 3, 0))]
    stage = staged(parts, {"m": 0.5}, sky=UNIFORM, lamps=(lamp((0, 0, 3), 3.0, 0.3),))
    view = Viewpoint(
        position_m=(0, -6, 3), forward=(0, 1, -0.4), shape=(48, 64), focal_px=(60.0, 60.0)
    )
    rays = SamplingSettings(error_limit=lambda signal: (0.02 * signal) ** 2)
    alone = render_scene(stage, view, rays, IntegratorSettings(), weight=WHITE, seed=seed)
    with workers(3) as run:
        together = render_scene(
            stage, view, rays, IntegratorSettings(), weight=WHITE, seed=seed, run=run
        )
    assert alone.cube.radiance.tobytes() == together.cube.radiance.tobytes()
