"""Colour planes of a picture that has them: one is chosen, or the luminance is taken and said so."""

import numpy as np
from numpy.typing import NDArray

from labdata.errors import BadInput
from labdata.frames import FrameStack

# Weights of red, green and blue in luminance, as the reference tables of ISO 12233 edges use them.
LUMINANCE = (0.2125, 0.7154, 0.0721)
LUMINANCE_NOTE = "colour picture: the luminance 0.2125 R + 0.7154 G + 0.0721 B was taken"


def frames_of(data: NDArray, name: str) -> NDArray:
    """Return an array of two axes or three as frames, shape (frame, row, col); one without pixels is a BadInput."""
    if not data.size:
        raise BadInput(f"an array of frames must hold pixels, got the shape {data.shape} in {name}")
    return data.reshape((-1, *data.shape[-2:]))


def mono(data: NDArray, plane: str | None, name: str) -> FrameStack:
    """Return frames that have no colour, shape (frame, row, col); asking a colour plane of them is a BadInput."""
    if plane not in (None, "mono"):
        raise BadInput(f"a plane can only be taken of a colour picture, got plane {plane!r} of {name}")
    return FrameStack(data=data)


def chosen(data: NDArray, plane: str | None, name: str) -> FrameStack:
    """Return one plane, or the luminance, of colour frames of the shape (frame, row, col, 3 or 4)."""
    if plane in (None, "luminance"):
        luminance = data[..., :3].astype(np.float64) @ np.asarray(LUMINANCE)
        # A mean of 8-bit planes ends where they do; of wider ones nobody knows how many bits are used.
        full_scale_dn = 255.0 if data.dtype == np.uint8 else None
        return FrameStack(data=luminance, full_scale_dn=full_scale_dn, plane="luminance", notes=(LUMINANCE_NOTE,))
    if plane not in ("r", "g", "b"):
        raise BadInput(f"the plane of an RGB picture must be r, g, b or luminance, got {plane!r} for {name}")
    return FrameStack(data=data[..., "rgb".index(plane)], plane=plane)
