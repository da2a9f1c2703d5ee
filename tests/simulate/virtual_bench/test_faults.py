"""The virtual bench with faults, in rehearsal, and with a gate out of step with the fields."""

import time
from dataclasses import replace

import numpy as np
import pytest
import serial

from labdata import (
    BadInput,
    CameraSettings,
    EventLog,
    Gating,
    InstrumentConfig,
    Target,
    fields_open_ns,
    from_mapping,
    load_sensor,
    out_of_step,
)
from simulate.virtual_bench.bench import VirtualBench
from simulate.virtual_bench.faults import Faults, inject_faults
from simulate.virtual_bench.in_process import InProcessCamera, InProcessInstruments
from simulate.virtual_bench.instruments.meters import LUX_PER_W
from simulate.virtual_bench.outputs import Outputs, read_outputs
from simulate.virtual_bench.process import VirtualInstruments
from simulate.virtual_bench.rehearsal import FaultScript, Rehearsal, ScriptedFault
from simulate.virtual_bench.tube import Fields

# Faults from outside an instrument's line: its panel, its obedience, its triggers, its port, and
# the room's light.


FAST = 1e4
OPEN = ("LAMP 1,4", "DLAY 3,2,0.016", "TRAT 60")
SUPPLY_ON = "VSET 650;HVON"


@pytest.fixture
def instruments():
    return InProcessInstruments(time_scale=FAST)


def told(port, *commands: str) -> None:
    for command in commands:
        port.send(command.encode() + b"\n")


def asked(port, question: str) -> str:
    port.send(question.encode() + b"\n")
    return port.receive(0.01).decode().strip()


def supply_told(instruments, *commands: str) -> None:
    told(instruments.supply_port, "++auto 0", "++addr 14", *commands)


def supply_asked(instruments, question: str) -> str:
    supply_told(instruments, question)
    return asked(instruments.supply_port, "++read eoi")


def settled_v(instruments) -> float:
    """Output once it has moved, V."""
    time.sleep(0.01)
    return instruments.outputs().mcp_v


def test_what_is_entered_at_a_panel_is_done_once_and_shows_on_the_line(instruments):
    gate = instruments.gate_port
    gate.faults = Faults(panel=("LOFF 1,2",))
    assert float(asked(gate, "LOFF? 1")) == 2.0
    assert instruments.outputs().gate_open
    told(gate, "LOFF 1,0")
    gate.faults = Faults(panel=("LOFF 1,2",), mute=True)
    assert not instruments.outputs().gate_open, "it was entered once"
    instruments.supply_port.faults = Faults(panel=("VSET 650", "HVON"))
    assert settled_v(instruments) == 650.0
    assert float(supply_asked(instruments, "VSET?")) == 650.0


def test_a_disobedient_supply_takes_orders_and_its_output_stays(instruments):
    supply_told(instruments, SUPPLY_ON)
    assert settled_v(instruments) == 650.0
    instruments.supply_port.faults = Faults(disobedient=True)
    supply_told(instruments, "HVOF")
    assert settled_v(instruments) == 650.0
    assert not int(supply_asked(instruments, "*STB?")) & 128, "it says that it is off"
    assert float(supply_asked(instruments, "VOUT?")) == 650.0, "what it measures is true"
    instruments.supply_port.faults = Faults()
    assert settled_v(instruments) < 650.0


def test_a_disobedient_gate_answers_what_was_set_and_stays_open(instruments):
    gate = instruments.gate_port
    told(gate, *OPEN, "TSRC 0")
    gate.faults = Faults(disobedient=True)
    told(gate, "TSRC 5")
    assert asked(gate, "TSRC?") == "5"
    assert instruments.outputs().gate_open
    gate.faults = Faults()
    assert not instruments.outputs().gate_open


@pytest.mark.parametrize(("source", "opens"), [("1", False), ("0", True)])
def test_without_pulses_at_its_input_only_a_gate_of_its_own_clock_opens(instruments, source, opens):
    gate = instruments.gate_port
    told(gate, *OPEN, f"TSRC {source}")
    assert instruments.outputs().gate_open
    gate.faults = Faults(untriggered=True)
    assert instruments.outputs().gate_open is opens


def test_room_light_falls_on_darks_and_on_the_meter_through_an_open_gate(tmp_path, seed):
    sensor = load_sensor("pulnix-ag5745ef3")
    sensor = replace(sensor, ccd=replace(sensor.ccd, rows=31, columns=44))
    wires = InstrumentConfig(bench="in-process", light_meter="pm101")
    with VirtualBench(tmp_path / "bench", sensor, seed, wires=wires, time_scale=FAST) as bench:
        assert bench.inside is not None
        bench.operator.place(kind="dark", target=Target(), illuminance_lux=0.0)
        told(bench.inside.gate_port, *OPEN, "TSRC 0")
        supply_told(bench.inside, SUPPLY_ON)
        assert settled_v(bench.inside) == 650.0
        camera, full_dn = bench.in_process_camera(), 2**sensor.video.bit_depth - 1

        def saturated_share() -> float:
            with camera.capture(frames=1) as capture:
                return float(np.mean(next(iter(capture)).pixels >= full_dn))

        assert saturated_share() == 0.0
        bench.provoke("surroundings", Faults(room_light_lux=1.0))
        assert saturated_share() > 0.5
        watts = float(asked(bench.inside.ports["light-meter"], "MEAS:POW?"))
        assert watts * LUX_PER_W == pytest.approx(1.0, rel=1e-3)
        bench.provoke("surroundings", Faults())
        assert saturated_share() == 0.0


@pytest.mark.wires
def test_a_port_goes_to_another_name_and_comes_back_with_its_outputs_unchanged(tmp_path):
    with VirtualInstruments(tmp_path / "bench") as virtual:
        with serial.Serial(virtual.gate_port, 9600, timeout=0.5) as port:
            port.write("\n".join((*OPEN, "TSRC 0\n")).encode())
            port.write(b"TSRC?\n")
            assert port.read_until(b"\r\n") == b"0\r\n"
        inject_faults(virtual.folder, "delay_generator", Faults(port_name="renamed"))
        _await(lambda: (virtual.folder / "renamed").is_symlink())
        with pytest.raises(serial.SerialException):
            serial.Serial(virtual.gate_port)
        with serial.Serial(virtual.port("renamed"), 9600, timeout=0.5) as port:
            port.write(b"TSRC?\n")
            assert port.read_until(b"\r\n") == b"0\r\n"
        inject_faults(virtual.folder, "delay_generator", Faults())
        _await((virtual.folder / "delay_generator").is_symlink)
        assert not (virtual.folder / "renamed").is_symlink()
        assert read_outputs(virtual.folder).gate_open


def _await(reached) -> None:
    until_s = time.monotonic() + 5.0
    while not reached():
        assert time.monotonic() < until_s
        time.sleep(0.01)


# A script of faults strikes at its times and at its steps, heals what is over, and strikes nothing
# twice.


class Bench:
    """Notes which faults each instrument was given."""

    def __init__(self) -> None:
        self.given: dict[str, list[Faults]] = {}

    def provoke(self, instrument: str, faults: Faults) -> None:
        self.given.setdefault(instrument, []).append(faults)

    def await_faults(self, instrument: str, faults: Faults) -> None:
        until_s = time.monotonic() + 3.0
        while self.given[instrument][-1] != faults:
            assert time.monotonic() < until_s, self.given[instrument]
            time.sleep(0.005)


def rehearsal(bench, folder, *strikes) -> Rehearsal:
    script = FaultScript(fault=strikes)
    return Rehearsal(
        script, provoke=bench.provoke, steps=folder / "log.jsonl", log=folder / "rehearsal.jsonl"
    )


@pytest.fixture
def closing_after():
    logs = []
    yield lambda log: logs.append(log) or log
    for log in logs:
        log.close()


def test_a_fault_strikes_when_its_step_begins_holds_its_time_and_is_healed(tmp_path, closing_after):
    bench, log = Bench(), closing_after(EventLog(tmp_path / "log.jsonl"))
    log("step begins", step="late")  # of an earlier run: it says nothing of this one
    log.flush()
    late = ScriptedFault(
        instrument="high_voltage", kind="late answers", value=0.3, at_step="late", for_s=0.15
    )
    with rehearsal(bench, tmp_path, late):
        time.sleep(0.1)
        assert bench.given["high_voltage"] == [Faults()]
        log("step begins", step="late")
        bench.await_faults("high_voltage", Faults(late_s=0.3))
        struck_s = time.monotonic()
        bench.await_faults("high_voltage", Faults())
        assert 0.1 < time.monotonic() - struck_s < 1.0


def test_faults_that_meet_hold_together_and_a_power_cycle_is_once(tmp_path):
    bench = Bench()
    mute = ScriptedFault(instrument="delay_generator", kind="no answers", for_s=0.3)
    cycle = ScriptedFault(instrument="delay_generator", kind="power cycle", at_s=0.1, for_s=0.05)
    with rehearsal(bench, tmp_path, mute, cycle):
        bench.await_faults("delay_generator", Faults(mute=True, power_cycles=1))
        bench.await_faults("delay_generator", Faults(power_cycles=1))


def test_leaving_heals_and_a_resumed_run_goes_on_with_what_has_not_struck(tmp_path):
    first = ScriptedFault(instrument="camera", kind="stalled camera", for_s=60.0)
    second = ScriptedFault(instrument="camera", kind="packet loss", value=0.1, at_s=0.3)
    bench = Bench()
    with rehearsal(bench, tmp_path, first, second):
        bench.await_faults("camera", Faults(stalled=True))
    assert bench.given["camera"][-1] == Faults()
    bench = Bench()
    with rehearsal(bench, tmp_path, first, second):
        bench.await_faults("camera", Faults(lost_packet_share=0.1))
    assert Faults(stalled=True) not in bench.given["camera"]


@pytest.mark.parametrize(
    ("fault", "rule"),
    [
        ({"instrument": "camera", "kind": "garbage"}, "a camera must suffer one of packet loss"),
        (
            {"instrument": "high_voltage", "kind": "clock jump", "value": 1.0},
            "a camera must suffer one of packet loss",
        ),
        (
            {"instrument": "delay_generator", "kind": "trip"},
            "must be of high_voltage or light_source, got trip of",
        ),
        (
            {"instrument": "high_voltage", "kind": "no triggers"},
            "must be of delay_generator, got no triggers of",
        ),
        (
            {"instrument": "surroundings", "kind": "silence"},
            "the surroundings must suffer room light",
        ),
        (
            {"instrument": "delay_generator", "kind": "front panel"},
            "panel must hold commands for a front panel",
        ),
        (
            {"instrument": "surroundings", "kind": "room light"},
            "value must be given for late answers",
        ),
        (
            {"instrument": "high_voltage", "kind": "late answers"},
            "value must be given for late answers",
        ),
        (
            {"instrument": "camera", "kind": "packet loss", "value": 1.5},
            "must lie between 0 and 1, got 1.5",
        ),
        ({"instrument": "high_voltage", "kind": "sabotage"}, "sabotage"),
        (
            {"instrument": "high_voltage", "kind": "garbage", "for_s": 0.0},
            "strike at 0 s or later for some time",
        ),
    ],
)
def test_a_script_that_makes_no_sense_is_refused_in_a_sentence(fault, rule):
    with pytest.raises(BadInput, match=rule):
        from_mapping({"fault": [fault]}, FaultScript, where="faults.toml")


# A gate out of step with the camera's fields makes bands between fields and a beat of frames; in
# step, neither.


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
