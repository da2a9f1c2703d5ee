"""Every BRDF is reciprocal, gives back no more light than comes, and is drawn from as it says."""

import numpy as np
import pytest

from labdata import BadInput
from simulate.radiance.brdf import (
    Glossy,
    Lambert,
    MeasuredTable,
    Metal,
    Reflectance,
    Retroreflector,
    grey,
    microfacet,
    specular_albedo,
)

WAVELENGTH = np.array([450.0, 650.0, 850.0])
TABLE = Reflectance(wavelength_nm=(450.0, 650.0, 850.0), fraction=(0.2, 0.6, 1.0))
POLAR, AZIMUTH = np.linspace(0.0, 90.0, 10), np.linspace(0.0, 180.0, 7)


def measured():
    """A rising, then falling shape that depends on both angles and azimuth, reciprocal by
    construction.
    """
    tilt = np.sin(np.deg2rad(2.0 * POLAR))
    bent = tilt[:, None, None] * tilt[None, :, None] * (1.0 - 0.6 * np.cos(np.deg2rad(AZIMUTH)))
    table = np.stack([level * (0.18 + 0.05 * bent) for level in (0.2, 0.6, 1.0)])
    return MeasuredTable(
        wavelength_nm=WAVELENGTH, polar_deg=POLAR, azimuth_deg=AZIMUTH, table=table
    )


BRDFS = {
    "diffuse": Lambert(reflectance=TABLE),
    "metal-.05": Metal(reflectance=TABLE, roughness=0.05),
    "metal-.3": Metal(reflectance=TABLE, roughness=0.3),
    "metal-1": Metal(reflectance=TABLE, roughness=1.0),
    "glossy-.1": Glossy(reflectance=TABLE, roughness=0.1),
    "water-.6": Glossy(reflectance=TABLE, roughness=0.6, refractive_index=1.33),
    "retro-.5": Retroreflector(retroreflectance=grey(0.5), reflectance=TABLE, half_width_deg=0.5),
    "retro-10": Retroreflector(retroreflectance=TABLE, reflectance=grey(0.4), half_width_deg=10.0),
    "measured": measured(),
}
ANGLES = (0.0, 40.0, 75.0, 86.0)
every = pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS.keys())


def eye(angle_deg, count=1):
    angle = np.deg2rad(angle_deg)
    return np.tile([[np.sin(angle), 0.0, np.cos(angle)]], (count, 1))


def random_directions(rng, count):
    up = rng.random(count) ** 2
    turn = 2.0 * np.pi * rng.random(count)
    level = np.sqrt(1.0 - up**2)
    return np.column_stack([level * np.cos(turn), level * np.sin(turn), up])


@every
def test_light_and_eye_can_change_places(brdf, seed):
    rng = np.random.default_rng(seed)
    one, other = random_directions(rng, 4000), random_directions(rng, 4000)
    # Half of the pairs lie where lobes are.
    near = 1e-3 * rng.standard_normal((2000, 3))
    other[:1000] = one[:1000] + near[:1000]
    other[1000:2000] = one[1000:2000] * [-1.0, -1.0, 1.0] + near[1000:]
    other /= np.linalg.norm(other, axis=1)[:, None]
    there, back = brdf.value(one, other, WAVELENGTH), brdf.value(other, one, WAVELENGTH)
    assert np.allclose(there, back, rtol=1e-9, atol=1e-12)
    assert (there >= 0.0).all() and np.isfinite(there).all()


@every
@pytest.mark.parametrize("angle", ANGLES)
def test_draws_average_to_the_albedo(brdf, angle, seed):
    count = 60_000
    outgoing = eye(angle, count)
    incoming, density = brdf.sample(outgoing, np.random.default_rng([seed, int(angle)]))
    assert np.allclose(np.linalg.norm(incoming, axis=1), 1.0)
    assert np.allclose(density, brdf.pdf(incoming, outgoing))
    light = brdf.value(incoming, outgoing, WAVELENGTH) * np.maximum(incoming[:, 2], 0.0) / density
    error = light.std(axis=1) / np.sqrt(count)
    albedo = brdf.albedo(outgoing[:1], WAVELENGTH)[:, 0]
    assert (np.abs(light.mean(axis=1) - albedo) < 4.5 * error + 1e-9).all()
    # No draw is worth so much that means would not settle.
    assert light.max() < 40.0


@pytest.mark.parametrize(
    "brdf",
    [
        Lambert(reflectance=grey(1.0)),
        Glossy(reflectance=grey(1.0), roughness=0.2),
        *(Metal(reflectance=grey(1.0), roughness=roughness) for roughness in (0.02, 0.3, 1.0)),
    ],
)
def test_what_reflects_all_light_vanishes_in_an_even_glow(brdf):
    for angle in ANGLES:
        assert brdf.albedo(eye(angle), WAVELENGTH) == pytest.approx(1.0, abs=1e-9)


# Albedo of GGX with facets that reflect all, at 0, 30, 60, 80 degrees, to the digits of the
# reference.
@pytest.mark.parametrize(
    ("roughness", "albedo", "within"),
    [
        (0.1, (0.99, 0.99, 0.97, 0.90), 0.006),
        (0.3, (0.88, 0.86, 0.82, 0.85), 0.006),
        (1.0, (0.307, 0.335, 0.451, 0.668), 0.001),
    ],
)
def test_a_single_bounce_loses_light_on_rough_faces(roughness, albedo, within):
    table = specular_albedo(roughness)
    for angle, expected in zip((0.0, 30.0, 60.0, 80.0), albedo, strict=True):
        assert table.at(eye(angle))[0] == pytest.approx(expected, abs=within)


@pytest.mark.parametrize(
    ("angle", "reflectance"),
    [(0, 0.0400), (30, 0.0415), (45, 0.0502), (60, 0.0892), (75, 0.2531), (85, 0.6128)],
)
def test_glass_reflects_by_fresnel(angle, reflectance):
    assert microfacet.dielectric(np.cos(np.deg2rad(angle)), 1.5) == pytest.approx(
        reflectance, abs=6e-5
    )


@pytest.mark.parametrize(("index", "reflectance"), [(1.5, 0.0918), (1.33, 0.0659)])
def test_glass_and_water_in_an_even_glow(index, reflectance):
    cosine = (np.arange(20_000) + 0.5) / 20_000
    assert np.mean(2.0 * cosine * microfacet.dielectric(cosine, index)) == pytest.approx(
        reflectance, abs=1e-4
    )


def test_a_retroreflector_is_brightest_to_the_lamps_own_eye():
    sheet = Retroreflector(retroreflectance=grey(0.1), reflectance=grey(0.3), half_width_deg=0.5)
    towards = np.array([eye(30.0)[0], eye(30.5)[0], eye(35.0)[0], eye(-30.0)[0]])
    value = sheet.value(towards, eye(30.0, 4), [550.0])[0]
    base = value[3]
    assert (value[1] - base) / (value[0] - base) == pytest.approx(0.5, rel=0.01)
    assert value[2] == pytest.approx(base, rel=0.02)
    # 0.1 N(0), the coefficient of retroreflection at normal incidence, in cd lx-1 m-2.
    head_on = sheet.value(eye(0.0), eye(0.0), [550.0])[0, 0] - base
    assert head_on == pytest.approx(0.1 * np.log(2.0) / (np.deg2rad(0.5) ** 2 * np.pi), rel=0.01)


def test_a_measured_table_is_read_at_its_angles():
    brdf = measured()
    light = np.array(
        [
            [np.sin(np.deg2rad(30.0)) * c, np.sin(np.deg2rad(30.0)) * s, np.cos(np.deg2rad(30.0))]
            for c, s in ((1.0, 0.0), (0.5, np.sqrt(0.75)), (-1.0, 0.0))
        ]
    )
    found = brdf.value(light, eye(60.0, 3), WAVELENGTH)
    assert np.allclose(found, brdf.table[:, 3, 6, [0, 2, 6]])
    assert np.allclose(brdf.value(light, eye(60.0, 3), [550.0]), found[:2].mean(axis=0))


def bad_table(**change):
    table = np.full((1, 10, 10, 7), 0.2)
    for index, value in change.get("at", ()):
        table[index] = value
    keys = {
        "wavelength_nm": np.array([550.0]),
        "polar_deg": POLAR,
        "azimuth_deg": AZIMUTH,
        "table": table,
    }
    return MeasuredTable(**{**keys, **{k: v for k, v in change.items() if k != "at"}})


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: bad_table(table=np.full((1, 10, 10, 7), 0.4)),
            "must not give off more light than arrives, got 1.2",
        ),
        (
            lambda: bad_table(at=[((0, 2, 7), 0.3)]),
            "the same with light and eye exchanged, got a difference of 0.1",
        ),
        (
            lambda: bad_table(at=[((0, 0, 3, 2), 0.3), ((0, 3, 0, 2), 0.3)]),
            "must not depend on the azimuth",
        ),
        (lambda: bad_table(polar_deg=POLAR[::-1]), "polar_deg of a measured BRDF must ascend"),
        (lambda: bad_table(polar_deg=0.9 * POLAR), "polar_deg must run from 0 to 90"),
        (lambda: bad_table(at=[((0, 0, 0, 0), -1.0)]), "finite and not negative"),
        (
            lambda: Metal(reflectance=grey(0.5), roughness=0.0),
            r"roughness must lie between 0.002 and 1, got 0",
        ),
        (
            lambda: Glossy(reflectance=grey(0.5), roughness=0.1, refractive_index=1.0),
            r"must lie in \(1, 4\], got 1",
        ),
        (
            lambda: Retroreflector(
                retroreflectance=grey(0.5), reflectance=grey(0.1), half_width_deg=0.0
            ),
            "half_width_deg must lie",
        ),
    ],
)
def test_impossible_surfaces_are_refused_in_a_sentence(make, says):
    with pytest.raises(BadInput, match=says):
        make()


@every
def test_nothing_shines_through_from_below(brdf):
    down = np.array([[0.3, 0.0, -np.sqrt(0.91)]])
    assert not brdf.value(down, eye(20.0), WAVELENGTH).any()
    assert not brdf.value(eye(20.0), down, WAVELENGTH).any()
