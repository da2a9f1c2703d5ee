"""Panes keep energy and mirror; lamps, sun and moon are in the picture as even discs, also behind
panes.
"""

import pickle
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from labdata import BadInput, from_mapping
from simulate.radiance import clearest, load_scene, pane_fractions
from simulate.radiance.geometry import Mesh, RasterGeometry, Viewpoint, collect_surfaces, shape
from simulate.radiance.integrator import (
    IntegratorSettings,
    Panes,
    SamplingSettings,
    add_small_sources,
    radiance_along,
    render_scene,
)
from simulate.radiance.outdoor import BuiltScene, MaterialSpec, OutdoorScene
from tests.simulate.radiance.staging import (
    NM,
    UNIFORM,
    UP,
    agree,
    at,
    disc_light,
    irradiance,
    lamp,
    staged,
    upright,
)

# Panes keep energy, weaken what comes through by the textbook, and mirror what stands before them.


INDEX = 1.5
# Reflectance of one face of glass of index 1.5 at 0, 30, 45, 60 and 75 degrees: Fresnel, as
# handbooks print it.
FACE = {0: 0.0400, 30: 0.0415, 45: 0.0502, 60: 0.0892, 75: 0.2531}


def glazed(stage, panes):
    """Return a stage with panes before it: meshes of clear glass."""
    found = collect_surfaces([(f"pane {i}", "glass", mesh) for i, mesh in enumerate(panes)])
    glass = Panes(
        tracer=found.tracer,
        kind_of_face=found.material_of,
        transmittance=np.full((1, len(NM)), clearest(INDEX)),
        refractive_index=(INDEX,),
    )
    return replace(stage, bsdfs=replace(stage.bsdfs, panes=glass))


def floor(rho=0.5, **light):
    return staged([("floor", "grey", shape("ground", (1000.0,)))], {"grey": rho}, **light)


def sheet(height, size=500.0) -> Mesh:
    """A level pane."""
    return at(shape("plane", (size, size)), 0.0, 0.0, height)


def textbook(angle_deg, internal=1.0):
    """Mirrored and let-through shares summed reflection by reflection, ray by ray, for both
    polarisations.
    """
    outer = np.deg2rad(angle_deg)
    inner = np.arcsin(np.sin(outer) / INDEX)
    n_in, n_out = np.cos(outer), np.cos(inner)
    left = internal ** (1.0 / n_out)
    shares = []
    for face in (
        ((n_in - INDEX * n_out) / (n_in + INDEX * n_out)) ** 2,
        ((INDEX * n_in - n_out) / (INDEX * n_in + n_out)) ** 2,
    ):
        back, on, inside = face, 0.0, 1.0 - face
        for crossing in range(200):
            inside *= left
            on, back = (
                on + inside * (1 - face) * (crossing % 2 == 0),
                back + inside * (1 - face) * (crossing % 2),
            )
            inside *= face
        shares.append((back, on))
    return np.mean(shares, axis=0)


@pytest.mark.parametrize("angle_deg", [0, 30, 45, 60, 75, 89])
def test_a_clear_pane_mirrors_and_lets_through_all_light_and_faces_are_the_handbooks(angle_deg):
    cosine = np.cos(np.deg2rad([float(angle_deg)]))
    back, on = pane_fractions(cosine, np.array([clearest(INDEX)]), INDEX)
    assert back + on == pytest.approx(1.0, abs=1e-12)
    assert (back[0, 0], on[0, 0]) == pytest.approx(textbook(angle_deg), abs=1e-6)
    if angle_deg == 0:
        assert back[0, 0] == pytest.approx(2 * FACE[0] / (1 + FACE[0]), abs=1e-4)


def test_what_a_grey_pane_neither_mirrors_nor_lets_through_it_keeps():
    internal = 0.8
    upright_on = textbook(0.0, internal)[1]
    for angle in (0.0, 40.0, 70.0, 85.0):
        back, on = pane_fractions(np.cos(np.deg2rad([angle])), np.array([upright_on]), INDEX)
        assert (back[0, 0], on[0, 0]) == pytest.approx(textbook(angle, internal), rel=1e-6)
        assert back + on < 1.0


@pytest.mark.parametrize("count", [1, 2])
def test_a_lamp_behind_panes_is_weakened_as_the_textbook_says(count):
    lit = floor(lamps=(lamp((0.0, 0.0, 5.0)),))
    panes = [sheet(1.0 + i) for i in range(count)]
    for across, angle in ((0.0, 0.0), (5.0, 45.0)):
        open_, behind = (
            irradiance(stage, [(across, 0.0, 0.0)], UP)[0] for stage in (lit, glazed(lit, panes))
        )
        assert behind / open_ == pytest.approx(textbook(angle)[1] ** count, rel=1e-4)


def test_the_sun_behind_a_pane_is_weakened_and_before_it_is_not():
    lit = floor(discs=(disc_light((0.0, 1.0, 1.0)),))
    open_, behind, beside = (
        irradiance(stage, [(0.0, 0.0, 0.0)], UP)[0]
        for stage in (lit, glazed(lit, [sheet(1.0)]), glazed(lit, [sheet(1.0, size=0.5)]))
    )
    assert behind / open_ == pytest.approx(textbook(45.0)[1], rel=1e-3)
    assert beside == pytest.approx(open_)


def test_under_an_even_sky_a_pane_takes_nothing_from_a_white_world():
    # Sky above and a floor that reflects all: what the pane mirrors is as bright as what it keeps
    # away.
    stage = glazed(floor(1.0, sky=UNIFORM), [sheet(1.0)])
    for known in (0.0, 1.0):
        seen = irradiance(
            stage,
            np.zeros((2000, 3)),
            UP,
            effort=IntegratorSettings(max_bounces=30),
            rays=4,
            sky_control_fraction=known,
        )
        agree(seen, np.pi, 0.01)


def test_under_glass_a_black_floor_gets_the_sky_that_the_pane_lets_through():
    stage = glazed(floor(1e-6, sky=UNIFORM), [sheet(0.5)])
    steps = np.deg2rad(np.linspace(0.25, 89.75, 180))
    through = [textbook(np.rad2deg(angle))[1] for angle in steps]
    expected = np.sum(np.array(through) * 2.0 * np.pi * np.sin(steps) * np.cos(steps)) * np.deg2rad(
        0.5
    )
    agree(
        irradiance(
            stage, np.zeros((4000, 3)), UP, effort=IntegratorSettings(max_bounces=1), rays=8
        ),
        float(expected),
        0.01,
    )


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_lit_wall_behind_windows_is_seen_weakened_and_the_sky_in_them(count):
    wall = at(upright(shape("plane", (100.0, 100.0))), 0.0, 20.0, 0.0)
    panes = [
        at(upright(shape("plane", (50.0, 50.0))), 0.0, 5.0 + 0.1 * i, 0.0) for i in range(count)
    ]
    lit = staged([("wall", "grey", wall)], {"grey": 0.5}, lamps=(lamp((0.0, 15.0, 0.0), 100.0),))
    rays = np.zeros((10_000, 3)), np.tile([0.0, 1.0, 0.0], (10_000, 1))
    effort = IntegratorSettings(max_bounces=0, sky_shadowing=False)
    bare, behind = (
        radiance_along(stage, *rays, effort, np.random.default_rng(11), gather_rays=1).total()[:, 0]
        for stage in (lit, glazed(lit, panes))
    )
    back, _ = textbook(0.0)
    # Parallel panes together: light goes to and fro between them, and the lamp shines on the wall
    # before them all.
    agree(behind / bare, (1 - back) / (1 + (count - 1) * back))
    sky = staged(
        [("wall", "grey", wall)],
        {"grey": 1e-6},
        sky=lambda way: np.ones((2, 1)) * (way[:, 1] < 0.0),
    )
    seen = radiance_along(
        glazed(sky, panes), *rays, effort, np.random.default_rng(12), gather_rays=1
    ).total()[:, 0]
    agree(seen, 1 - (1 - back) / (1 + (count - 1) * back))


GLASSHOUSE = """
name = "a window"
[camera]
position_m = [0, 0, 1]
look_at_m = [0, 10, 1]
[[material]]
label = "grey"
reflectance = [0.3]
[[material]]
label = "green glass"
wavelength_nm = [400, 550, 900]
pane_transmittance = [0.5, 0.88, 0.6]
[[object]]
label = "ground"
shape = "ground"
size_m = [100]
material = "grey"
[[object]]
label = "window"
shape = "plane"
size_m = [2, 2]
material = "green glass"
position_m = [0, 5, 1.1]
pitch_deg = 90
[[lamp]]
label = "lamp"
kind = "incandescent"
lumens = 100
position_m = [0, 8, 1]
"""


def test_a_window_is_written_in_a_scene_and_goes_with_it_to_other_processes(tmp_path):
    path = tmp_path / "window.toml"
    path.write_text(GLASSHOUSE)
    site = BuiltScene(cast("OutdoorScene", load_scene(path)))
    surfaces_there = pickle.loads(pickle.dumps(site.surfaces))
    assert surfaces_there.objects == ("ground",)
    assert surfaces_there.panes is not None and surfaces_there.panes.objects == ("window",)
    grid = np.array([400.0, 550.0, 900.0])
    panes = site.on(grid).bsdfs.panes
    assert panes is not None
    which, left = panes.transmittance_along(
        np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 10.0, 0.0]]), 1.0
    )
    assert which == [0] and left[0] == pytest.approx([0.5, 0.88, 0.6], rel=1e-5)
    assert not len(
        panes.transmittance_along(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 4.0, 0.0]]), 1.0)[0]
    )
    path.write_text(GLASSHOUSE.replace("position_m = [0, 8, 1]", "position_m = [0, 5.01, 1]"))
    with pytest.raises(BadInput, match="stand clear of surfaces"):
        _ = BuiltScene(cast("OutdoorScene", load_scene(path))).surfaces


def test_panes_that_nobody_could_buy_are_refused():
    for keys, says in (
        ({"pane_transmittance": [0.95]}, "between 0 and what the faces leave, 0.91"),
        ({"pane_transmittance": [0.9], "glow_lm_per_m2": 1.0}, "must not glow"),
        ({"pane_transmittance": [0.9], "refractive_index": 0.9}, "must exceed 1, got 0.9"),
        ({"pane_transmittance": [0.9, 0.8]}, "got 2 for 1"),
        ({"pane_transmittance": [0.9], "reflectance": [0.1]}, "must have a library"),
    ):
        with pytest.raises(BadInput, match=says):
            from_mapping({"label": "glass", **keys}, MaterialSpec)


def light_in_the_picture(stage):
    """Irradiance at the lens by what a camera that looks north sees of lamps, and in which
    directions.
    """
    view = Viewpoint(
        position_m=(0.0, 0.0, 0.0), forward=(0.0, 1.0, 0.0), shape=(60, 80), focal_px=(100.0, 100.0)
    )
    radiance = np.zeros((60 * 80, len(NM)), np.float32)
    add_small_sources(stage, view, radiance)
    pixel = np.flatnonzero(radiance[:, 0])
    row, col = pixel // 80 + 0.5, pixel % 80 + 0.5
    return radiance[pixel, 0] * view.solid_angle_sr(row, col), view.rays(row, col)[1]


def test_a_lamp_behind_a_window_is_seen_weakened():
    window = at(upright(shape("plane", (4.0, 4.0))), 0.0, 5.0, 0.0)
    lit = staged([], {}, lamps=(lamp((0.0, 10.0, 0.0), 3.0),))
    light, _ = light_in_the_picture(glazed(lit, [window]))
    assert light.sum() == pytest.approx(textbook(0.0)[1] * 3.0 / 10.0**2, rel=1e-3)


def test_a_lamp_beside_the_camera_is_mirrored_by_a_window_where_the_law_of_reflection_says():
    window = at(upright(shape("plane", (4.0, 4.0))), 0.0, 5.0, 0.0)
    lit = staged([], {}, lamps=(lamp((1.0, -1.0, 0.0), 3.0),))
    light, direction = light_in_the_picture(glazed(lit, [window]))
    # Its image stands at y = 11: the way is as long as to there.
    angle = np.rad2deg(np.arctan2(1.0, 11.0))
    assert light.sum() == pytest.approx(textbook(angle)[0] * 3.0 / (1.0 + 11.0**2), rel=1e-3)
    assert (
        np.linalg.norm(direction - np.array([1.0, 11.0, 0.0]) / np.hypot(1.0, 11.0), axis=1) < 0.01
    ).all()
    small = at(upright(shape("plane", (0.2, 0.2))), 0.0, 5.0, 0.0)
    assert not light_in_the_picture(glazed(lit, [small]))[0].size, (
        "the foot of the way is beside the pane"
    )
    screen = at(upright(shape("plane", (0.2, 0.2))), 0.25, 2.5, 0.0)
    hidden = staged([("screen", "grey", screen)], {"grey": 0.1}, lamps=lit.lighting.lamps)
    assert not light_in_the_picture(glazed(hidden, [window]))[0].size
    moon = staged([], {}, discs=(disc_light((0.0, -1.0, 0.1)),))
    assert light_in_the_picture(glazed(moon, [window]))[0].sum() == pytest.approx(
        textbook(5.71)[0], rel=1e-3
    )


# Lamps, sun and moon are in the picture as even discs, with the light that reaches the lens.


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
