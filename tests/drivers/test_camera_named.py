"""A plan's wires name a camera of any kind."""

import pytest

from drivers import camera_named
from drivers.cameras.aravis.camera import AravisCamera
from drivers.cameras.replay import ReplayCamera
from drivers.cameras.v4l2 import V4l2Camera
from labdata import BadInput


@pytest.mark.parametrize(
    ("name", "kind", "identifier"),
    [
        ("v4l2:/dev/video3", V4l2Camera, "/dev/video3"),
        ("v4l2:/dev/video3#1", V4l2Camera, "/dev/video3"),
        ("replay:some/day1", ReplayCamera, "replay of some/day1"),
        ("replay:some/day1#flat-03", ReplayCamera, "replay of some/day1#flat-03"),
        ("Aravis-Fake-GV01", AravisCamera, "Aravis-Fake-GV01"),
        ("192.168.1.7", AravisCamera, "192.168.1.7"),
        (None, AravisCamera, "camera"),
    ],
)
def test_a_camera_is_reached_by_what_its_name_begins_with(name, kind, identifier):
    camera = camera_named(name)
    assert isinstance(camera, kind)
    assert camera.identifier == identifier


@pytest.mark.parametrize("name", ["v4l2:", "replay:#flat", "v4l2:/dev/video0#composite"])
def test_half_a_name_is_refused(name):
    with pytest.raises(BadInput, match="must"):
        camera_named(name)
