"""Watching a session: each stack is told once, as it lands, and the end is the run's own."""

import json
import threading

import numpy as np
import pytest

from charact.live import look_at, run_outcome, watch_stacks
from labdata import BadInput, Conditions, EventLog, SessionWriter
from tests.charact.cli.runner import done_well
from tests.charact.live.sources import edge

SHAPE = (96, 112)
FRAMES = 6


def take(
    writer: SessionWriter, label: str, kind: str, rng: np.random.Generator, finish: bool = True
) -> None:
    setting = Conditions(mcp_v=700.0, gate_ns=1e7)
    with writer.begin_stack(label, kind, SHAPE, np.uint8, setting) as stack:  # type: ignore[arg-type]
        for number in range(FRAMES):
            if kind == "edge":
                pixels = edge(rng, blur_px=1.5, shape=SHAPE)
            else:
                level, sd = (12.0, 2.0) if kind == "dark" else (90.0, 6.0)
                pixels = np.rint(rng.normal(level, sd, SHAPE)).astype(np.uint8)
            if kind == "edge":
                pixels[0, :number] = 255
            stack.append(pixels, number / 30.0, number)
        if finish:
            stack.finish()


@pytest.fixture
def session(tmp_path, seed):
    rng = np.random.default_rng(seed)
    with SessionWriter.create(tmp_path / "day", name="day", bit_depth=8) as writer:
        log = EventLog(tmp_path / "day" / "log.jsonl")
        log("run begins", plan="day")
        yield writer, log, rng
        log.close()


def test_each_stack_is_told_once_as_it_lands_and_the_watch_ends_with_the_run(session) -> None:
    writer, log, rng = session
    took, told = threading.Event(), []

    def running() -> None:
        for label, kind in (("dark", "dark"), ("flat", "flat"), ("edge", "edge")):
            take(writer, label, kind, rng)
            took.wait(5.0)
            took.clear()
        log("run ends", whole=True)

    run = threading.Thread(target=running)
    run.start()
    for so_far, entry in watch_stacks(writer.folder, look_s=0.01, patience_s=20.0):
        told.append(entry.label)
        assert entry.finished and so_far.stacks[-1] == entry
        took.set()
    run.join(5.0)
    assert told == ["dark", "flat", "edge"]


def test_a_stack_that_is_still_taken_is_not_told(session) -> None:
    writer, _, rng = session
    take(writer, "dark", "dark", rng)
    take(writer, "flat", "flat", rng, finish=False)
    assert [entry.label for _, entry in watch_stacks(writer.folder, once=True)] == ["dark"]


def test_a_run_that_failed_or_fell_silent_ends_the_watch_with_a_sentence(session) -> None:
    writer, log, rng = session
    take(writer, "dark", "dark", rng)
    with pytest.raises(BadInput, match=r"within 0\.05 s, got none"):
        list(watch_stacks(writer.folder, look_s=0.01, patience_s=0.05))
    log("run ends", whole=False, reason="camera X has gone")
    log.flush()
    with pytest.raises(BadInput, match="camera X has gone"):
        list(watch_stacks(writer.folder, look_s=0.01))
    log("run begins", plan="day", resume=True)
    log.flush()
    assert run_outcome(writer.folder) is None


def test_a_flat_is_measured_over_the_dark_of_its_setting_and_its_numbers_hold(session) -> None:
    writer, _, rng = session
    take(writer, "dark", "dark", rng)
    take(writer, "flat", "flat", rng)
    *_, (so_far, flat) = watch_stacks(writer.folder, once=True)
    looked = look_at(so_far, flat)
    assert looked.frames == FRAMES and looked.saturated_px == 0
    assert looked.mean_dn == pytest.approx(90.0, abs=0.2)
    assert looked.leading and all(m.value is None or m.interval95 for m in looked.leading)
    gain = looked.result.find("covariance_gain")[0]
    # Of white noise: the variance over the mean, what the darks hold of both taken off.
    standard_error = (gain.interval95[1] - gain.interval95[0]) / 3.92
    assert abs(gain.value - (36.0 - 4.0) / (90.0 - 12.0)) < 4.5 * standard_error
    # Six frames of so few pixels tell the gain within some eighth, and not surer than their
    # variances let them.
    assert 0.05 < standard_error / gain.value < 0.2


def test_the_verb_prints_one_line_a_stack_with_interval_and_saturation(session) -> None:
    writer, log, rng = session
    take(writer, "edge", "edge", rng)
    log("run ends", whole=True)
    (line,) = done_well("watch", writer.folder).stdout.splitlines()
    assert (
        line.startswith("edge (edge): 6 frames, 0 lost, mean ") and "at most 5 px at 255 DN" in line
    )
    assert "mtf50" in line and "cy/px [" in line and "95 %" in line
    lines = done_well("watch", writer.folder, "--once", "--json").stdout.splitlines()
    told = json.loads(lines[0])
    assert len(lines) == 1 and told["stack"] == "edge" and told["most_saturated_px"] == 5
