"""A growing session is seen as it grows, by reading alone."""

import time

import numpy as np
import pytest

from charact.live import FocusReader, LiveLoop, SessionSource
from labdata import BadInput, Conditions, SessionWriter
from labdata.store import ArrayFollower
from tests.charact.live.sources import AtOnce, edge

SHAPE = (24, 32)


def picture(value: int) -> np.ndarray:
    return np.full(SHAPE, value, np.uint16)


def begun(writer: SessionWriter, label: str, mcp_v: float):
    return writer.begin_stack(label, "flat", SHAPE, np.uint16, Conditions(mcp_v=mcp_v))


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
