"""Uneven light and correlated noise on an edge: what they may do to its MTF, and what must be said
of them.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf import prepare_edge
from charact.estimators.mtf.edge.pixels import profile as edge_profile
from charact.method import Context
from labdata import FrameStack
from tests.truth import BlurOf, EdgeScene, TrueBlur

QUICK = Context(quick=True)


LENS = TrueBlur(sigma_px=1.2)


def frame_of(angle_deg, rows=110, cols=110, blur=LENS):
    levels = {"dark_dn": 1000.0, "bright_dn": 2500.0, "black_dn": 0.0, "full_scale_dn": 4095.0}
    pose = {"angle_deg": angle_deg, "offset_px": 0.3}
    return EdgeScene(blur=blur, rows=rows, cols=cols, **pose, **levels).mean()


def measured(frame, **options):
    return mtf.measure(
        "edge", FrameStack(data=frame[None]), method="edge-parametric", context=QUICK
    ).find("mtf50")[0]


@pytest.mark.parametrize(
    ("angle_deg", "along"),
    [(4.0, False), (14.0, True), (35.0, False), (94.0, True), (124.0, False)],
)
def test_light_that_changes_over_the_frame_leaves_the_mtf_alone(angle_deg, along, seed):
    """Light changing by a fifth over the frame, along columns or rows, at a step of 40 standard
    deviations.
    """
    frame = frame_of(angle_deg)
    ramp = 1.0 + 0.2 * (np.arange(110) / 110 - 0.5)
    frame = frame * (ramp[:, None] if along else ramp[None])
    found = measured(frame + 40.0 * np.random.default_rng(seed).standard_normal(frame.shape))
    half = (found.interval95[1] - found.interval95[0]) / 2
    assert abs(found.value - LENS.mtf50(angle_deg)) < 2.0 * half


def test_a_ramp_along_a_tilted_edge_does_not_turn_its_line():
    """The line found is the edge's, whatever its light: a ramp by half turns it by less than a
    hundredth of a pixel.
    """
    frame = frame_of(96.0)
    ramp = 1.0 + 0.5 * (np.arange(110) / 110 - 0.5)
    plain, sloped = (
        prepare_edge(FrameStack(data=each[None]), None, QUICK).profile.angle_rad
        for each in (frame, frame * ramp)
    )
    assert abs(plain - sloped) * 110 < 0.02


@pytest.mark.parametrize("share", [0.15, 0.3])
def test_light_wider_than_the_window_is_told_or_within_the_interval(share, seed):
    """A Gaussian veil of 80 px in a window of 55 px on both sides: its light belongs to the
    normalisation.
    """
    veil = TrueBlur(sigma_px=80.0).before_pixel
    blur = BlurOf(of=lambda f: LENS.before_pixel(f) * (1 - share + share * veil(f)))
    frame, truth = frame_of(5.0, blur=blur), blur.mtf50(5.0)
    for one in range(6):
        found = measured(
            frame + 40.0 * np.random.default_rng([seed, one]).standard_normal(frame.shape)
        )
        assert found.status != "ok" or found.interval95[0] < truth < found.interval95[1], (
            found.provenance
        )


def test_a_line_that_leaves_the_region_is_no_edge(seed):
    """Noise in a region of a few pixels: whatever line is found there, one sentence comes back."""
    rng = np.random.default_rng(seed)
    for size in (8, 9, 11, 14):
        found = measured(1000.0 + 50.0 * rng.standard_normal((size, size)))
        assert found.status in ("refused", "suspect")
        assert found.value is not None or found.reason


def blurred_noise(rng, size, sigma_px):
    """White noise through a Gaussian, by transform, of unit variance."""
    f = np.fft.fftfreq(size)
    gain = np.exp(-2 * (np.pi * sigma_px) ** 2 * (f[:, None] ** 2 + f[None] ** 2))
    field = np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * gain).real
    return field / np.sqrt(np.mean(gain**2))


@pytest.mark.parametrize(("sigma_px", "share"), [(0.0, 0.0), (0.6, 0.8), (1.0, 0.8)])
def test_the_sum_of_the_noise_correlation_is_unbiased(sigma_px, share, seed):
    """Sum of the correlation: the share of the blurred noise over the mean of its squared gain,
    plus the white rest.

    Twenty frames; 4 standard errors of their mean, at least 4 percent.
    """
    rng = np.random.default_rng(seed)
    frame = frame_of(12.0)
    sums = []
    for _ in range(20):
        noise = np.sqrt(share) * blurred_noise(rng, 110, sigma_px) + np.sqrt(
            1 - share
        ) * rng.standard_normal((110, 110))
        stack = FrameStack(data=(frame + 60.0 * noise)[None])
        sums.append(prepare_edge(stack, None, QUICK).profile.correlated_noise.correlation_factor)
    f = np.fft.fftfreq(110)
    power = np.mean(np.exp(-4 * (np.pi * sigma_px) ** 2 * (f[:, None] ** 2 + f[None] ** 2)))
    truth = share / power + 1 - share
    assert abs(np.mean(sums) - truth) < max(4 * np.std(sums) / np.sqrt(20), 0.04 * truth)


@pytest.mark.parametrize("cols", [48, 150])
def test_ripples_are_no_undulations_many_times_their_size(cols, seed):
    """What a bend leaves over of a plateau of 13 px is a fiftieth of an undulation, and not to be
    blown up to one.
    """
    frame = frame_of(4.0, rows=110, cols=cols) + 10.0 * np.random.default_rng(seed).standard_normal(
        (110, cols)
    )
    profile = prepare_edge(FrameStack(data=frame[None]), None, QUICK).profile
    ripples, waves = (
        height * np.sin(2 * np.pi * profile.distance / px)
        for height, px in ((6.0, 5.0), (45.0, 40.0))
    )
    assert edge_profile.with_shading(profile, ripples).shading_sd < 3 * 6.0
    # Waves of 45 DN are undulations of their own size, as a plateau of 62 px lets them be told.
    assert cols < 100 or 45.0 < edge_profile.with_shading(profile, waves).shading_sd < 90.0
