"""The MTF of rendered targets seen by the noiseless camera is the product of the stages'
transfers.
"""

import numpy as np
import pytest

from labdata import Conditions, Target
from simulate import LabBench
from simulate.camera import Slot, StageImage, product, true_quantities

ROWS, COLUMNS, RATIO = 160, 200, 13.0 / 11.0
LUX = Conditions(illuminance_lux=1e-4)


@pytest.fixture(scope="module")
def bench(plain) -> LabBench:
    return LabBench(plain(ROWS, COLUMNS))


@pytest.fixture(scope="module")
def full(bench) -> tuple[float, float]:
    """Dark level and full signal, DN, from the truths."""
    q = true_quantities.true_quantities(bench.camera.description)
    dark = 400.0 + q["photoelectron_gain"] * q["ebi_per_field"]
    return dark, 1e-4 * q["photoelectrons_per_lux"] * q["photoelectron_gain"]


def _transfer(bench: LabBench, fx_cy_per_px: np.ndarray, fy_cy_per_px: np.ndarray) -> np.ndarray:
    """Transfer of the whole camera at a frequency in the plane, both components per column
    pitch.
    """
    camera = bench.camera
    pitch = camera.cells.pitch_x_mm
    blurs = (*true_quantities._before_gain(camera), *true_quantities._after_gain(camera))
    video = np.abs(camera.stage(Slot.VIDEO).low_pass.transfer(fx_cy_per_px))
    return product(blurs, fx_cy_per_px / pitch, fy_cy_per_px / pitch) * video


def _places() -> tuple[np.ndarray, np.ndarray]:
    """Places of the pixels about the picture's centre, column pitches, x (1, col) and y (row,
    1).
    """
    x = np.arange(COLUMNS) + 0.5 - COLUMNS / 2
    y = (np.arange(ROWS) + 0.5 - ROWS / 2) * RATIO
    return x[None, :], y[:, None]


def test_flat_has_the_truths_level(bench, full):
    dark, signal = full
    flat = bench.mean("flat", Target(), LUX)
    assert flat == pytest.approx(dark + signal, rel=1e-4)


@pytest.mark.parametrize(
    ("frequency", "angle"),
    [
        (0.06, 4.0),
        (0.3, 4.0),
        (0.12, 94.0),
        (0.25, 30.0),
    ],
)
def test_bars_over_their_exact_spectrum_give_the_mtf(bench, full, frequency, angle):
    """|I(f)|/|O(f)| with O of four finite bars (physics reference, section 11)."""
    dark, signal = full
    target = Target(bars=4, frequency_cy_per_px=frequency, angle_deg=angle)
    image = (bench.mean("bars", target, LUX) - dark) / signal
    fx, fy = frequency * np.cos(np.deg2rad(angle)), frequency * np.sin(np.deg2rad(angle))
    x, y = _places()
    spectrum = np.abs(np.sum(image * np.exp(-2j * np.pi * (fx * x + fy * y)))) * RATIO
    width = 0.5 / frequency
    exact = 4.0 * width * np.sinc(0.5) * 7.0 * width
    expected = _transfer(bench, np.array([fx]), np.array([fy]))[0]
    assert spectrum / exact == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize("angle", [5.0, 95.0])
def test_slanted_edge_gives_the_mtf(bench, full, angle):
    """Transform of the edge spread, oversampled over all rows, against the transfer along the
    edge's normal.
    """
    dark, signal = full
    image = (bench.mean("edge", Target(angle_deg=angle), LUX) - dark) / signal
    x, y = _places()
    turn = np.deg2rad(angle)
    distance = (x * np.cos(turn) + y * np.sin(turn)).ravel()
    fine = 16
    place = np.rint(distance * fine).astype(int)
    reach = 60 * fine
    inside = np.abs(place) <= reach
    count = np.bincount(place[inside] + reach, minlength=2 * reach + 1)
    spread = np.bincount(place[inside] + reach, image.ravel()[inside], minlength=2 * reach + 1)
    filled = count > 0
    steps = np.arange(2 * reach + 1)
    spread = np.interp(steps, steps[filled], spread[filled] / count[filled])
    line = np.diff(spread)
    middle = (np.arange(len(line)) + 0.5 - reach) / fine
    frequency = np.array([0.1, 0.2, 0.3])
    found = np.abs(np.exp(-2j * np.pi * np.outer(frequency, middle)) @ line)
    # Undo the bins and the difference of neighbours.
    found = found / np.sinc(frequency / fine) ** 2
    expected = _transfer(bench, frequency * np.cos(turn), frequency * np.sin(turn))
    # The window cuts off the tube's far wings, which move all frequencies alike by a fraction of a
    # per cent.
    assert found == pytest.approx(expected, abs=0.005)


def test_edge_turned_by_a_small_angle_leans_to_lower_columns_further_down(bench, full):
    dark, signal = full
    image = (bench.mean("edge", Target(angle_deg=5.0), LUX) - dark) / signal
    assert image[:, -1].mean() > 0.9 and image[:, 0].mean() < 0.1
    crossing = [
        float(np.interp(0.5, image[row, 60:140], np.arange(60, 140) + 0.5)) for row in (20, 140)
    ]
    assert crossing[1] - crossing[0] == pytest.approx(
        -120 * RATIO * np.tan(np.deg2rad(5.0)), abs=0.05
    )


def test_blur_keeps_the_light(plain, full, bench):
    dark, signal = full
    image = (bench.mean("point", Target(pinhole_px=6.0), LUX) - dark) / signal
    plate = bench.mcp_input("point", Target(pinhole_px=6.0), LUX)
    q = true_quantities.true_quantities(bench.camera.description)
    # A pixel as read is two rows high and holds eight cells.
    lit = plate.values.sum(dtype=float) - plate.values.size * q["ebi_per_field"] / 8.0
    area = lit / (1e-4 * q["photoelectrons_per_lux"]) * 2.0 * RATIO
    assert area == pytest.approx(np.pi * 9.0, rel=0.03)
    assert image.sum() * RATIO == pytest.approx(np.pi * 9.0, rel=0.03)


def test_paid_blur_keeps_the_sum_and_makes_no_light(bench):
    grid = bench.camera.cells
    values = np.zeros(grid.shape, np.float32)
    values[40:60, 50:70] = 100.0
    blurred = (
        StageImage(values=values, grid=grid)
        .with_blurs(*true_quantities._after_gain(bench.camera))
        .with_blurs_applied()
    )
    assert blurred.values.sum(dtype=float) == pytest.approx(values.sum(), rel=1e-5)


def test_mtf_matches_the_published_cascade(sheet):
    """Table 1.12 at f_pc 5, 10, 15, 20 lp/mm, its pixel, lens, fibres and filter being ours, the
    halo left out.
    """
    no_halo = sheet.with_values({"photocathode.halo_fraction": 0.0})
    frequency = np.array([5.0, 10.0, 15.0, 20.0]) * 0.018
    assert true_quantities.true_mtf(no_halo, frequency, "vertical") == pytest.approx(
        [0.79, 0.49, 0.23, 0.06], abs=0.03
    )
    # The pixel clock's staircase lowers ours beside the analog filter of the table.
    staircase = np.sinc(frequency)
    assert true_quantities.true_mtf(no_halo, frequency) == pytest.approx(
        np.array([0.84, 0.64, 0.44, 0.26]) * staircase, abs=0.03
    )


def test_mtf50_is_where_the_mtf_is_one_half(sheet):
    for direction in ("horizontal", "vertical"):
        found = true_quantities.true_crossing_frequency(sheet, 0.5, direction)
        assert true_quantities.true_mtf(sheet, found, direction) == pytest.approx(0.5, abs=1e-9)
