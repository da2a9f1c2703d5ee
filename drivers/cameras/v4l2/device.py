"""Open V4L2 device and its mapped buffers."""

import errno
import fcntl
import mmap
import os
import select
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.v4l2.structures import Request
from drivers.errors import CameraError

MOST_LISTED = 256  # Largest number of formats, sizes, inputs or controls; more is an endless list
_GONE = {errno.ENODEV, errno.ENXIO, errno.EBADF}


class Device:
    """A video device of this machine, opened without blocking."""

    def __init__(self, path: str) -> None:
        if struct.calcsize("P") != 8:
            raise CameraError(
                "V4L2 cameras need a 64-bit Linux: the kernel's structures are laid out for it"
            )
        try:
            self._file = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise CameraError(
                f"the video device {path} must be there and free to use, got: {error.strerror}"
            ) from None

    def ask(self, request: Request, structure: Any) -> None:
        """Pass a structure to the kernel, which fills it in; a refusal is an OSError."""
        fcntl.ioctl(self._file, request.code, structure, True)

    def map(self, length_bytes: int, offset: int) -> "MappedBuffer":
        """Map one of the device's buffers."""
        return MappedBuffer(
            mmap.mmap(self._file, length_bytes, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)
        )

    def wait(self, timeout_s: float) -> bool:
        """Wait for a filled buffer or an event; False after the time limit."""
        poll = select.poll()
        poll.register(self._file, select.POLLIN)
        return bool(poll.poll(max(0.0, timeout_s) * 1e3))

    def close(self) -> None:
        """Close the device."""
        os.close(self._file)


class MappedBuffer:
    """One mapped buffer."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._memory = memory

    def copy(self, size_bytes: int) -> NDArray[np.uint8]:
        """Return a copy of its first bytes."""
        # Copied: an array over the map itself would keep the map from being closed.
        return np.frombuffer(self._memory[:size_bytes], np.uint8)

    def close(self) -> None:
        """Unmap it."""
        self._memory.close()


def list_structures(device: Device, request: Request, **known: int) -> Iterator[Any]:
    """Yield the structures of a list, selected by `known` fields, that ends with a refusal of the
    kernel.
    """
    for index in range(MOST_LISTED):
        structure = request.structure(index=index, **known)
        if not offers(device, request, structure):
            return
        yield structure
    raise CameraError(
        f"a list of the video device must end, {request.name} gave {MOST_LISTED} entries"
    )


def offers(device: Device, request: Request, structure: Any) -> bool:
    """Send a request and return whether the device supports it; a lost device is a
    `CameraError`.
    """
    try:
        device.ask(request, structure)
    except OSError as error:
        if error.errno in _GONE:
            raise CameraError(f"the video device has gone ({error.strerror})") from None
        return False
    return True


def query_device(device: Device, request: Request, structure: Any, rule: str) -> None:
    """Send a request; a refusal is a `CameraError` that begins with the broken rule."""
    try:
        device.ask(request, structure)
    except OSError as error:
        raise CameraError(f"{rule}, got: {error.strerror or error}") from None
