"""Frames cut below full scale: white of video, a spot at its own ceiling; and siblings drawn
here.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf, ndtr

from charact.estimators.mtf import measure
from charact.frames.clipping import ceiling_of
from charact.method import Context
from labdata import FrameStack, read_frames

CASES = Path(__file__).resolve().parents[2].parent / "shared" / "cases"
QUICK = Context(quick=True)
SIZE = 41


@pytest.fixture
def rng():
    return np.random.default_rng(20)


def case(name, file):
    path = CASES / name / file
    if not path.is_file():
        pytest.skip(f"the case {name} is not beside this checkout")
    return read_frames(path)


def spot(sigma_px, height_dn, sd_dn, rng, frames=1):
    """Gaussian spot through square pixels on 100 DN with noise, shape (frame, row, col), DN."""
    at = np.arange(SIZE + 1) - 0.5 * SIZE
    across, down = (np.diff(ndtr((at - shift) / sigma_px)) for shift in rng.uniform(-0.5, 0.5, 2))
    peak = erf(0.5 / (np.sqrt(2.0) * sigma_px)) ** 2
    mean = 100.0 + height_dn / peak * np.outer(down, across)
    return mean + rng.normal(0.0, sd_dn, (frames, SIZE, SIZE))


def codes(values, ceiling_dn=65535):
    return np.minimum(np.rint(values), ceiling_dn).astype(np.uint16)


def edge(black_dn, white_dn, sd_dn, rng):
    """Edge of 5 degrees blurred by a Gaussian of 1 px, shape (1, row, col), DN."""
    row, col = np.mgrid[:120, :120] - 60.0
    distance = (col - np.tan(np.deg2rad(5.0)) * row) * np.cos(np.deg2rad(5.0))
    mean = black_dn + (white_dn - black_dn) * ndtr(distance)
    return (mean + rng.normal(0.0, sd_dn, mean.shape))[None]


def test_white_of_limited_range_is_a_ceiling():
    frames = case("y1-limited-range-edge", "e.png")
    assert ceiling_of(frames.data, frames.full_scale_dn) == 235.0
    assert "clipped" in measure("edge", frames, context=QUICK).find("mtf50")[0].flags


@pytest.mark.parametrize(("ceiling_dn", "sd_dn"), [(200, 0.9), (235, 2.0), (250, 4.0)])
def test_an_edge_cut_at_any_code_is_clipped_and_one_below_it_is_not(ceiling_dn, sd_dn, rng):
    for white_dn, cut in ((ceiling_dn + 20.0, True), (ceiling_dn - 12.0 * sd_dn, False)):
        values = codes(edge(30.0, white_dn, sd_dn, rng), ceiling_dn).astype(np.uint8)
        measurement = measure("edge", FrameStack(data=values), context=QUICK).find("mtf50")[0]
        assert ("clipped" in measurement.flags) == cut
        assert (ceiling_of(values, 255.0) == ceiling_dn) == cut


def test_a_single_frame_spot_at_full_scale_keeps_its_width():
    frames = case("ee1-clipped-single-frame-spot", "p.tif")
    for measurement in measure("point", frames, context=QUICK).find("mtf50"):
        low, high = measurement.interval95
        assert measurement.status == "ok" and low <= 0.2201 <= high


@pytest.mark.parametrize("ceiling_dn", [1000, 1500, 1800])
def test_a_spot_cut_at_its_own_ceiling_keeps_its_width(ceiling_dn, rng):
    values = spot(1.0, 2000.0, 8.0, rng)
    f = np.linspace(0.05, 0.5, 4501)
    truth = f[np.argmax(np.sinc(f) * np.exp(-2.0 * (np.pi * f) ** 2) < 0.5)]
    measurement = measure("point", FrameStack(data=codes(values, ceiling_dn)), context=QUICK).find(
        "mtf50"
    )[0]
    low, high = measurement.interval95
    assert low <= truth <= high or "clipped" in measurement.flags


def test_one_pixel_at_one_code_in_every_frame_is_cut(rng):
    frames = spot(0.5, 800.0, 4.0, rng, frames=8)
    assert ceiling_of(codes(frames), None) is None
    assert ceiling_of(codes(frames, 600), None) == 600.0


def test_noise_shows_a_ceiling_by_chance_in_few_spots_edges_and_flats(rng):
    shown = 0
    for _ in range(200):
        sd_dn = rng.uniform(2.0, 20.0)
        pictures = (
            codes(spot(rng.uniform(0.6, 1.5), rng.uniform(500.0, 3000.0), sd_dn, rng)),
            codes(edge(100.0, 200.0, 0.2 * sd_dn, rng)),
            codes(rng.normal(500.0, sd_dn, (2, SIZE, SIZE))),
            codes(spot(0.5, 800.0, sd_dn, rng, frames=6)),
        )
        shown += sum(ceiling_of(picture, None) is not None for picture in pictures)
    assert shown <= 6


def test_frames_without_noise_show_no_ceiling_but_that_of_a_digitiser(rng):
    values = codes(edge(100.0, 900.0, 0.0, rng), 700)
    assert ceiling_of(values, None) is None
    assert ceiling_of(codes(edge(100.0, 1900.0, 0.0, rng), 1023), None) == 1023.0
