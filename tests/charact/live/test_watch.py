"""Sessions and folders that grow are measured as they grow, and a camera as it runs."""

import io
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from threading import Event

import numpy as np
import pytest

from charact.live import (
    CameraSource,
    FocusReader,
    FrameRate,
    LiveLoop,
    SessionSource,
    lines,
    look_at,
    run_outcome,
    watch_on_terminal,
    watch_stacks,
)
from charact.method import Context
from labdata import BadInput, CameraSettings, Conditions, EventLog, Frame, SessionWriter
from labdata.store import ArrayFollower
from tests.charact.cli.runner import done_well
from tests.charact.live.sources import AtOnce, Told, edge, noisy, seen

# Watching a session: each stack is told once, as it lands, and the end is the run's own.


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


# A growing session is seen as it grows, by reading alone.


SMALL_SHAPE = (24, 32)


def picture(value: int) -> np.ndarray:
    return np.full(SMALL_SHAPE, value, np.uint16)


def begun(writer: SessionWriter, label: str, mcp_v: float):
    return writer.begin_stack(label, "flat", SMALL_SHAPE, np.uint16, Conditions(mcp_v=mcp_v))


def test_the_newest_frame_is_shown_with_its_stacks_conditions_and_its_lost_frames(tmp_path) -> None:
    with SessionWriter.create(tmp_path / "day", name="day", bit_depth=12) as writer:
        frames = iter(SessionSource(tmp_path / "day", look_s=0.0))
        assert next(frames) is None
        with begun(writer, "flat-1", 700.0) as stack:
            stack.append(picture(10), 1.0, 101)
            one = next(frames)
            assert one is not None and one.frame.pixels[0, 0] == 10 and one.of == "stack flat-1"
            assert (
                one.full_scale_dn == 4095.0
                and one.conditions.mcp_v == 700.0
                and one.lost_frames == 0
            )
            assert next(frames) is None
            # Two frames that were taken between two looks, and one that the camera numbered and
            # never sent.
            stack.append(picture(11), 1.1, 102)
            stack.append(picture(12), 1.3, 104)
            two = next(frames)
            assert two is not None and two.frame.pixels[0, 0] == 12 and two.lost_frames == 1
            stack.finish()
        with begun(writer, "flat-2", 800.0) as stack:
            stack.append(picture(20), 2.0, 1)
            three = next(frames)
            assert (
                three is not None and three.of == "stack flat-2" and three.conditions.mcp_v == 800.0
            )
            assert three.lost_frames == 0


def test_looking_leaves_a_session_as_it_is_and_does_not_keep_its_writer_out(tmp_path) -> None:
    with (
        SessionWriter.create(tmp_path / "day", name="day") as writer,
        begun(writer, "flat-1", 700.0) as stack,
    ):
        stack.append(picture(1), 0.0, 0)
        before = {path: path.stat().st_mtime_ns for path in (tmp_path / "day").rglob("*")}
        assert next(iter(SessionSource(tmp_path / "day"))) is not None
        assert {path: path.stat().st_mtime_ns for path in (tmp_path / "day").rglob("*")} == before
        stack.append(picture(2), 0.1, 1)


def test_a_line_cut_short_is_news_only_once_it_is_whole(tmp_path) -> None:
    with (
        SessionWriter.create(tmp_path / "day", name="day") as writer,
        begun(writer, "flat-1", 700.0) as stack,
    ):
        for number in range(3):
            stack.append(picture(number), float(number), number)
    path = tmp_path / "day" / "frames" / "flat-1.zarr"
    whole = (path / "journal.jsonl").read_bytes()
    (path / "journal.jsonl").write_bytes(whole[:-20])
    following = ArrayFollower(path)
    assert [entry.frame_number for entry in following.news()] == [0, 1]
    assert following.news() == ()
    (path / "journal.jsonl").write_bytes(whole)
    (last,) = following.news()
    assert (
        last.frame_number == 2 and following.frame(last).pixels[0, 0] == 2 and len(following) == 3
    )


def test_what_is_no_session_of_ours_is_refused_in_a_sentence(tmp_path) -> None:
    with pytest.raises(BadInput, match=r"must be a folder with a session\.toml"):
        SessionSource(tmp_path)
    np.save(tmp_path / "flat.npy", np.zeros((2, 4, 4), np.uint8))
    (tmp_path / "session.toml").write_text(
        'name = "x"\n[[stack]]\nlabel = "f"\nkind = "flat"\nframes = "flat.npy"\n'
    )
    with pytest.raises(BadInput, match="must be acquired by charact acquire"):
        next(iter(SessionSource(tmp_path)))


def test_a_stack_that_is_there_already_is_shown_with_its_noise_and_its_focus(
    tmp_path, seed
) -> None:
    rng = np.random.default_rng(seed)
    pictures = [edge(rng, blur_px=1.5, shape=(100, 100)) for _ in range(6)]
    with SessionWriter.create(tmp_path / "day", name="day") as writer:
        stack = writer.begin_stack("edge", "edge", (100, 100), np.uint8, Conditions())
        for number, pixels in enumerate(pictures):
            stack.append(pixels, number / 30.0, number)
        stack.finish()
    source = SessionSource(tmp_path / "day")
    with (
        FocusReader(source.context, None, AtOnce()) as reader,
        LiveLoop(source, focus=reader) as running,
    ):
        view, until_s = None, time.monotonic() + 20.0
        while (view is None or view.focus is None) and time.monotonic() < until_s:
            view = running.newest.after(view.number if view else 0, timeout_s=1.0)
    assert (
        view is not None
        and view.source_frame.frame.number == 5
        and view.statistics.noise_dn is not None
    )
    assert view.focus is not None and view.focus.mtf50_cy_per_px is not None


# The bench at work: a camera is only read, its rate is its own, and the terminal shows what the
# page shows.


class AskedCamera:
    """A camera that writes down what it is asked."""

    identifier = "asked"

    def __init__(self, frames: list[Frame]) -> None:
        self.asked: list[CameraSettings] = []
        self._frames, self.lost_frames = frames, 0

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self.asked.append(settings)
        return CameraSettings(
            pixel_format="Mono12", exposure_s=0.01, gain_db=6.0, frame_rate_hz=30.0
        )

    @contextmanager
    def capture(
        self, *, frames: int, discard: int = 0, while_waiting: Callable[[], None] = lambda: None
    ) -> Iterator["AskedCamera"]:
        yield self

    def __iter__(self) -> Iterator[Frame]:
        for place, frame in enumerate(self._frames):
            self.lost_frames = frame.number - self._frames[0].number - place
            yield frame


def test_a_camera_is_read_and_nothing_of_it_is_set() -> None:
    frames = [
        Frame(pixels=np.full((8, 8), n, np.uint16), number=n, time_s=n / 30.0) for n in (5, 6, 9)
    ]
    camera = AskedCamera(frames)

    @contextmanager
    def opened():
        yield camera

    # One capture after the other, without end; the first is looked at.
    shown = list(islice(CameraSource(opened(), name="asked", context=Context()), 3))
    assert camera.asked == [CameraSettings()]
    assert [one.lost_frames for one in shown if one] == [0, 0, 2]
    assert all(
        one and one.full_scale_dn == 4095.0 and one.conditions.camera_gain_db == 6.0
        for one in shown
    )


def test_the_rate_is_the_cameras_own_and_counts_frames_that_nobody_looked_at() -> None:
    rate = FrameRate()
    told = [
        rate.after(Frame(pixels=np.zeros((2, 2)), number=n, time_s=n / 25.0))
        for n in range(0, 200, 3)
    ]
    assert told[0] is None
    assert told[-1] == pytest.approx(25.0)
    # A new stack counts from the beginning.
    assert rate.after(Frame(pixels=np.zeros((2, 2)), number=1, time_s=9.0)) is None


def test_frames_of_two_stacks_are_not_subtracted_from_one_another(seed) -> None:
    rng = np.random.default_rng(seed)
    frames = [seen(noisy(rng), 1, of="one"), seen(noisy(rng, mean_dn=200), 2, of="another")]
    with LiveLoop(Told(frames, pause_s=0.05)) as running:
        while running.newest.end_reason is None:
            running.newest.after(2**62, timeout_s=1.0)
        view = running.newest.view
    assert view is not None and view.number == 2 and view.statistics.noise_dn is None


def test_the_terminal_shows_every_meter_with_its_unit_and_ends_with_a_reason(seed) -> None:
    from rich.console import Console

    rng, written = np.random.default_rng(seed), io.StringIO()
    with LiveLoop(Told([seen(noisy(rng), 1)], let_go=Event())) as running:
        view = running.newest.after(0, timeout_s=5.0)
        assert view is not None
        told = lines(view)
        running.source.let_go.set()  # type: ignore[attr-defined]
        with pytest.raises(BadInput, match="no more frames"):
            watch_on_terminal(running, title="meters", console=Console(file=written, width=120))
    assert told["saturated"].startswith("0 of 20480 px") and told["mean"].endswith("DN")
    assert told["temporal noise"] == "needs two frames"
