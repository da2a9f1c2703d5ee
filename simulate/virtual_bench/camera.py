"""Virtual GigE Vision camera on loopback, in a process of its own, and its start and stop."""

import argparse
import contextlib
import fcntl
import hashlib
import json
import os
import queue
import select
import stat
import subprocess
import sys
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from typing import IO, Self

from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.virtual_bench import aravis_library as aravis
from simulate.virtual_bench.faults import FaultFile, Faults
from simulate.virtual_bench.outputs import TargetPlacement, read_outputs
from simulate.virtual_bench.process import end_processes
from simulate.virtual_bench.tube import Scene, VirtualTube

LOOPBACK = "127.0.0.1"
MODEL = "VirtualICCD"
LOCK_WAIT_S = 300.0
IDLE_S = 0.002
STUCK_S = 60.0


def main(arguments: list[str]) -> int:
    """Run the camera until the process that started it is gone."""
    parser = argparse.ArgumentParser(prog="python -m simulate.virtual_bench.camera")
    parser.add_argument("folder", type=Path, help="folder of the bench")
    parser.add_argument(
        "wires", type=Path, help="folder of the wires of the instruments that now run"
    )
    parser.add_argument("serial")
    parser.add_argument("--parent", type=int, required=True, help="process whose end is ours")
    parser.add_argument(
        "--lost-packet-share", type=float, default=0.0, help="share of packets lost on the wire"
    )
    options = parser.parse_args(arguments)
    try:
        lock = hold_loopback(options.parent)
        tube = VirtualTube(options.folder, partial(read_outputs, options.wires))
        camera = VirtualCamera(
            tube,
            options.serial,
            description=options.wires / "camera.genicam.xml",
            lost_packet_share=options.lost_packet_share,
            faults=FaultFile(options.wires, "camera"),
        )
        tube.warm_up()
    except BadInput as refusal:
        tell({"error": str(refusal)})
        return 1
    tell({"camera": f"Aravis-{MODEL}-{options.serial}"})
    while os.getppid() == options.parent:
        camera.turn()
    lock.close()
    # The wire's own thread must not outlive the pixels that it sends.
    os._exit(0)


class VirtualCamera:
    """A camera that exposes a tube's image while a client requests frames.

    Frames are drawn in this thread. The wire's own thread takes them without waiting, and so
    answers its client at any time. `description` is the file to which its GenICam description is
    written.
    """

    def __init__(
        self,
        tube: VirtualTube,
        serial: str,
        *,
        description: Path,
        faults: FaultFile,
        lost_packet_share: float = 0.0,
    ) -> None:
        self._tube, self._faults, self._lost_packet_share = tube, faults, lost_packet_share
        self._losing = lost_packet_share
        field_us = round(1e6 / float(tube.sensor.video.field_rate_hz))
        description.write_text(aravis.genicam_description(field_us))
        self._wire = aravis.FakeCamera(LOOPBACK, serial, description)
        self._wire.lose_packets(lost_packet_share)
        self._slot: queue.Queue[tuple[Scene, bytes]] = queue.Queue(maxsize=1)
        self._prepared: TargetPlacement | None = None
        self._pictures: deque[NDArray] = deque(maxlen=8)  # the last new ones
        self._sent = count()
        self._wire.name_model(MODEL)
        video, ccd = tube.sensor.video, tube.sensor.ccd
        field_rate_hz, fields = float(video.field_rate_hz), 2 if video.interlaced else 1
        for register, value in {
            aravis.Register.SENSOR_WIDTH: ccd.columns,
            aravis.Register.SENSOR_HEIGHT: ccd.rows,
            aravis.Register.WIDTH: ccd.columns,
            aravis.Register.HEIGHT: ccd.rows,
            aravis.Register.PIXEL_FORMAT: aravis.MONO_8 if video.bit_depth <= 8 else aravis.MONO_16,
            aravis.Register.EXPOSURE_US: field_us,
            aravis.Register.FRAME_PERIOD_US: round(1e6 * fields / field_rate_hz),
        }.items():
            self._wire.write(register, value)
        self._wire.send_when_triggered(field_rate_hz / fields, self._next_pixels)

    def turn(self) -> None:
        """Expose the next frame if one is requested; otherwise render a changed target."""
        self._wire.hold_trigger()
        faults = self._faults.now()
        self._lose_packets(max(faults.lost_packet_share, self._lost_packet_share))
        self._wire.clock_jump_ns = round(faults.clock_jump_s * 1e9)
        scene = self._scene()
        if faults.stalled:
            self._take_back()
            time.sleep(IDLE_S)
        elif not self._wire.read(aravis.Register.ACQUISITION):
            self._take_back()
            self._prepare(scene)
            time.sleep(IDLE_S)
        elif self._slot.empty():
            frame = self._picture(scene, faults)
            # A frame whose scene changed while it was drawn is of no time at all.
            if self._scene() == scene:
                self._slot.put((scene, self._as_sent(frame)))
                self._wire.trigger()
        else:
            time.sleep(IDLE_S)

    def _picture(self, scene: Scene, faults: Faults) -> NDArray:
        """Return the next picture: a new one, or one of the last."""
        repeated = faults.repeated_pictures
        if repeated and len(self._pictures) >= repeated:
            return self._pictures[-repeated + next(self._sent) % repeated]
        picture = self._tube.expose(scene)
        if faults.ceiling_dn is not None:
            picture = picture.clip(max=faults.ceiling_dn)
        self._pictures.append(picture)
        return self._pictures[-1]

    def _lose_packets(self, fraction: float) -> None:
        if fraction != self._losing:
            self._wire.lose_packets(fraction)
            self._losing = fraction

    def _scene(self) -> Scene:
        return self._tube.scene(
            exposure_s=self._wire.read(aravis.Register.EXPOSURE_US) * 1e-6,
            gain_db=float(self._wire.read(aravis.Register.GAIN_RAW)),
        )

    def _prepare(self, scene: Scene) -> None:
        if scene.placement != self._prepared:
            self._tube.prepare(scene)
            self._prepared = scene.placement

    def _take_back(self) -> None:
        """Withdraw an unsent frame, its trigger first: the wire would wait for another frame."""
        self._wire.take_trigger_back()
        with contextlib.suppress(queue.Empty):
            self._slot.get_nowait()

    def _next_pixels(self) -> bytes:
        """Return the pixels of the present scene; called by the wire's thread."""
        try:
            while True:
                scene, pixels = self._slot.get(timeout=STUCK_S)
                if scene == self._scene():
                    return pixels
        except BaseException:
            # Nothing can leave through C; a camera without a frame falls dead rather than send
            # something else.
            traceback.print_exc()
            os._exit(1)

    def _as_sent(self, frame: NDArray) -> bytes:
        """Return the frame's window in the pixel format; 8-bit pixels of a deeper digitiser are its
        upper bits.
        """
        row, col = (
            self._wire.read(aravis.Register.Y_OFFSET),
            self._wire.read(aravis.Register.X_OFFSET),
        )
        pixels = frame[
            row : row + self._wire.read(aravis.Register.HEIGHT),
            col : col + self._wire.read(aravis.Register.WIDTH),
        ]
        pixel_format = self._wire.read(aravis.Register.PIXEL_FORMAT)
        if pixel_format == aravis.MONO_16:
            return pixels.astype("<u2").tobytes()
        if pixel_format == aravis.MONO_8:
            return (pixels >> max(0, self._tube.sensor.video.bit_depth - 8)).astype("u1").tobytes()
        raise BadInput(
            f"the virtual camera sends Mono8 and Mono16, got pixel format {pixel_format:#x}"
        )


def hold_loopback(parent: int, *, folder: Path | None = None) -> IO[bytes]:
    """Wait for the single GigE Vision port of the loopback interface and lock it while `parent`
    lives.

    The lock is in a folder that other users may write to: anything but a file of this user is
    BadInput.
    """
    lock = _open_lock(
        (folder or Path(tempfile.gettempdir())) / f"charact-virtual-camera-{os.getuid()}.lock"
    )
    until_s = time.monotonic() + LOCK_WAIT_S
    reported = False
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except OSError:
            if not reported:
                tell({"waiting": "another virtual camera holds the loopback"})
                reported = True
        if os.getppid() != parent or time.monotonic() > until_s:
            lock.close()
            raise BadInput(
                f"one virtual camera runs on a machine at a time, waited {LOCK_WAIT_S:g} s for "
                f"another"
            )
        time.sleep(0.1)


def _open_lock(path: Path) -> IO[bytes]:
    """Open the lock file without following links, blocking on a pipe or changing its contents."""
    rule = "the lock of the virtual camera must be a regular file of this user alone"
    remedy = f"{path}: remove it, or set TMPDIR to a folder of your own"
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise BadInput(f"{rule}, got {error.strerror!r}, {remedy}") from None
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.getuid() or status.st_nlink != 1:
        os.close(descriptor)
        raise BadInput(
            f"{rule}, got one of type {stat.filemode(status.st_mode)}, user {status.st_uid} and "
            f"{status.st_nlink} names, {remedy}"
        )
    return os.fdopen(descriptor, "r+b")


def tell(message: dict[str, str]) -> None:
    """Send a message to the bench, one JSON object a line."""
    print(json.dumps(message), flush=True)


READY_S = 300.0  # A cold start compiles the loops of the frames, a minute of processor time


class CameraProcess:
    """The virtual camera on its loopback wire, between `with` and the end of its block.

    It lives in a session of its own, so that Ctrl-C at the terminal does not unplug it, and ends
    when the process that started it is gone.
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
        self._command = [
            sys.executable,
            "-P",
            "-m",
            "simulate.virtual_bench.camera",
            str(folder),
            str(wires),
            serial,
        ]
        self._command += ["--lost-packet-share", str(lost_packet_share)]
        self._log, self._say = wires / "camera.stderr", say
        self.identifier = ""  # Aravis identifier of the camera, once it runs

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

    def __exit__(self, *_: object) -> None:
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
        """Return the next message of the camera, or None if it ended or sent none in time."""
        if self._process.stdout is None:
            return None
        ready, _, _ = select.select(
            [self._process.stdout], [], [], max(0.0, until_s - time.monotonic())
        )
        line = self._process.stdout.readline() if ready else ""
        return json.loads(line) if line else None

    def _stop(self) -> None:
        end_processes(self._process)
        if self._process.stdout:
            self._process.stdout.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
