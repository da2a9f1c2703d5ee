"""Rules of the literature against exact forms: the guided filter at every pixel, and opponent
colours in 8 bits.
"""

from dataclasses import replace

import numpy as np
import pytest
from skimage import data

from charact.frames.noise_law import NoiseLaw
from charact.fusion import Band, fuse, rules
from tests.truth.fusion import Pair, bands_of, gaussian


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
