"""No damage of a journal loses a frame in silence, hands one out changed, or costs a byte of the
record.
"""

import json
import os
import random
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from labdata import BadInput, Conditions, SessionWriter, open_lazy_stack, open_session
from labdata.store import ArrayFollower, read_journal
from labdata.store.journal import JOURNAL, _restore_frames

SHAPE = (6, 5)
FRAMES = 12
FIRST_NUMBER = 4711
NEW_NUMBER = 9999
PLACES = {
    "index": rb'(?<="index": )\d+',
    "number": rb'(?<="frame_number": )\d+',
    "time": rb'(?<="time_s": )[0-9.]+',
    "digest": rb'(?<="sha256": ")[0-9a-f]+',
    "checksum": rb'(?<="checksum": ")[0-9a-f]+',
    "punctuation": rb'[{}":, ]|index|frame_number|time_s|sha256|checksum',
    "end": rb"\n",
}


def pixels(place: int) -> np.ndarray:
    return np.random.default_rng(place).integers(0, 4096, SHAPE, dtype=np.uint16)


def begun(writer: SessionWriter):
    return writer.begin_stack("flat", "flat", SHAPE, np.uint16, Conditions())


def array_of(folder: Path) -> Path:
    return folder / "frames" / "flat.zarr"


@pytest.fixture(autouse=True)
def quick_disk(monkeypatch):
    """What survives a power cut is tested elsewhere; here the disk is forced to nothing some
    thousand times.
    """
    monkeypatch.setattr(os, "fsync", lambda file: None)


@pytest.fixture(autouse=True)
def restored_once(monkeypatch):
    """Each damage is restored once, although a journal is read by everybody who looks at its
    stack.
    """
    found: dict = {}

    def once(damaged, there, path):
        chunks = sorted((file.name, file.stat().st_mtime_ns) for file in path.glob("c.*"))
        key = (*damaged.items(), *sorted(there), *chunks)
        if key not in found:
            found[key] = tuple(_restore_frames(damaged, there, path))
        return found[key]

    monkeypatch.setattr("labdata.store.journal._restore_frames", once)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A session of one stack, finished or broken off."""

    def taken(finished: bool) -> Path:
        folder = tmp_path_factory.mktemp("sound") / "s"
        with SessionWriter.create(folder, name="sound") as writer, begun(writer) as stack:
            for place in range(FRAMES):
                stack.append(pixels(place), 0.5 + place / 30, FIRST_NUMBER + place)
            if finished:
                stack.finish()
        return folder

    return {finished: taken(finished) for finished in (True, False)}


def copied(sound: dict[bool, Path], folder: Path, *, finished: bool, journal: bytes) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sound[finished], folder)
    (array_of(folder) / JOURNAL).write_bytes(journal)
    return folder


def lines_of(sound: dict[bool, Path]) -> list[bytes]:
    return (array_of(sound[True]) / JOURNAL).read_bytes().splitlines(keepends=True)


def record_of(folder: Path) -> dict[Path, bytes]:
    """All journals and chunks below a folder."""
    return {
        path: path.read_bytes()
        for path in folder.rglob("*")
        if path.name == JOURNAL or path.name.startswith("c.")
    }


def check_reading(folder: Path) -> tuple[int, tuple[str, ...]]:
    """Read a session; return the number of frames lost, and the notes. Nothing is changed, wrong or
    lost in silence.
    """
    before, journal = record_of(folder), array_of(folder) / JOURNAL
    session = open_session(folder)
    entry = session.stack("flat")
    try:
        read = entry.read()
    except BadInput as error:
        assert str(journal) in str(error)
        return FRAMES, (str(error),)
    assert read.lost_frames == entry.lost_frames == FRAMES - len(read)
    for data, number, time_s in zip(
        read.data, read.frame_number.tolist(), read.time_s, strict=True
    ):
        place = number - FIRST_NUMBER
        assert (
            0 <= place < FRAMES
            and time_s == 0.5 + place / 30
            and np.array_equal(data, pixels(place))
        )
    assert len(set(read.frame_number.tolist())) == len(read)
    unread = open_lazy_stack(entry)
    assert np.array_equal(unread.frames(0, len(unread)), read.data)
    assert unread.frame_number.tolist() == read.frame_number.tolist()
    notes = tuple(note for note in read.notes if str(journal) in note)
    assert set(notes) == set(session.notes)
    if read.lost_frames:
        (note,) = notes
        (missing, *_) = sorted(
            set(range(FRAMES)) - set((read.frame_number - FIRST_NUMBER).tolist())
        )
        assert re.search(rf"frames? {missing}\b", note) and f"got {len(read)}" in note
    assert record_of(folder) == before
    return read.lost_frames, notes


def check_resuming(folder: Path, lost: int) -> None:
    """Go on with a stack of which frames are lost: its record is still there, in place or put
    aside.
    """
    before, journal = record_of(folder), (array_of(folder) / JOURNAL).read_bytes()
    with SessionWriter.resume(folder) as writer:
        assert writer.partial == {"flat": FRAMES - lost}
        with begun(writer) as stack:
            assert len(stack) == FRAMES - lost
            stack.append(pixels(NEW_NUMBER), 99.0, NEW_NUMBER)
            stack.finish()
    after = record_of(folder)
    assert any(
        content.startswith(journal) for path, content in after.items() if path.name == JOURNAL
    )
    kept = list(after.values())
    assert all(content in kept for path, content in before.items() if path.name != JOURNAL)
    read = open_session(folder).stack("flat").read()
    assert read.frame_number[-1] == NEW_NUMBER and np.array_equal(read.data[-1], pixels(NEW_NUMBER))
    assert len(read) == FRAMES - lost + 1
    for data, number in zip(read.data[:-1], read.frame_number.tolist(), strict=False):
        assert np.array_equal(data, pixels(number - FIRST_NUMBER))
    assert read.lost_frames == lost or any("aside" in note for note in read.notes)


def damages(line: bytes, rng: random.Random) -> Iterator[tuple[str, str, bytes]]:
    """One byte of each class of a line changed, inserted before, and removed."""
    for place, pattern in PLACES.items():
        spans = [span.span() for span in re.finditer(pattern, line)]
        for how in ("changed", "inserted", "removed"):
            at = rng.choice([at for first, last in spans for at in range(first, last)])
            byte = bytes(
                [
                    rng.choice(
                        [other for other in b'0123456789abcdefx}", \n\r\0\xff' if other != line[at]]
                    )
                ]
            )
            yield (
                place,
                how,
                line[:at] + (b"" if how == "removed" else byte) + line[at + (how != "inserted") :],
            )


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("place", [0, 1, 6, FRAMES - 1])
def test_one_damaged_byte_costs_no_frame(tmp_path, sound, finished, place, seed):
    """21 damages of four lines of a finished stack and of one that is gone on with: 168."""
    lines = lines_of(sound)
    for where, how, damaged in damages(
        lines[place], random.Random(100 * seed + place + 1000 * finished)
    ):
        journal = b"".join((*lines[:place], damaged, *lines[place + 1 :]))
        folder = copied(sound, tmp_path / "s", finished=finished, journal=journal)
        lost, notes = check_reading(folder)
        assert lost == 0, (where, how, damaged)
        # A last line that lacks its end may have been cut short by a crash, and nothing is missing.
        if (where, place) != ("end", FRAMES - 1):
            assert re.search(rf"lines? ({place + 1}|{place}|{place + 2})\b", notes[0]), (
                where,
                how,
                damaged,
            )
        if not finished:
            check_resuming(folder, lost)


@pytest.mark.parametrize("finished", [True, False])
def test_a_line_that_is_missing_is_told_and_one_that_is_there_twice_costs_nothing(
    tmp_path, sound, finished
):
    lines = lines_of(sound)
    for place, line in enumerate(lines):
        for there in ([], [line, line]):
            journal = b"".join((*lines[:place], *there, *lines[place + 1 :]))
            folder = copied(sound, tmp_path / "s", finished=finished, journal=journal)
            assert check_reading(folder)[0] == (not there)
            if not finished:
                check_resuming(folder, int(not there))


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("part", range(4))
def test_whatever_the_damage_no_frame_is_lost_in_silence_or_handed_out_changed(
    tmp_path, sound, finished, part, seed
):
    """Bytes changed by the dozen, lines cut, exchanged and swept away: 160 journals."""
    rng = random.Random(10 * seed + part)
    whole = b"".join(lines_of(sound))
    for _ in range(20):
        journal = bytearray(whole)
        for _ in range(rng.choice([2, 3, 8, 40])):
            journal[rng.randrange(len(journal))] = rng.randrange(256)
        first, last = sorted(rng.randrange(len(journal) + 1) for _ in range(2))
        how = rng.choice(["as it is", "cut", "hole", "zeros", "turned", "empty"])
        journal = {
            "as it is": journal,
            "cut": journal[:first],
            "hole": journal[:first] + journal[last:],
            "zeros": journal[:first] + bytes(last - first) + journal[last:],
            "turned": b"".join(rng.sample(lines_of(sound), FRAMES)),
            "empty": b"",
        }[how]
        folder = copied(sound, tmp_path / "s", finished=finished, journal=bytes(journal))
        lost, _ = check_reading(folder)
        if not finished:
            check_resuming(folder, lost)


def without_checksums(lines: list[bytes]) -> list[bytes]:
    return [re.sub(rb', "checksum": "[0-9a-f]+"', b"", line) for line in lines]


def test_a_journal_from_before_there_were_checksums_is_read_and_gone_on_with(tmp_path, sound):
    lines = without_checksums(lines_of(sound))
    assert b"checksum" not in b"".join(lines)
    folder = copied(sound, tmp_path / "s", finished=False, journal=b"".join(lines))
    assert check_reading(folder) == (0, ())
    check_resuming(folder, 0)


@pytest.mark.parametrize("finished", [True, False])
def test_damage_that_shows_without_checksums_is_told_as_well(tmp_path, sound, finished, seed):
    """The digits of numbers and times cannot show it; all else does."""
    lines = without_checksums(lines_of(sound))
    for place, line in enumerate(lines):
        rng = random.Random(seed + place)
        at = line.index(rng.choice([b'"frame_number"', b'"time_s"', b'"sha256"', b"}"]))
        of_another = line.replace(b'"index": %d' % place, b'"index": %d' % ((place + 5) % FRAMES))
        for there in ([], [line, line], [line[:at] + b"x" + line[at + 1 :]], [of_another]):
            journal = b"".join((*lines[:place], *there, *lines[place + 1 :]))
            folder = copied(sound, tmp_path / "s", finished=finished, journal=journal)
            assert check_reading(folder)[0] == (len(there) < 2)
            if not finished:
                check_resuming(folder, int(len(there) < 2))


def test_a_torn_line_that_a_later_run_ended_is_no_frame(tmp_path, sound):
    """Whatever part of the last line a power cut left, the stack goes on, and again after a second
    cut.
    """
    *lines, last = lines_of(sound)
    for cut in (1, 40, len(last) - 3):
        folder = copied(
            sound, tmp_path / "s", finished=False, journal=b"".join((*lines, last[:cut]))
        )
        with SessionWriter.resume(folder) as writer, begun(writer) as stack:
            assert len(stack) == FRAMES - 1
            for number in (1, 2):
                stack.append(pixels(number), float(number), number)
        journal = array_of(folder) / JOURNAL
        journal.write_bytes(journal.read_bytes()[:-20])
        with SessionWriter.resume(folder) as writer, begun(writer) as stack:
            stack.append(pixels(3), 3.0, 3)
            stack.finish()
        read = open_session(folder).stack("flat").read()
        assert read.frame_number.tolist() == [*range(FIRST_NUMBER, FIRST_NUMBER + FRAMES - 1), 1, 3]
        assert read.lost_frames == 0


def test_who_follows_a_growing_array_passes_over_damaged_lines(tmp_path, sound):
    lines = lines_of(sound)
    lines[3] = b"x" * 7 + lines[3][7:]
    folder = copied(sound, tmp_path / "s", finished=False, journal=b"".join(lines[:6]))
    follower = ArrayFollower(array_of(folder))
    assert [entry.index for entry in follower.news()] == [0, 1, 2, 4, 5]
    (array_of(folder) / JOURNAL).write_bytes(b"".join(lines))
    assert [entry.index for entry in follower.news()] == list(range(6, FRAMES))
    assert len(follower) == FRAMES - 1


def test_a_frame_is_restored_only_where_its_chunk_is_the_one_acknowledged(tmp_path, sound):
    """A line of another frame in the place of the missing one, its index made to fit, proves
    nothing.
    """
    lines = lines_of(sound)
    lines[5] = lines[5].replace(b'"time_s": ', b'"time_s": 1', 1)
    folder = copied(sound, tmp_path / "s", finished=True, journal=b"".join(lines))
    assert check_reading(folder)[0] == 0
    chunk = array_of(folder) / "c.5.0.0"
    chunk.write_bytes(bytes(len(chunk.read_bytes())))
    journal = read_journal(array_of(folder))
    assert journal.lost_frames == 1 and 5 not in {frame.index for frame in journal.frames}


def test_the_sentence_of_a_long_damage_stays_short(tmp_path, sound):
    lines = [json.dumps({"index": n}).encode() + b"\n" for n in range(FRAMES)]
    folder = copied(
        sound, tmp_path / "s", finished=True, journal=lines_of(sound)[0] + b"".join(lines[1:])
    )
    lost, (note,) = check_reading(folder)
    assert lost == FRAMES - 1
    assert (
        "lines 2, 3, 4, 5, 6 and 6 more are damaged; frames 1, 2, 3, 4, 5 and 6 more are not read"
        in note
    )
