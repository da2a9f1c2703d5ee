"""Objects that move by keyframes, and copies of one mesh."""

import subprocess
import sys
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from labdata import BadInput, Conditions, from_mapping
from simulate import Look, Motion, Shot
from simulate.radiance.geometry import Viewpoint, embree
from simulate.radiance.integrator import IntegratorSettings, radiance_along, truth
from simulate.radiance.outdoor import (
    BuiltScene,
    CameraKeyframe,
    LampPlacement,
    MaterialSpec,
    Object,
    ObjectKeyframe,
    OutdoorScene,
    Pose,
    SceneCamera,
    build,
    pose_at,
    rotation_of,
)
from simulate.thermal import temperatures_of

# Motion of a scene's camera and objects by keyframes, and the temperatures that objects take
# along.


SCENE = {
    "name": "a box on a lawn",
    "place": {"latitude_deg": 43.16, "longitude_deg": -77.61, "time": "1998-06-24T14:00:00-04:00"},
    "weather": {"temperature_c": 16, "wind_m_s": 1},
    "camera": {"position_m": [0, -9, 3], "look_at_m": [0, 0, 1]},
    "material": [
        {"label": "lawn", "library": "green-canopy"},
        {"label": "paint", "library": "olive-drab-paint"},
    ],
    "object": [
        {"label": "ground", "shape": "ground", "size_m": [40], "material": "lawn"},
        {
            "label": "box",
            "shape": "box",
            "size_m": [1.2, 1.2, 1.6],
            "material": "paint",
            "position_m": [1, 0, 0],
        },
    ],
}
KEYS = (
    ObjectKeyframe(time_s=2.0, position_m=(1.0, 4.0, 0.0)),
    ObjectKeyframe(time_s=4.0, position_m=(5.0, 4.0, 0.0), heading_deg=-90.0),
)


def test_values_change_linearly_between_keyframes_and_stay_behind_the_last():
    box = Object(
        label="box",
        shape="box",
        size_m=(1, 1, 1),
        material="paint",
        position_m=(1.0, 0.0, 0.0),
        scale=2.0,
    )
    assert pose_at(box, KEYS, 0.0) == box
    assert pose_at(box, KEYS, 0.5).position_m == (1.0, 1.0, 0.0)
    on_its_way = pose_at(box, KEYS, 3.0)
    assert (
        on_its_way.position_m == (3.0, 4.0, 0.0)
        and on_its_way.heading_deg == -45.0
        and on_its_way.scale == 2.0
    )
    assert (
        pose_at(box, KEYS, 4.0)
        == pose_at(box, KEYS, 9.0)
        == replace(box, position_m=(5.0, 4.0, 0.0), heading_deg=-90.0)
    )


def test_a_scene_reads_keyframes_and_stands_still_at_each_time():
    camera = SCENE["camera"] | {"keyframe": [{"time_s": 1, "position_m": [2, -9, 3]}]}
    things = [
        SCENE["object"][0],
        SCENE["object"][1] | {"keyframe": [{"time_s": 1, "heading_deg": 90}]},
    ]
    scene = from_mapping(
        SCENE | {"camera": camera, "object": things}, OutdoorScene, where="scene.toml"
    )
    half = scene.at(0.5)
    assert scene.moves and not half.moves and half.at(1.0) is half
    assert (
        half.camera.position_m == (1.0, -9.0, 3.0)
        and half.camera.look_at_m == scene.camera.look_at_m
    )
    assert half.object[1].heading_deg == 45.0 and half.object[0] == scene.object[0]
    still = from_mapping(SCENE, OutdoorScene, where="scene.toml")
    assert still.at(3.0) is still


BOX = {"label": "box", "shape": "box", "size_m": (1, 1, 1), "material": "a"}
STILL = {
    SceneCamera: {"position_m": (0.0, 0.0, 1.0), "look_at_m": (0.0, 1.0, 1.0)},
    Object: BOX | {"instances": (Pose(),)},
}


@pytest.mark.parametrize(
    ("thing", "keyframes", "words"),
    [
        (
            Object,
            KEYS,
            "an object with keyframes must have no copies, got 1 of 'box'",
        ),
        (
            SceneCamera,
            (CameraKeyframe(time_s=0.0, roll_deg=1.0),),
            "times of keyframes must ascend from 0 s, got 0 s after 0 s",
        ),
        (
            SceneCamera,
            (CameraKeyframe(time_s=2.0, roll_deg=1.0), CameraKeyframe(time_s=1.0, roll_deg=1.0)),
            "got 1 s after 2 s",
        ),
        (
            SceneCamera,
            (CameraKeyframe(time_s=1.0),),
            "a keyframe must state a pose, got none at 1 s of the camera",
        ),
        (
            SceneCamera,
            (CameraKeyframe(time_s=1.0, roll_deg=np.nan),),
            "places and angles of keyframes must be finite",
        ),
    ],
)
def test_keyframes_that_are_none_are_refused(thing, keyframes, words):
    with pytest.raises(BadInput, match=words):
        thing(**STILL[thing], keyframe=keyframes)


def test_a_view_is_rendered_anew_only_where_something_stands_otherwise():
    scene = from_mapping(SCENE, OutdoorScene, where="scene.toml")
    scene = replace(scene, object=(scene.object[0], replace(scene.object[1], keyframe=KEYS)))
    rendered = []

    def look(now, seed):
        rendered.append((now.object[1].position_m, seed))
        return Look(view=None, light=len(rendered))

    motion = Motion(scene=scene, sensor=None, look=look, seed=3)
    times_s = [0.0, 1.0, 4.0, 5.0, 6.0]
    found = [each.light for each in motion.looks(Look(view=None, light=0), times_s)]
    assert found == [0, 1, 2, 2, 2] and [place for place, _ in rendered] == [
        (1.0, 2.0, 0.0),
        (5.0, 4.0, 0.0),
    ]
    assert len({3, *(seed for _, seed in rendered)}) == 3
    assert motion.is_still(times_s[2:]) and not motion.is_still(times_s)


class TwoFields:
    """A camera whose frames are the lights of their two fields."""

    has_tube, fields_per_frame, frame_s = True, 2, 0.5

    def moving_frames(self, lights, conditions, *, seed, settled):
        return iter(lambda: list(islice(lights, 2)), [])


def test_each_field_of_an_interlaced_camera_shows_its_own_time():
    scene = from_mapping(SCENE, OutdoorScene, where="scene.toml")
    scene = replace(scene, object=(scene.object[0], replace(scene.object[1], keyframe=KEYS)))
    views = []
    motion = Motion(
        scene=scene,
        sensor=None,
        seed=0,
        look=lambda now, seed: Look(
            view=now.object[1].position_m[1], light=now.object[1].position_m[1]
        ),
    )
    shot = Shot(
        camera=TwoFields(),
        light=1.0,
        kind="scene",
        conditions=Conditions(),
        view=0.0,
        delay_s=0.5,
        motion=motion,
    )
    # At 2 m/s, from 0.5 s on: the first light is that of the first view.
    assert list(shot.frames(seed=0, count=3, keep=lambda *view: views.append(view))) == [
        [1.0, 1.5],
        [2.0, 2.5],
        [3.0, 3.5],
    ]
    assert views == [(1, 2.0), (2, 3.0)] and shot.time_s(2) == 1.5


def test_temperatures_move_with_their_surfaces():
    """All objects and the camera are carried off and turned together: the camera sees the same
    temperatures.
    """
    scene = from_mapping(SCENE, OutdoorScene, where="scene.toml")
    found = temperatures_of(scene)
    assert found.moved(scene) is found
    pose = Pose(position_m=(30.0, -20.0, 0.0), heading_deg=70.0)
    turn, shift = rotation_of(pose), np.array(pose.position_m)
    moved = tuple(
        replace(thing, position_m=tuple(turn @ thing.position_m + shift), heading_deg=70.0)
        for thing in scene.object
    )
    lens = Viewpoint(
        position_m=(0.0, -9.0, 3.0), forward=(0.0, 9.0, -2.0), shape=(16, 24), focal_px=(30.0, 30.0)
    )
    other = replace(
        lens, position_m=tuple(turn @ lens.position_m + shift), forward=tuple(turn @ lens.forward)
    )
    before, after = found.map_k(lens), found.moved(replace(scene, object=moved)).map_k(other)
    np.testing.assert_array_equal(np.isnan(after), np.isnan(before))
    # Sunlit and shaded sides differ by several kelvin; rays make pixels uncertain by about 0.1 K.
    assert np.nanstd(before) > 1.5
    assert np.sqrt(np.nanmean((after - before) ** 2)) < 0.3


# Copies of a mesh share it: they are hit where copies of their own would be, and twenty thousand
# fit into memory.


NM = np.array([500.0, 600.0])


def site(finish="diffuse", **lamp):
    """Return twelve turned and scaled boxes, on a floor far from the origin, lit by a lamp."""
    rng = np.random.default_rng(5)
    more = (
        {} if finish == "diffuse" else {"finish": finish, "roughness": 0.3, "refractive_index": 1.5}
    )
    poses = tuple(
        Pose(
            position_m=(500.0 + 2.5 * (i % 4), 3.0 * (i // 4), 0.3),
            heading_deg=float(rng.uniform(0, 360)),
            pitch_deg=float(rng.uniform(-30, 30)),
            roll_deg=float(rng.uniform(-30, 30)),
            scale=float(rng.uniform(0.5, 1.5)),
        )
        for i in range(12)
    )
    box = Object(
        label="boxes", material="box", shape="box", size_m=(1.0, 0.6, 1.2), instances=poses
    )
    floor = Object(
        label="floor",
        material="floor",
        shape="plane",
        size_m=(40.0, 40.0),
        position_m=(500.0, 0.0, 0.0),
    )
    post = LampPlacement(
        **{"label": "lamp", "kind": "mercury", "position_m": (503.0, 1.5, 4.0), "lumens": 100.0}
        | lamp
    )
    return BuiltScene(
        OutdoorScene(
            name="boxes",
            camera=SceneCamera(position_m=(503.0, -8.0, 5.0), look_at_m=(503.0, 3.0, 0.0)),
            material=(
                MaterialSpec(label="box", reflectance=(0.7,), **more),
                MaterialSpec(label="floor", reflectance=(0.4,)),
            ),
            object=(floor, box),
            lamp=(post,),
        )
    )


def rays(count):
    rng = np.random.default_rng(7)
    towards = np.column_stack(
        [rng.uniform(-1, 1, count), rng.uniform(0.2, 1, count), rng.uniform(-0.7, 0.0, count)]
    )
    origin = np.broadcast_to([503.0, -8.0, 5.0], towards.shape)
    return origin, towards / np.linalg.norm(towards, axis=1, keepdims=True)


@pytest.fixture
def shared(monkeypatch):
    """Share meshes from two copies on."""
    monkeypatch.setattr(build, "SHARED_FROM", 0)


def test_shared_copies_are_hit_where_copies_of_their_own_are(shared, monkeypatch):
    origin, towards = rays(20_000)
    one = site().surfaces
    monkeypatch.setattr(build, "SHARED_FROM", 10**9)
    own = site().surfaces
    here, there = (of.tracer.hits(origin, towards) for of in (one, own))
    assert (
        np.count_nonzero(here.face >> embree.COPY_BITS > 0) > 500
        and (there.face >> embree.COPY_BITS <= 0).all()
    )
    met = np.flatnonzero((here.face >= 0) & (there.face >= 0))
    assert len(met) > 0.999 * max(len(here.rays), len(there.rays))
    same = np.abs(here.range_m[met] - there.range_m[met]) < 1e-6
    assert same.mean() > 0.999, "but for rays along edges"
    normals = one.tracer.normals(here.face[met[same]]), own.tracer.normals(there.face[met[same]])
    assert (np.abs(normals[0] - normals[1]).max(axis=1) < 1e-9).mean() > 0.999


@pytest.mark.parametrize(
    ("finish", "place"), [("glossy", (503.0, 1.5, 4.0)), ("diffuse", (500.9, -1.2, 0.05))]
)
def test_light_by_way_of_shared_copies_is_that_of_copies_of_their_own(
    shared, monkeypatch, finish, place
):
    """A lamp high above, and one so close to the floor that its patch is looked for from the
    lamp.
    """
    (origin, towards), effort = rays(6_000), IntegratorSettings(max_bounces=3)

    def seen(seed):
        stage = site(finish, position_m=place, radius_m=0.01).on(NM)
        light = radiance_along(
            stage, origin, towards, effort, np.random.default_rng(seed), gather_rays=4
        ).total()[:, 0]
        return np.minimum(light, np.percentile(light, 99.5))

    one = seen(1)
    monkeypatch.setattr(build, "SHARED_FROM", 10**9)
    own, again = seen(1), seen(2)
    error = np.std(own - again) / np.sqrt(len(own))
    assert one.mean() == pytest.approx(own.mean(), abs=4.0 * error)
    assert error < 0.03 * own.mean()


def test_truth_and_refusals_know_shared_copies(shared):
    scene = site()
    view = Viewpoint(
        position_m=(503.0, -8.0, 5.0),
        forward=(0.0, 0.9, -0.4),
        shape=(40, 60),
        focal_px=(50.0, 50.0),
    )
    found = truth(scene.on(NM), view)
    assert set(found.objects) == {"floor", "boxes"}
    middle = np.count_nonzero(found.object == found.objects.index("boxes"))
    assert (
        middle > 100 and (found.material[found.object == 1] == found.materials.index("box")).all()
    )
    pose = scene.scene.object[1].instances[-1]
    with pytest.raises(
        BadInput, match=r"clear of surfaces by its radius of 5 m, got 'lamp' .* from 'boxes'"
    ):
        _ = site(position_m=(pose.position_m[0], pose.position_m[1], 5.2), radius_m=5.0).surfaces


PEAK = """
from simulate.radiance.outdoor import build_surfaces
from simulate.radiance.outdoor import MaterialSpec
from simulate.radiance.outdoor import Object, OutdoorScene, Pose, SceneCamera

poses = tuple(
    Pose(position_m=(3.0 * (i % 150), 3.0 * (i // 150), 1.0), heading_deg=i % 360)
    for i in range(20_000)
)
ball = Object(label="balls", material="grey", shape="sphere", size_m=(1.0,), instances=poses)
camera = SceneCamera(position_m=(0, -5, 2), look_at_m=(0, 0, 2))
grey = MaterialSpec(label="grey", reflectance=(0.5,))
found = build_surfaces(OutdoorScene(name="balls", camera=camera, material=(grey,), object=(ball,)))
assert len(found.tracer.planes[3]) == 20_000
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""


def test_twenty_thousand_copies_of_five_thousand_triangles_take_less_than_400_megabytes():
    """A hundred million triangles of their own would take tens of gigabytes."""
    done = subprocess.run([sys.executable, "-c", PEAK], capture_output=True, text=True, check=True)
    print(f"peak {1e-3 * int(done.stdout):.0f} MB")
    assert int(done.stdout) < 400_000


def test_another_embree_than_the_fourth_is_refused(monkeypatch):
    old = SimpleNamespace(
        rtcNewDevice=lambda config: 1, rtcGetDeviceProperty=lambda device, number: 30_105
    )
    monkeypatch.setattr(embree, "_library", lambda: old)
    with pytest.raises(BadInput, match="rays need Embree 4, got version 30105"):
        embree._device.__wrapped__()
