"""Points that users of other tools reported: a diffraction spot, a dense field; and siblings drawn
here.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import erf, j1

from charact.estimators import mtf
from charact.method import Context
from labdata import FrameStack, read_frames

CASES = Path(__file__).resolve().parents[2].parent / "shared" / "cases"
QUICK = Context(quick=True)


def case(name, file):
    path = CASES / name / file
    if not path.is_file():
        pytest.skip(f"the case {name} is not beside this checkout")
    return read_frames(path)


def both(result):
    return [result.find("mtf50", orientation_deg=angle)[0] for angle in (0.0, 90.0)]


def holds(found, truth):
    low, high = found.interval95
    return low <= truth <= high


def airy_picture(cut_off, size, place, fine=9):
    """Return an Airy spot through square pixels, by sums over finer pixels, shape (row, col)."""
    at = (np.arange(size * fine) - (size * fine - 1) / 2) / fine
    radius = np.hypot(at - place[0], (at - place[1])[:, None])
    u = np.maximum(np.pi * cut_off * radius, 1e-9)
    spread = (2.0 * j1(u) / u) ** 2
    return spread.reshape(size, fine, size, fine).sum(axis=(1, 3))


def airy_mtf50(cut_off):
    """Return where diffraction times a square pixel falls to one half, cy/px."""
    f = np.linspace(0.001, cut_off, 20001)
    v = f / cut_off
    transfer = 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)) * np.sinc(f)
    return float(f[np.argmax(transfer < 0.5)])


def gaussian_field(places, sigma, size):
    """Return Gaussian spots (light, col, row) through square pixels, shape (row, col)."""
    at = np.arange(size)

    def line(middle):
        return 0.5 * (
            erf((at + 0.5 - middle) / sigma / np.sqrt(2))
            - erf((at - 0.5 - middle) / sigma / np.sqrt(2))
        )

    return sum(light * np.outer(line(row), line(col)) for light, col, row in places)


def test_the_diffraction_spot_has_its_closed_form():
    """MTF50 of an Airy spot of cut-off 0.45 cy/px times the pixel is 0.1721; it came out as
    0.0318.
    """
    truth = airy_mtf50(0.45)
    for found in both(
        mtf.measure_all("point", case("f1-diffraction-spot", "airy.tif"), context=QUICK)
    ):
        assert found.status == "ok", found.flags
        low, high = found.interval95
        assert abs(found.value - truth) < high - low < 0.02 * truth


def test_the_spot_in_the_dense_field_is_measured_beside_its_neighbours():
    stack = case("n1-dense-field-roi", "f.tif")
    for found in both(mtf.measure("point", stack, region=(34, 34, 29, 29), context=QUICK)):
        assert found.status == "ok", found.flags
        assert holds(found, 0.187) and found.value == pytest.approx(0.187, rel=0.05)
        assert any("neighbours" in note for note in found.notes)


@pytest.mark.parametrize(
    ("cut_off", "bits", "size", "place"),
    [(0.3, 8, 81, (0.3, -0.4)), (0.6, 12, 65, (-0.1, 0.2)), (0.8, 16, 97, (0.5, 0.5))],
)
def test_diffraction_spots_of_one_frame_are_ok(cut_off, bits, size, place, seed):
    rng = np.random.default_rng([seed, bits])
    picture = airy_picture(cut_off, size, place)
    electrons = rng.poisson(20000.0 * picture / picture.max()) + rng.normal(0.0, 8.0, picture.shape)
    gain = 0.7 * 2**bits / 20000.0
    data = np.clip(np.rint(0.05 * 2**bits + gain * electrons), 0, 2**bits - 1).astype(
        np.uint8 if bits == 8 else np.uint16
    )
    result = mtf.measure_all(
        "point", FrameStack(data=data[None], full_scale_dn=2.0**bits - 1), context=QUICK
    )
    for found in both(result):
        assert found.status == "ok", found.flags
        low, high = found.interval95
        assert abs(found.value - airy_mtf50(cut_off)) < high - low
        assert high - low < 0.08 * found.value


@pytest.mark.parametrize(("sigma", "pitch", "frames"), [(0.9, 8.0, 1), (1.2, 10.0, 4)])
def test_a_spot_in_a_field_of_neighbours_is_its_own(sigma, pitch, frames, seed):
    """Neighbours 7 to 9 sigma away, brighter and fainter than the spot in the middle."""
    rng = np.random.default_rng(seed)
    middle = 24.0
    places = [
        (
            float(rng.uniform(0.6, 1.8)) * 8000.0,
            middle + pitch * col + rng.uniform(-0.8, 0.8),
            middle + pitch * row,
        )
        for col in range(-2, 3)
        for row in range(-2, 3)
        if (row, col) != (0, 0)
    ]
    mean = gaussian_field([(8000.0, middle + 0.3, middle - 0.2), *places], sigma, 49)
    data = np.rint(
        100.0
        + rng.poisson(mean, (frames, *mean.shape))
        + rng.normal(0.0, 8.0, (frames, *mean.shape))
    )
    f = np.linspace(0.001, 0.6, 6001)
    truth = f[np.argmax(np.exp(-2 * (np.pi * f * sigma) ** 2) * np.sinc(f) < 0.5)]
    result = mtf.measure(
        "point", FrameStack(data=data.astype(np.uint16)), region=(8, 8, 33, 33), context=QUICK
    )
    for found in both(result):
        assert found.status == "ok", found.flags
        low, high = found.interval95
        assert abs(found.value - truth) < high - low
        assert found.value == pytest.approx(truth, rel=0.1)


def test_each_flag_of_a_point_names_what_settles_it(seed):
    """A spot cut by the region: how large the effect may be, and `roi`."""
    rng = np.random.default_rng(seed)
    data = np.rint(
        100.0
        + rng.poisson(gaussian_field([(9000.0, 4.0, 16.0)], 1.1, 33))
        + rng.normal(0.0, 5.0, (33, 33))
    )
    found = both(
        mtf.measure(
            "point",
            FrameStack(data=data.astype(np.uint16)[None]),
            region=(0, 0, 33, 33),
            context=QUICK,
        )
    )
    assert "window-too-small" in found[0].flags and "too-few-frames" not in found[0].flags
    (note,) = (note for note in found[0].notes if note.startswith("window-too-small"))
    assert "MTF50 may be high" in note and "`roi`" in note
