"""A GigE Vision camera on loopback whose every frame can be told from its number: Aravis' fake
camera, losing packets.

Run as `python -m tests.drivers.pattern_camera FOLDER SERIAL PARENT LOST_PACKET_SHARE`.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from simulate.virtual_bench import aravis_library as aravis
from simulate.virtual_bench.camera import LOOPBACK, hold_loopback
from tests.drivers.fake_video import luma

ROWS, COLUMNS, PERIOD_US = 61, 84, 10_000
# Packets of a frame of 61 x 84 bytes: four of at most 1400 bytes or so, a leader and a trailer
PACKETS = 4 + 2


def main(folder: Path, serial: str, parent: int, lost_packet_share: float) -> None:
    lock = hold_loopback(parent)
    description = folder / "camera.genicam.xml"
    description.write_text(aravis.genicam_description(1e5))
    wire = aravis.FakeCamera(LOOPBACK, serial, description)
    wire.lose_packets(lost_packet_share)
    for register, value in {
        aravis.Register.SENSOR_WIDTH: COLUMNS,
        aravis.Register.SENSOR_HEIGHT: ROWS,
        aravis.Register.WIDTH: COLUMNS,
        aravis.Register.HEIGHT: ROWS,
        aravis.Register.PIXEL_FORMAT: aravis.MONO_8,
        aravis.Register.FRAME_PERIOD_US: PERIOD_US,
    }.items():
        wire.write(register, value)

    def pixels(number: int) -> bytes:
        deep = wire.read(aravis.Register.PIXEL_FORMAT) == aravis.MONO_16
        size = wire.read(aravis.Register.HEIGHT), wire.read(aravis.Register.WIDTH)
        return luma(number, *size, deep=deep).astype("<u2" if deep else "u1").tobytes()

    wire.fill_frames(pixels)
    print(f"Aravis-Fake-{serial}", flush=True)
    while os.getppid() == parent:
        time.sleep(0.05)
    lock.close()
    os._exit(0)


@contextmanager
def running(folder: Path, lost_packet_share: float) -> Iterator[str]:
    """The camera's identifier while it runs."""
    serial = f"PT{os.getpid()}"
    arguments = [str(folder), serial, str(os.getpid()), str(lost_packet_share)]
    with subprocess.Popen(
        [sys.executable, "-m", "tests.drivers.pattern_camera", *arguments],
        cwd=Path(__file__).resolve().parents[2],
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            while (line := (process.stdout.readline() if process.stdout else "")).startswith("{"):
                pass
            assert line, "the camera must come up"
            yield line.strip()
        finally:
            process.kill()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
