"""What happened is on its line, and a disk that takes no line stops nobody."""

import errno
import os

from labdata.event_log import EventLog, events


def test_events_come_back_in_order_with_their_times(tmp_path):
    log = EventLog(tmp_path / "log.jsonl")
    log("begun", plan="series")
    log("ended", frames=3)
    log.close()
    first, second = events(tmp_path / "log.jsonl")
    assert (first["event"], first["plan"], second["frames"]) == ("begun", "series", 3)
    assert first["monotonic_s"] <= second["monotonic_s"]


def test_a_line_cut_short_by_a_crash_spoils_no_other(tmp_path):
    (tmp_path / "log.jsonl").write_text('{"event": "begun"}\n{"event": "en')
    log = EventLog(tmp_path / "log.jsonl")
    log("resumed")
    log.close()
    assert [each["event"] for each in events(tmp_path / "log.jsonl")] == ["begun", "resumed"]


def test_lines_that_a_full_disk_did_not_take_are_counted_and_raise_nothing(tmp_path, monkeypatch):
    log = EventLog(tmp_path / "log.jsonl")
    write = os.write

    def full(file, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    log("lost")
    log("lost as well")
    monkeypatch.setattr(os, "write", write)
    log("found")
    log.close()
    (only,) = events(tmp_path / "log.jsonl")
    assert (only["event"], only["lines_missed_before"]) == ("found", 2)
