"""Meters read what is in the frame: counts are exact, the noise lies within its stated standard
errors.
"""

import numpy as np
import pytest

from charact.live import SATURATED_BGR, measure_frame, render_preview
from labdata import BadInput


@pytest.mark.parametrize(
    "dtype,full_scale_dn", [(np.uint8, 255), (np.uint16, 1023), (np.uint16, 65535)]
)
def test_every_saturated_pixel_is_counted_and_every_pixel_is_in_the_histogram(
    dtype, full_scale_dn, seed
) -> None:
    rng = np.random.default_rng(seed)
    frame = rng.integers(0, full_scale_dn, (97, 131)).astype(dtype)
    places = rng.choice(frame.size, 37, replace=False)
    frame.ravel()[places] = full_scale_dn
    meters = measure_frame(frame, full_scale_dn=full_scale_dn)
    assert meters.saturated_px == 37
    assert meters.histogram.sum() == meters.pixels == frame.size
    assert meters.highest_dn == full_scale_dn
    assert meters.mean_dn == pytest.approx(frame.mean())
    assert len(meters.histogram) * meters.bin_dn == full_scale_dn + 1


def test_one_saturated_pixel_that_the_picture_leaves_out_is_counted_and_marked() -> None:
    import cv2

    frame = np.full((300, 4 * 768), 50, np.uint8)
    frame[101, 203] = 255
    meters = measure_frame(frame, full_scale_dn=255.0)
    picture = render_preview(frame, meters, full_scale_dn=255.0)
    drawn = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert meters.saturated_px == 1
    assert picture.step == 4 and drawn.shape == (75, 768, 3)
    # A JPEG smears the mark over its neighbours; its blue stands out all the same.
    blue, _, red = SATURATED_BGR
    excess = drawn[..., 0].astype(int) - drawn[..., 2]
    assert np.unravel_index(excess.argmax(), excess.shape) == (25, 50)
    assert excess.max() > 0.1 * (blue - red)


def test_stated_error_of_the_noise_holds_where_pixels_share_their_noise(seed) -> None:
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    shared = [
        gaussian_filter(rng.normal(0.0, 60.0, (480, 640)), 2.0, mode="wrap") for _ in range(41)
    ]
    frames = [np.rint(2000.0 + one).astype(np.uint16) for one in shared]
    read = [
        measure_frame(b, a, full_scale_dn=4095.0)
        for a, b in zip(frames[::2], frames[1::2], strict=False)
    ]
    scatter = np.std([meters.noise_dn for meters in read], ddof=1)
    stated = np.mean([meters.noise_se_dn for meters in read])
    assert 0.5 < stated / scatter < 1.7


def test_mean_and_noise_are_those_of_the_region_and_saturation_that_of_the_frame(seed) -> None:
    rng = np.random.default_rng(seed)
    a, b = (rng.normal(100.0, 4.0, (200, 200)) for _ in range(2))
    frames = [np.rint(one).astype(np.uint8) for one in (a, b)]
    for frame in frames:
        frame[:100] = 255
    meters = measure_frame(*frames, full_scale_dn=255.0, region=(100, 0, 100, 200))
    assert meters.saturated_px == 100 * 200
    assert meters.mean_dn == pytest.approx(100.0, abs=4 * 4.0 / np.sqrt(20_000))
    assert meters.noise_dn == pytest.approx(np.sqrt(16.0 + 1 / 12), abs=5 * meters.noise_se_dn)


def test_what_cannot_be_metered_is_refused_in_a_sentence() -> None:
    frame = np.zeros((10, 10), np.uint8)
    with pytest.raises(BadInput, match="inside the image of 10 rows"):
        measure_frame(frame, full_scale_dn=255.0, region=(5, 5, 6, 5))
    with pytest.raises(BadInput, match="unsigned integers"):
        measure_frame(frame.astype(float), full_scale_dn=255.0)
    with pytest.raises(BadInput, match="one shape"):
        measure_frame(frame, frame[:5], full_scale_dn=255.0)
