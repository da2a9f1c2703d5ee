"""The interlaced default camera: what lines share, and scintillations in the dark."""

from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from labdata import Camera, Conditions, Target
from simulate import LabBench
from simulate.camera import (
    CameraModel,
    mcp_input_from_photoelectrons,
    true_quantities,
)
from tests.simulate import event_by_event as slow

NO_DECAY = {"phosphor.fast_decay_ms": 1e-6, "phosphor.slow_decay_ms": 1e-6}
# What the filter along the line makes of a line's beginning is no flat.
LINE_START_PX = 16
LEVEL_PE, FRAMES = 6.0, 240


# Noise of a flat.


def _deviations(sensor: Camera, seed: int) -> NDArray[np.floating]:
    """A flat's frames less their own mean in time, so that fixed patterns are gone, DN, shape
    (frame, row, col).
    """
    camera = CameraModel(replace(sensor, ccd=replace(sensor.ccd, rows=180, columns=260)))
    light = mcp_input_from_photoelectrons(camera, np.full(camera.shape, LEVEL_PE), Conditions())
    stream = camera.frames(light, Conditions(), seed=seed)
    codes = np.stack([frame.astype(float) for frame in islice(stream, FRAMES)])[
        :, :, LINE_START_PX:
    ]
    assert codes.mean() > 20.0 and codes.max() < 255.0
    return codes - codes.mean(axis=0)


@pytest.fixture(scope="module")
def glowing(sheet, seed) -> NDArray[np.floating]:
    return _deviations(sheet, seed)


@pytest.fixture(scope="module")
def lagless(sheet, seed) -> NDArray[np.floating]:
    return _deviations(sheet.with_values(NO_DECAY), seed)


def _correlation(
    x: NDArray[np.floating], rows: int, columns: int, blocks: int = FRAMES
) -> tuple[float, float]:
    """Correlation with the pixel so many rows and columns on, and its standard error by blocks of
    frames.
    """
    height, width = x.shape[1] - rows, x.shape[2] - columns
    product = (x[:, rows:, columns:] * x[:, :height, :width]).mean(axis=(1, 2)) / np.mean(x**2)
    means = product.reshape(blocks, -1).mean(axis=1)
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(blocks))


def test_without_decay_lines_of_different_fields_are_uncorrelated(lagless):
    """Truth 20: zero within three standard errors, at one line, and at three; two lines on is the
    same field.
    """
    for lines in (1, 3):
        found, error = _correlation(lagless, lines, 0)
        assert abs(found) < 3.0 * error
        assert error < 0.002
    same_field, error = _correlation(lagless, 2, 0)
    assert same_field > 30.0 * error


def test_p20_correlates_pixels_of_a_line_so_many_times_as_lines(glowing, sheet):
    """What field residuals and the overlap of row pairs predict, by the independent theory, within
    a tenth.
    """
    camera = slow.of_sensor(sheet)
    shares, weight = slow.field_shares(camera)
    decay = float(weight @ np.sum(shares**2, axis=1))
    following = float(weight @ np.sum(shares[:, 1:] * shares[:, :-1], axis=1))
    field_correlation = true_quantities.true_quantities(sheet)["field_correlation"]
    assert [following / decay, field_correlation] == pytest.approx([0.36, 0.36], abs=0.005)
    theory = slow.campbell(
        camera, LEVEL_PE / 2.0, step_e=1.0 / float(sheet.video.conversion_gain_dn_per_e)
    )
    along, along_error = _correlation(glowing, 0, 1, blocks=20)
    across, across_error = _correlation(glowing, 1, 0, blocks=20)
    predicted = theory.horizontal[0] / theory.vertical[0]
    assert along / across == pytest.approx(predicted, rel=0.1)
    assert abs(along - theory.horizontal[0] / theory.variance) < 4.5 * along_error + 0.01
    assert abs(across - theory.vertical[0] / theory.variance) < 4.5 * across_error + 0.01
    assert across == pytest.approx(0.23, abs=0.02)
    # The reference's 2.1 is of a video filter without the staircase of the pixel clock.
    assert 2.1 * 0.9 < along / across < 2.75


# Scintillations in the dark.

GATE_SHARE = 0.01
WINDOW_ROWS, WINDOW_COLUMNS = 7, 13


def _events(field: NDArray[np.floating], candidate: float) -> NDArray[np.floating]:
    """Sums of windows round the peaks of a field that stand alone and away from its borders, e-."""
    from scipy.ndimage import maximum_filter, uniform_filter

    size: Any = (WINDOW_ROWS, WINDOW_COLUMNS)
    highest: Any = maximum_filter(field, size)
    around: Any = uniform_filter(field, size=size, mode="constant") * (WINDOW_ROWS * WINDOW_COLUMNS)
    peak = (field == highest) & (field > candidate)
    border = np.zeros_like(peak)
    border[WINDOW_ROWS:-WINDOW_ROWS, WINDOW_COLUMNS + LINE_START_PX : -WINDOW_COLUMNS] = True
    return around[peak & border]


@pytest.mark.parametrize("shape", [1.0, 2.0])
def test_dark_frames_show_scintillations_at_the_ebi_rate_with_the_pulse_height_law(
    shape, plain, seed
):
    """Gate so short that events stand alone. Above a threshold, rate and heights are those of the
    gamma law.
    """
    from scipy import stats

    rows, columns, frames = 240, 320, 240
    sensor = plain(
        rows,
        columns,
        ccd__read_noise_e=4.0,
        ccd__dark_current_e_per_s=0.0,
        microchannel_plate__pulse_height_shape=shape,
    ).with_values(NO_DECAY)
    assert float(sensor.tube.luminous_gain) == 15000.0
    bench = LabBench(sensor)
    conditions = Conditions(gate_ns=GATE_SHARE * bench.camera.field_s * 1e9)
    stack = bench.expose("dark", Target(), conditions, frames=frames, seed=seed).data.astype(float)
    charge = (stack - 400.0) / float(sensor.video.conversion_gain_dn_per_e)
    camera = replace(slow.of_sensor(sensor), gate_s=GATE_SHARE / 59.94)
    height_e = camera.charge_e / camera.detection_probability
    seen = height_e * _window_share(camera)
    threshold = 0.8 * seen
    found = np.concatenate(
        [_events(f[parity::2], 0.08 * height_e) for f in charge for parity in (0, 1)]
    )
    found = found[found > threshold]
    # 1.129 photoelectrons per s and chip pixel; a field's pixels have two rows each.
    searched = (
        (rows / 2 - 2 * WINDOW_ROWS) * (columns - 2 * WINDOW_COLUMNS - LINE_START_PX) * 2 * frames
    )
    expected = 2.0 * 1.129 * GATE_SHARE / 59.94 * camera.detection_probability * searched
    law = stats.gamma(shape, scale=seen / shape)
    expected_above = expected * float(law.sf(threshold))
    assert len(found) > 1000
    # Two in a window count as one, which a share of a few per cent of them does.
    crowding = expected / searched * WINDOW_ROWS * WINDOW_COLUMNS
    assert crowding < 0.03
    assert (
        abs(len(found) - expected_above) < 3.0 * np.sqrt(expected_above) + crowding * expected_above
    )
    above = (law.cdf(found) - law.cdf(threshold)) / law.sf(threshold)
    assert stats.kstest(above, "uniform").pvalue > 1e-3
    # The wrong law is told: an exponential's events are no Polya's.
    other = stats.gamma(3.0 - shape, scale=seen / (3.0 - shape))
    wrong = (other.cdf(found) - other.cdf(threshold)) / other.sf(threshold)
    assert stats.kstest(wrong, "uniform").pvalue < 1e-3


def _window_share(camera: slow.EventCamera) -> float:
    """Share of a pulse's light in the window round its pixel, over all places within the pixel."""
    rows, columns = 2 * WINDOW_ROWS, WINDOW_COLUMNS
    table = slow.pixel_response(camera, 4 * rows, 4 * columns, slow.PHASES)
    pair = table + np.roll(table, slow.PHASES, axis=0)
    pair = sum(
        (tap * np.roll(pair, -n * slow.PHASES, axis=1) for n, tap in enumerate(camera.video_taps)),
        start=0.0,
    )
    total = np.asarray(pair).shape
    row, col = total[0] // 2 - slow.PHASES, total[1] // 2
    # Places of an event that pixels of the window see: the peak's pixel is where most of the light
    # is.
    reach_rows, reach_columns = rows * slow.PHASES // 2, columns * slow.PHASES // 2
    inside = np.asarray(pair)[row - reach_rows : row + reach_rows, :]
    centre = int(np.argmax(np.asarray(pair).sum(axis=0)))
    inside = inside[:, centre - reach_columns : centre + reach_columns]
    assert abs(centre - col) < 2 * slow.PHASES
    return float(inside.sum()) / slow.PHASES**2 / 2.0
