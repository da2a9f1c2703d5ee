"""Lamps by their watts: lasers, diodes and black bodies that shine unseen, with beams."""

import numpy as np
import pytest

from labdata import BadInput
from simulate.camera import JOULE_METRE
from simulate.radiance import load_scene
from simulate.radiance.integrator import IntegratorSettings, radiance_along
from simulate.radiance.lamps import read_spectrum, spectrum
from simulate.radiance.outdoor import BuiltScene

SCENE = """
name = "a wall and an illuminator"
camera = {{ position_m = [0, 0, 2], look_at_m = [0, 1, 2] }}
[[material]]
label = "wall"
reflectance = [0.4]
[[object]]
label = "wall"
shape = "box"
size_m = [20, 1, 20]
position_m = [0, 10.5, -8]
material = "wall"
[[lamp]]
label = "illuminator"
position_m = [0, 0, 2]
aim_m = [0, 10, 2]
{lamp}
"""
IES = """IESNA:LM-63-2002
TILT=NONE
1 1000 1 3 1 1 2 0 0 0
1 1 20
0 90 180
0
100 100 0
"""
# A detector's efficiency over wavelength: 0.2 at 850 nm.
NM = np.arange(400.0, 951.0, 5.0)
EFFICIENCY = np.interp(NM, [400.0, 800.0, 950.0], [0.5, 0.3, 0.0])


def site(folder, lamp):
    """Return the scene with a lamp of such lines."""
    path = folder / "scene.toml"
    path.write_text(SCENE.format(lamp=lamp))
    return BuiltScene(load_scene(path))


def photons_from_the_wall(scene):
    """Return photons per s, m2 and sr that a detector finds in what the middle of the wall sends
    back.
    """
    per_watt = EFFICIENCY * NM * 1e-9 / JOULE_METRE
    grid = scene.bands(NM, per_watt, 0.001)
    stage = scene.on(grid)
    ahead, eye = np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 2.0]])
    light = radiance_along(
        stage,
        eye,
        ahead,
        IntegratorSettings(max_bounces=0),
        np.random.default_rng(0),
        gather_rays=1,
    ).total()[0]
    return float(np.sum(light * np.gradient(grid) * np.interp(grid, NM, per_watt)))


@pytest.mark.parametrize("width_nm", [0.0, 0.3, 30.0])
def test_an_infrared_beam_of_two_watts_gives_a_wall_the_photons_of_its_intensity(
    tmp_path, width_nm
):
    """E = P (m + 1) / (2 pi d^2) on the axis of cos^m; its photons at 850 nm, of which a fifth is
    detected.
    """
    beam = 'beam = "spot"\nhalf_angle_deg = 10'
    lamp = f'kind = "narrow-band"\nwavelength_nm = 850\nwidth_nm = {width_nm}\nwatts = 2\n{beam}'
    power = np.log(0.5) / np.log(np.cos(np.deg2rad(10.0)))
    irradiance = 2.0 * (power + 1.0) / (2.0 * np.pi * 10.0**2)
    exact = 0.4 / np.pi * irradiance * 0.2 * 850e-9 / JOULE_METRE
    assert photons_from_the_wall(site(tmp_path, lamp)) == pytest.approx(exact, rel=0.005)


def test_watts_go_where_a_photometric_file_says(tmp_path):
    """A file that is even over the lower half and falls linearly to none above: the intensity is a
    share of watts.
    """
    (tmp_path / "lamp.ies").write_text(IES)
    lamp = 'kind = "narrow-band"\nwavelength_nm = 850\nwatts = 3\nbeam = "lamp.ies"'
    # Over solid angle: 2 pi (1 + int_0^(pi/2) (1 - 2 u/pi) cos u du) = 2 pi (1 + 2/pi).
    intensity = 3.0 / (2.0 * np.pi * (1.0 + 2.0 / np.pi))
    exact = 0.4 / np.pi * intensity / 10.0**2 * 0.2 * 850e-9 / JOULE_METRE
    assert photons_from_the_wall(site(tmp_path, lamp)) == pytest.approx(exact, rel=0.005)


def test_a_spectrum_without_visible_light_is_scaled_to_watts(tmp_path):
    (tmp_path / "diode.csv").write_text("nm,power\n900,0\n940,7\n980,0\n")
    found = read_spectrum(tmp_path / "diode.csv", watts=5.0)
    assert found.total() == pytest.approx(5.0) and found.lumens == 0.0
    assert site(tmp_path, 'kind = "diode.csv"\nwatts = 5').lamps[0][
        1
    ].flux.total() == pytest.approx(5.0)
    with pytest.raises(
        BadInput, match=r"must have visible light to be scaled to lumens \(state watts\)"
    ):
        _ = site(tmp_path, 'kind = "diode.csv"\nlumens = 5').lamps


def test_a_watt_of_a_black_body_at_2856_kelvin_is_16_5_lumens():
    assert spectrum("incandescent", watts=1.0).lumens == pytest.approx(16.5, rel=0.005)


def test_a_lasers_line_keeps_its_power_and_place():
    laser = spectrum("narrow-band", wavelength_nm=532.0, width_nm=0.1, watts=1e-3)
    assert laser.total(531.5, 532.5) == pytest.approx(1e-3, rel=1e-4)
    # Half of its height at half of its width from the middle.
    assert np.interp(
        532.05, laser.wavelength_nm, laser.density
    ) / laser.density.max() == pytest.approx(0.5, rel=0.01)
    # V(532 nm) between .862 at 530 and .954 at 540.
    assert laser.lumens == pytest.approx(683e-3 * (0.862 + 0.2 * 0.092), rel=1e-3)


@pytest.mark.parametrize(
    ("lamp", "says"),
    [
        (
            'kind = "mercury"\nlumens = 1\nwatts = 1',
            "either lumens or watts, or neither .*, got both of 'illuminator'",
        ),
        ('kind = "mercury"', "either lumens or watts, or neither .*, got none of 'illuminator'"),
        ('kind = "mercury"\nwatts = -1', "must not be negative, got -1"),
        ('kind = "narrow-band"\nwatts = 1', "wavelength_nm must be given for a narrow-band lamp"),
        (
            'kind = "mercury"\nwavelength_nm = 500\nwatts = 1',
            "belong to a narrow-band lamp, got mercury",
        ),
        ('kind = "a.csv"\nwidth_nm = 5\nwatts = 1', "belong to a narrow-band lamp, got a.csv"),
        ('kind = "narrow-band"\nwavelength_nm = 2000\nwatts = 1', "must lie within 300 to 1200 nm"),
        ('kind = "narrow-band"\nwavelength_nm = 850\nlumens = 1', "must have visible light"),
    ],
)
def test_impossible_illuminators_are_refused_in_a_sentence(tmp_path, lamp, says):
    with pytest.raises(BadInput, match=says):
        _ = site(tmp_path, lamp).lamps
