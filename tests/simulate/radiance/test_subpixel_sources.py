"""Lamps, sun and moon are in the picture as even discs, with the light that reaches the lens."""

import numpy as np
import pytest

from simulate.radiance.geometry import RasterGeometry, Viewpoint, shape
from simulate.radiance.integrator import (
    IntegratorSettings,
    SamplingSettings,
    add_small_sources,
    render_scene,
)
from tests.simulate.radiance.staging import at, disc_light, lamp, staged, upright


def seen(view, walls=(), **lights):
    """Return what lamps and discs add to a picture, (row, col)."""
    stage = staged(list(walls), {"grey": 0.5}, **lights)
    radiance = np.zeros((view.shape[0] * view.shape[1], 2), np.float32)
    add_small_sources(stage, view, radiance)
    return radiance[:, 0].reshape(view.shape)


def looking_north(shape, focal_px, **more):
    """Return a camera at the origin with square pixels."""
    focal = (float(focal_px), float(focal_px))
    return Viewpoint(
        position_m=(0.0, 0.0, 0.0), forward=(0.0, 1.0, 0.0), shape=shape, focal_px=focal, **more
    )


def area_of_circle(shape, row, col, radius):
    """Share of each pixel inside a circle, by 64 x 64 places of each."""
    at = (np.arange(64 * max(shape)) + 0.5) / 64
    inside = np.hypot(at[: 64 * shape[0], None] - row, at[None, : 64 * shape[1]] - col) < radius
    return inside.reshape(shape[0], 64, shape[1], 64).mean(axis=(1, 3))


@pytest.mark.parametrize("diameter_px", [0.3, 6.0, 29.0])
def test_a_disc_is_evenly_as_bright_as_its_light_over_its_solid_angle(diameter_px):
    """Of lamps and of the moon; pixels at its rim have the share of their area inside the
    circle.
    """
    radius = 0.5 * diameter_px / 4000.0
    direction = np.array([1.3 / 4000.0, 1.0, 2.2 / 4000.0])
    view = looking_north((40, 48), 4000.0)
    covered = area_of_circle(view.shape, 20.0 - 2.2, 24.0 + 1.3, 0.5 * diameter_px)
    bright = 1.0 / (np.pi * radius**2)
    moon = seen(view, discs=(disc_light(direction, radius),))
    ball = seen(view, lamps=(lamp(10.0 * direction, 100.0, 10.0 * radius),))
    for found in (moon, ball):
        assert found / bright == pytest.approx(covered, abs=0.02)
        assert found.sum() / bright == pytest.approx(np.pi * 0.25 * diameter_px**2, rel=1e-3)
        inside = found[covered == 1.0]
        assert not len(inside) or inside.std() / inside.mean() < 1e-5


def test_a_wall_before_half_of_a_disc_leaves_half_of_its_light():
    """The wall's edge runs through the middle of the lamp: pixels on one side are dark, on the
    other bright.
    """
    view = looking_north((40, 40), 1000.0)
    wall = [("wall", "grey", at(upright(shape("plane", (2.0, 2.0))), 1.0, 5.0, 0.0))]
    free, half = (
        seen(view, walls, lamps=(lamp((0.0, 10.0, 0.0), 1.0, 0.1),)) for walls in ((), wall)
    )
    assert half.sum() / free.sum() == pytest.approx(0.5, rel=0.01)
    assert not half[:, 20:].any() and half[:, :20] == pytest.approx(free[:, :20], rel=0.05)


def test_a_disc_that_reaches_beyond_the_picture_is_cut_at_its_border():
    view = looking_north((8, 10), 1000.0)
    found = seen(view, lamps=(lamp((0.05, 10.0, 0.0), 1.0, 0.1),))
    covered = area_of_circle(view.shape, 4.0, 10.0, 10.0)
    assert found / found.max() == pytest.approx(covered, abs=0.02)


def test_a_scanner_that_turns_by_a_pixel_a_row_sees_the_disc_that_a_framing_camera_sees():
    """Its line stands upright and sweeps from west to east past a lamp, which moves through the
    line's own width.
    """
    scan = RasterGeometry(line_time_s=1.0, turn_deg_per_s=float(np.rad2deg(1.0 / 500.0)))
    view = looking_north((60, 40), 500.0, roll_deg=90.0, scan=scan)
    azimuth = 30.3 / 500.0
    found = seen(
        view, lamps=(lamp((10.0 * np.sin(azimuth), 10.0 * np.cos(azimuth), 0.0), 1.0, 0.12),)
    )
    assert np.isfinite(found).all()
    covered = area_of_circle(view.shape, 30.3, 20.0, 6.0)
    assert found / found.max() == pytest.approx(covered, abs=0.03)
    inside = found[covered == 1.0]
    assert inside.std() / inside.mean() < 0.001


def test_a_scanners_pixels_are_as_high_as_they_are_wide():
    view = looking_north(
        (6, 8), 500.0, scan=RasterGeometry(line_time_s=1.0, velocity_m_per_s=(0.0, 0.0, 1.0))
    )
    middle = np.array([2.5]), np.array([3.5])
    assert view.solid_angle_sr(*middle)[0] == pytest.approx(1.0 / 500.0**2, rel=1e-3)


def test_a_camera_within_a_lamp_does_not_see_it():
    view = looking_north((8, 10), 100.0)
    assert not seen(
        view, lamps=(lamp((0.0, 0.0, 0.0), 1.0, 0.05), lamp((0.0, 0.01, 0.0), 1.0, 0.05))
    ).any()


def test_a_lamp_whose_light_on_surfaces_is_left_out_is_seen_all_the_same():
    wall = at(upright(shape("plane", (100.0, 100.0))), 0.0, 20.0, 0.0)
    stage = staged([("wall", "grey", wall)], {"grey": 0.5}, lamps=(lamp((0.1, 10.0, 0.1), 3.0),))
    view = Viewpoint(
        position_m=(0.0, 0.0, 0.0), forward=(0.0, 1.0, 0.0), shape=(12, 16), focal_px=(20.0, 20.0)
    )
    effort = IntegratorSettings(max_bounces=0, sky_shadowing=False, neglected=frozenset({"lamp"}))
    seen = render_scene(
        stage, view, SamplingSettings(cache_rays=None), effort, weight=np.ones(2), seed=1
    ).cube.radiance[0]
    row, col = (axis.ravel() + 0.5 for axis in np.indices(view.shape))
    at_the_lens = np.sum(seen.ravel() * view.solid_angle_sr(row, col))
    assert np.count_nonzero(seen) == 1
    assert at_the_lens == pytest.approx(3.0 / (10.0**2 + 2 * 0.1**2), rel=0.01)
