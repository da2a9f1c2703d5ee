"""A gate out of step with the camera's fields makes bands between fields and a beat of frames; in
step, neither.
"""

from dataclasses import replace

import numpy as np
import pytest

from labdata import (
    BadInput,
    CameraSettings,
    Gating,
    InstrumentConfig,
    Target,
    fields_open_ns,
    load_sensor,
    out_of_step,
)
from simulate.virtual_bench.bench import VirtualBench
from simulate.virtual_bench.in_process import InProcessCamera
from simulate.virtual_bench.outputs import Outputs
from simulate.virtual_bench.tube import Fields

FRAMES = 10


def test_the_time_open_in_each_exposure_is_that_of_a_picture_of_it():
    """Against a drawing of the gate, nanosecond by hundred nanoseconds."""
    width_ns, rate_hz, exposure_s = 3.7e6, 60.0, 0.0123
    begins_s = np.array([0.0, 0.0011, 0.009, 0.0162, 0.0166, 0.9])
    open_ns = fields_open_ns(begins_s, exposure_s, width_ns=width_ns, rate_hz=rate_hz)
    for begin_s, found_ns in zip(begins_s, open_ns, strict=True):
        moments_s = begin_s + np.arange(0.0, exposure_s, 1e-7)
        drawn_ns = 100.0 * np.count_nonzero(np.mod(moments_s, 1.0 / rate_hz) < width_ns * 1e-9)
        assert found_ns == pytest.approx(drawn_ns, abs=400.0)


@pytest.mark.parametrize(
    ("gating", "exposure_s", "varies"),
    [
        (Gating(), 1 / 59.94, None),  # one opening a field, wherever it falls
        (Gating(), 0.004, "100%"),  # an opening that may miss the exposure
        # a field is 17 us longer than the mains' period
        (
            Gating(sync="line-locked"),
            1 / 59.94,
            "1.67%",
        ),
        (Gating(sync="line-locked", line_hz=50.0), 1 / 59.94, "100%"),  # one field in six has none
        (Gating(sync="triggered"), 1 / 59.94, None),
        (Gating(sync="triggered", delay_ns=1.3e7), 0.004, None),
    ],
)
def test_a_plan_is_told_where_gate_and_fields_do_not_keep_step(gating, exposure_s, varies):
    told = out_of_step(gating, width_ns=1e6, exposure_s=exposure_s, field_hz=59.94)
    assert (told is None) == (varies is None)
    assert told is None or f"varies by {varies} of the opening" in told


def frames_of(folder, **gate) -> np.ndarray:
    """Frames of a flat before a gate, of a camera of 50 fields a second, shape (frame, row,
    col).
    """
    sensor = load_sensor("pulnix-ag5745ef3")
    video = replace(sensor.video, field_rate_hz=replace(sensor.video.field_rate_hz, value=50.0))
    small = replace(sensor, ccd=replace(sensor.ccd, rows=24, columns=36), video=video)
    with VirtualBench(folder, small, 3, wires=InstrumentConfig(bench="in-process")) as bench:
        outputs = Outputs(mcp_v=700.0, **gate)
        bench.operator.place(kind="flat", target=Target(), illuminance_lux=4e-4)
        camera = InProcessCamera(folder.resolve(), lambda: outputs)
        camera.configure(CameraSettings(exposure_s=0.02))
        with camera.capture(frames=FRAMES) as capture:
            return np.stack([frame.pixels for frame in capture]).astype(float)


def bands(frames: np.ndarray) -> np.ndarray:
    """Difference of the two fields of each frame over their mean, dimensionless."""
    even, odd = frames[:, 4:-4:2].mean(axis=(1, 2)), frames[:, 5:-4:2].mean(axis=(1, 2))
    return (even - odd) / (0.5 * (even + odd))


def test_a_gate_locked_to_the_mains_before_a_50_hz_camera_bands_and_beats(
    tmp_path,
):
    """Six openings in five fields: some field has more than its neighbour, and it is the same again
    five frames on.
    """
    pulse = {"gate_open": True, "gate_ns": 4e6, "gate_hz": 60.0}
    mains = frames_of(tmp_path / "mains", gate_trigger="mains", **pulse)
    triggered = frames_of(tmp_path / "camera", gate_trigger="camera", **pulse)
    banded = np.abs(bands(mains)) > 0.1
    assert np.count_nonzero(banded) == 4
    assert np.array_equal(banded[:5], banded[5:])
    assert np.abs(bands(triggered)).max() < 0.05
    dark = frames_of(tmp_path / "dark", gate_open=False, gate_ns=0.0, gate_hz=0.0).mean()
    # Frames of ten fields hold twelve openings of the one gate and ten of the other.
    assert (mains[:10].mean() - dark) / (triggered[:10].mean() - dark) == pytest.approx(
        60.0 / 50.0, rel=0.02
    )


def test_the_share_of_an_opening_that_a_camera_sees_follows_its_delay():
    out = Outputs(
        mcp_v=0.0,
        gate_open=True,
        gate_ns=2e6,
        gate_hz=50.0,
        gate_trigger="camera",
        gate_delay_ns=9e6,
    )
    fields = Fields.of(out, field_hz=50.0, exposure_s=0.01, phase=0.0)
    assert fields.open_ns(0, 3) == pytest.approx([1e6, 1e6, 1e6])
    assert fields.in_step


def test_a_frequency_that_no_mains_has_is_refused():
    with pytest.raises(BadInput, match="line_hz must be one of 50, 60, got 55"):
        Gating(line_hz=55.0)
