"""No-reference scores against formulas written out, scikit-image and scipy."""

import math

import numpy as np
import pytest
from scipy.signal import convolve2d, correlate2d
from skimage.metrics import structural_similarity

from charact.fusion import score, scores
from labdata import BadInput

SHAPE = (37, 45)  # odd, and no multiple of the blocks of 16 px


@pytest.fixture(scope="module")
def pictures():
    """Visible, thermal and fused grey pictures with structure of unlike contrast; part of the fused
    one is a copy.
    """
    rng = np.random.default_rng(7)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    visible = 90 + 60 * np.sin(x / 4.0) + 30 * (y > 20) + rng.normal(0, 6, SHAPE)
    thermal = (
        120
        - 70 * ((x - 25) ** 2 + (y - 15) ** 2 < 80)
        + 20 * np.cos(y / 5.0)
        + rng.normal(0, 4, SHAPE)
    )
    visible, thermal = (
        np.clip(np.round(one), 0, 255).astype(np.uint8) for one in (visible, thermal)
    )
    fused = np.round(0.5 * visible + 0.5 * thermal).astype(np.uint8)
    fused[:, 30:] = visible[:, 30:]
    return visible, thermal, fused


def values(*three):
    return {row.quantity: row.value for row in score(*three, rng=np.random.default_rng(1))}


def test_entropies_are_sums_over_the_codes(pictures):
    counts = [[int(np.sum(one == code)) / one.size for code in range(256)] for one in pictures]
    entropy = -sum(p * math.log2(p) for p in counts[2] if p > 0)
    # Codes count that occur in both pictures alone.
    cross = sum(
        p * math.log2(p / q)
        for band in counts[:2]
        for p, q in zip(band, counts[2], strict=True)
        if p > 0 and q > 0
    )
    found = values(*pictures)
    assert found["entropy"] == pytest.approx(entropy, rel=1e-12)
    assert found["cross_entropy"] == pytest.approx(cross / 2, rel=1e-12)


def stretched(one):
    low, high = float(one.min()), float(one.max())
    return np.floor((one - low) / (high - low) * 255 + 0.5)


def test_mutual_information_is_in_nats_of_pictures_stretched_and_rounded_half_up(pictures):
    total = 0.0
    for band in pictures[:2]:
        pair = [stretched(one).ravel() for one in (band, pictures[2])]
        joint = np.histogram2d(*pair, bins=np.arange(257) - 0.5)[0] / band.size
        apart = np.outer(joint.sum(axis=1), joint.sum(axis=0))
        total += (
            joint * np.log(np.where(joint > 0, joint, 1) / np.where(joint > 0, apart, 1))
        ).sum()
    assert values(*pictures)["mutual_information"] == pytest.approx(total, rel=1e-10)


def gradients(plane):
    """Return Sobel derivatives, zeros beyond the border: x to the right, y upwards."""
    kernel = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]])
    return [correlate2d(plane.astype(float), k, "same") for k in (kernel, -kernel.T)]


def qabf_of(visible, thermal, fused):
    up = down = 0.0
    fx, fy = gradients(fused)
    for bx, by in (gradients(visible), gradients(thermal)):
        g, f = np.hypot(bx, by), np.hypot(fx, fy)
        with np.errstate(divide="ignore", invalid="ignore"):
            # The reference implementation takes the strength for the ratio where both are equal.
            ratio = np.where(g == f, f, np.minimum(g, f) / np.maximum(g, f))
            angle = [np.where(x == 0, np.pi / 2, np.arctan(y / x)) for x, y in ((bx, by), (fx, fy))]
        alignment = 1 - np.abs(angle[0] - angle[1]) / (np.pi / 2)
        strength = 0.9994 / (1 + np.exp(-15 * (np.minimum(ratio, 60) - 0.5)))
        up += (g * strength * 0.9879 / (1 + np.exp(-22 * (alignment - 0.8)))).sum()
        down += g.sum()
    return up / down


def test_qabf_is_the_sum_over_pixels_with_zeros_beyond_the_border(pictures):
    assert values(*pictures)["qabf"] == pytest.approx(qabf_of(*pictures), rel=1e-10)


def test_qabf_of_equal_pictures_takes_the_strength_for_the_ratio(pictures):
    copy = pictures[0]
    assert values(copy, copy, copy)["qabf"] == pytest.approx(
        0.9994 * 0.9879 / (1 + math.exp(-22 * 0.2)), rel=1e-6
    )


def test_ssim_is_the_sum_of_scikit_image_over_whole_windows(pictures):
    visible, thermal, fused = pictures
    total = 0.0
    for band in (visible, thermal):
        _, field = structural_similarity(
            band.astype(float),
            fused.astype(float),
            data_range=255,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            full=True,
            truncate=3.5,
        )
        total += field[5:-5, 5:-5].mean()
    assert values(*pictures)["ssim_sum"] == pytest.approx(total, rel=1e-9)


def test_gradients_and_spread_are_sums_over_pixels(pictures):
    fused, found = pictures[2].astype(float), values(*pictures)
    rows, columns = fused.shape
    average = np.sqrt(sum(slope**2 for slope in np.gradient(fused)) / 2).sum()
    average /= (rows - 1) * (columns - 1)
    assert found["average_gradient"] == pytest.approx(average, rel=1e-12)
    edge = np.pad(fused, 1, mode="edge")
    kernel = np.array([[1, 2, 1], [0, 0, 0], [-1, -2, -1]])
    modulus = np.hypot(convolve2d(edge, kernel, "valid"), convolve2d(edge, kernel.T, "valid"))
    assert found["edge_intensity"] == pytest.approx(modulus.mean(), rel=1e-12)
    spread = math.sqrt(((fused - fused.mean()) ** 2).sum() / fused.size)
    assert found["standard_deviation"] == pytest.approx(spread)
    steps = sum((np.diff(fused, axis=axis) ** 2).sum() for axis in (0, 1))
    assert found["spatial_frequency"] == pytest.approx(math.sqrt(steps / fused.size), rel=1e-12)


def filtered(plane, sensitivity, cycles):
    """Filter in the frequency domain, zero frequency in the middle."""
    rows, columns = plane.shape
    v, u = (2.0 * (np.arange(n) - n // 2) / n for n in (rows, columns))
    r = np.hypot(*np.meshgrid(u * columns / cycles, v * rows / cycles))
    return np.fft.ifft2(np.fft.ifftshift(np.fft.fftshift(np.fft.fft2(plane)) * sensitivity(r))).real


def test_qcb_keeps_masked_contrasts_of_filtered_pictures(pictures):
    offsets = np.arange(-15, 16)
    kernels = [
        np.exp(-np.add.outer(offsets**2, offsets**2) / (2 * s * s)) / (2 * np.pi * s * s)
        for s in (2, 4)
    ]
    masked = []
    for one in pictures:
        plane = filtered(
            stretched(one),
            lambda r: np.exp(-((r / 15.387) ** 2)) - 0.7622 * np.exp(-((r / 1.3456) ** 2)),
            30,
        )
        near, wide = (convolve2d(plane, kernel, "same") for kernel in kernels)
        contrast = np.abs(near / wide - 1)
        masked.append(contrast**3 / (contrast**2 + 1e-4))
    a, b, f = masked
    kept = a**2 * np.minimum(a, f) / np.maximum(a, f) + b**2 * np.minimum(b, f) / np.maximum(b, f)
    assert values(*pictures)["qcb"] == pytest.approx(np.mean(kept / (a**2 + b**2)), rel=1e-8)


def test_qcv_weights_blocks_by_their_edges(pictures):
    def sensitivity(r):
        return 2.6 * (0.0192 + 0.144 * r) * np.exp(-((0.144 * r) ** 1.1))

    up = down = 0.0
    for band in pictures[:2]:
        modulus = np.hypot(*gradients(stretched(band)))
        seen = filtered(stretched(band) - stretched(pictures[2]), sensitivity, 8)
        for i in range(0, SHAPE[0], 16):
            for j in range(0, SHAPE[1], 16):
                saliency = (modulus[i : i + 16, j : j + 16] ** 5).sum()
                up += saliency * (seen[i : i + 16, j : j + 16] ** 2).sum() / 256
                down += saliency
    assert values(*pictures)["qcv"] == pytest.approx(up / down, rel=1e-9)


def test_channels_are_averaged_but_lie_side_by_side_for_the_spatial_frequency(pictures):
    visible, thermal, fused = pictures
    colour = np.stack([fused, visible, thermal], axis=-1)
    found = values(visible, thermal, colour)
    single = [values(visible, thermal, plane) for plane in (fused, visible, thermal)]
    for name in scores.UNITS.keys() - {"spatial_frequency"}:
        assert found[name] == pytest.approx(np.mean([one[name] for one in single]), rel=1e-12)
    wide = np.concatenate([fused, visible, thermal], axis=1)
    assert found["spatial_frequency"] == pytest.approx(
        scores.spatial_frequency(wide.astype(float)), rel=1e-12
    )


def test_noise_control_raises_gradients_and_the_copy_control_is_the_visible_picture(pictures):
    visible, thermal, fused = pictures
    rows = {
        row.quantity: row for row in score(visible, thermal, fused, rng=np.random.default_rng(3))
    }
    copy = values(visible, thermal, visible)
    assert rows["average_gradient"].noise_control > 1.1 * rows["average_gradient"].value
    assert rows["entropy"].noise_control > rows["entropy"].value
    assert all(row.copy_control == copy[name] for name, row in rows.items())
    assert score(visible, thermal, fused, rng=np.random.default_rng(3)) == tuple(rows.values())


def test_noise_control_has_ten_codes():
    grey = np.full((200, 200), 128, np.uint8)
    row = {row.quantity: row for row in score(grey, grey, grey, rng=np.random.default_rng(5))}[
        "standard_deviation"
    ]
    # Rounding adds 1/12; the standard error of an sd is sd / sqrt(2 n).
    assert abs(row.noise_control - math.sqrt(100 + 1 / 12)) < 3 * 10 / math.sqrt(2 * grey.size)


def test_scores_of_constant_pictures_are_undefined_not_errors():
    grey = np.full((32, 32), 40, np.uint8)
    found = values(grey, grey, grey)
    assert found["qcv"] is None and found["qcb"] is None
    black = np.zeros((32, 32), np.uint8)
    assert values(black, black, black)["qabf"] is None
    assert found["entropy"] == 0.0 and found["mutual_information"] == 0.0


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.zeros((32, 32)), "8-bit codes, got float64"),
        (np.zeros((32, 32, 4), np.uint8), r"\(row, col, 3\)"),
        (np.zeros((32, 31), np.uint8), "one size"),
        (np.zeros((8, 32), np.uint8), "16 rows and columns or more"),
    ],
)
def test_pictures_that_cannot_be_scored_are_refused(picture, words):
    good = np.zeros((32, 32), np.uint8)
    with pytest.raises(BadInput, match=words):
        score(good, good, picture, rng=np.random.default_rng(1))
