"""Scenes out of doors: files are read or refused in one sentence, light falls where it should,
nothing breaks it.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance import load_bench, load_scene
from simulate.radiance.brdf import Metal, grey
from simulate.radiance.geometry import Mesh, Viewpoint, box, ground, plane, shape, shed, sphere
from simulate.radiance.geometry import surfaces as surface_shapes
from simulate.radiance.integrator import (
    IntegratorSettings,
    RenderSensor,
    SamplingSettings,
    radiance_along,
    render_scene,
    truth,
)
from simulate.radiance.outdoor import (
    BuiltScene,
    OutdoorScene,
    Pose,
    build_surfaces,
    choose_render_settings,
    place_mesh,
)
from tests.simulate.radiance.staging import (
    NM,
    UNIFORM,
    UP,
    at,
    disc_light,
    inside_out,
    irradiance,
    lamp,
    staged,
)

CAMERA = "[camera]\nposition_m = [0, -10, 2]\nlook_at_m = [0, 0, 1]\n"
GREY = '[[material]]\nlabel = "grey"\nreflectance = [0.5]\n'
BALL = '[[object]]\nlabel = "ball"\nshape = "sphere"\nsize_m = [1]\nmaterial = "grey"\n'
LAMP = '[[lamp]]\nlabel = "bulb"\nkind = "incandescent"\nlumens = 1000\nposition_m = [0, 0, 3]\n'
VIEW = Viewpoint(
    position_m=(0, -10, 2), forward=(0, 1, -0.1), shape=(24, 32), focal_px=(40.0, 40.0)
)
WEIGHT = np.ones(2, np.float32)


def scene_of(folder, text: str) -> OutdoorScene:
    path = folder / "scene.toml"
    path.write_text(f'name = "test"\n{text}')
    found = load_scene(path)
    assert isinstance(found, OutdoorScene)
    return found


@pytest.mark.parametrize("name", ["airfield", "hangar", "road"])
def test_shipped_scenes_are_built_and_a_bench_is_another_kind(name):
    scene = load_scene(name)
    assert isinstance(scene, OutdoorScene)
    surfaces = BuiltScene(scene).surfaces
    assert len(surfaces.objects) == len(scene.object)
    with pytest.raises(BadInput, match="a lab bench needs"):
        load_bench(name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CAMERA + BALL, "material of an object must be one of none described, got 'grey'"),
        (CAMERA + GREY + BALL.replace('"grey"', '"gray"'), "must be one of grey, got 'gray'"),
        (CAMERA + GREY + BALL.replace('"sphere"', '"ball"'), "a shape must be one of box"),
        (CAMERA + GREY + BALL.replace("[1]", "[1, 2]"), r"size_m of a sphere must be \[radius\]"),
        (CAMERA + GREY + BALL.replace("[1]", "[-1]"), "must be positive"),
        (
            CAMERA + GREY + BALL.replace("size_m", "size"),
            "unknown key 'size'.*did you mean 'size_m'",
        ),
        (CAMERA + GREY + BALL + BALL, "labels of objects must differ"),
        (CAMERA + '[[material]]\nlabel = "m"\nlibrary = "gold"\n', "must be one of .*got 'gold'"),
        (
            CAMERA + '[[material]]\nlabel = "m"\nlibrary = "window-glass"\n',
            "light goes through panes alone",
        ),
        (
            CAMERA
            + "[place]\nlatitude_deg = 43\nlongitude_deg = -77\ntime = 1998-06-24T02:00:00\n",
            "offset from UTC",
        ),
        (
            CAMERA + "[sky]\nmoon = false\n",
            r"a sky must have a place and a time, got \[sky\] without \[place\]",
        ),
        (CAMERA.replace("[0, 0, 1]", "[0, -10, 2]"), "must look at another place"),
        (
            CAMERA + GREY + BALL + 'map = "a.png"\nmap_materials = ["grey"]\n',
            "either a material or a map",
        ),
        (CAMERA + GREY + BALL + "gaps = 1.0\n", r"gaps must lie in \[0, 1\), got 1"),
        (
            CAMERA + GREY + BALL.replace("sphere", "disc") + "gaps = 0.2\n",
            "must have at least 400 triangles.*got 48",
        ),
        (
            CAMERA + GREY + '[[object]]\nlabel = "a"\nfile = "a.obj"\nmaterial = "grey"\n',
            "unit must be one of m, cm",
        ),
    ],
)
def test_a_scene_that_breaks_a_rule_is_refused_in_one_sentence(tmp_path, text, words):
    with pytest.raises(BadInput, match=words):
        build_surfaces(scene_of(tmp_path, text))


def test_a_mesh_file_is_read_in_its_unit_and_one_that_glows_must_be_closed(tmp_path):
    import trimesh

    whole = sphere(10.0)
    part = {"sphere": whole.faces, "bowl": whole.faces[:2000]}
    for name, faces in part.items():
        trimesh.Trimesh(whole.vertices_m, faces, process=False).export(tmp_path / f"{name}.ply")
    glow = '[[material]]\nlabel = "grey"\nreflectance = [0.5]\nglow_lm_per_m2 = 10\n'
    mesh = '[[object]]\nlabel = "a"\nunit = "cm"\nmaterial = "grey"\nfile = '
    surfaces = build_surfaces(scene_of(tmp_path, CAMERA + glow + mesh + '"sphere.ply"\n'))
    assert np.linalg.norm(surfaces.mesh.vertices_m, axis=1) == pytest.approx(0.1, rel=1e-5)
    with pytest.raises(BadInput, match="must be closed"):
        build_surfaces(scene_of(tmp_path, CAMERA + glow + mesh + '"bowl.ply"\n'))
    assert (
        len(build_surfaces(scene_of(tmp_path, CAMERA + GREY + mesh + '"bowl.ply"\n')).area_m2)
        == 2000
    )
    (tmp_path / "letter.obj").write_text("Dear lab")
    with pytest.raises(BadInput, match=r"letter\.obj"):
        build_surfaces(scene_of(tmp_path, CAMERA + GREY + mesh + '"letter.obj"\n'))


def test_a_mesh_files_own_materials_are_named_as_left_out(tmp_path):
    import trimesh

    painted, sprayed, bare = (trimesh.creation.box() for _ in range(3))
    paint = trimesh.visual.material.PBRMaterial(
        name="red paint", baseColorFactor=[200, 30, 30, 255]
    )
    painted.visual = trimesh.visual.TextureVisuals(material=paint)
    sprayed.visual = trimesh.visual.ColorVisuals(sprayed, vertex_colors=[10, 200, 10, 255])
    trimesh.Scene({"a": painted, "b": sprayed, "c": bare}).export(tmp_path / "house.glb")
    bare.export(tmp_path / "bare.glb")
    mesh = '[[object]]\nlabel = "a"\nunit = "m"\nmaterial = "grey"\nfile = '
    surfaces = build_surfaces(scene_of(tmp_path, CAMERA + GREY + mesh + '"house.glb"\n'))
    assert len(surfaces.mesh.faces) == 36
    assert surfaces.notes == (
        "house.glb has materials (red paint) and colours, which are not used: all of 'a' is 'grey'",
    )
    assert build_surfaces(scene_of(tmp_path, CAMERA + GREY + mesh + '"bare.glb"\n')).notes == ()


def test_parts_of_a_mesh_file_have_the_materials_that_its_names_are_given(tmp_path):
    import trimesh

    parts = {"paint": 1.0, "glass": 2.0, "tyre": 3.0}
    whole = trimesh.Scene()
    for name, side in parts.items():
        cube = trimesh.creation.box((side, side, side))
        cube.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(name=name)
        )
        whole.add_geometry(
            cube, transform=trimesh.transformations.translation_matrix([9.0 * side, 0, 0])
        )
    whole.export(tmp_path / "car.glb")
    (tmp_path / "car.mtl").write_text("".join(f"newmtl {name}\nKd 1 0 0\n" for name in parts))
    flat = ["mtllib car.mtl", "v 0 0 0", "v 2 0 0", "v 0 1 0", "v 0 0 4"]
    (tmp_path / "car.obj").write_text(
        "\n".join([*flat, "usemtl paint", "f 1 2 3", "usemtl glass", "f 1 2 4", ""])
    )
    red = (
        GREY
        + GREY.replace("grey", "red")
        + '[[material]]\nlabel = "window"\npane_transmittance = [0.9]\n'
    )
    mesh = '[[object]]\nlabel = "car"\nunit = "m"\nfile = "car.glb"\n'
    given = 'material = "grey"\nfile_materials = { paint = "red", glass = "window" }\n'
    found = build_surfaces(scene_of(tmp_path, CAMERA + red + mesh + given))
    area = {
        name: found.area_m2[found.material_of == n].sum() for n, name in enumerate(found.materials)
    }
    assert area == pytest.approx({"red": 6.0, "grey": 54.0}) and found.notes == ()
    assert found.panes is not None and found.panes.area_m2.sum() == pytest.approx(24.0)
    assert found.mesh.vertices_m[:, 0].max() == pytest.approx(28.5)
    drawn = build_surfaces(scene_of(tmp_path, CAMERA + red + mesh.replace("glb", "obj") + given))
    assert drawn.area_m2.sum() == pytest.approx(1.0) and drawn.panes is not None
    for text, words in (
        (
            given.replace("paint", "varnish"),
            "must name materials of .*, 'glass', 'paint', 'tyre', got 'varnish'",
        ),
        (
            given.replace('material = "grey"\n', ""),
            "must name all materials of .* got none for 'tyre' of 'car'",
        ),
        (given.replace('"red"', '"pink"'), "must be one of grey, red, window, got 'pink'"),
    ):
        with pytest.raises(BadInput, match=words):
            build_surfaces(scene_of(tmp_path, CAMERA + red + mesh + text))
    with pytest.raises(BadInput, match="must be those of a mesh file"):
        build_surfaces(
            scene_of(tmp_path, CAMERA + GREY + BALL + 'file_materials = { a = "grey" }\n')
        )


def test_a_measured_surface_in_a_scene_reflects_as_its_table_says(tmp_path):
    polar, azimuth = np.linspace(0.0, 90.0, 10), np.linspace(0.0, 180.0, 7)
    table = np.broadcast_to(np.array([0.2, 0.6]).reshape(2, 1, 1, 1) / np.pi, (2, 10, 10, 7))
    np.savez(
        tmp_path / "paint.npz",
        wavelength_nm=[500.0, 700.0],
        polar_deg=polar,
        azimuth_deg=azimuth,
        table=table,
    )
    paint = '[[material]]\nlabel = "grey"\nmeasured = "paint.npz"\n'
    site = BuiltScene(scene_of(tmp_path, CAMERA + paint + BALL))
    stage = site.on(np.array([500.0, 600.0]))
    albedo = stage.bsdfs.brdfs[0].albedo(np.array([[0.0, 0.6, 0.8]]), stage.bsdfs.wavelength_nm)[
        :, 0
    ]
    assert albedo == pytest.approx([0.2, 0.4], rel=1e-3)
    for name, content, words in (
        ("letter.npz", b"Dear lab", r"readable \.npz file, got .*letter\.npz"),
        ("nothing.npz", None, r"measured BRDF must exist to be read"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput, match=words):
            BuiltScene(scene_of(tmp_path, CAMERA + paint.replace("paint.npz", name) + BALL)).on(NM)
    np.savez(tmp_path / "part.npz", wavelength_nm=[500.0])
    with pytest.raises(BadInput, match=r"must hold .* got no polar_deg in part\.npz"):
        BuiltScene(scene_of(tmp_path, CAMERA + paint.replace("paint.npz", "part.npz") + BALL)).on(
            NM
        )


def test_a_picture_says_how_long_it_will_take_before_it_begins():
    stage = staged([("floor", "m", plane(40, 40))], {"m": 0.5}, sky=UNIFORM)
    told: list[tuple[str, float]] = []
    rays = SamplingSettings(error_limit=lambda signal: 1e-3 * np.ones_like(signal))
    announce, progress = (
        lambda value, name=name: told.append((name, value)) for name in ("expected", "done")
    )
    render_scene(
        stage,
        VIEW,
        rays,
        IntegratorSettings(),
        weight=WEIGHT,
        seed=0,
        announce=announce,
        progress=progress,
    )
    assert [name for name, _ in told].index("expected") == 0
    assert told[0][1] > 0.0 and told[-1] == ("done", 1.0)


def test_a_crown_with_gaps_lets_through_what_they_leave_open(tmp_path):
    leaves = BALL + "gaps = 0.4\n"
    crown = build_surfaces(scene_of(tmp_path, CAMERA + GREY + leaves))
    assert crown.area_m2.sum() == pytest.approx(0.6 * 4.0 * np.pi, rel=0.01)
    rng = np.random.default_rng(3)
    radius, turn = np.sqrt(rng.random(20000)), 2.0 * np.pi * rng.random(20000)
    start = np.column_stack([radius * np.cos(turn), np.full(20000, -3.0), radius * np.sin(turn)])
    open_ = ~crown.tracer.is_occluded(start, np.broadcast_to([0.0, 1.0, 0.0], start.shape))
    # Light that crosses passes the front and the back: 0.4 of each; rays of one gap share it, so
    # chance counts gaps.
    assert open_.mean() == pytest.approx(0.16, abs=0.025)
    again = build_surfaces(scene_of(tmp_path, CAMERA + GREY + leaves))
    assert np.array_equal(again.mesh.faces, crown.mesh.faces)


def test_a_map_lays_materials_on_a_plane_as_its_picture_shows_them(tmp_path):
    rng = np.random.default_rng(4)
    picture_of = rng.integers(0, 3, (6, 9))
    np.save(tmp_path / "signs.npy", picture_of.astype(np.uint8))
    paints = "".join(f'[[material]]\nlabel = "{name}"\nreflectance = [0.5]\n' for name in "abc")
    lot = '[[object]]\nlabel = "lot"\nshape = "plane"\nsize_m = [18, 6]\nmap = "signs.npy"\n'
    laid = build_surfaces(
        scene_of(tmp_path, CAMERA + paints + lot + 'map_materials = ["a", "b", "c"]\n')
    )
    assert laid.objects == ("lot",) and laid.area_m2.sum() == pytest.approx(18 * 6)
    row, col = (axis.ravel() for axis in np.indices(picture_of.shape))
    above = np.column_stack([2.0 * (col + 0.45) - 9.0, 3.0 - (row + 0.55), np.full(row.size, 2.0)])
    face = laid.tracer.hits(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape)).face
    assert [laid.materials[number] for number in laid.material_of[face]] == [
        "abc"[n] for n in picture_of.ravel()
    ]
    assert (laid.tracer.planes[1][:, 2] > 0.99).all()
    with pytest.raises(BadInput, match=r"whole numbers from 0 to 1, got 2 in signs\.npy"):
        build_surfaces(scene_of(tmp_path, CAMERA + paints + lot + 'map_materials = ["a", "b"]\n'))


def test_a_map_lies_on_a_mesh_by_its_texture_coordinates(tmp_path):
    rng = np.random.default_rng(5)
    picture_of = rng.integers(0, 3, (7, 11))
    np.save(tmp_path / "signs.npy", picture_of.astype(np.uint8))
    # A square of 2 m, seen with v up: its texture covers it once. A coarse mesh, of two triangles.
    (tmp_path / "wall.mtl").write_text("newmtl any\nKd 1 1 1\n")
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    lines = [
        "mtllib wall.mtl",
        *(f"v {2 * u} {2 * v} 0" for u, v in corners),
        *(f"vt {u} {v}" for u, v in corners),
    ]
    (tmp_path / "wall.obj").write_text(
        "\n".join([*lines, "usemtl any", "f 1/1 2/2 3/3", "f 1/1 3/3 4/4", ""])
    )
    paints = "".join(f'[[material]]\nlabel = "{name}"\nreflectance = [0.5]\n' for name in "abc")
    wall = '[[object]]\nlabel = "wall"\nunit = "m"\nfile = "wall.obj"\nmap = "signs.npy"\n'
    laid = build_surfaces(
        scene_of(tmp_path, CAMERA + paints + wall + 'map_materials = ["a", "b", "c"]\n')
    )
    assert laid.area_m2.sum() == pytest.approx(4.0) and (laid.tracer.planes[1][:, 2] > 0.99).all()
    row, col = (axis.ravel() for axis in np.indices(picture_of.shape))
    above = np.column_stack(
        [2.0 * (col + 0.5) / 11, 2.0 - 2.0 * (row + 0.5) / 7, np.full(row.size, 2.0)]
    )
    face = laid.tracer.hits(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape)).face
    found = [laid.materials[number] for number in laid.material_of[face]]
    assert (
        np.mean([name == "abc"[n] for name, n in zip(found, picture_of.ravel(), strict=True)])
        > 0.85
    )
    # Edges of pixels are ragged by a part of a pixel: areas agree with their number of pixels.
    area = [laid.area_m2[laid.material_of == laid.materials.index(name)].sum() for name in "abc"]
    assert area == pytest.approx(4.0 * np.bincount(picture_of.ravel()) / 77, rel=0.1)
    np.save(tmp_path / "signs.npy", np.ones((7, 11), np.uint8))
    one = build_surfaces(
        scene_of(tmp_path, CAMERA + paints + wall + 'map_materials = ["a", "b", "c"]\n')
    )
    assert len(one.mesh.faces) == 2 and one.materials == ("b",)
    (tmp_path / "wall.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(BadInput, match=r"must have texture coordinates, got none in wall\.obj"):
        build_surfaces(
            scene_of(tmp_path, CAMERA + paints + wall + 'map_materials = ["a", "b", "c"]\n')
        )


def test_solids_are_closed_and_hold_their_volume():
    sizes = {
        "box": (1, 2, 3),
        "cylinder": (1, 2),
        "cone": (1, 3),
        "sphere": (1,),
        "shed": (10, 8, 4, 6),
    }
    volumes = {"box": 6.0, "cylinder": 2.0 * np.pi, "cone": np.pi, "sphere": 4.0 / 3.0 * np.pi}
    for name, size in sizes.items():
        mesh = shape(name, size)
        corners = mesh.corners_m
        volume = (
            np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
        )
        assert mesh.is_closed, name
        assert volume == pytest.approx(volumes.get(name, volume), rel=0.005), name
        assert volume > 0.0
    assert set(surface_shapes.SIZES) == {*sizes, "plane", "disc", "ground"}
    assert not plane(1, 1).is_closed
    assert ground(1000.0).corners_m[:2].max() <= 32.0


def test_a_heading_turns_clockwise_from_north():
    turned = place_mesh(
        Mesh(np.array([[0.0, 1.0, 0.0]]), np.zeros((0, 3), np.int64)), Pose(heading_deg=90.0)
    )
    assert turned.vertices_m[0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    nose_up = place_mesh(
        Mesh(np.array([[0.0, 1.0, 0.0]]), np.zeros((0, 3), np.int64)), Pose(pitch_deg=90.0)
    )
    assert nose_up.vertices_m[0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)


@pytest.mark.parametrize("distortion", [0.0, -0.05, 0.1])
def test_a_ray_goes_where_its_direction_is_seen(seed, distortion):
    view = replace(VIEW, distortion_fraction=distortion, roll_deg=7.0)
    rng = np.random.default_rng(seed)
    row, col = 24 * rng.random(200), 32 * rng.random(200)
    _, towards = view.rays(row, col)
    back_row, back_col, inside = view.project(towards)
    assert inside.all()
    assert np.abs(back_row - row).max() < 1e-4 and np.abs(back_col - col).max() < 1e-4
    assert np.sum(view.solid_angle_sr(np.array([12.0]), np.array([16.0]))) == pytest.approx(
        1.0 / 1600.0, rel=0.02
    )


def test_the_picture_is_the_right_way_round():
    _, towards = Viewpoint(
        position_m=(0, 0, 0), forward=(0, 1, 0), shape=(2, 2), focal_px=(2.0, 2.0)
    ).rays(np.array([0.5, 1.5]), np.array([0.5, 1.5]))
    assert towards[0, 0] < 0.0 < towards[1, 0], "east is to the right of a camera that looks north"
    assert towards[0, 2] > 0.0 > towards[1, 2], "row 0 is on top"


def test_shadows_fall_away_from_the_light_and_truth_knows_them():
    parts = [("floor", "m", plane(40, 40)), ("post", "m", at(box(0.5, 6.0, 3.0), 0, 8, 0))]
    stage = staged(parts, {"m": 0.5}, discs=(disc_light((-1, 0, 1)),))
    found = truth(stage, VIEW)
    edge = found.object[12]
    post = np.flatnonzero(edge == 1)
    shadow = (found.shadow & 1).astype(bool) & (found.object == 0)
    columns = np.flatnonzero(shadow.any(axis=0))
    assert len(columns) and columns.min() >= post.min(), (
        "light from the west throws its shadow to the east"
    )
    assert found.sources == ("sun",)
    assert np.isnan(found.temperature_k).all()
    assert (found.object[0] == -1).all() and np.isinf(found.range_m[0]).all()


def test_choosing_where_to_look_closely_does_not_bend_the_picture(seed):
    parts = [("floor", "m", plane(40, 40)), ("shed", "m", at(shed(6, 5, 3, 4), 0, 4, 0))]
    stage = staged(parts, {"m": 0.5}, sky=UNIFORM, lamps=(lamp((0, 4, 2), 3.0, 0.3),))
    effort = IntegratorSettings(max_bounces=1)
    rays = SamplingSettings(max_rays=64, error_limit=lambda signal: (0.02 * signal) ** 2 + 1e-6)
    found = render_scene(stage, VIEW, rays, effort, weight=WEIGHT, seed=seed)
    rng = np.random.default_rng([seed, 1])
    row, col = 24 * rng.random(40000), 32 * rng.random(40000)
    every = (
        radiance_along(stage, *VIEW.rays(row, col), effort, rng, gather_rays=2).total().sum(axis=1)
    )
    error = np.hypot(every.std() / 200.0, np.sqrt(found.variance.sum()) / found.variance.size)
    assert abs(found.signal.mean() - every.mean() - _of_lamp(stage, found)) < 4.0 * error
    assert found.rays.min() == 2 and found.rays.max() > 8
    again = render_scene(stage, VIEW, rays, effort, weight=WEIGHT, seed=seed)
    assert np.array_equal(again.cube.radiance, found.cube.radiance)


def _of_lamp(stage, found) -> float:
    """Mean over the picture of the lamp itself, which single rays never meet."""
    place = np.array(VIEW.position_m) - stage.lighting.lamps[0].position_m
    row, col, inside = VIEW.project(-place[None])
    assert inside.all()
    size = float(VIEW.solid_angle_sr(row, col)[0])
    return float(2.0 * 3.0 / (place @ place) / size / found.signal.size)


def test_of_faces_in_one_plane_the_light_is_that_of_either():
    parts = [("one", "dark", plane(4, 4)), ("two", "pale", plane(4, 4))]
    stage = staged(parts, {"dark": 0.1, "pale": 0.9}, sky=UNIFORM, discs=(disc_light(UP),))
    towards = np.array([[0.0, 0.0, -1.0]] * 500)
    origin = np.random.default_rng(0).random((500, 3)) * [3, 3, 0] + [-1.5, -1.5, 2.0]
    seen = radiance_along(
        stage, origin, towards, IntegratorSettings(), np.random.default_rng(1), gather_rays=2
    ).total()[:, 0]
    bright = 1.0 + 1.0 / np.pi
    assert np.minimum(np.abs(seen - 0.1 * bright), np.abs(seen - 0.9 * bright)).max() < 1e-3


def test_grazing_rays_are_finite():
    stage = staged(
        [("floor", "m", plane(1e4, 1e4))],
        {"m": 0.5},
        sky=UNIFORM,
        discs=(disc_light((1, 0, 1e-4)),),
    )
    slope = -np.logspace(-12, -1, 300)
    towards = np.column_stack([np.ones(300), np.zeros(300), slope])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    origin = np.broadcast_to([0.0, 0.0, 1e-3], towards.shape)
    seen = radiance_along(
        stage, origin, towards, IntegratorSettings(), np.random.default_rng(0), gather_rays=2
    ).total()
    assert np.isfinite(seen).all() and seen.min() >= -1e-6 and seen.max() < 1.2


def test_a_lamp_that_touches_a_wall_is_refused(tmp_path):
    near = LAMP.replace("[0, 0, 3]", "[0, 0, 1.03]")
    with pytest.raises(
        BadInput, match=r"stand clear of surfaces by its radius of 0\.05 m, got 'bulb'.*'ball'"
    ):
        _ = BuiltScene(scene_of(tmp_path, CAMERA + GREY + BALL + near)).surfaces


def test_a_glowing_wall_that_touches_another_makes_no_bright_specks(seed):
    panel = Mesh(
        plane(2, 2).vertices_m @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), plane(2, 2).faces
    )
    stage = staged(
        [("floor", "m", plane(9, 9)), ("panel", "p", at(panel, 0, 1, 1))],
        {"m": 0.5, "p": 0.0},
        glow={"p": 1.0},
    )
    close = np.column_stack([np.linspace(-0.5, 0.5, 3000), np.full(3000, 0.999), np.zeros(3000)])
    found = irradiance(stage, close, UP, seed=seed, rays=1)
    assert found.max() < 2.0 * np.pi
    assert found.mean() == pytest.approx(0.5 * np.pi, rel=0.05)


def test_a_mirror_that_faces_a_mirror_ends():
    mirror = Metal(reflectance=grey(0.99), roughness=0.05)
    parts = [("a", "m", plane(20, 20)), ("b", "m", at(inside_out(plane(20, 20)), 0, 0, 1))]
    stage = staged(parts, {"m": mirror}, sky=UNIFORM)
    towards = np.array([[0.3, 0.0, -1.0]] * 300) / np.hypot(0.3, 1.0)
    effort = IntegratorSettings(max_bounces=200, roulette_depth=3)
    rng = np.random.default_rng(2)
    seen = radiance_along(
        stage, np.array([[0.0, 0.0, 0.5]] * 300), towards, effort, rng, gather_rays=1
    ).total()
    assert np.isfinite(seen).all()
    assert -0.01 < seen.mean() < 1.1


def test_a_scene_without_a_triangle_is_all_sky():
    stage = staged([], {}, sky=UNIFORM)
    found = render_scene(
        stage,
        replace(VIEW, forward=(0, 1, 1)),
        SamplingSettings(),
        IntegratorSettings(),
        weight=WEIGHT,
        seed=0,
    )
    assert found.signal == pytest.approx(2.0, rel=1e-5)


def test_daylight_starlight_and_sodium_light_are_planned_differently(tmp_path):
    eye = RenderSensor(
        response_nm=(450.0, 700.0, 900.0),
        response=(1e5, 4e5, 3e5),
        dark_variance=1.0,
        variance_per_signal=3.0,
    )
    floor = '[[object]]\nlabel = "floor"\nshape = "ground"\nsize_m = [200]\nmaterial = "grey"\n'
    shed = (
        '[[object]]\nlabel = "shed"\nshape = "shed"\nsize_m = [6, 5, 3, 4]\nmaterial = '
        '"grey"\nposition_m = [0, 5, 0]\n'
    )
    there = "[place]\nlatitude_deg = 43.16\nlongitude_deg = -77.61\ntime = "
    sodium = LAMP.replace("incandescent", "low-pressure-sodium").replace("1000", "0.5")
    plans = {}
    for name, light in (
        ("day", there + "1998-06-24T12:00:00-04:00\n"),
        ("stars", there + "1998-06-24T02:00:00-04:00\n"),
        ("sodium", sodium),
    ):
        site = BuiltScene(scene_of(tmp_path, CAMERA + light + GREY + floor + shed))
        plans[name], _ = choose_render_settings(site, VIEW, eye, 0.1, 1)
    kept = {name: {effect.name for effect in plan.plan.kept} for name, plan in plans.items()}
    assert "sun" in kept["day"] and "bulb" in kept["sodium"] and "hidden sky" in kept["stars"]
    assert "hidden sky" not in kept["sodium"] and "sun" not in kept["stars"]
    assert plans["day"].effort.max_bounces > plans["stars"].effort.max_bounces > 0
    bands = {name: len(plan.wavelength_nm) for name, plan in plans.items()}
    assert bands["sodium"] < bands["stars"], "two lines need few bands, airglow many"
    assert any(abs(plans["sodium"].wavelength_nm - 589.0) < 0.1), "the line is on the grid"
    assert len({plan.text() for plan in plans.values()}) == 3


def test_a_lamp_whose_light_arrives_by_reflection_alone_is_kept(tmp_path):
    """A shade keeps the lamp from the wall that the camera sees, but not from the wall behind the
    camera.
    """
    eye = RenderSensor(
        response_nm=(450.0, 700.0, 900.0),
        response=(1e7, 4e7, 3e7),
        dark_variance=1.0,
        variance_per_signal=3.0,
    )
    wall = (
        '[[object]]\nlabel = "{}"\nshape = "box"\nsize_m = {}\nposition_m = {}\nmaterial = "grey"\n'
    )
    parts = wall.format("screen", [30, 0.2, 8], [0, 5, 0.02]) + wall.format(
        "back", [30, 0.2, 8], [0, -14, 0.02]
    )
    shade = wall.format("shade", [4, 0.2, 4], [0, -11, 1])
    lit = LAMP.replace("[0, 0, 3]", "[0, -12.5, 3]")
    plan, _ = choose_render_settings(
        BuiltScene(scene_of(tmp_path, CAMERA + GREY + parts + shade + lit)), VIEW, eye, 0.1, 1
    )
    kept = {effect.name for effect in plan.plan.kept}
    assert {"bulb", "bounce 1"} <= kept and "bulb" not in plan.effort.neglected


def test_rays_go_on_until_the_error_is_as_promised(seed):
    """A lamp's glint in metal takes a small part of some pixels."""
    parts = [("floor", "m", plane(40, 40)), ("ball", "steel", at(sphere(1.0), 0, 0, 1))]
    brdf = Metal(reflectance=grey(0.8), roughness=0.05)
    stage = staged(parts, {"m": 0.2, "steel": brdf}, lamps=(lamp((2, -6, 5), 1000.0),))
    few, direct = (
        replace(VIEW, shape=(6, 8), focal_px=(10.0, 10.0)),
        IntegratorSettings(max_bounces=0),
    )
    few_rays = SamplingSettings(min_rays=32, edge=32, max_rays=8192, cache_rays=None)
    first = render_scene(stage, few, few_rays, direct, weight=WEIGHT, seed=seed)
    assert first.rays.max() == 32 and first.variance.mean() > 3.0 * 0.05**2
    many = replace(
        few_rays, min_rays=2, edge=2, error_limit=lambda signal: np.full_like(signal, 0.05**2)
    )
    found, again = (
        render_scene(stage, few, many, direct, weight=WEIGHT, seed=seed + turn) for turn in (1, 2)
    )
    assert found.rays.mean() > 64
    assert found.variance.mean() < 1.2 * 0.05**2
    # Two such pictures differ by no more than both errors.
    assert np.mean((found.signal - again.signal) ** 2) < 3.0 * 2.0 * 0.05**2
