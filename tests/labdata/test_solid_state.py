"""A camera without a tube: described, told apart from intensified ones, and kept out of where a
tube is needed.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import BadInput, Camera, load_camera, load_sensor, open_session, to_toml
from labdata.camera import Parameter


@pytest.fixture
def camera() -> Camera:
    return load_camera("emccd-512")


def test_a_camera_with_a_tube_is_a_sensor_and_one_without_is_not(camera):
    assert load_camera("pulnix-ag5745ef3").has_tube and not camera.has_tube
    with pytest.raises(
        BadInput, match=r"must be an intensified camera, got 'EMCCD 512', which has no \[tube\]"
    ):
        load_sensor("emccd-512")


def test_the_register_fills_the_scale_and_its_dark_current_is_gone_when_cooled(camera):
    video = camera.video
    span = 2**video.bit_depth - 1 - float(video.black_level_dn)
    assert span / float(video.conversion_gain_dn_per_e) == pytest.approx(8e5, rel=1e-3)
    colder = 2.0 ** ((-70.0 - 25.0) / float(camera.ccd.dark_current_doubling_k))
    assert float(camera.ccd.dark_current_e_per_s) * colder < 0.02


def test_an_efficiency_other_than_the_highest_of_the_silicon_is_refused(camera) -> None:
    with pytest.raises(BadInput, match=r"must be the silicon's highest, 0\.92, got 0\.5"):
        replace(camera, ccd=replace(camera.ccd, quantum_efficiency=Parameter(value=0.5)))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"register.em_gain": 0.5}, "em_gain must be at least 1, got 0.5"),
        ({"register.clock_induced_e": -1.0}, "clock_induced_e must not be negative, got -1"),
        ({"optics.focal_length_mm": 0.0}, "focal_length_mm must be positive, got 0"),
    ],
)
def test_what_no_camera_can_have_is_refused(camera, changes, sentence):
    with pytest.raises(BadInput) as error:
        camera.with_values(changes)
    assert str(error.value) == sentence


def test_a_camera_without_a_tube_is_progressive_and_digital(camera):
    with pytest.raises(BadInput, match="progressive and digital"):
        replace(camera, video=replace(camera.video, interlaced=True))


def test_a_session_of_such_a_camera_is_that_of_any_camera(camera, tmp_path):
    np.save(tmp_path / "f.npy", np.zeros((2, 8, 8), np.uint16))
    (tmp_path / "camera.toml").write_text(to_toml(camera))
    (tmp_path / "session.toml").write_text(
        'name = "s"\nsensor = "camera.toml"\n[[stack]]\nlabel = "a"\nkind = "dark"\nframes = '
        '"f.npy"\nem_gain = 300.0\n'
    )
    session = open_session(tmp_path)
    assert session.camera == camera and not session.is_interlaced
    assert session.stacks[0].conditions.em_gain == 300.0
