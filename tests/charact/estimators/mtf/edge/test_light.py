"""Uneven light and correlated noise on an edge: what they may do to its MTF, and what must be said
of them.
"""

import numpy as np
import pytest

from charact.estimators import mtf
from charact.estimators.mtf.edge.pixels.noise_model import fit_correlation_model
from charact.estimators.mtf.edge.pixels.prepare_edge import prepare_edge
from charact.estimators.mtf.edge.pixels.profile import with_shading
from charact.estimators.mtf.edge.thresholds import ACCURACY
from charact.method import Context
from labdata import FrameStack
from tests.truth import gaussian_edges as edges

QUICK = Context(quick=True)


def gaussian(sigma_px):
    return lambda f: np.exp(-2 * (np.pi * f * sigma_px) ** 2)


def frame_of(angle_deg, rows=110, cols=110, pedestal=1000.0, step=1500.0):
    return pedestal + step * edges.frame_of(
        gaussian(1.2), rows, cols, angle_deg=angle_deg, offset_px=0.3
    )


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
    assert abs(found.value - edges.level_of(gaussian(1.2), angle_deg)) < 2.0 * half


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
    form = lambda f: gaussian(1.2)(f) * (1 - share + share * gaussian(80.0)(f))  # noqa: E731
    frame = 1000.0 + 1500.0 * edges.frame_of(form, 110, 110, angle_deg=5.0)
    truth = edges.level_of(form, 5.0)
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


def test_the_form_of_a_correlation_is_found_and_none_where_there_is_none(seed):
    y, x = np.mgrid[-14:15, -14:15].astype(float)
    truth = np.where((x == 0) & (y == 0), 1.0, 0.7 * np.exp(-(x**2) / 9.0 - y**2 / 4.0))
    pairs = np.full(truth.shape, 10_000.0)
    noise = np.random.default_rng(seed).standard_normal(truth.shape) / 100.0
    noise = (noise + noise[::-1, ::-1]) / np.sqrt(2.0)
    noise[14, 14] = 0.0
    form, taken = fit_correlation_model(truth + noise, pairs, x)
    assert form.sum() == pytest.approx(truth.sum(), rel=0.05)
    white, _ = fit_correlation_model((truth == 1.0) + noise, pairs, x)
    assert white.sum() == 1.0
    lost = 0.02 * np.maximum(1.0 - np.abs(x), 0.0) * (truth != 1.0)
    _, taken = fit_correlation_model((truth == 1.0) + noise / 10.0 - lost, 100.0 * pairs, x)
    assert taken[:14, 14].mean() == pytest.approx(-0.02, abs=0.003)


def test_noise_of_no_smooth_form_keeps_its_own_correlation(seed):
    """Lines of two fields and a core on a pedestal: correlations that no single smooth form has,
    kept lag by lag.
    """
    rng = np.random.default_rng(seed)
    parts = (
        blurred_noise(rng, 200, 0.6),
        blurred_noise(rng, 200, 3.0),
        rng.standard_normal((200, 200)),
    )
    noise = np.sqrt(0.5) * parts[0] + np.sqrt(0.4) * parts[1] + np.sqrt(0.1) * parts[2]
    truth = lambda x, y: 0.5 * np.exp(-(x**2 + y**2) / 1.44) + 0.4 * np.exp(-(x**2 + y**2) / 36.0)  # noqa: E731
    frame = frame_of(8.0, rows=200, cols=200)
    correlation = prepare_edge(
        FrameStack(data=(frame + 60.0 * noise)[None]), None, QUICK
    ).profile.correlated_noise.correlation
    # Errors of a correlation under this noise, by Bartlett: sqrt(sum rho^2 / pairs), at most 0.04
    # here.
    for x, y in ((1, 0), (0, 1), (1, 1), (2, 0), (0, 3), (3, 3)):
        assert correlation[14 + y, 14 + x] == pytest.approx(truth(x, y), abs=0.12)


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
    assert with_shading(profile, ripples).shading_sd < 3 * 6.0
    assert with_shading(profile, waves).shading_sd > 10.0 or cols < 100


def test_undulations_are_what_a_bend_and_the_noise_leave_over(seed):
    """Reference: the same by projections, plateau by plateau: squares beyond the trace over what
    undulations make.
    """
    frame = frame_of(4.0, rows=110, cols=150) + 10.0 * np.random.default_rng(seed).standard_normal(
        (110, 150)
    )
    profile = prepare_edge(FrameStack(data=frame[None]), None, QUICK).profile
    waves = 45.0 * np.sin(2 * np.pi * profile.distance / 40.0)
    excess = weight = 0.0
    for side in (
        profile.distance < -ACCURACY.plateau_from_px,
        profile.distance > ACCURACY.plateau_from_px,
    ):
        place = profile.distance[side]
        bend = np.vander(place, 3)
        rest = np.eye(place.size) - bend @ np.linalg.pinv(bend)
        undulating = np.exp(-0.5 * ((place[:, None] - place) / ACCURACY.shading_length_px) ** 2)
        excess += waves[side] @ rest @ waves[side] - np.trace(
            rest @ profile.covariance[np.ix_(side, side)] @ rest
        )
        weight += np.trace(rest @ undulating)
    assert with_shading(profile, waves).shading_sd == pytest.approx(
        np.sqrt(excess / weight), rel=1e-6
    )
