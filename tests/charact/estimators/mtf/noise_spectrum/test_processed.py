"""Processing behind the digitiser shows in the noise of even areas; noise of cameras does not look
like it.
"""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, median_filter

from charact.estimators import mtf
from charact.estimators.mtf.noise_spectrum.processed import processing_findings
from charact.method import Context
from labdata import FrameStack
from tests.truth import EdgeScene, TrueBlur

DARK, BRIGHT = 40.0, 170.0


def as_jpeg(codes, quality=60):
    return cv2.imdecode(cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0)


def as_interpolated(codes):
    return cv2.resize(codes, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_LINEAR)


def as_median(codes):
    return median_filter(codes, 3)


def as_encoded(codes):
    return np.rint(255.0 * (codes / 255.0) ** (1.0 / 2.2)).astype(np.uint8)


def halves(rng, noise_dn=4.0, shape=(96, 128), correlated_px=0.0):
    """Dark and bright halves of 8-bit codes under noise, and which is which."""
    mean = np.full(shape, DARK)
    mean[:, shape[1] // 2 :] = BRIGHT
    noise = rng.normal(size=shape)
    if correlated_px:
        noise = gaussian_filter(noise, correlated_px)
    noise *= noise_dn / noise.std()
    return np.clip(np.rint(mean + noise), 0, 255).astype(np.uint8)


def findings(codes):
    """What the codes of two halves say, their middle column left out."""
    cols = codes.shape[1]
    areas = np.ones(codes.shape, int)
    areas[:, cols // 2 :] = 2
    areas[:, cols // 2 - 8 : cols // 2 + 8] = 0
    sides = [float(np.mean(codes[areas == side])) for side in (1, 2)]
    expected = np.where(np.arange(cols) < cols // 2, *sides) * np.ones(codes.shape)
    return list(processing_findings(codes, expected, areas))


@pytest.mark.parametrize(
    ("process", "flag", "sentence", "bounded"),
    [
        (as_jpeg, "processed", "blocks of 8", False),
        (as_interpolated, "processed", "twice the samples", True),
        (as_median, "processed", "median", True),
        (as_encoded, "gamma", "left out", False),
    ],
)
@pytest.mark.parametrize("shape", [(96, 128), (150, 70)])
def test_processing_is_known_by_the_noise(process, flag, sentence, bounded, shape, seed):
    found = findings(process(halves(np.random.default_rng([seed, *shape]), shape=shape)))
    assert [finding.flag for finding in found] == [flag]
    assert sentence in found[0].effect
    assert (found[0].undo is not None) == bounded


@pytest.mark.parametrize("noise_dn", [0.4, 1.0, 4.0])
@pytest.mark.parametrize("correlated_px", [0.0, 0.7, 1.5])
def test_noise_of_a_camera_is_no_processing(noise_dn, correlated_px, seed):
    """White noise, and noise that a phosphor or a filter of the video chain blurs."""
    for number in range(3):
        rng = np.random.default_rng([seed, number])
        assert not findings(halves(rng, noise_dn, correlated_px=correlated_px))


def test_an_interlaced_frame_is_not_interpolated(seed):
    """Fields of unequal gain and noise differ between rows; neighbours along rows do not."""
    rng = np.random.default_rng(seed)
    codes = halves(rng).astype(float)
    codes[::2] = 1.03 * codes[::2] + rng.normal(0.0, 4.0, codes[::2].shape)
    assert not findings(np.clip(np.rint(codes), 0, 255).astype(np.uint8))


@pytest.mark.parametrize(
    ("process", "scale", "kernel"),
    [(as_jpeg, 1.0, 1.0), (as_interpolated, 0.5, 0.85), (as_median, 1.0, 1.0)],
)
def test_a_processed_edge_is_flagged_or_its_interval_holds(process, scale, kernel, seed):
    """The kernel of interpolation takes up to 15 % of the MTF50 of so sharp an edge."""
    for number in range(3):
        rng = np.random.default_rng([seed, 5, number])
        scene = EdgeScene(
            blur=TrueBlur(sigma_px=1.1),
            rows=96,
            cols=110,
            angle_deg=5.5,
            dark_dn=DARK,
            bright_dn=BRIGHT,
        )
        frame = np.clip(np.rint(scene.mean() + rng.normal(0.0, 3.0, (96, 110))), 0, 255)
        stack = FrameStack(data=process(frame.astype(np.uint8))[None])
        found = mtf.measure("edge", stack, context=Context(quick=True)).find("mtf50")[0]
        low, high = found.interval95
        truth = scale * scene.truth_mtf50
        assert found.status == "suspect" or (low <= truth and high >= kernel * truth)
        assert "processed" in found.flags or any("processed" in note for note in found.notes)
