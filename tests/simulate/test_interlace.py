"""The interlaced default camera: what lines share, and scintillations in the dark."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from labdata import Array, Conditions, Target
from simulate import LabBench
from simulate.camera import (
    true_quantities,
)
from tests.simulate import pulse_theory

NO_DECAY = {"phosphor.fast_decay_ms": 1e-6, "phosphor.slow_decay_ms": 1e-6}
# What the filter along the line makes of a line's beginning is no flat.
LINE_START_PX = 16


def test_p20_correlates_pixels_of_a_line_so_many_times_as_lines(sheet):
    """What field residuals and the overlap of row pairs predict, by the independent theory."""
    camera = pulse_theory.of_sensor(sheet)
    shares, weight = pulse_theory.field_shares(camera)
    decay = float(weight @ np.sum(shares**2, axis=1))
    following = float(weight @ np.sum(shares[:, 1:] * shares[:, :-1], axis=1))
    field_correlation = true_quantities.true_quantities(sheet)["field_correlation"]
    assert [following / decay, field_correlation] == pytest.approx([0.36, 0.36], abs=0.005)
    theory = pulse_theory.campbell(
        camera, 3.0, step_e=1.0 / float(sheet.video.conversion_gain_dn_per_e)
    )
    assert theory.vertical[0] / theory.variance == pytest.approx(0.23, abs=0.02)
    # The reference's 2.1 is of a video filter without the staircase of the pixel clock.
    assert 2.1 * 0.9 < theory.horizontal[0] / theory.vertical[0] < 2.75


# Scintillations in the dark.

GATE_SHARE = 0.01
WINDOW_ROWS, WINDOW_COLUMNS = 7, 13


def _events(field: Array, candidate: float) -> Array:
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
    camera = replace(pulse_theory.of_sensor(sensor), gate_s=GATE_SHARE / 59.94)
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


def _window_share(camera: pulse_theory.EventCamera) -> float:
    """Share of a pulse's light in the window round its pixel, over all places within the pixel."""
    rows, columns = 2 * WINDOW_ROWS, WINDOW_COLUMNS
    table = pulse_theory.pixel_response(camera, 4 * rows, 4 * columns, pulse_theory.PHASES)
    pair = table + np.roll(table, pulse_theory.PHASES, axis=0)
    pair = sum(
        (
            tap * np.roll(pair, -n * pulse_theory.PHASES, axis=1)
            for n, tap in enumerate(camera.video_taps)
        ),
        start=0.0,
    )
    total = np.asarray(pair).shape
    row, col = total[0] // 2 - pulse_theory.PHASES, total[1] // 2
    # Places of an event that pixels of the window see: the peak's pixel is where most of the light
    # is.
    reach_rows, reach_columns = rows * pulse_theory.PHASES // 2, columns * pulse_theory.PHASES // 2
    inside = np.asarray(pair)[row - reach_rows : row + reach_rows, :]
    centre = int(np.argmax(np.asarray(pair).sum(axis=0)))
    inside = inside[:, centre - reach_columns : centre + reach_columns]
    assert abs(centre - col) < 2 * pulse_theory.PHASES
    return float(inside.sum()) / pulse_theory.PHASES**2 / 2.0
