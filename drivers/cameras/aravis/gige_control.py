"""Whether a GigE Vision camera still answers on its control port, asked beside the library that streams from it."""

import socket
import struct
from typing import Literal

CONTROL_PORT = 3956
# GVCP discovery command: key, acknowledge required, command 0x0002, no payload, request number.
_DISCOVERY = struct.pack(">BBHHH", 0x42, 0x01, 0x0002, 0, 0x7FFF)

Answer = Literal["answered", "silent", "refused"]


def ask(address: str, *, timeout_s: float = 0.1) -> Answer:
    """Send one discovery command to a camera's control port.

    Parameters
    ----------
    address
        IPv4 address of the camera.
    timeout_s
        Longest wait for the acknowledge, s.

    Returns
    -------
    Answer
        "answered"; "silent" if nothing came in time; "refused" if the far end says that no camera listens there any
        more (on loopback at once, when the camera's process is gone).
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.settimeout(timeout_s)
        try:
            control.connect((address, CONTROL_PORT))
            control.send(_DISCOVERY)
            control.recv(1024)
        except TimeoutError:
            return "silent"
        except OSError:
            return "refused"
    return "answered"


class BlockNumbers:
    """Running frame numbers from block numbers, which in GigE Vision's 16 bits count 1..65535 and start again at 1."""

    _CYCLE = 65535

    def __init__(self) -> None:
        self._block: int | None = None
        self._number = 0

    def running(self, block: int) -> int:
        """Return the running number of a block; the first block keeps its own number."""
        if self._block is None:
            self._block = self._number = block
            return block
        step = block - self._block
        if max(block, self._block) <= self._CYCLE and abs(step) > self._CYCLE // 2:
            # Back: the count began again. Forward: a late block of before, which is not a whole cycle ahead.
            step += self._CYCLE if step < 0 else -self._CYCLE
        self._block, self._number = block, self._number + step
        return self._number
