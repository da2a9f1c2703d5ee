"""Blooming in a pixel is the light that entered farther away: against pictures whose parts are
known exactly.
"""

import numpy as np
import pytest

from charact.estimators.bloom import PosteriorPsf, bloom_map
from tests.truth.bloom import noiseless_frame, stack
from tests.truth.bloom_light import GLARE_SIDE_PX, BloomScene, radial_light

CLIP_DN = 243.0


def spread_of_scene(
    scene: BloomScene, rng: np.random.Generator, *, sd: float = 0.01, draws: int = 8
) -> PosteriorPsf:
    """The scene's own spread as a posterior knows it: diameter to so much, the halo's share to
    three times that.
    """

    def about(value: float, share: float) -> np.ndarray:
        return value * np.exp(share * rng.standard_normal(draws))

    return PosteriorPsf(
        halo_diameter_px=about(scene.halo_diameter_px, sd),
        elastic_share=np.full(draws, scene.halo_elastic_share),
        halo_fraction=about(scene.halo_fraction, 3 * sd),
        core_frequency_cy_per_px=np.full(draws, np.inf),
        core_exponent=np.full(draws, 1.2),
        core_spread_px2=np.full(draws, scene.core_sigma_px**2),
        wing_share=scene.wing_share,
        wing_radius_px=scene.wing_radius_px,
        wing_exponent=scene.wing_exponent,
        glare_fraction=scene.glare_fraction,
        glare_area_px=GLARE_SIDE_PX**2 / scene.row_pitch,
    )


def near_share(scene: BloomScene) -> float:
    """Share of a point's light that lands within `NEAR_PX`."""
    radius = np.arange(0.005, bloom_map.NEAR_PX, 0.01)
    return float((2 * np.pi * radius * 0.01 * radial_light(scene, radius)).sum())


def parts(scene: BloomScene, overload: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All light, the share of it that belongs elsewhere, and the distance from the source, of every
    pixel.
    """
    light = noiseless_frame(scene, overload) - scene.dark_dn
    row, col = scene.centre
    down = (np.arange(scene.rows) - row)[:, None] * scene.row_pitch
    distance = np.hypot(down, (np.arange(scene.cols) - col)[None, :])
    glare = scene.row_pitch * scene.source_dn(overload) * scene.glare_fraction / GLARE_SIDE_PX**2
    of_source = np.where(distance > bloom_map.NEAR_PX, light - scene.background_dn, glare)
    # The even background comes from everywhere alike; glare is that of the source alone.
    far = of_source + scene.background_dn * (1 - near_share(scene) / (1 - scene.glare_fraction))
    return light, far / light, distance


def compared(found, truth, distance):
    """Errors in standard deviations where something is said, away from the step at `NEAR_PX` and
    from the border.
    """
    where = (
        np.isfinite(found.fraction)
        & (np.abs(distance - bloom_map.NEAR_PX) > 1.0)
        & ~found.near_border
    )
    return ((found.fraction - truth) / found.sd)[where], (found.fraction - truth)[where]


@pytest.mark.parametrize("overload", [0.5, 200.0])
@pytest.mark.parametrize(
    "scene",
    [
        BloomScene(),
        BloomScene(wing_share=0.2, post_gain_sigma_px=0.0),
        BloomScene(glare_fraction=0.05),
        BloomScene(row_pitch=13 / 11),
    ],
    ids=["plain", "wing", "glare", "row-pitch"],
)
def test_the_share_of_a_point_source_is_its_light_beyond_the_near(scene, overload, seed):
    """Means over draws about the truth err by the draws' scatter over the root of their number, and
    by what is rounded.

    Pixels round off the steps of the share, at `NEAR_PX` and at the halo's edge: .009 over the
    frame, root mean square.
    """
    rng = np.random.default_rng(seed)
    draws, diameter_sd = 30, 0.01
    light, truth, distance = parts(scene, overload)
    clipped = np.minimum(light, CLIP_DN)
    spread = spread_of_scene(scene, rng, sd=diameter_sd, draws=draws)
    found = bloom_map.bloom_map(
        clipped, spread, clip_dn=CLIP_DN, pitch_ratio=scene.row_pitch, noise_dn=0.05, rng=rng
    )
    pull, error = compared(found, truth, distance)
    assert not found.unknown.any()
    assert np.sqrt(np.mean(error**2)) < 0.009 + 4.5 * np.sqrt(np.mean(found.sd**2) / draws)
    assert np.quantile(np.abs(pull), 0.99) < 6.0
    for source in found.sources:
        # A frame tells the halo's light, whatever share of the source's a draw takes it for: it
        # goes with the square of the diameter at most, and the fit's own noise is under a
        # twohundredth.
        of_halo = source.light_dn_px * spread.halo_fraction
        true_dn_px = scene.source_dn(overload) * (1.0 - scene.glare_fraction) * scene.halo_fraction
        error = np.hypot(2.0 * diameter_sd, 0.005) / np.sqrt(draws)
        assert abs(of_halo.mean() / true_dn_px - 1.0) < 4.5 * error


def test_standard_deviations_hold_the_noise_of_the_frame(seed):
    scene = BloomScene()
    rng = np.random.default_rng(seed)
    for overload in (0.5, 200.0):
        _, truth, distance = parts(scene, overload)
        frames = stack(scene, overload, rng).data
        found = bloom_map.bloom_map(
            frames.mean(axis=0) - scene.dark_dn,
            spread_of_scene(scene, rng),
            clip_dn=CLIP_DN,
            clipped=(frames >= scene.full_scale_dn).mean(axis=0) > 0.1,
            rng=rng,
        )
        pull, _ = compared(found, truth, distance)
        assert 0.7 < np.sqrt(np.mean(pull**2)) < 1.4


def test_a_halo_that_is_clipped_all_over_tells_nothing_and_says_so(seed):
    rng = np.random.default_rng(seed)
    for scene in (
        BloomScene(),
        BloomScene(wing_share=0.2, post_gain_sigma_px=0.0),
        BloomScene(glare_fraction=0.05),
    ):
        light, truth, distance = parts(scene, 5e4)
        found = bloom_map.bloom_map(
            np.minimum(light, CLIP_DN),
            spread_of_scene(scene, rng),
            clip_dn=CLIP_DN,
            noise_dn=0.2,
            rng=rng,
        )
        assert "halo is clipped" in found.sources[0].reason
        assert found.unknown[distance < 0.5 * scene.halo_diameter_px].all()
        assert np.all(np.abs(found.fraction - truth)[~found.unknown & ~found.near_border] < 0.06)


def test_two_halos_that_overlap_are_each_told(seed):
    rng = np.random.default_rng(seed)
    one = BloomScene(rows=170, cols=220, row=80.0, col=80.0)
    other = BloomScene(rows=170, cols=220, row=90.0, col=122.0)
    levels = (2000.0, 300.0)
    light = sum(
        noiseless_frame(scene, level) - scene.dark_dn
        for scene, level in zip((one, other), levels, strict=True)
    )
    found = bloom_map.bloom_map(
        np.minimum(light, CLIP_DN),
        spread_of_scene(one, rng, sd=0.002),
        clip_dn=CLIP_DN,
        noise_dn=0.05,
        rng=rng,
    )
    told = sorted(float(np.median(source.light_dn_px)) for source in found.sources)
    assert told == pytest.approx([one.source_dn(level) for level in sorted(levels)], rel=0.06)


def laid(image: np.ndarray, scene: BloomScene, *, beyond_px: float = -1.0) -> np.ndarray:
    """A picture through the scene's spread by plain sums, or the part of it that lands farther than
    a distance.
    """
    from scipy.signal import fftconvolve

    reach = 70
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    radius = np.hypot(y, x)
    kernel = np.interp(radius, table := np.arange(0.0, 120.0, 0.05), radial_light(scene, table))
    return fftconvolve(image, np.where(radius > beyond_px, kernel, 0.0), mode="same")


def test_a_lit_door_is_a_patch_and_the_halo_beside_it_blooming(seed):
    rng = np.random.default_rng(seed)
    scene = BloomScene(rows=170, cols=200)
    world = np.full((scene.rows, scene.cols), 4.0)
    world[50:110, 80:110] = 900.0
    light, far = laid(world, scene), laid(world, scene, beyond_px=bloom_map.NEAR_PX)
    found = bloom_map.bloom_map(
        np.minimum(light, CLIP_DN),
        spread_of_scene(scene, rng, sd=0.003),
        clip_dn=CLIP_DN,
        noise_dn=0.1,
        rng=rng,
    )
    assert [source.shape for source in found.sources] == ["patch"]
    beside = (slice(60, 100), slice(118, 128))
    assert np.abs(found.fraction - far / light)[beside].max() < 0.05
    assert np.median(found.sources[0].light_dn_px) == pytest.approx(896.0 * 60 * 30, rel=0.1)


def test_a_source_at_the_border_is_not_guessed(seed):
    rng = np.random.default_rng(seed)
    scene = BloomScene(row=1.0)
    light = np.minimum(noiseless_frame(scene, 300.0) - scene.dark_dn, CLIP_DN)
    found = bloom_map.bloom_map(
        light, spread_of_scene(scene, rng), clip_dn=CLIP_DN, noise_dn=0.2, rng=rng
    )
    assert "border" in found.sources[0].reason
    assert np.isnan(found.fraction[5, round(scene.centre[1])])


def test_noise_is_found_where_blur_ties_neighbours(seed):
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(np.random.default_rng(seed).normal(0.0, 1.0, (200, 240)), 1.0)
    assert np.median(bloom_map.pixel_noise(40.0 + noise)) == pytest.approx(noise.std(), rel=0.1)
