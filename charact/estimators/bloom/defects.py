"""Defective pixels and particle hits in a point series, replaced by their neighbours' mean."""

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.bloom.thresholds import (
    DARK_DEFECT_SD,
    DEFECT_SD,
    LEAST_DEFECT_DN,
    LIT_NEIGHBOURS,
    MOST_DEFECTS,
    NEIGHBOUR_SD,
)
from charact.frames.robust import robust_sd
from labdata import Array, FrameStack, Mask, Session, StackEntry


@dataclass(frozen=True, kw_only=True)
class SoundEntry(StackEntry):
    """Stack that is read with its defective pixels replaced.

    `entry`: stack as recorded; `bad`: its defective pixels, shape (row, col).
    """

    entry: StackEntry
    bad: Mask

    def read(self, plane: str | None = None) -> FrameStack:
        """Return the frames with defective pixels replaced."""
        stack = self.entry.read() if plane is None else self.entry.read(plane)
        return replace(stack, data=replace_bad_pixels(np.asarray(stack.data), self.bad))


def with_sound_pixels(session: Session) -> tuple[Session, int]:
    """Return a session whose darks and point stacks are read without defective pixels, and the
    number of those pixels.

    `session`: with stacks of kind "point", and darks where there are any.
    """
    hot = _hot(session)
    entries, every = [], set()
    for entry in session.stacks:
        if entry.kind in ("dark", "point"):
            image = entry.read().data.mean(axis=0, dtype=np.float64)
            bad = hot if hot.shape == image.shape else np.zeros(image.shape, bool)
            bad = bad | lone_pixels(replace_bad_pixels(image[None], bad)[0])
            if bad.any():
                every |= {tuple(row_col) for row_col in np.argwhere(bad).tolist()}
                entry_fields = {
                    entry_field.name: getattr(entry, entry_field.name)
                    for entry_field in fields(StackEntry)
                }
                entry = SoundEntry(**entry_fields, entry=entry, bad=bad)
        entries.append(entry)
    return (replace(session, stacks=tuple(entries)), len(every)) if every else (session, 0)


def bad_pixels(entry: StackEntry, shape: tuple[int, ...]) -> Mask:
    """Return the pixels of a stack that are replaced, shape (row, col)."""
    return entry.bad if isinstance(entry, SoundEntry) else np.zeros(shape, bool)


def _hot(session: Session) -> Mask:
    """Pixels that stand out of a dark and of the faintest point stack; pulses stand out of one of
    them only.
    """
    points = sorted(
        session.of_kind("point"), key=lambda entry: entry.conditions.illuminance_lux or 0.0
    )
    darks = session.of_kind("dark")
    if not points or not darks:
        return np.zeros((0, 0), bool)
    lit, sd = _excess(points[0].read().data.mean(axis=0, dtype=np.float64))
    out = np.zeros(lit.shape, bool)
    for entry in darks:
        excess, dark_sd = _excess(entry.read().data.mean(axis=0, dtype=np.float64))
        if excess.shape == lit.shape:
            out |= np.abs(excess) > max(DARK_DEFECT_SD * dark_sd, LEAST_DEFECT_DN)
    out &= np.abs(lit) > max(DARK_DEFECT_SD * sd, LEAST_DEFECT_DN)
    return out


def lone_pixels(image: Array) -> Mask:
    """Return the pixels of a mean frame that stand out while their neighbours do not, shape (row,
    col).

    A Gaussian of 0.35 px, sharper than any lens, still gives the one or two pixels next to its
    brightest one 30 % of the signal.
    """
    excess, sd = _excess(image)
    out = np.zeros(image.shape, bool)
    padded = np.pad(excess, 1)
    for row, col in np.argwhere(np.abs(excess) > max(DEFECT_SD * sd, LEAST_DEFECT_DN)):
        height = abs(excess[row, col])
        adjacent = np.sort(np.abs(np.delete(padded[row : row + 3, col : col + 3], 4)))
        # Two defects may touch.
        lit = adjacent[:-1].sum()
        neighbourhood = excess[max(0, row - 3) : row + 4, max(0, col - 3) : col + 4]
        local = robust_sd(neighbourhood, 0.0)
        out[row, col] = (
            height > DEFECT_SD * local and lit < LIT_NEIGHBOURS * height + NEIGHBOUR_SD * local
        )
    # Single bright pixels all over a frame are unblurred pulses, photon noise.
    return out if out.mean() < MOST_DEFECTS else np.zeros(image.shape, bool)


def _excess(image: Array) -> tuple[Array, float]:
    """Difference of each pixel from its local median, and its robust standard deviation, DN."""
    import cv2

    excess = image - cv2.medianBlur(image.astype(np.float32), 5).astype(np.float64)
    return excess, robust_sd(excess)


def replace_bad_pixels(data: NDArray, bad: Mask) -> NDArray:
    """Replace bad pixels by the mean of their sound neighbours, shape (frame, row, col)."""
    if not bad.any():
        return data
    out = data.copy()
    for row, col in np.argwhere(bad):
        half_width = 1
        while True:
            window = np.s_[
                max(0, row - half_width) : row + half_width + 1,
                max(0, col - half_width) : col + half_width + 1,
            ]
            sound = ~bad[window]
            if sound.any():
                break
            half_width += 1
        mean = data[:, window[0], window[1]][:, sound].mean(axis=1)
        out[:, row, col] = np.rint(mean) if np.issubdtype(data.dtype, np.integer) else mean
    return out
