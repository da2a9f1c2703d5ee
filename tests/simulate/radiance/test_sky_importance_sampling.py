"""The glow around the sun is looked for by name: the same light as by gathering, without bright
specks.
"""

from dataclasses import replace

import numpy as np
import pytest

from simulate.radiance.brdf import Glossy, grey
from simulate.radiance.geometry import plane
from simulate.radiance.integrator import (
    IntegratorSettings,
    SkyImportance,
    SpectralScene,
    environment_map,
    radiance_along,
)
from tests.simulate.radiance.staging import OVERCAST, UNIFORM, at, inside_out, staged, upright

SUN = np.array([0.0, np.cos(0.6), np.sin(0.6)])
GLOSS = Glossy(reflectance=grey(0.3), roughness=0.3)
DOWN = np.array([0.0, 0.1, -1.0]) / np.hypot(0.1, 1.0)


def glow(way):
    """An even sky with a glow of some degrees that holds about half of all light: radiance falls as
    exp(-angle).
    """
    return np.ones((2, 1)) * (
        1.0 + 400.0 * np.exp(-np.arccos(np.clip(way @ SUN, -1.0, 1.0)) / 0.04)
    )


def without(stage: SpectralScene) -> SpectralScene:
    """The same stage whose bright sky is found by gathering alone."""
    lighting = replace(stage.lighting)
    lighting.__dict__["bright_sky"] = None
    return replace(stage, lighting=lighting)


def seen(
    stage: SpectralScene,
    count: int,
    seed: int,
    sky_control_fraction: float,
    effort: IntegratorSettings,
):
    origin = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
    share = np.full(count, sky_control_fraction, np.float32)
    found = radiance_along(
        stage,
        origin,
        np.broadcast_to(DOWN, (count, 3)),
        effort,
        np.random.default_rng(seed),
        gather_rays=2,
        sky_control_fraction=share,
    )
    return found.total()[:, 0].astype(float)


def wall(y: float):
    """A wall 2 m high that hides the glow from the north, and mirrors light from the south."""
    return at(upright(plane(30, 2)), 0, y, 1.0)


@pytest.mark.parametrize(
    ("floor", "y", "known", "bounces", "gain"),
    [
        (0.5, 1.0, 1.0, 0, 3.0),
        (0.5, 4.0, 0.3, 0, 3.0),
        (0.5, -1.0, 0.3, 1, 3.0),
        (GLOSS, 4.0, 1.0, 0, 3.0),
        (GLOSS, 1.0, 1.0, 1, 0.8),
    ],
    ids=[
        "hidden from diffuse ground",
        "on diffuse ground",
        "on a wall behind",
        "in a gloss",
        "hidden from a gloss",
    ],
)
def test_light_of_a_glow_is_that_found_by_gathering_with_less_chance(
    seed, floor, y, known, bounces, gain
):
    parts = [
        ("floor", "floor", plane(60, 60)),
        ("wall", "wall", wall(y) if y > 0 else inside_out(wall(y))),
    ]
    stage = staged(parts, {"floor": floor, "wall": 0.5}, sky=glow)
    effort = IntegratorSettings(max_bounces=bounces)
    by_name = seen(stage, 6_000, seed, known, effort)
    gathered = seen(without(stage), 24_000, seed + 100, known, effort)
    error = np.hypot(by_name.std() / np.sqrt(len(by_name)), gathered.std() / np.sqrt(len(gathered)))
    assert abs(by_name.mean() - gathered.mean()) < 3.5 * error
    assert error < 0.08 * gathered.mean()

    assert gathered.std() > gain * by_name.std()


def test_directions_are_drawn_with_the_density_stated(seed):
    bright = SkyImportance.of(environment_map.environment_map(glow))
    assert bright is not None
    rng = np.random.default_rng(seed)
    way = bright.draw(40_000, rng)
    assert np.linalg.norm(way, axis=1) == pytest.approx(1.0)
    # The mean of one over the density is the solid angle drawn from; the density adds up to one.
    inverse = 1.0 / bright.density(way)
    assert abs(inverse.mean() - 2.0 * np.pi) < 4.0 * inverse.std() / np.sqrt(len(inverse))
    even = np.column_stack([rng.normal(size=(100_000, 3))])
    even /= np.linalg.norm(even, axis=1, keepdims=True)
    found = 4.0 * np.pi * bright.density(even)
    assert abs(found.mean() - 1.0) < 4.0 * found.std() / np.sqrt(len(found))
    assert np.mean(way @ SUN > np.cos(0.2)) > 0.3, "so much of the light is close to the sun"


def test_an_even_sky_costs_no_further_rays():
    assert SkyImportance.of(environment_map.environment_map(UNIFORM)) is None
    assert SkyImportance.of(environment_map.environment_map(OVERCAST)) is None
