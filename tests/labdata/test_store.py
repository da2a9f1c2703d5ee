"""The store: what was acknowledged is there and whole, whenever the writer dies."""

import hashlib
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from labdata import (
    BadInput,
    Conditions,
    Frame,
    LostFrames,
    SessionWriter,
    StackWriter,
    Target,
    open_session,
    store,
)
from labdata.session import read_manifest
from labdata.store.array_writer import ArrayWriter

SHAPE = (49, 77)

# Appends frames for ever and tells of each once append has returned.
WRITER = """
import sys
import numpy as np
from pathlib import Path
from labdata import Conditions
from labdata.session_writer import SessionWriter

folder = Path(sys.argv[1])
if (folder / "session.toml").exists():
    writer = SessionWriter.resume(folder)
else:
    writer = SessionWriter.create(folder, name="killed")
stack = writer.begin_stack("flat", "flat", (493, 768), np.uint16, Conditions(mcp_v=700.0))
print("begun", len(stack), flush=True)
while True:
    n = len(stack)
    frame = np.random.default_rng(n).integers(0, 65536, (493, 768), dtype=np.uint16)
    done = stack.append(frame, n / 30, n)
    print(done.index, done.sha256, flush=True)
"""


def expected_sha256(index: int) -> str:
    frame = np.random.default_rng(index).integers(0, 65536, (493, 768), dtype=np.uint16)
    return hashlib.sha256(frame.tobytes()).hexdigest()


def killed_after(frames: int, folder: Path) -> list[str]:
    """Start the writer, kill it -9 once it has told of some frames, and return all that it told."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(folder)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    told = [process.stdout.readline() for _ in range(frames + 1)]
    os.kill(process.pid, signal.SIGKILL)
    told += process.stdout.readlines()
    process.stdout.close()
    process.wait()
    return [line for line in told if line.endswith("\n") and not line.startswith("begun")]


def test_every_acknowledged_frame_outlives_a_kill(tmp_path, seed):
    rng = np.random.default_rng(seed)
    folder = tmp_path / "session"
    told: dict[int, str] = {}
    for _ in range(5):
        lines = killed_after(int(rng.integers(1, 25)), folder)
        told |= {int(index): digest for index, digest in map(str.split, lines)}
        stack = open_session(folder).stack("flat").read()
        assert len(stack) >= len(told)
        assert stack.frame_number.tolist() == list(range(len(stack)))
        assert [store.sha256(frame) for frame in stack.data] == [
            expected_sha256(n) for n in range(len(stack))
        ]
        assert all(expected_sha256(index) == digest for index, digest in told.items())
    assert sorted(told) == list(range(len(told)))


def test_the_array_of_a_killed_writer_opens_with_zarr_alone(tmp_path):
    import zarr

    folder = tmp_path / "session"
    lines = killed_after(3, folder)
    array = zarr.open_array(folder / "frames" / "flat.zarr", mode="r")
    assert array.metadata.zarr_format == 3
    assert array.chunks == (1, 493, 768)
    assert array.shape[0] >= len(lines)
    assert hashlib.sha256(np.asarray(array[0]).tobytes()).hexdigest() == expected_sha256(0)


def frame(level: int) -> np.ndarray:
    return np.full(SHAPE, level, np.uint8)


def append_all(folder: Path, *levels: int) -> None:
    """Append frames to an array behind those that it has, and close it."""
    array = ArrayWriter(folder / "a.zarr", SHAPE, np.uint8)
    for level in levels:
        array.append(frame(level), float(len(array)), len(array))
    array.close()


def writer_of(folder: Path, **keys) -> SessionWriter:
    return SessionWriter.create(folder, name="test", **keys)


def begun(writer: SessionWriter, label: str = "flat", **changes) -> StackWriter:
    keys = {
        "kind": "flat",
        "shape": SHAPE,
        "dtype": np.uint8,
        "conditions": Conditions(mcp_v=700.0),
        **changes,
    }
    return writer.begin_stack(label, **keys)


def test_frames_come_back_with_their_stamps_numbers_and_losses(tmp_path):
    taken = {"asked": Conditions(mcp_v=701.0), "target": Target(contrast=0.9)}
    with (
        writer_of(tmp_path / "s", sensor="pulnix-ag5745ef3", bit_depth=8) as writer,
        begun(writer, **taken) as stack,
    ):
        for n in range(4):
            stack.append(frame(10 * n), 0.5 + n / 30, 100 + 2 * n)
        stack.finish(
            losses=(LostFrames(first=101, last=103, reason="missing packets"),), notes=("warm",)
        )
    entry = open_session(tmp_path / "s").stack("flat")
    read = entry.read()
    assert read.data[:, 0, 0].tolist() == [0, 10, 20, 30]
    assert read.time_s == pytest.approx([0.5 + n / 30 for n in range(4)])
    assert read.frame_number.tolist() == [100, 102, 104, 106]
    assert read.lost_frames == 3
    assert entry.losses == (LostFrames(first=101, last=103, reason="missing packets"),)
    assert read.notes == ("warm",)
    assert read.full_scale_dn == 255
    assert entry.conditions == Conditions(mcp_v=700.0)
    assert entry.asked == Conditions(mcp_v=701.0)
    assert entry.target == Target(contrast=0.9)
    assert entry.finished


def test_a_black_frame_has_its_chunk_like_any_other(tmp_path):
    append_all(tmp_path, 0)
    assert (tmp_path / "a.zarr" / "c.0.0.0").stat().st_size == frame(0).nbytes


def test_big_endian_pixels_are_refused_rather_than_turned(tmp_path):
    array = ArrayWriter(tmp_path / "a.zarr", SHAPE, np.uint16)
    with pytest.raises(BadInput, match=r"must be \(49, 77\) uint16, got"):
        array.append(np.zeros(SHAPE, ">u2"), 0.0, 0)
    with pytest.raises(BadInput, match="must be"):
        array.append(np.zeros((3, 3), "<u2"), 0.0, 0)
    array.close()


def test_a_frame_is_on_the_disk_before_the_array_grows_and_the_array_before_the_journal(
    tmp_path, monkeypatch
):
    array = ArrayWriter(tmp_path / "a.zarr", SHAPE, np.uint8)
    events = []
    fsync, replace = os.fsync, os.replace

    def logged_fsync(descriptor):
        events.append(("sync", Path(os.readlink(f"/proc/self/fd/{descriptor}")).name))
        fsync(descriptor)

    def logged_replace(source, target):
        events.append(("rename", Path(target).name))
        replace(source, target)

    monkeypatch.setattr(os, "fsync", logged_fsync)
    monkeypatch.setattr(os, "replace", logged_replace)
    array.append(frame(7), 0.0, 0)
    array.close()
    assert [(what, re.sub(r"^\.(.*)\.\w+\.partial$", r"\1", name)) for what, name in events] == [
        ("sync", "c.0.0.0"),
        ("sync", "zarr.json"),
        ("rename", "zarr.json"),
        ("sync", "a.zarr"),
        ("sync", "journal.jsonl"),
    ]


def test_the_array_grows_only_when_every_frame_written_with_it_is_on_the_disk(
    tmp_path, monkeypatch
):
    array = ArrayWriter(tmp_path / "a.zarr", SHAPE, np.uint8)
    fsync, done = os.fsync, []

    def slow_fsync(descriptor):
        name = Path(os.readlink(f"/proc/self/fd/{descriptor}")).name
        time.sleep(0.02 * name.startswith("c."))
        fsync(descriptor)
        done.append(name)

    monkeypatch.setattr(os, "fsync", slow_fsync)
    array.extend([Frame(pixels=frame(n), number=n, time_s=n / 30) for n in range(11)])
    array.close()
    assert sorted(done[:11]) == sorted(f"c.{n}.0.0" for n in range(11))
    assert done[-1] == "journal.jsonl"


def test_frames_written_together_are_the_same_as_one_after_the_other(tmp_path):
    frames = [Frame(pixels=frame(10 * n), number=5 + n, time_s=n / 30) for n in range(5)]
    together, apart = (
        ArrayWriter(tmp_path / name, SHAPE, np.uint8) for name in ("a.zarr", "b.zarr")
    )
    told = together.extend(frames[:3]) + together.extend(frames[3:])
    assert told == tuple(apart.append(each.pixels, each.time_s, each.number) for each in frames)
    together.close()
    apart.close()
    for name in ("zarr.json", "journal.jsonl", "c.3.0.0"):
        assert (tmp_path / "a.zarr" / name).read_bytes() == (
            tmp_path / "b.zarr" / name
        ).read_bytes()


def test_an_array_does_not_show_a_frame_that_was_torn_by_a_crash(tmp_path):
    import zarr

    append_all(tmp_path, 1)
    (tmp_path / "a.zarr" / "c.1.0.0").write_bytes(b"torn")
    assert zarr.open_array(tmp_path / "a.zarr", mode="r").shape[0] == 1
    append_all(tmp_path, 2)
    assert store.read(tmp_path / "a.zarr").data[:, 0, 0].tolist() == [1, 2]


def test_a_last_line_cut_short_is_not_acknowledged_and_stays_where_it_is(tmp_path):
    append_all(tmp_path, 0, 1, 2)
    journal = tmp_path / "a.zarr" / "journal.jsonl"
    whole = journal.read_bytes()
    for cut in range(len(whole)):
        journal.write_bytes(whole[:cut])
        # A line that lacks nothing but its end is whole: its checksum says so.
        complete = (whole[:cut] + b"\n").count(b"}\n")
        assert len(store.read_journal(tmp_path / "a.zarr").frames) == complete
    journal.write_bytes(whole[:-5])
    append_all(tmp_path, 9)
    assert store.read(tmp_path / "a.zarr").data[:, 0, 0].tolist() == [0, 1, 9]
    assert journal.read_bytes().startswith(whole[:-5] + b"\n")
    assert (tmp_path / "a.zarr" / "c.2.0.0.aside-1").read_bytes() == frame(2).tobytes()


@pytest.mark.parametrize("file", ["", "journal.jsonl"])
def test_a_full_disk_is_a_sentence_and_what_it_did_not_take_whole_leaves_nothing_behind(
    tmp_path, monkeypatch, file
):
    """Full for every file, and for the lines of the journal alone."""
    array = ArrayWriter(tmp_path / "a.zarr", SHAPE, np.uint8)
    array.append(frame(1), 0, 0)
    fsync = os.fsync

    def full(descriptor):
        if os.readlink(f"/proc/self/fd/{descriptor}").endswith(file):
            raise OSError(28, "No space left on device")
        fsync(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(
            BadInput, match="the disk must take every frame, got 'No space left on device' after 1 "
        ):
            array.extend([Frame(pixels=frame(n), number=n, time_s=n) for n in (2, 3)])
    assert not list((tmp_path / "a.zarr").glob(".*.partial"))
    array.append(frame(4), 4, 4)
    array.close()
    read = store.read(tmp_path / "a.zarr")
    assert (read.frame_number.tolist(), read.data[:, 0, 0].tolist()) == ([0, 4], [1, 4])
    assert (read.lost_frames, read.notes) == (0, ())


def test_a_frame_that_changed_on_the_disk_is_refused(tmp_path):
    append_all(tmp_path, 0, 1, 2)
    chunk = tmp_path / "a.zarr" / "c.1.0.0"
    content = bytearray(chunk.read_bytes())
    content[5] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(BadInput, match="got other pixels in frame 1"):
        store.read(tmp_path / "a.zarr")
    chunk.unlink()
    with pytest.raises(BadInput, match="got other pixels in frame 1"):
        store.read(tmp_path / "a.zarr")


def test_resuming_goes_on_behind_the_last_frame_and_keeps_what_is_finished(tmp_path):
    with writer_of(tmp_path / "s") as writer:
        with begun(writer, "dark", kind="dark") as stack:
            stack.append(frame(1), 0, 0)
            stack.finish()
        with begun(writer) as stack:
            stack.append(frame(2), 0, 0)
    assert not open_session(tmp_path / "s").stack("flat").finished
    assert "broken off after 1 frames" in open_session(tmp_path / "s").stack("flat").read().notes[0]
    with SessionWriter.resume(tmp_path / "s") as writer:
        assert writer.finished_labels == ("dark",)
        assert writer.partial == {"flat": 1}
        with pytest.raises(BadInput, match="a complete stack cannot be begun again, got 'dark'"):
            begun(writer, "dark", kind="dark")
        with begun(writer) as stack:
            assert len(stack) == 1
            stack.append(frame(3), 1, 1)
            stack.finish()
        assert writer.partial == {}
    session = open_session(tmp_path / "s")
    assert [entry.label for entry in session.stacks] == ["dark", "flat"]
    assert session.stack("flat").read().data[:, 0, 0].tolist() == [2, 3]


def test_frames_that_a_kill_left_before_the_manifest_knew_of_them_are_no_part_of_their_stack(
    tmp_path, monkeypatch
):
    with writer_of(tmp_path) as writer:
        monkeypatch.setattr(writer, "_save", lambda form: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt), begun(writer) as stack:
            stack.append(frame(1), 0.0, 1)
    with SessionWriter.resume(tmp_path) as writer:
        assert writer.partial == {}
        with begun(writer) as stack:
            assert len(stack) == 0
            for number in (8, 9):
                stack.append(frame(number), 0.1 * number, number)
            stack.finish()
    assert open_session(tmp_path).stack("flat").read().frame_number.tolist() == [8, 9]
    (aside,) = (tmp_path / "frames").glob("flat.aside-*.zarr")
    assert store.read(aside).frame_number.tolist() == [1]


@pytest.mark.parametrize("harm", [Path.unlink, lambda path: os.truncate(path, 200)])
@pytest.mark.parametrize("at_end", [False, True])
def test_a_journal_that_is_removed_or_cut_ends_the_run_and_costs_no_frame(tmp_path, harm, at_end):
    with writer_of(tmp_path) as writer, begun(writer) as stack:
        for number in range(4):
            stack.append(frame(number), 0.1 * number, number)
        harm(tmp_path / "frames" / "flat.zarr" / "journal.jsonl")
        with pytest.raises(BadInput, match=r"during a run, got .* after 4 frames"):
            stack.finish() if at_end else stack.append(frame(9), 1.0, 9)
    assert open_session(tmp_path).stack("flat").read().frame_number.tolist() == [0, 1, 2, 3]
    with SessionWriter.resume(tmp_path) as writer, begun(writer) as stack:
        stack.append(frame(9), 1.0, 9)
        stack.finish()
    assert len(open_session(tmp_path).stack("flat").read()) == 5


def test_no_flipped_bit_of_a_manifest_is_read_as_another_record(tmp_path):
    with writer_of(tmp_path) as writer, begun(writer) as stack:
        stack.append(frame(1), 0.0, 1)
        stack.finish()
    path = tmp_path / "session.toml"
    written, form = path.read_bytes(), read_manifest(tmp_path)
    for place in range(8 * len(written)):
        flipped = bytearray(written)
        flipped[place // 8] ^= 1 << place % 8
        path.write_bytes(flipped)
        with suppress(BadInput):
            assert read_manifest(tmp_path) == form
    *lines, _ = written.decode().splitlines()
    path.write_text("\n".join(lines).replace("test", "by hand"))
    assert open_session(tmp_path).name == "by hand"


def test_a_stack_goes_on_only_as_it_was_begun(tmp_path):
    with writer_of(tmp_path / "s") as writer, begun(writer, asked=Conditions(mcp_v=700.0)) as stack:
        stack.append(frame(2), 0, 0)
    with SessionWriter.resume(tmp_path / "s") as writer:
        with pytest.raises(BadInput, match="another kind, target or setting for 'flat'"):
            begun(writer, asked=Conditions(mcp_v=720.0))
        with pytest.raises(
            BadInput, match=r"was begun with frames of \(49, 77\) uint8, got \(4, 4\) uint8"
        ):
            begun(writer, asked=Conditions(mcp_v=700.0), shape=(4, 4))
        writer.set_aside("flat")
        with begun(writer, shape=(4, 4)) as stack:
            assert len(stack) == 0
            stack.append(np.zeros((4, 4), np.uint8), 0, 0)
            stack.finish()
    assert open_session(tmp_path / "s").stack("flat").read().shape == (1, 4, 4)


def test_a_stack_without_frames_is_no_part_of_the_session(tmp_path):
    with writer_of(tmp_path / "s") as writer:
        with begun(writer, "dark", kind="dark") as stack:
            stack.append(frame(1), 0, 0)
            stack.finish()
        with (
            begun(writer) as stack,
            pytest.raises(BadInput, match="at least one frame, got none in 'flat'"),
        ):
            stack.finish()
    assert [entry.label for entry in open_session(tmp_path / "s").stacks] == ["dark"]


def test_two_writers_do_not_share_a_session(tmp_path):
    code = (
        "import sys; from labdata.session_writer import SessionWriter; "
        "SessionWriter.resume(sys.argv[1])"
    )
    with writer_of(tmp_path / "s"):
        other = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / "s")], capture_output=True, text=True
        )
    assert other.returncode == 1
    assert "one process may write to a session at a time" in other.stderr
    assert (
        subprocess.run([sys.executable, "-c", code, str(tmp_path / "s")], check=False).returncode
        == 0
    )


@pytest.mark.parametrize("label", ["", "a/b", ".hidden", "a\\b"])
def test_a_label_that_is_no_file_name_is_refused(tmp_path, label):
    with (
        writer_of(tmp_path / "s") as writer,
        pytest.raises(BadInput, match="a label must be a file name"),
    ):
        begun(writer, label)
