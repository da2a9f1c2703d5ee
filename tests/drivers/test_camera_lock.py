"""The lock of the virtual camera lies where other users may write: nothing that they put there is
followed.
"""

import os
import signal
import socket
from pathlib import Path

import pytest

from labdata import BadInput
from simulate.virtual_bench.camera import hold_loopback

NAME = f"charact-virtual-camera-{os.getuid()}.lock"
PRECIOUS = "precious"


def link(path: Path) -> None:
    path.symlink_to(path.with_name("mine"))


def hanging_link(path: Path) -> None:
    path.symlink_to(path.with_name("nowhere"))


def second_name(path: Path) -> None:
    path.hardlink_to(path.with_name("mine"))


def bound(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(os.path.relpath(path))


@pytest.mark.parametrize("puts", [link, hanging_link, second_name, os.mkfifo, Path.mkdir, bound])
def test_what_another_user_put_there_is_refused_at_once_and_left_alone(tmp_path, monkeypatch, puts):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").write_text(PRECIOUS)
    puts(tmp_path / NAME)
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail("the lock was waited for"))
    signal.alarm(10)
    try:
        with pytest.raises(
            BadInput, match=r"must be a regular file of this user alone, got .* set TMPDIR to"
        ):
            hold_loopback(os.getppid(), folder=tmp_path)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert (tmp_path / "mine").read_text() == PRECIOUS
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.skipif(os.getuid() != 0, reason="only root may give files away")
def test_a_file_of_another_user_is_refused(tmp_path):
    (tmp_path / NAME).touch()
    os.chown(tmp_path / NAME, 12345, 12345)
    with pytest.raises(BadInput, match="user 12345 and 1 names"):
        hold_loopback(os.getppid(), folder=tmp_path)


def test_one_process_holds_it_at_a_time_and_its_content_stays(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("simulate.virtual_bench.camera.LOCK_WAIT_S", 0.2)
    (tmp_path / NAME).write_text(PRECIOUS)
    with (
        hold_loopback(os.getppid(), folder=tmp_path),
        pytest.raises(BadInput, match="one virtual camera runs on a machine at a time"),
    ):
        hold_loopback(os.getppid(), folder=tmp_path)
    assert "another virtual camera holds the loopback" in capsys.readouterr().out
    hold_loopback(os.getppid(), folder=tmp_path).close()
    assert (tmp_path / NAME).read_text() == PRECIOUS
