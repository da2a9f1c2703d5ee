"""Lamps have the lumens or watts asked for, and shine where they say."""

import os

import numpy as np
import pytest

from labdata import BadInput
from simulate.camera import JOULE_METRE, quantum_efficiency
from simulate.radiance import load_scene, luminous_efficiency
from simulate.radiance.brdf import read_measured
from simulate.radiance.integrator import IntegratorSettings, radiance_along
from simulate.radiance.lamps import (
    Cosine,
    Isotropic,
    MeasuredDistribution,
    SpotBeam,
    read_ies,
    read_spectrum,
    spectra,
    spectrum,
)
from simulate.radiance.outdoor import BuiltScene, build
from simulate.radiance.sky import dark_sky, moon_spectrum

# Lamps have the lumens asked for, the photoelectrons that the tube makes of them, and shine where
# they say.


def per_lumen(sheet, light):
    """Photoelectrons of the case-study tube (1350 uA/lm) per lumen."""
    nm = np.arange(300.0, 1001.0)
    electrons = light.through(nm, quantum_efficiency(sheet, nm) * nm * 1e-9 / JOULE_METRE)
    return electrons / light.lumens


# lm per W within 380 to 780 nm, and photoelectrons per lumen; without near-infrared lines.
@pytest.mark.parametrize(
    ("kind", "efficacy", "electrons"),
    [
        ("incandescent", 156.0, 8.4e15),
        ("high-pressure-sodium", 382.0, 1.53e15),
        ("low-pressure-sodium", 523.0, 1.13e15),
        ("mercury", 336.0, 1.0e15),
        ("mercury-coated", 310.0, 1.45e15),
        ("metal-halide", 253.0, 1.9e15),
        ("led-cool", 294.0, 1.2e15),
        ("led-warm", 294.0, 2.0e15),
    ],
)
def test_photoelectrons_of_a_lumen_differ_eightfold_between_lamps(sheet, kind, efficacy, electrons):
    share = {} if kind == "incandescent" else {"near_infrared_share": 0.0}
    light = spectrum(kind, **share)
    assert 1.0 / light.total(380.0, 780.0) == pytest.approx(efficacy, rel=0.01)
    assert per_lumen(sheet, light) == pytest.approx(electrons, rel=0.025)


def test_photoelectrons_of_a_lumen_of_moon_and_dark_sky(sheet):
    assert per_lumen(sheet, moon_spectrum(5.0)) == pytest.approx(3.7e15, rel=0.02)
    assert per_lumen(sheet, dark_sky().total) == pytest.approx(6.6e15, rel=0.02)


@pytest.mark.parametrize("kind", spectra.KINDS)
@pytest.mark.parametrize("temperature", [2200.0, 3200.0])
def test_every_lamp_has_the_lumens_asked_for(kind, temperature):
    light = spectrum(kind, lumens=1234.0, temperature_k=temperature)
    assert light.lumens == pytest.approx(1234.0, rel=1e-9)
    fine = np.arange(300.0, 1201.0, 0.25)
    assert 683.0 * np.sum(light.on(fine) * luminous_efficiency(fine)) * 0.25 == pytest.approx(
        1234.0, rel=2e-3
    )


DIRECTIONS = 400


def whole_sphere():
    """Directions and solid angles of an even mesh over all directions."""
    up = -1.0 + (np.arange(DIRECTIONS) + 0.5) * 2.0 / DIRECTIONS
    turn = (np.arange(DIRECTIONS) + 0.5) * 2.0 * np.pi / DIRECTIONS
    z, phi = (axis.ravel() for axis in np.meshgrid(up, turn, indexing="ij"))
    level = np.sqrt(1.0 - z**2)
    return np.column_stack(
        [level * np.cos(phi), level * np.sin(phi), z]
    ), 4.0 * np.pi / DIRECTIONS**2


POLAR = np.array([0.0, 30.0, 60.0, 80.0, 90.0])
STREET = np.array(
    [
        [100.0, 120.0, 260.0, 90.0, 0.0],
        [100.0, 110.0, 150.0, 40.0, 0.0],
        [100.0, 90.0, 60.0, 10.0, 0.0],
    ]
)


@pytest.mark.parametrize(
    "distribution",
    [
        Isotropic(),
        Cosine(),
        SpotBeam(half_angle_deg=10.0),
        SpotBeam(half_angle_deg=60.0),
        MeasuredDistribution(polar_deg=POLAR, azimuth_deg=np.array([0.0]), candela=STREET[:1]),
        MeasuredDistribution(
            polar_deg=POLAR, azimuth_deg=np.array([0.0, 45.0, 90.0]), candela=STREET
        ),
        MeasuredDistribution(
            polar_deg=POLAR, azimuth_deg=np.array([0.0, 90.0, 180.0]), candela=STREET
        ),
        MeasuredDistribution(
            polar_deg=POLAR, azimuth_deg=np.array([0.0, 120.0, 360.0]), candela=STREET[[0, 1, 0]]
        ),
    ],
    ids=str,
)
def test_a_lamp_shines_all_of_its_light_and_no_more(distribution):
    direction, each = whole_sphere()
    assert distribution.per_sr(direction).sum() * each == pytest.approx(1.0, rel=4e-3)


def test_a_table_is_read_at_its_angles_and_mirrored():
    lamp = MeasuredDistribution(
        polar_deg=POLAR, azimuth_deg=np.array([0.0, 45.0, 90.0]), candela=STREET
    )
    turn = np.deg2rad([45.0, 135.0, 225.0, 315.0])
    down = np.deg2rad(60.0)
    ring = np.column_stack(
        [np.sin(down) * np.cos(turn), np.sin(down) * np.sin(turn), np.full(4, np.cos(down))]
    )
    found = lamp.per_sr(ring) / lamp.per_sr(np.array([[0.0, 0.0, 1.0]]))
    assert np.allclose(found, 1.5)
    assert lamp.per_sr(np.array([[0.0, 0.0, -1.0]])) == 0.0


def test_a_spot_falls_to_half_at_its_half_angle():
    spot, angle = SpotBeam(half_angle_deg=12.0), np.deg2rad(12.0)
    edge, axis = spot.per_sr(np.array([[np.sin(angle), 0.0, np.cos(angle)], [0.0, 0.0, 1.0]]))
    assert edge / axis == pytest.approx(0.5, rel=1e-9)


def test_a_spectrum_comes_from_a_file(tmp_path):
    path = tmp_path / "lamp.csv"
    path.write_text("# any unit\nnm,power\n500,1\n600,3\n700,0\n")
    found = read_spectrum(path, lumens=10.0)
    assert found.lumens == pytest.approx(10.0)
    assert found.on(np.array([490.0, 550.0, 600.0, 650.0]))[2] > 0.0
    assert found.density[1] / found.density[0] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("500 1\n", "at least two lines of numbers, got 1"),
        ("nm p\n500 1\n600 x\n", "two numbers on each line, got '600 x'"),
        ("600 1\n500 1\n", "must be positive and ascend"),
        (
            "900 1\n950 1\n",
            "must have visible light to be scaled to lumens .state watts., got none",
        ),
        ("500 1\n600 -1\n", "finite and not negative"),
    ],
)
def test_a_bad_file_is_refused_in_a_sentence(tmp_path, text, says):
    path = tmp_path / "lamp.txt"
    path.write_text(text)
    with pytest.raises(BadInput, match=says):
        read_spectrum(path)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: spectrum("neon"), "one of the kinds incandescent"),
        (lambda: spectrum("mercury", lumens=-1.0), "lumens must not be negative, got -1"),
        (
            lambda: spectrum("incandescent", temperature_k=300.0),
            r"temperature_k must lie in \[1000, 20000\], got 300",
        ),
        (
            lambda: spectrum("led-warm", near_infrared_share=0.1),
            "near_infrared_share must be 0 for led-warm",
        ),
        (lambda: spectrum("incandescent", near_infrared_share=0.1), "has no near_infrared_share"),
        (lambda: SpotBeam(half_angle_deg=90.0), "half_angle_deg must lie in"),
        (
            lambda: MeasuredDistribution(
                polar_deg=POLAR, azimuth_deg=np.array([0.0, 70.0]), candela=STREET[:2]
            ),
            "azimuth_deg must ascend from 0 to 0, 90, 180 or 360",
        ),
    ],
)
def test_impossible_lamps_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()


@pytest.mark.parametrize(
    "read",
    [read_spectrum, read_ies, read_measured, lambda path: build.read_mesh(path, 1.0)],
    ids=["spectrum", "ies", "brdf", "mesh"],
)
def test_what_is_no_regular_file_is_refused_before_it_is_opened(tmp_path, read):
    pipe = tmp_path / "pipe.obj"
    os.mkfifo(pipe)
    with pytest.raises(BadInput, match="must be a regular file"):
        read(pipe)
    with pytest.raises(BadInput, match="must exist to be read"):
        read(tmp_path / "nowhere.obj")


# Lamps by their watts: lasers, diodes and black bodies that shine unseen, with beams.


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
