"""Laws of a fused picture: nothing lost, damage named, colours of the table, rules of the
operator.
"""

from dataclasses import replace

import numpy as np
import pytest
from skimage import data

from charact.frames.noise_law import NoiseLaw
from charact.fusion import (
    COLOURED,
    Band,
    ColourTable,
    display_planes,
    fuse,
    fuse_by_table,
    fuse_levels,
    make_colour_table,
    rules,
)
from charact.method import chart_table
from labdata import BadInput
from tests.truth.fusion import Pair, bands_of, gaussian

# Laws of fusion rules: equal bands, infinite noise, scale of the noise, its correlation, and a
# band of noise alone.


GREY = ("weighted", "pca", "laplacian", "guided-filter", "inverse-noise")
SHAPE = (96, 128)


def band(name: str, image: np.ndarray, read_dn: float = 1.0, **fields) -> Band:
    return Band(name=name, image=image, noise=NoiseLaw(gain_dn=0.0, read_dn=read_dn), **fields)


@pytest.fixture
def scene() -> np.ndarray:
    return 10.0 * gaussian(np.random.default_rng(0).normal(size=SHAPE), 3.0)


@pytest.mark.parametrize("method", [*GREY, "noise-aware"])
def test_equal_bands_are_returned_by_noise_aware_fusion_if_they_have_no_noise(method, scene):
    read_dn, off = (1e-4, 1e-3) if method == "noise-aware" else (1.0, 1e-4)
    found = fuse([band(name, scene, read_dn) for name in "ab"], method=method, registered=True)
    low, high = found.spans["a"]
    assert np.abs(found.picture - (scene - low) / (high - low)).max() < off


@pytest.mark.parametrize("noisy", [0, 1])
def test_details_of_a_band_of_infinite_noise_have_no_weight(noisy: int, scene) -> None:
    other = 10.0 * gaussian(np.random.default_rng(1).normal(size=SHAPE), 3.0)
    sds = [1e6 if number == noisy else 1e-3 for number in range(2)]
    planes = display_planes([band("a", scene, sds[0]), band("b", other, sds[1])], bloom=True)
    _, weights, _ = fuse_levels(planes)
    assert max(float(np.max(one)) for one in weights[noisy][:-1]) < 1e-6
    assert min(float(np.min(one)) for one in weights[1 - noisy][:-1]) > 0.99


def test_a_band_that_is_clipped_everywhere_leaves_the_other_and_is_flagged(scene) -> None:
    white = band("visible", np.full(SHAPE, 245.0) + np.arange(128) % 2 * 1e-3, clip=245.0)
    found = fuse(
        [white, band("thermal", scene)], method="noise-aware", spans={"visible": (0.0, 245.0)}
    )
    assert "clipped" in found.measurements[0].flags
    assert np.corrcoef(found.picture.ravel(), scene.ravel())[0, 1] > 0.95
    assert (found.share[1] > 0.8).all()


def test_noise_power_scales_the_deviation_and_not_the_weights_of_detection() -> None:
    images = np.random.default_rng(2).normal(size=(2, *SHAPE))
    one, four = (
        fuse(
            [band("a", images[0], sd), band("b", images[1], 2.0 * sd)],
            method="inverse-noise",
            registered=True,
        )
        for sd in (1.0, 2.0)
    )
    assert np.abs(one.picture - four.picture).max() < 1e-5
    assert four.sd == pytest.approx(2.0 * one.sd, rel=1e-4)


def test_weights_follow_the_noise_power_of_objects_not_the_variance_of_a_pixel(scene) -> None:
    pixel_sd = 2.0
    blurred = NoiseLaw(gain_dn=1.0, read_dn=0.0, blur_px=1.0)
    bright = scene - scene.min() + 5.0
    hidden = Band(name="a", image=bright, noise=blurred)
    planes = display_planes([hidden, band("b", scene, pixel_sd)], bloom=True)
    white = display_planes(
        [replace(hidden, noise=replace(blurred, blur_px=0.0)), band("b", scene, pixel_sd)],
        bloom=True,
    )
    pixel = planes[0].gains[0].pixel
    assert pixel == pytest.approx(1.0 / (4.0 * np.pi * 1.0**2), rel=0.01)
    # At object scale the power is that of white noise; the variance of a pixel would be 1/S times
    # lower.
    assert planes[0].variance(3) == pytest.approx(white[0].variance(3), rel=0.1)
    assert np.mean(planes[0].pixel_variance / white[0].pixel_variance) == pytest.approx(
        pixel, rel=1e-3
    )


def test_exchanged_bands_give_the_same_grey_picture_and_exchanged_colours(scene) -> None:
    other = 10.0 * gaussian(np.random.default_rng(1).normal(size=SHAPE), 3.0)
    bands = [band("a", scene), band("b", other)]
    first, second = (
        fuse(order, method="noise-aware", registered=True) for order in (bands, bands[::-1])
    )
    assert np.abs(first.picture - second.picture).max() < 1e-5
    first, second = (fuse(order, colour=True, registered=True) for order in (bands, bands[::-1]))
    assert np.array_equal(first.picture[..., 0], second.picture[..., 1])


def test_a_third_band_of_noise_costs_little(pair: Pair, redraw) -> None:
    rng = np.random.default_rng(5)
    mask = pair.objects[0][2] > 0.5
    outputs = {2: [], 3: []}
    absent = Pair(seed=pair.seed, visible_pe=0.0, thermal_k=0.0)
    for _ in range(16):
        for sign, scene in ((1.0, pair), (-1.0, absent)):
            bands = redraw(scene, rng)
            noise = band("third", rng.normal(size=bands[0].image.shape))
            for count, own in ((2, bands), (3, [*bands, noise])):
                picture = fuse(own, method="noise-aware", registered=True).picture
                contrast = picture[mask].mean() - picture[pair.disc(28, 160, 14) > 0.5].mean()
                outputs[count].append((sign, contrast))
    values = {count: np.array(one) for count, one in outputs.items()}
    d = {}
    for count, one in values.items():
        present, missing = one[one[:, 0] > 0, 1], one[one[:, 0] < 0, 1]
        d[count] = (present.mean() - missing.mean()) / np.sqrt(
            0.5 * (present.var(ddof=1) + missing.var(ddof=1))
        )
    # The same frames: the difference of both d' has a far smaller error than either.
    assert d[3] >= 0.98 * d[2]


def test_spans_hold_over_a_sequence(scene) -> None:
    bands = [band("a", scene), band("b", scene + 1.0)]
    first = fuse(bands, registered=True)
    brighter = [replace(one, image=one.image + 3.0) for one in bands]
    held = fuse(brighter, spans=first.spans, registered=True)
    low, high = first.spans["a"]
    assert np.median(held.picture - first.picture) == pytest.approx(3.0 / (high - low), rel=1e-3)


def test_auto_takes_the_quickest_method_that_meets_the_tolerance(scene) -> None:
    rows = {row["method"]: row for row in chart_table("fusion_error")}
    bands = [band("a", scene), band("b", scene)]
    grey = {name: row for name, row in rows.items() if name not in COLOURED}
    loose = max(row["error_limit_percent"] for row in grey.values())
    quickest = min(grey.values(), key=lambda row: row["seconds"])["method"]
    found = fuse(bands, registered=True, within_percent=loose).measurements[0].method
    assert found == quickest
    best = min(grey.values(), key=lambda row: row["error_percent"])["method"]
    assert fuse(bands, registered=True).measurements[0].method == best == "noise-aware"
    assert fuse(bands, registered=True, colour=True).measurements[0].method == "noise-aware-colour"


# A hundred damaged cases: each is flagged or refused; sound ones are not.


SEEDS = range(1, 8)


@pytest.fixture(scope="module")
def sound() -> dict[int, tuple]:
    """Bands with walls that both see, without lamps and so without a map, by seed."""
    found = {}
    for seed in SEEDS:
        pair = Pair(seed=seed, buildings=2.0, lamp_pe=0.0, flood_pe=0.0)
        found[seed] = bands_of(pair, pair.frames(np.random.default_rng(seed)), with_map=False)
    return found


def is_caught(damage, bands) -> bool:
    """Whether damaged bands are refused or their picture is flagged."""
    try:
        return fuse(damage(*bands)).measurements[0].status == "suspect"
    except BadInput:
        return True


def shifted(band, rows: int, cols: int):
    return replace(band, image=np.roll(band.image, (rows, cols), axis=(0, 1)))


def with_pixel(band, value: float):
    image = band.image.copy()
    image[20, 30] = value
    return replace(band, image=image)


DAMAGES = {
    "shift of 2 columns": lambda v, t: (v, shifted(t, 0, 2)),
    "shift of 2 rows": lambda v, t: (v, shifted(t, -2, 0)),
    "shift of 4": lambda v, t: (v, shifted(t, 3, 3)),
    "unknown gain": lambda v, t: (replace(v, noise=None), t),
    "gain of twice": lambda v, t: (
        replace(v, noise=replace(v.noise, gain_dn=2.0 * v.noise.gain_dn)),
        t,
    ),
    "gain of half": lambda v, t: (
        replace(v, noise=replace(v.noise, gain_dn=0.5 * v.noise.gain_dn)),
        t,
    ),
    "wrong NETD": lambda v, t: (v, replace(t, noise=NoiseLaw(gain_dn=0.0, read_dn=0.1))),
    "unequal sizes": lambda v, t: (v, replace(t, image=t.image[:-1])),
    "one name": lambda v, t: (v, replace(t, name=v.name)),
    "gain of 4 times": lambda v, t: (
        replace(v, noise=replace(v.noise, gain_dn=4.0 * v.noise.gain_dn)),
        t,
    ),
    "a missing pixel": lambda v, t: (with_pixel(v, np.nan), t),
    "an infinite pixel": lambda v, t: (v, with_pixel(t, np.inf)),
    "another size": lambda v, t: (replace(v, image=v.image[:, 8:]), t),
    "a dark level of 20 DN too little": lambda v, t: (replace(v, image=v.image - 20.0), t),
    "a tenth clipped": lambda v, t: (
        replace(v, image=np.where(np.arange(320) < 40, v.clip, v.image)),
        t,
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_pair_is_flagged_or_refused(sound, damage: str) -> None:
    missed = [seed for seed, bands in sound.items() if not is_caught(DAMAGES[damage], bands)]
    assert not missed


def test_a_sound_pair_is_not_flagged(sound) -> None:
    flags = {seed: fuse(bands).measurements[0].flags for seed, bands in sound.items()}
    assert not any(flags.values()), flags


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        *(
            (
                lambda pair, _, value=value: bands_of(
                    pair, (np.full((240, 320), value), np.zeros((240, 320))), with_map=False
                ),
                "every pixel must be finite",
            )
            for value in (np.nan, np.inf)
        ),
        (lambda _, bands: fuse(bands[:1]), "two bands or more"),
        (lambda _, bands: fuse(bands, spans={"visible": (3.0, 3.0)}), "wider than 0"),
        (lambda _, bands: fuse(bands, spans={"red": (0.0, 3.0)}), "one of the bands"),
    ],
)
def test_values_bands_and_spans_that_cannot_be_are_refused(pair, bands, make, rule) -> None:
    with pytest.raises(BadInput, match=rule):
        make(pair, bands)


# Rules of the literature against exact forms: the guided filter at every pixel, and opponent
# colours in 8 bits.


def exact_guided_filter(guide, image, radius: int, regularisation: float, *_) -> np.ndarray:
    """Filter of He, Sun and Tang (ECCV 2010) in float64: means over windows of the mirrored frame,
    by its sums.
    """

    def mean(values: np.ndarray) -> np.ndarray:
        for _ in range(2):
            padded = np.pad(values, ((radius, radius), (0, 0)), mode="reflect")
            sums = np.cumsum(np.pad(padded, ((1, 0), (0, 0))), axis=0)
            values = ((sums[2 * radius + 1 :] - sums[: len(values)]) / (2 * radius + 1)).T
        return values

    g, p = guide.astype(float), image.astype(float)
    slope = (mean(g * p) - mean(g) * mean(p)) / (mean(g * g) - mean(g) ** 2 + regularisation)
    offset = mean(p) - slope * mean(g)
    return (mean(slope) * g + mean(offset)).astype(np.float32)


def photographed(name: str) -> tuple[Band, Band]:
    """A photograph and its blurred negative, with noise."""
    photo, rng, law = (
        getattr(data, name)().astype(float),
        np.random.default_rng(0),
        NoiseLaw(gain_dn=0.0, read_dn=3.0),
    )
    images = [
        one + 3.0 * rng.normal(size=photo.shape) for one in (photo, gaussian(255.0 - photo, 3.0))
    ]
    return Band(name="a", image=images[0], noise=law, clip=255.0), Band(
        name="b", image=images[1], noise=law
    )


def textured(seed: int) -> tuple[Band, Band]:
    pair = Pair(seed=seed, buildings=1.5)
    return bands_of(pair, pair.frames(np.random.default_rng(seed)), with_map=False)


@pytest.mark.parametrize(
    "bands",
    [textured(1), textured(2), photographed("camera"), photographed("coins")],
    ids=["pair 1", "pair 2", "camera", "coins"],
)
def test_guided_filter_fusion_is_that_of_the_exact_filter(bands, monkeypatch) -> None:
    """Rms of 1 % of the span: two and a half codes of 8 bits, below the noise of any band here (2
    to 20 %).

    Windows of the base are 92 px of blocks of 4 instead of 91: the largest difference is where its
    weights are steep.
    """
    found = rules.fuse_guided(bands, uncertainty=False).picture
    monkeypatch.setattr(rules, "guided_filter", exact_guided_filter)
    left = found - rules.fuse_guided(bands, uncertainty=False).picture
    rms, largest = np.sqrt(np.mean(left**2)), np.abs(left).max()
    assert rms <= 0.01 and largest <= 0.04


def test_opponent_colours_fill_the_range_of_8_bits(pair, bands) -> None:
    found = fuse(bands, method="opponent", registered=True)
    # Two percentiles at the ends leave 1 % of the pixels of each colour at 0 and 255.
    assert (found.codes.std(axis=(0, 1)) > 25.0).all() and 255.0 * found.picture.std(
        axis=(0, 1)
    ).max() < 10.0
    assert np.mean((found.codes == 0) | (found.codes == 255), axis=(0, 1)) == pytest.approx(
        0.012, abs=0.004
    )
    order = np.argsort(found.picture[..., 1].ravel())
    assert (np.diff(found.codes[..., 1].ravel()[order].astype(int)) >= 0).all()


@pytest.mark.parametrize(
    "method", ["weighted", "pca", "laplacian", "guided-filter", "inverse-noise", "opponent"]
)
def test_a_deviation_by_a_wrong_noise_law_is_flagged(method: str) -> None:
    visible, thermal = textured(1)
    assert fuse((visible, thermal), method=method, registered=True).measurements[0].status == "ok"
    described = visible.noise
    assert described is not None
    for ratio, flag in ((None, "uncalibrated"), (0.25, "model-misfit"), (4.0, "model-misfit")):
        law = None if ratio is None else replace(described, gain_dn=ratio * described.gain_dn)
        wrong = fuse((replace(visible, noise=law), thermal), method=method, registered=True)
        assert flag in wrong.measurements[0].flags, ratio


# Colours by a table: materials have the colour of daylight, whatever the noise, and the deviation
# is stated.


# Number of a material: daylight colour, visible and thermal level.
GRASS, ROAD, WALL = 1, 2, 5
COLOURS = {GRASS: (0.2, 0.5, 0.1), ROAD: (0.4, 0.4, 0.45), WALL: (0.7, 0.5, 0.3)}
LEVELS = {GRASS: (40.0, 280.0), ROAD: (20.0, 290.0), WALL: (60.0, 295.0)}
ALIKE = {GRASS: (40.0, 285.0), ROAD: (36.0, 284.5), WALL: (60.0, 295.0)}


@pytest.fixture
def materials() -> np.ndarray:
    out = np.full(SHAPE, GRASS)
    out[:, 40:80] = ROAD
    out[20:70, 90:120] = WALL
    return out


def material_bands(
    materials: np.ndarray, rng: np.random.Generator, sd: float, levels=LEVELS
) -> list[Band]:
    images = [np.vectorize(lambda number, k=k: levels[number][k])(materials) for k in range(2)]
    laws = [NoiseLaw(gain_dn=0.0, read_dn=max(scale * sd, 1e-3)) for scale in (4.0, 1.0)]
    return [
        Band(name=name, image=image + law.read_dn * rng.normal(size=SHAPE), noise=law)
        for name, image, law in zip(("visible", "thermal"), images, laws, strict=True)
    ]


def test_materials_have_their_daylight_colour(materials, tmp_path) -> None:
    rng = np.random.default_rng(0)
    make_colour_table(material_bands(materials, rng, 0.0), materials, COLOURS).save(
        tmp_path / "table.npz"
    )
    table = ColourTable.load(tmp_path / "table.npz")
    noisy = material_bands(materials, rng, 1.0)
    found = fuse_by_table(noisy, table)
    for number, colour in COLOURS.items():
        assert found.picture[materials == number].mean(axis=0) == pytest.approx(colour, abs=0.05)
    assert found.share.sum(axis=0) == pytest.approx(1.0, abs=1e-5)


def test_the_deviation_is_no_less_than_that_of_repeated_frames(materials) -> None:
    rng = np.random.default_rng(1)
    table = make_colour_table(material_bands(materials, rng, 0.0, ALIKE), materials, COLOURS)
    found = [fuse_by_table(material_bands(materials, rng, 1.0, ALIKE), table) for _ in range(12)]
    spread = np.stack([one.picture for one in found]).std(axis=0, ddof=1)
    ratio = spread.mean() / np.mean([one.sd for one in found])
    # Colours are taken around noisy values instead of true ones: the stated deviation is up to
    # twice too large.
    assert 0.4 < ratio < 1.1 and spread.mean() > 0.01


def test_a_table_that_does_not_fit_is_refused(materials, tmp_path) -> None:
    rng = np.random.default_rng(2)
    bands = material_bands(materials, rng, 0.0)
    with pytest.raises(BadInput, match="got none"):
        make_colour_table(bands, materials, {9: (0.0, 0.0, 0.0)})
    with pytest.raises(BadInput, match="of two bands"):
        fuse_by_table(bands[:1], make_colour_table(bands, materials, COLOURS))
    with pytest.raises(BadInput, match="of colours and spans"):
        ColourTable.load(tmp_path / "absent.npz")
