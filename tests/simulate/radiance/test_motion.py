"""Motion of a scene's camera and objects by keyframes, and the temperatures that objects take
along.
"""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from labdata import BadInput, Conditions, from_mapping
from simulate import Look, Motion, Shot
from simulate.radiance.geometry import Viewpoint
from simulate.radiance.outdoor import (
    CameraKeyframe,
    Object,
    ObjectKeyframe,
    OutdoorScene,
    Pose,
    SceneCamera,
    pose_at,
    rotation_of,
)
from simulate.thermal import temperatures_of

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


@pytest.mark.parametrize(
    ("keyframes", "words"),
    [
        (
            (CameraKeyframe(time_s=0.0, roll_deg=1.0),),
            "times of keyframes must ascend from 0 s, got 0 s after 0 s",
        ),
        (
            (CameraKeyframe(time_s=2.0, roll_deg=1.0), CameraKeyframe(time_s=1.0, roll_deg=1.0)),
            "got 1 s after 2 s",
        ),
        (
            (CameraKeyframe(time_s=1.0),),
            "a keyframe must state a pose, got none at 1 s of the camera",
        ),
        (
            (CameraKeyframe(time_s=1.0, roll_deg=np.nan),),
            "places and angles of keyframes must be finite",
        ),
    ],
)
def test_keyframes_that_are_none_are_refused(keyframes, words):
    with pytest.raises(BadInput, match=words):
        SceneCamera(position_m=(0.0, 0.0, 1.0), look_at_m=(0.0, 1.0, 1.0), keyframe=keyframes)


def test_an_object_with_copies_has_no_keyframes():
    with pytest.raises(
        BadInput, match="an object with keyframes must have no copies, got 1 of 'box'"
    ):
        Object(
            label="box",
            shape="box",
            size_m=(1, 1, 1),
            material="a",
            instances=(Pose(),),
            keyframe=KEYS,
        )


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
