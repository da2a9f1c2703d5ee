"""How light is sampled changes no mean: compiled loops, the bright sky by name, rays where they
differ.
"""

from dataclasses import replace

import numpy as np
import pytest

from simulate.radiance.brdf import Glossy, grey
from simulate.radiance.geometry import box, plane
from simulate.radiance.integrator import (
    IntegratorSettings,
    LampLight,
    RenderSensor,
    SkyImportance,
    SpectralScene,
    additional_rays,
    environment_map,
    integrator_settings,
    lamp_arrays,
    lamp_pattern,
    outgoing_radiance,
    radiance_along,
)
from simulate.radiance.lamps import Cosine, Isotropic, MeasuredDistribution, SpotBeam
from simulate.radiance.outdoor import render_settings
from tests.simulate.radiance.staging import (
    OVERCAST,
    UNIFORM,
    at,
    disc_light,
    inside_out,
    lamp,
    staged,
    upright,
)

# Light followed by compiled loops is the light that batches for all kinds of surfaces find.


def glowing(way: np.ndarray) -> np.ndarray:
    """A glow of a hundred times the rest around a place 30 degrees high."""
    return np.ones((2, 1)) * (0.2 + 20.0 * np.exp(-(((1.0 - way @ [0.866, 0.0, 0.5]) / 0.02) ** 2)))


ONCE = IntegratorSettings(max_bounces=1)
EVEN = {
    "effort": IntegratorSettings(max_bounces=3),
    "sky": OVERCAST,
    "lamps": (lamp((0, 0, 3), 5.0, 0.2),),
}
# Things that glow unlike each other; the plate shines upwards, and its underside is dark.
SHINING = {"beam": 1.0, "box": 3.0, "plate": 20.0}
UPWARDS = {"beam": 1e-3, "plate": 1.0}
DARK = {"sky": None, "lamps": (), "glow": SHINING}
# Below the plate; and before the box, so that part of the lamp is within it.
CLOSE = (lamp((-1.2, 0.6, 0.75), 1.0, 0.1), lamp((0.4, 0.8, 0.5), 1.0, 0.15))
CASES = {
    "a lamp under an overcast sky": EVEN,
    "one bounce": {**EVEN, "effort": ONCE},
    "without hidden sky": {
        **EVEN,
        "effort": IntegratorSettings(max_bounces=2, sky_shadowing=False),
    },
    "many lamps": {
        **EVEN,
        "sky": None,
        "lamps": tuple(lamp((x, 0.5, 2), 2.0 + x, 0.1) for x in (-2.0, -1.0, 0.0, 1.5)),
    },
    "the sun and a glow around it": {
        **EVEN,
        "sky": glowing,
        "lamps": (),
        "discs": (disc_light((0.866, 0, 0.5)),),
    },
    "paths that chance ends": {
        **EVEN,
        "effort": IntegratorSettings(max_bounces=100, roulette_depth=1),
    },
    "glowing things alone, without bounces": {**DARK, "effort": IntegratorSettings(max_bounces=0)},
    "a glow by way of the ceiling": {**DARK, "effort": ONCE, "glow": UPWARDS, "ceiling": True},
    "glowing and glossy things": {**EVEN, "glow": SHINING, "gloss": True},
    "lamps close to a plate and half within a box": {
        **EVEN,
        "sky": None,
        "lamps": CLOSE,
        "close": [True, True],
        "rays": 32,
    },
    "a lamp close to something glossy": {
        **EVEN,
        "sky": None,
        "lamps": (lamp((0.0, -0.7, 0.54), 1.0, 0.04),),
        "gloss": True,
        "close": [True],
        "rays": 64,
    },
}


def crowded(case: dict) -> SpectralScene:
    """A box, a beam and a plate over a floor; the beam may be glossy, and they may glow."""
    gloss = Glossy(reflectance=grey(0.3), roughness=0.3) if case.get("gloss") else 0.3
    parts = [
        ("floor", "floor", plane(12, 12)),
        ("box", "box", at(box(1, 1, 1), 1.0, 0.8, 0.0)),
        ("beam", "beam", at(box(4, 0.3, 0.3), 0.0, -0.7, 0.6)),
        ("plate", "plate", at(plane(1, 1), -1.2, 0.6, 0.9)),
    ]
    if case.get("ceiling"):
        parts.append(("ceiling", "floor", inside_out(at(plane(12, 12), 0.0, 0.0, 2.0))))
    rho = {"floor": 0.5, "box": 0.7, "beam": gloss, "plate": 0.2}
    lights = {
        "sky": case["sky"],
        "lamps": case["lamps"],
        "discs": case.get("discs", ()),
        "glow": case.get("glow"),
    }
    return staged(parts, rho, **lights)


@pytest.mark.parametrize(("number", "name"), list(enumerate(CASES)))
def test_loops_find_what_batches_find(number, name, seed):
    """Light asked for in parts is gathered in batches: over 300 places the means agree to four
    standard errors.
    """
    case, known = CASES[name], (1.0, 0.4)[number % 2]
    stage, rng = crowded(case), np.random.default_rng(seed)
    if "close" in case:
        assert stage.beams.is_efficient.tolist() == case["close"]
    place = np.column_stack([rng.uniform(-2.0, 2.0, (300, 2)), np.zeros(300)])
    down, share = np.broadcast_to([0.0, 0.0, -1.0], place.shape), np.full(300, known, np.float32)
    points = stage.bsdfs.points(stage.surfaces, np.zeros(300, np.int64), place, down, share)
    found = np.array(
        [
            [
                outgoing_radiance.outgoing_radiance(
                    stage, points, case["effort"], rng, rays=case.get("rays", 16), split=split
                ).total()[:, 0]
                for split in (True, False)
            ]
            for _ in range(16)
        ],
        float,
    )
    apart = (found[:, 0] - found[:, 1]).mean(axis=1)
    mean, error = apart.mean(), apart.std(ddof=1) / np.sqrt(len(apart))
    assert abs(mean) < 4.0 * error
    assert error < 0.015 * found.mean()


def measured() -> MeasuredDistribution:
    azimuth, polar = np.array([0.0, 30.0, 90.0, 180.0]), np.array([0.0, 20.0, 50.0, 120.0])
    return MeasuredDistribution(
        polar_deg=polar,
        azimuth_deg=azimuth,
        candela=np.random.default_rng(1).uniform(1.0, 9.0, (4, 4)),
    )


@pytest.mark.parametrize(
    "distribution",
    [
        Isotropic(),
        Cosine(),
        SpotBeam(half_angle_deg=12.0),
        measured(),
        MeasuredDistribution(
            polar_deg=np.array([10.0, 40.0, 90.0]),
            azimuth_deg=np.zeros(1),
            candela=np.array([[5.0, 2.0, 1.0]]),
        ),
    ],
)
def test_loops_know_where_lamps_shine(distribution, seed):
    rng = np.random.default_rng(seed)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    way = rng.normal(size=(500, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    light = LampLight(
        name="lamp",
        position_m=np.zeros(3),
        radius_m=0.0,
        spectrum=np.ones(2, np.float32),
        distribution=distribution,
        frame=frame,
    )
    *_, axes, ends, tables = lamp_arrays((light, light), 2)
    found = [lamp_pattern(tables[ends[1] : ends[2]], axes[1], *towards) for towards in way]
    assert found == pytest.approx(light.per_sr(way), rel=1e-9, abs=1e-12)


# The glow around the sun is looked for by name: the same light as by gathering, without bright
# specks.


SUN = np.array([0.0, np.cos(0.6), np.sin(0.6)])
GLOSS = Glossy(reflectance=grey(0.3), roughness=0.3)
DOWN = np.array([0.0, 0.1, -1.0]) / np.hypot(0.1, 1.0)


def glow(way):
    """An even sky with a glow of some degrees that holds about half of all light: radiance falls as
    exp(-angle).
    """
    return np.ones((2, 1)) * (
        1.0 + 400.0 * np.exp(-np.arccos(np.clip(way @ SUN, -1.0, 1.0)) / 0.04)
    )


def without(stage: SpectralScene) -> SpectralScene:
    """The same stage whose bright sky is found by gathering alone."""
    lighting = replace(stage.lighting)
    lighting.__dict__["bright_sky"] = None
    return replace(stage, lighting=lighting)


def seen(
    stage: SpectralScene,
    count: int,
    seed: int,
    sky_control_fraction: float,
    effort: IntegratorSettings,
):
    origin = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
    share = np.full(count, sky_control_fraction, np.float32)
    found = radiance_along(
        stage,
        origin,
        np.broadcast_to(DOWN, (count, 3)),
        effort,
        np.random.default_rng(seed),
        gather_rays=2,
        sky_control_fraction=share,
    )
    return found.total()[:, 0].astype(float)


def wall(y: float):
    """A wall 2 m high that hides the glow from the north, and mirrors light from the south."""
    return at(upright(plane(30, 2)), 0, y, 1.0)


@pytest.mark.parametrize(
    ("floor", "y", "known", "bounces", "gain"),
    [
        (0.5, 1.0, 1.0, 0, 3.0),
        (0.5, 4.0, 0.3, 0, 3.0),
        (0.5, -1.0, 0.3, 1, 3.0),
        (GLOSS, 4.0, 1.0, 0, 3.0),
        (GLOSS, 1.0, 1.0, 1, 0.8),
    ],
    ids=[
        "hidden from diffuse ground",
        "on diffuse ground",
        "on a wall behind",
        "in a gloss",
        "hidden from a gloss",
    ],
)
def test_light_of_a_glow_is_that_found_by_gathering_with_less_chance(
    seed, floor, y, known, bounces, gain
):
    parts = [
        ("floor", "floor", plane(60, 60)),
        ("wall", "wall", wall(y) if y > 0 else inside_out(wall(y))),
    ]
    stage = staged(parts, {"floor": floor, "wall": 0.5}, sky=glow)
    effort = IntegratorSettings(max_bounces=bounces)
    by_name = seen(stage, 6_000, seed, known, effort)
    gathered = seen(without(stage), 24_000, seed + 100, known, effort)
    error = np.hypot(by_name.std() / np.sqrt(len(by_name)), gathered.std() / np.sqrt(len(gathered)))
    assert abs(by_name.mean() - gathered.mean()) < 3.5 * error
    assert error < 0.08 * gathered.mean()

    assert gathered.std() > gain * by_name.std()


def test_directions_are_drawn_with_the_density_stated(seed):
    bright = SkyImportance.of(environment_map.environment_map(glow))
    assert bright is not None
    rng = np.random.default_rng(seed)
    way = bright.draw(40_000, rng)
    assert np.linalg.norm(way, axis=1) == pytest.approx(1.0)
    # The mean of one over the density is the solid angle drawn from; the density adds up to one.
    inverse = 1.0 / bright.density(way)
    assert abs(inverse.mean() - 2.0 * np.pi) < 4.0 * inverse.std() / np.sqrt(len(inverse))
    even = np.column_stack([rng.normal(size=(100_000, 3))])
    even /= np.linalg.norm(even, axis=1, keepdims=True)
    found = 4.0 * np.pi * bright.density(even)
    assert abs(found.mean() - 1.0) < 4.0 * found.std() / np.sqrt(len(found))
    assert np.mean(way @ SUN > np.cos(0.2)) > 0.3, "so much of the light is close to the sun"


def test_an_even_sky_costs_no_further_rays():
    assert SkyImportance.of(environment_map.environment_map(UNIFORM)) is None
    assert SkyImportance.of(environment_map.environment_map(OVERCAST)) is None


# Rays go where single ones differ, as many as the picture's error needs and no more; influences
# are free of specks.


SHAPE = (32, 96)
LEFT = np.broadcast_to(np.arange(SHAPE[1]) < SHAPE[1] // 2, SHAPE)
GROUPS = (LEFT, ~LEFT)


def sent_for(variance, allowed, max_rays=100_000, total=np.inf):
    """Rays of pixels whose single rays have a variance, turn by turn, and the number of turns."""
    sent, turns = np.full(SHAPE, 8, np.int64), 0
    while (more := additional_rays(variance / sent / allowed, sent, GROUPS, max_rays, total)).any():
        assert (more <= integrator_settings.LIMITS.max_growth * sent).all(), (
            "few rays are not trusted for many times as many"
        )
        sent, turns = sent + more, turns + 1
    return sent, turns


def test_rays_are_as_the_root_of_the_variance_and_bring_its_mean_to_what_is_allowed():
    variance = np.where(LEFT, 0.1, 40.0)
    sent, turns = sent_for(variance, 0.01)
    assert 1 < turns < 8
    assert 0.4 < np.mean(variance / sent) / 0.01 < 1.1
    assert 10.0 < sent[~LEFT].mean() / sent[LEFT].mean() < 40.0, "as the root, in powers of two"
    assert sent.mean() < 0.75 * np.mean(variance) / 0.01, (
        "the same error by as many rays everywhere costs more"
    )


def test_a_pixel_that_met_nothing_bright_goes_on_with_those_around_it_that_did():
    met = np.where(np.random.default_rng(4).random(SHAPE) < 0.1, 100.0, 0.0)
    more = additional_rays(np.where(LEFT, met, 0.0), np.full(SHAPE, 64), GROUPS, 100_000)
    assert (more[LEFT] > 0).mean() > 0.95
    assert not more[~LEFT].any(), "nor do those of another group"


def test_no_limit_is_broken_for_the_errors_sake():
    assert sent_for(np.ones(SHAPE), 1e-6, max_rays=64)[0].max() <= 64
    assert sent_for(np.ones(SHAPE), 1e-6, total=64 * LEFT.size)[0].sum() < 1.5 * 64 * LEFT.size
    assert not additional_rays(np.full(SHAPE, 0.9), np.full(SHAPE, 8), GROUPS, 64).any(), (
        "what is good is left alone"
    )


def test_differences_are_weighed_by_noise_or_by_a_share_of_the_signal():
    eye = RenderSensor(
        response_nm=(500.0,), response=(1.0,), dark_variance=4.0, variance_per_signal=3.0
    )
    assert eye.noise_floor(0.0) == 2.0
    assert eye.noise_floor(20.0) == pytest.approx(8.0)
    assert eye.noise_floor(1e6) == pytest.approx(integrator_settings.KNOWN * 1e6)
    blurred = replace(eye, noise_averaging_factor=0.3)
    assert blurred.noise_floor(20.0) == eye.noise_floor(20.0), (
        "blur evens what differs by chance like the noise"
    )
    assert blurred.noise_floor(20.0, smooth=True) == pytest.approx(0.3 * 8.0)
    assert blurred.noise_floor(1e6, smooth=True) == pytest.approx(integrator_settings.KNOWN * 1e6)


def test_the_influence_of_a_part_is_its_size_where_it_is_largest_and_specks_have_none():
    shape, rng = (40, 40), np.random.default_rng(6)
    part = np.zeros(shape)
    part[
        : shape[0] // render_settings.RENDER_LIMITS.regions,
        : shape[1] // render_settings.RENDER_LIMITS.regions,
    ] = 0.3
    twice = np.repeat(part.reshape(-1, 1), 2, axis=1)
    assert render_settings._influence(twice, shape) == pytest.approx(0.3)
    # Each ray in a hundred is a speck of 10: the mean of two rays makes 0.7 of that, their product
    # rarely anything.
    many = [np.where(rng.random((1600, 2)) < 0.01, 10.0, 0.0) - 0.1 for _ in range(15)]
    assert np.median(
        [render_settings._influence(twice + specks, shape) for specks in many]
    ) == pytest.approx(0.3, abs=0.15)
    assert np.median([np.sqrt(np.mean(specks.mean(axis=1) ** 2)) for specks in many]) > 0.6
