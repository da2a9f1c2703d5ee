"""Starting and stopping the virtual camera's process."""

import hashlib
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from labdata.errors import BadInput
from simulate.virtual_bench.camera import LOCK_WAIT_S

READY_S = 60.0
STOP_S = 3.0


class CameraProcess:
    """The virtual camera on its loopback wire, between `with` and the end of its block.

    It lives in a session of its own, so that Ctrl-C at the terminal does not unplug it, and ends when the process
    that started it is gone.

    Parameters
    ----------
    folder
        Folder of the bench: its truth, and what its operator placed.
    wires
        Folder where the instruments publish what they put out.
    lost_packet_share
        Share of the packets that get lost on the wire, dimensionless.
    say
        Told in a sentence what is waited for.

    Raises
    ------
    BadInput
        On entering: if the camera cannot start.
    """

    def __init__(
        self,
        folder: Path,
        wires: Path,
        *,
        lost_packet_share: float = 0.0,
        say: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        serial = "VB" + hashlib.sha256(str(folder).encode()).hexdigest()[:10]
        self._command = [sys.executable, "-P", "-m", "simulate.virtual_bench.camera", str(folder), str(wires), serial]
        self._command += ["--lost-packet-share", str(lost_packet_share)]
        self._log, self._say = wires / "camera.stderr", say
        self.identifier = ""
        """Aravis identifier of the camera, once it runs."""

    def __enter__(self) -> Self:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [*self._command, "--parent", str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
            )
        try:
            self.identifier = self._await_camera()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    def kill(self) -> None:
        """Kill the camera at once, as a power cut would."""
        self._process.kill()
        self._process.wait()

    def _await_camera(self) -> str:
        until_s = time.monotonic() + READY_S
        while message := self._message(until_s):
            if "camera" in message:
                return message["camera"]
            if "error" in message:
                raise BadInput(message["error"])
            self._say(f"The virtual camera waits: {message['waiting']}.")
            until_s = time.monotonic() + LOCK_WAIT_S + READY_S
        raise BadInput(f"the virtual camera must come up within {READY_S:g} s, see {self._log}")

    def _message(self, until_s: float) -> dict[str, str] | None:
        """Return the next message of the camera, or None if it ended or said nothing in time."""
        if self._process.stdout is None:
            return None
        ready, _, _ = select.select([self._process.stdout], [], [], max(0.0, until_s - time.monotonic()))
        line = self._process.stdout.readline() if ready else ""
        return json.loads(line) if line else None

    def _stop(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(timeout=STOP_S)
        except subprocess.TimeoutExpired:
            self.kill()
        if self._process.stdout:
            self._process.stdout.close()
