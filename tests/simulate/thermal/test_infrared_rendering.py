"""Infrared images: isothermal worlds, Kirchhoff's law, mirrored sky, sun, shadow, chance, and
edges.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from labdata import from_mapping
from labdata.camera import Parameter
from simulate.radiance import (
    internal_transmittance,
    material,
    material_names,
)
from simulate.radiance.brdf import Glossy, dielectric, directions_at_cosine
from simulate.radiance.geometry import Viewpoint
from simulate.radiance.outdoor import MaterialSpec, OutdoorScene, Slab
from simulate.thermal import (
    ZERO_C,
    InfraredAir,
    InfraredTracer,
    apparent_temperature,
    bins_of,
    infrared_brdf,
    infrared_radiance,
    infrared_rendering,
    infrared_surfaces,
    infrared_tracer,
    open_rings,
    pane_transmittance,
    sky_of,
    temperatures_of,
    thresholds,
)

AIR_C = 16.0
NIGHT = {
    "name": "night",
    "place": {"latitude_deg": 43.16, "longitude_deg": -77.61, "time": "1998-06-24T02:00:00-04:00"},
    "weather": {"temperature_c": AIR_C, "relative_humidity": 0.7, "wind_m_s": 1.0},
    "camera": {"position_m": [0, -20, 5], "look_at_m": [0, 0, 0]},
}
AWAY = [200.0, 0.0, 2.0]
NOON = NIGHT | {"place": NIGHT["place"] | {"time": "1998-06-24T13:00:00-04:00"}}


@dataclass(frozen=True)
class EvenSky:
    """A sky of one temperature in all directions."""

    air: InfraredAir
    kelvin: float
    sun: None = None

    def radiance(self, direction):
        return np.tile(self.air.black_body(self.kelvin), (len(direction), 1))

    @property
    def sunlight(self):
        return np.zeros(len(self.air.low_um))


def scene_of(materials, objects, base=NIGHT) -> OutdoorScene:
    return from_mapping(
        base | {"material": materials, "object": objects}, OutdoorScene, where="test"
    )


def box(label, material, at, **more):
    return {
        "label": label,
        "shape": "box",
        "size_m": [1, 1, 1],
        "material": material,
        "position_m": at,
        **more,
    }


def ground(material, side=300.0, **more):
    return {
        "label": "ground",
        "shape": "plane",
        "size_m": [side, side],
        "material": material,
    } | more


def look_of(
    scene, view, band=(8.0, 12.0), sky_k=None, rays=32, mirror_rays=64, without=()
) -> InfraredTracer:
    temperatures = temperatures_of(scene)
    sky = sky_of(band, temperatures.balance.weather, scene.weather)
    above = sky if sky_k is None else EvenSky(sky.air, sky_k)
    return InfraredTracer(
        temperatures=temperatures,
        surfaces=infrared_surfaces.infrared_surfaces(temperatures, scene, sky.air, above),
        air=sky.air,
        sky=above,
        viewpoint=view,
        seed=3,
        rays=rays,
        mirror_rays=mirror_rays,
        without=frozenset(without),
    )


def down(height=3.0, shape=(4, 6)) -> Viewpoint:
    return Viewpoint(
        position_m=(0.0, 0.0, height), forward=(0.0, 0.0, -1.0), shape=shape, focal_px=(20.0, 20.0)
    )


@pytest.mark.parametrize("band", [(3.4, 4.9), (8.0, 12.0)])
def test_an_isothermal_world_is_a_black_body_whatever_the_materials_angle_and_range(band):
    """Every shipped material, glass, mirrors facing each other, air, and from 5 m to 3 km: within
    1e-6.
    """
    opaque = [name for name in material_names() if not any(material(name).transmittance)]
    materials = [
        {"label": n, "library": n, "slab": material(n).slab or "steel-sheet-painted"}
        for n in opaque
    ]
    materials += [{"label": "pane", "pane_transmittance": [0.8]}]
    warm = {"temperature_c": AIR_C}
    things = [
        box(m["label"], m["label"], [2.0 * (i % 4), 2.0 * (i // 4), 0], **warm)
        for i, m in enumerate(materials)
    ]
    scene = scene_of(materials, [ground("asphalt", **warm), *things])
    middle = np.mean([thing["position_m"] for thing in things], axis=0)
    for distance in (10.0, 3000.0):
        away = distance * np.array([0.1, -1.0, 0.4])
        place, ahead = tuple(middle + away), tuple(-away / np.linalg.norm(away))
        view = Viewpoint(
            position_m=place,
            forward=ahead,
            shape=(24, 32),
            focal_px=(2.2 * distance, 2.2 * distance),
        )
        look = look_of(scene, view, band, sky_k=ZERO_C + AIR_C, rays=8, mirror_rays=8)
        picture = infrared_rendering._render(look, 10.0, None, lambda share: None)
        assert len(np.unique(picture.truth.material)) > 10
        black = look.air.black_body(ZERO_C + AIR_C)
        assert np.abs(picture.radiance / black - 1.0).max() < 1e-6
        assert picture.error_k < 1e-9


LOW_E = [  # emissivity, band, how warm 10 C looks under a sky of 220 and 250 K, C
    (0.1, (8.0, 12.0), (-42.990, -19.062)),
    (0.3, (8.0, 12.0), (-27.049, -11.559)),
    (0.9, (8.0, 12.0), (5.680, 7.250)),
    (0.1, (8.0, 14.0), (-43.457, -19.145)),
    (0.3, (8.0, 14.0), (-27.781, -11.724)),
    (0.9, (8.0, 14.0), (5.528, 7.202)),
    (0.1, (3.0, 5.0), (-32.465, -17.129)),
    (0.3, (3.0, 5.0), (-15.290, -8.285)),
    (0.9, (3.0, 5.0), (7.522, 8.009)),
]


@pytest.mark.parametrize(("emissivity", "band", "looks_c"), LOW_E)
def test_a_plate_under_an_even_sky_looks_as_cold_as_the_closed_form_says(emissivity, band, looks_c):
    slab = {
        "label": "plate",
        "temperature_c": 10.0,
        "emissivity": emissivity,
        "emissivity_mwir": emissivity,
    }
    metal = {"label": "plate", "reflectance": [0.5], "slab": "plate"}
    scene = from_mapping(
        NIGHT | {"material": [metal], "object": [ground("plate")], "slab": [slab]},
        OutdoorScene,
        where="test",
    )
    for sky_k, expected in zip((220.0, 250.0), looks_c, strict=True):
        seen = look_of(scene, down(), band, sky_k=sky_k, without=(infrared_tracer.AIR,)).rows(0)
        found = apparent_temperature(seen.radiance.sum(axis=1), band)
        assert found - ZERO_C == pytest.approx(expected, abs=0.005)


def test_a_glossy_coat_emits_less_at_grazing_angles():
    """Of index 1.5 the emissivity is that of Fresnel's equations: 0.96 along the normal, 0.39 at 85
    degrees.
    """
    paint = MaterialSpec(
        label="enamel",
        reflectance=(0.1,),
        finish="glossy",
        roughness=0.01,
        refractive_index=1.5,
        slab="x",
    )
    slab = Slab(above_air_k=Parameter(value=0.0), emissivity=Parameter(value=0.96))
    brdf = infrared_brdf(paint, slab)
    assert isinstance(brdf, Glossy)
    cosine = np.cos(np.deg2rad([0.0, 60.0, 75.0, 85.0]))
    found = 1.0 - brdf.albedo(directions_at_cosine(cosine), [10e3])[0]
    assert found == pytest.approx(1.0 - dielectric(cosine, 1.5), abs=0.015)
    assert found == pytest.approx([0.96, 0.91, 0.75, 0.39], abs=0.02)


@pytest.mark.parametrize("finish", ["diffuse", "metal"])
def test_emissivities_of_both_windows_hold_along_the_normal(finish):
    roughness = 0.3 if finish == "metal" else None
    surface = MaterialSpec(
        label="x", reflectance=(0.5,), finish=finish, slab="x", roughness=roughness
    )
    mwir, lwir = Parameter(value=0.35), Parameter(value=0.28)
    slab = Slab(above_air_k=Parameter(value=0.0), emissivity=lwir, emissivity_mwir=mwir)
    albedo = infrared_brdf(surface, slab).albedo(np.array([[0.0, 0.0, 1.0]]), [4e3, 10e3])[:, 0]
    assert 1.0 - albedo == pytest.approx([0.35, 0.28], abs=1e-4)


def test_what_a_plane_sees_of_the_sky_without_obstacles_is_half_of_1_plus_the_cosine():
    angle = np.deg2rad(np.linspace(0.0, 180.0, 37))
    normal = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)
    assert open_rings(normal).sum(axis=1) == pytest.approx(0.5 * (1.0 + np.cos(angle)), abs=2e-4)
    assert open_rings(normal[:1]) == pytest.approx(1.0 / 12.0, abs=1e-6)


@pytest.fixture(scope="module")
def yard():
    """Bare aluminium, painted steel, concrete and a wall under the night sky."""
    labels = ("aluminium", "olive-drab-paint", "concrete")
    flat = [
        {
            "label": name,
            "shape": "plane",
            "size_m": [2, 2],
            "material": name,
            "position_m": [3.0 * i, 0, 1.0],
        }
        for i, name in enumerate(labels)
    ]
    scene = scene_of(
        [{"label": name, "library": name} for name in labels],
        [ground("concrete"), *flat, box("wall", "olive-drab-paint", [3.0, 4.0, 0.0])],
    )
    return scene, temperatures_of(scene)


def test_bare_aluminium_looks_cold_and_painted_tops_and_walls_lie_between_it_and_paving(yard):
    """All apparent temperatures beside the air's 16 C: metal 25 K below its own, paint below air,
    paving above it.
    """
    scene, temperatures = yard
    view = Viewpoint(
        position_m=(3.0, 0.0, 12.0), forward=(0.0, 0.0, -1.0), shape=(48, 64), focal_px=(64.0, 64.0)
    )
    picture = infrared_radiance(temperatures, scene, view, band_um=(8.0, 12.0), netd_k=0.1)
    kelvin, truth = picture.apparent_k(), picture.truth
    mean = {
        name: (
            kelvin[truth.object == i].mean() - ZERO_C,
            truth.temperature_k[truth.object == i].mean() - ZERO_C,
        )
        for i, name in enumerate(truth.objects)
    }
    looks, has = mean["aluminium"]
    assert looks < has - 25.0 and has == pytest.approx(AIR_C, abs=1.5)
    assert mean["olive-drab-paint"][0] < mean["olive-drab-paint"][1] < AIR_C - 2.0
    assert mean["ground"][1] > AIR_C > mean["wall"][0] > looks
    assert truth.range_m.min() == pytest.approx(11.0, abs=0.02) and truth.sources == ()
    names = {effect.name for effect in (*picture.effects, *picture.left_out)}
    assert {
        infrared_tracer.AIR,
        infrared_tracer.MORE,
        infrared_tracer.SUN,
    } < names and infrared_tracer.SUN in {effect.name for effect in picture.left_out}
    assert "times the NETD" in picture.text(100.0)


def test_the_error_is_that_of_repeated_pictures_and_falls_with_the_noise_asked_for(yard):
    scene, temperatures = yard
    view = Viewpoint(
        position_m=(3.0, -8.0, 2.0), forward=(0.0, 1.0, -0.2), shape=(16, 24), focal_px=(30.0, 30.0)
    )
    per_radiance = InfraredAir(
        edges_um=bins_of((8.0, 12.0)), temperature_k=ZERO_C + AIR_C, vapour_g_m3=9.5
    ).kelvin_per_radiance(ZERO_C + AIR_C)
    fine, errors = None, {}
    for netd_k in (0.05, 0.4):
        runs = [
            infrared_radiance(
                temperatures, scene, view, band_um=(8.0, 12.0), netd_k=netd_k, seed=seed
            )
            for seed in (1, 2)
        ]
        apart = (runs[0].radiance - runs[1].radiance).sum(axis=2) * per_radiance / np.sqrt(2.0)
        apart = apart[np.isfinite(runs[0].truth.temperature_k)]
        errors[netd_k] = float(np.sqrt(np.mean(np.square(apart))))
        # Random pixels of the trial, independent rays: within a half of all pixels, whose
        # neighbours share rays.
        assert errors[netd_k] == pytest.approx(runs[0].error_k, rel=0.5)
        assert runs[0].rays <= (thresholds.INFRARED.max_rays, thresholds.INFRARED.max_mirror_rays)
        fine = fine or runs[0]
    assert errors[0.05] < 0.6 * errors[0.4] < 0.6 * 0.4
    assert fine.rays[0] > runs[0].rays[0]
    again = infrared_radiance(temperatures, scene, view, band_um=(8.0, 12.0), netd_k=0.4, seed=2)
    assert np.array_equal(again.radiance, runs[1].radiance)


def test_panes_of_glass_are_clear_to_4_5_um_as_rubin_measured():
    """Of 4 mm at 4 um exp(-4 pi k d / l) is 0.264, k = 1.06e-4, and 0.929 of it leaves the faces of
    index 1.47.
    """
    assert pane_transmittance(4.0, (3.99, 4.01))[0] == pytest.approx(0.929 * 0.264, rel=1e-2)
    # Internal transmittances of twice the thickness are the squares.
    thin, thick = (
        internal_transmittance(pane_transmittance(mm, (3.5, 3.51, 3.52)), 1.47) for mm in (3.0, 6.0)
    )
    assert thick == pytest.approx(thin**2, rel=1e-3)
    found = pane_transmittance(4.0, bins_of((3.0, 5.0)))
    assert (found[:5] > 0.2).all() and 0.05 < found[5] < 0.15 and (found[6:] < 0.003).all()
    assert not pane_transmittance(0.1, bins_of((7.5, 14.0))).any()


@pytest.mark.parametrize("panes", [1, 2, 3])
def test_a_hot_plate_behind_panes_shows_by_what_they_let_through(panes):
    """Straight down, of each pane: what it reflects of the even sky, emits, and transmits; nothing
    beyond 7.5 um.
    """
    metal = [
        {"label": "black", "reflectance": [0.0], "slab": "black"},
        {"label": "pane", "pane_transmittance": [0.9]},
    ]
    slab = {"label": "black", "temperature_c": 60.0, "emissivity": 1.0}
    things = [
        {
            "label": f"pane {i}",
            "shape": "plane",
            "size_m": [200, 200],
            "material": "pane",
            "position_m": [0, 0, 1 + i],
        }
        | {"temperature_c": 10.0}
        for i in range(panes)
    ]
    scene = from_mapping(
        NIGHT | {"material": metal, "slab": [slab], "object": [ground("black"), *things]},
        OutdoorScene,
        where="test",
    )
    view = Viewpoint(
        position_m=(0.0, 0.0, 9.0), forward=(0.0, 0.0, -1.0), shape=(2, 2), focal_px=(400.0, 400.0)
    )
    for band, clear in (((3.4, 4.1), True), ((8.0, 12.0), False)):
        look = look_of(
            scene,
            view,
            band,
            sky_k=250.0,
            without=(infrared_tracer.AIR, infrared_tracer.BETWEEN),
        )
        seen = look.rows(0).radiance
        assert (
            replace(look, without=look.without | {infrared_tracer.GLASS}).rows(0).radiance == seen
        ).all() != clear
        pane, hot, sky = (
            look.air.black_body(kelvin) for kelvin in (ZERO_C + 10.0, ZERO_C + 60.0, 250.0)
        )
        through = pane_transmittance(4.0, look.air.edges_um)
        reflects = 0.05 if clear else 0.16
        facets = dict(
            zip(look.temperatures.balance.facets.names, look.surfaces.facets, strict=True)
        )
        expected = hot
        for number in range(panes - 1):
            expected = through * expected + (1.0 - through) * facets[f"pane {number}:pane"]
        expected = through * expected + (1.0 - reflects - through) * pane + reflects * sky
        assert seen == pytest.approx(np.tile(expected, (4, 1)), rel=2e-3)


def test_what_is_left_out_of_glass_is_stated():
    scene = scene_of(
        [
            {"label": "concrete", "library": "concrete"},
            {"label": "pane", "pane_transmittance": [0.9]},
        ],
        [ground("concrete"), ground("pane", 2.0, label="pane", position_m=[0, 0, 1.0])],
    )
    temperatures = temperatures_of(scene)
    for band, clear in (((3.4, 4.9), True), ((8.0, 12.0), False)):
        picture = infrared_radiance(
            temperatures, scene, down(), band_um=band, netd_k=10.0, tolerance=None
        )
        changes = {
            effect.name: effect.influence for effect in (*picture.effects, *picture.left_out)
        }
        assert (
            (changes[infrared_tracer.GLASS] > 10.0)
            == clear
            == (changes[infrared_rendering.INSIDE] > 10.0)
        )


def test_the_sun_reflects_in_the_mid_infrared_and_not_in_the_shadow():
    """On open concrete rho E cos(i)/pi over the emission; below a roof nothing."""
    scene = scene_of(
        [{"label": "concrete", "library": "concrete"}],
        [
            ground("concrete", side=2000.0, temperature_c=20.0),
            ground("concrete", 40.0, label="roof", position_m=AWAY),
        ],
        NOON,
    )
    lit, dark = (replace(down(1.0), position_m=(x, 0.0, 1.0)) for x in (-60.0, AWAY[0]))
    for view, shines in ((lit, True), (dark, False)):
        look = look_of(scene, view, (3.4, 4.1), without=(infrared_tracer.AIR,))
        sun = look.sky.sun
        assert sun is not None
        added = (
            look.rows(0).radiance
            - replace(look, without=frozenset({infrared_tracer.AIR, infrared_tracer.SUN}))
            .rows(0)
            .radiance
        )
        reflectance = np.pi * look.surfaces.bsdfs.rho_by_pi[0]
        expected = reflectance * look.sky.sunlight * sun[2] / np.pi
        assert added == pytest.approx(
            np.tile(expected if shines else 0.0 * expected, (len(added), 1)), rel=1e-5
        )
        assert look.rows(0).shadow.all() != shines
    kelvin = 1e-3 * look.air.kelvin_per_radiance(293.0) * 1e3 * expected.sum()
    assert 3.0 < kelvin < 60.0


def test_pixels_where_objects_meet_are_means_over_their_parts():
    slabs = [
        {"label": name, "temperature_c": c, "emissivity": 1.0}
        for name, c in (("cold", 0.0), ("hot", 40.0))
    ]
    paint = [{"label": s["label"], "reflectance": [0.5], "slab": s["label"]} for s in slabs]
    half = {
        "label": "half",
        "shape": "plane",
        "size_m": [100, 100],
        "material": "hot",
        "position_m": [50.05, 0, 0.001],
    }
    scene = from_mapping(
        NIGHT | {"slab": slabs, "material": paint, "object": [ground("cold"), half]},
        OutdoorScene,
        where="test",
    )
    view = Viewpoint(
        position_m=(0.0, 0.0, 2.0), forward=(0.0, 0.0, -1.0), shape=(6, 8), focal_px=(8.0, 8.0)
    )
    look = look_of(scene, view, sky_k=280.0, rays=8)
    radiance = infrared_rendering._render(look, 1.0, None, lambda share: None).radiance.sum(axis=2)
    ends = look.air.after_path(look.air.black_body([273.15, 313.15]), [2.0, 2.0]).sum(axis=1)
    share = (radiance - ends[0]) / (ends[1] - ends[0])
    # The edge lies a fifth of a pixel to the right of the middle of the frame: a third of the pixel
    # is cold.
    assert share[:, 3] == pytest.approx(0.0, abs=1e-3) and share[:, 5] == pytest.approx(
        1.0, abs=1e-3
    )
    assert share[:, 4] == pytest.approx(2.0 / 3.0, abs=1e-3)


def test_apparent_temperature_inverts_the_radiance_of_black_bodies():
    air = InfraredAir(edges_um=bins_of((7.5, 13.5)), temperature_k=288.0, vapour_g_m3=6.4)
    kelvin = np.array([180.0, 233.33, 288.0, 320.1, 700.0])
    found = apparent_temperature(air.black_body(kelvin).sum(axis=1), (7.5, 13.5))
    assert found == pytest.approx(kelvin, abs=1e-3)
