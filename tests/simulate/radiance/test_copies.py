"""Copies of a mesh share it: they are hit where copies of their own would be, and twenty thousand
fit into memory.
"""

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance.geometry import Viewpoint, embree
from simulate.radiance.integrator import IntegratorSettings, radiance_along, truth
from simulate.radiance.outdoor import (
    BuiltScene,
    LampPlacement,
    MaterialSpec,
    Object,
    OutdoorScene,
    Pose,
    SceneCamera,
    build,
)

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
    assert len(met) > 0.999 * max(len(here.met), len(there.met))
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
