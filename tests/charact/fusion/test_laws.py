"""Laws of fusion rules: equal bands, infinite noise, scale of the noise, its correlation, and a
band of noise alone.
"""

from dataclasses import replace

import numpy as np
import pytest

from charact.frames.noise_law import NoiseLaw
from charact.fusion import COLOURED, Band, display_planes, fuse, fuse_levels
from charact.method import chart_table
from tests.truth.fusion import Pair, gaussian

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
