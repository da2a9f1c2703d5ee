"""Where there can be no guest, that is one sentence and no failure."""

import os
import shutil
import subprocess

import pytest

from tests.vivid import guest


def _no_root(monkeypatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda program: None)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)


def _no_network(monkeypatch) -> None:
    monkeypatch.setattr(
        shutil, "which", lambda program: "/usr/bin/apt-get" if program == "apt-get" else None
    )
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    told = "E: Some index files failed to download.\nE: Unable to locate package qemu-system-x86\n"
    monkeypatch.setattr(
        subprocess, "run", lambda *a, **k: subprocess.CompletedProcess(a, 100, "", told)
    )


def _slow_network(monkeypatch) -> None:
    _no_network(monkeypatch)

    def late(*_: object, **__: object):
        raise subprocess.TimeoutExpired("apt-get", 240)

    monkeypatch.setattr(subprocess, "run", late)


@pytest.mark.parametrize("lack", [_no_root, _no_network, _slow_network])
def test_without_the_packages_the_guest_is_skipped_in_one_sentence(monkeypatch, capsys, lack):
    lack(monkeypatch)
    assert guest.main([]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if "skipped" in line]
    assert len(said) == 1 and said[0].startswith("vivid: skipped: ")
