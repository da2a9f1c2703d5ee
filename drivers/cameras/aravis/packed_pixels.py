"""Pixels packed into fewer bytes than they have codes for, unpacked to 16 bits.

Sources: GenICam Pixel Format Naming Convention 2.4, section 6.2 (Mono10p, Mono12p: lower bits first, without gaps);
GigE Vision 1.2, section 26.1 (Mono10Packed, Mono12Packed: two pixels in three bytes, the lower bits of both in the
middle one).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint16]


def _mono10p(byte: _Bytes) -> tuple[_Bytes, ...]:
    return (
        byte[0] | (byte[1] & 0x03) << 8,
        byte[1] >> 2 | (byte[2] & 0x0F) << 6,
        byte[2] >> 4 | (byte[3] & 0x3F) << 4,
        byte[3] >> 6 | byte[4] << 2,
    )


def _mono12p(byte: _Bytes) -> tuple[_Bytes, ...]:
    return byte[0] | (byte[1] & 0x0F) << 8, byte[1] >> 4 | byte[2] << 4


def _mono10_packed(byte: _Bytes) -> tuple[_Bytes, ...]:
    return byte[0] << 2 | byte[1] & 0x03, byte[2] << 2 | byte[1] >> 4 & 0x03


def _mono12_packed(byte: _Bytes) -> tuple[_Bytes, ...]:
    return byte[0] << 4 | byte[1] & 0x0F, byte[2] << 4 | byte[1] >> 4


@dataclass(frozen=True, kw_only=True)
class Packing:
    """How pixels share bytes.

    Parameters
    ----------
    pixels, bytes
        Pixels of one group, and the bytes that they share.
    split
        Takes the bytes of all groups, shape (byte, group), and returns the pixels, one array each.
    """

    pixels: int
    bytes: int
    split: Callable[[_Bytes], tuple[_Bytes, ...]]

    def size_bytes(self, pixels: int) -> int:
        """Bytes that so many pixels take."""
        return -(-pixels * self.bytes // self.pixels)

    def unpacked(self, packed: NDArray[np.uint8], pixels: int) -> NDArray[np.uint16]:
        """Return the first `pixels` pixels of packed bytes, shape (pixel,), DN."""
        groups = -(-pixels // self.pixels)
        whole = np.zeros(groups * self.bytes, np.uint8)
        there = packed[: self.size_bytes(pixels)]
        whole[: len(there)] = there
        byte = whole.reshape(groups, self.bytes).T.astype(np.uint16)
        return np.stack(self.split(byte), axis=1).reshape(-1)[:pixels]


PACKINGS = {
    "Mono10p": Packing(pixels=4, bytes=5, split=_mono10p),
    "Mono12p": Packing(pixels=2, bytes=3, split=_mono12p),
    "Mono10Packed": Packing(pixels=2, bytes=3, split=_mono10_packed),
    "Mono12Packed": Packing(pixels=2, bytes=3, split=_mono12_packed),
}
