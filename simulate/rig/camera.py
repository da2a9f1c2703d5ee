"""The virtual camera's own process: a GigE Vision camera on loopback whose frames are drawn as they are exposed."""

import argparse
import fcntl
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from simulate.rig import aravis_library as aravis
from simulate.rig.tube import VirtualTube

LOOPBACK = "127.0.0.1"
MODEL = "VirtualICCD"
PARENT_CHECK_S = 0.1
LOCK_WAIT_S = 300.0


def main(arguments: list[str]) -> int:
    """Run the camera until the process that started it is gone."""
    parser = argparse.ArgumentParser(prog="python -m simulate.rig.camera")
    parser.add_argument("folder", type=Path, help="folder of the bench")
    parser.add_argument("wires", type=Path, help="folder of the wires of the instruments that now run")
    parser.add_argument("serial")
    parser.add_argument("--parent", type=int, required=True, help="process whose end is ours")
    options = parser.parse_args(arguments)
    try:
        lock = hold_loopback(options.parent)
        camera = build(VirtualTube(options.folder, options.wires), options.serial)
    except BadInput as refusal:
        tell({"error": str(refusal)})
        return 1
    tell({"camera": f"Aravis-{MODEL}-{options.serial}"})
    while os.getppid() == options.parent:
        time.sleep(PARENT_CHECK_S)
    del camera, lock
    return 0


def build(tube: VirtualTube, serial: str) -> aravis.FakeCamera:
    """Switch the camera on with the size, depth and field time of its sensor."""
    sensor = tube.sensor
    camera = aravis.FakeCamera(LOOPBACK, serial)
    camera.name_model(MODEL)
    field_rate_hz = float(sensor.video.field_rate_hz)
    fields = 2 if sensor.video.interlaced else 1
    for register, value in {
        aravis.SENSOR_WIDTH: sensor.ccd.columns,
        aravis.SENSOR_HEIGHT: sensor.ccd.rows,
        aravis.WIDTH: sensor.ccd.columns,
        aravis.HEIGHT: sensor.ccd.rows,
        aravis.PIXEL_FORMAT: aravis.MONO_8 if sensor.video.bit_depth <= 8 else aravis.MONO_16,
        aravis.EXPOSURE_US: round(1e6 / field_rate_hz),
        aravis.FRAME_PERIOD_US: round(1e6 * fields / field_rate_hz),
    }.items():
        camera.write(register, value)
    camera.fill_with(_painter(camera, tube))
    return camera


def _painter(camera: aravis.FakeCamera, tube: VirtualTube) -> Callable[[int, int, int], bytes]:
    def paint(exposure_us: int, gain: int, pixel_format: int) -> bytes:
        try:
            frame = tube.expose(exposure_s=exposure_us * 1e-6, gain_db=float(gain))
            return _as_sent(frame, pixel_format, tube.sensor.video.bit_depth, _window(camera)).tobytes()
        except BaseException:
            # Nothing can leave through C; a camera that cannot expose falls dead rather than send something else.
            traceback.print_exc()
            os._exit(1)

    return paint


def _window(camera: aravis.FakeCamera) -> tuple[slice, slice]:
    row, col = camera.read(aravis.Y_OFFSET), camera.read(aravis.X_OFFSET)
    return slice(row, row + camera.read(aravis.HEIGHT)), slice(col, col + camera.read(aravis.WIDTH))


def _as_sent(frame: NDArray, pixel_format: int, bit_depth: int, window: tuple[slice, slice]) -> NDArray:
    """Return the frame's window in a pixel format; 8-bit pixels of a deeper digitiser are its upper bits."""
    if pixel_format == aravis.MONO_16:
        return np.ascontiguousarray(frame[window], "<u2")
    if pixel_format == aravis.MONO_8:
        return np.ascontiguousarray(frame[window].astype(np.int64) >> max(0, bit_depth - 8), "u1")
    raise BadInput(f"the virtual camera sends Mono8 and Mono16, got pixel format {pixel_format:#x}")


def hold_loopback(parent: int) -> IO[str]:
    """Wait for the one GigE Vision port that loopback has, and hold it for this process."""
    lock = (Path(tempfile.gettempdir()) / f"charact-virtual-camera-{os.getuid()}.lock").open("w")
    until_s = time.monotonic() + LOCK_WAIT_S
    told = False
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except OSError:
            if not told:
                tell({"waiting": "another virtual camera holds the loopback"})
                told = True
        if os.getppid() != parent or time.monotonic() > until_s:
            raise BadInput(f"one virtual camera runs on a machine at a time, waited {LOCK_WAIT_S:g} s for another")
        time.sleep(PARENT_CHECK_S)


def tell(message: dict[str, str]) -> None:
    """Tell the bench, one JSON object a line."""
    print(json.dumps(message), flush=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
