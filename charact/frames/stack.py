"""One stack of frames, and what they hold: each computed once, when a method asks for it."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.frames import clipping
from charact.frames.image_lag import ImageLagModel, image_lag_model
from charact.frames.layout import BORDER, STRIP, Layout, Region, layout_of, lost_rows, profiles_of
from charact.frames.thresholds import CLIPPING, LAYOUT
from charact.method import Context
from charact.verdict import Finding
from labdata import Array, Camera, FrameStack, Mask


@dataclass(frozen=True, kw_only=True)
class Stack:
    """Frames of one scene under one set of conditions.

    Parameters
    ----------
    frames
        Pixel values, shape (frame, row, col), DN, with what their file states.
    camera
        Description of the camera; None: unknown.
    interlaced
        Whether odd and even rows are two fields.
    stated_full_scale_dn
        Full scale as the session states it, DN, which precedes that of the file; None: not stated.
    """

    frames: FrameStack
    camera: Camera | None = None
    interlaced: bool = False
    stated_full_scale_dn: float | None = None

    @classmethod
    def of(cls, frames: FrameStack, context: Context) -> "Stack":
        """Return frames as those of a method's camera."""
        return cls(
            frames=frames,
            camera=context.camera,
            interlaced=context.interlaced,
            stated_full_scale_dn=context.full_scale_dn,
        )

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def data(self) -> NDArray:
        """Pixel values, shape (frame, row, col), DN."""
        return self.frames.data

    @property
    def pitch_ratio(self) -> float:
        """Row pitch over column pitch; 1 if the camera is unknown."""
        return 1.0 if self.camera is None else self.camera.pitch_ratio

    @cached_property
    def mean_frame_dn(self) -> Array:
        """Mean frame, shape (row, col), DN."""
        return self.data.mean(axis=0, dtype=np.float64)

    @cached_property
    def temporal_variance_dn2(self) -> Array:
        """Variance of each pixel over two frames or more, shape (row, col), DN^2."""
        return self.data.var(axis=0, ddof=1, dtype=np.float64)

    @cached_property
    def holds_codes(self) -> bool:
        """Whether the values are whole codes of a digitiser."""
        first = self.data[0]
        return self.data.dtype.kind in "ui" or bool(np.all(first == np.rint(first)))

    @cached_property
    def ceiling_dn(self) -> float | None:
        """Highest value that a pixel can have, DN: that of full wells, which is below the
        digitiser's, else the lower one of what is stated and what a plateau shows; None: unknown.
        """
        known, stated = self.frames.full_scale_dn, self.stated_full_scale_dn
        wells_dn = clipping.full_wells(self.data) if len(self.data) > 1 else None
        if wells_dn is not None:
            return wells_dn
        return clipping.ceiling_of(self.data, known if stated is None else stated)

    @cached_property
    def top_dn(self) -> float:
        """Highest code of the digitiser, DN, whatever the wells hold; where it is unknown the
        highest value.
        """
        known, stated = self.frames.full_scale_dn, self.stated_full_scale_dn
        end_dn = clipping.ceiling_of(self.data, known if stated is None else stated)
        return float(self.data.max()) if end_dn is None else end_dn

    @cached_property
    def image_lag(self) -> ImageLagModel:
        """Image lag of the described phosphor between and within frames."""
        return image_lag_model(self.camera, len(self), interlaced=self.interlaced)

    @cached_property
    def layout(self) -> Layout:
        """Unexposed strips and lost rows; an amplifier only at the middle of a frame, as a scene
        may have straight edges elsewhere.
        """
        if min(self.frames.shape[1:]) < 2 * LAYOUT.bands:
            return Layout(size=self.frames.shape[1:], parts=lost_rows(self.data))
        shown = layout_of((), [profiles_of(self.mean_frame_dn)], lost=lost_rows(self.data))
        parts = [
            part
            for part in shown.parts
            if part.name != BORDER or abs(2 * part.first - sum(shown.span(part.axis))) <= 2
        ]
        return replace(shown, parts=tuple(parts))

    def layout_findings(self, region: Region | None) -> tuple[list[Finding], list[str]]:
        """Return the finding of rows of a region (row, col, height, width; None: all) that single
        frames lost, and notes on strips without light and on rows of one value in every frame.
        """
        _, rows, cols = self.frames.shape
        row, col, height, width = region or (0, 0, rows, cols)
        data = self.data[:, row : row + height, col : col + width]
        lost = [
            replace(part, first=part.first + row, stop=part.stop + row) for part in lost_rows(data)
        ]
        in_every_frame = len({part.frame for part in lost}) == len(self)
        notes = [part.note for part in lost] if in_every_frame else []
        if not (row and col and row + height < rows and col + width < cols):
            strips = replace(self.layout, parts=self.layout.of(STRIP))
            notes += strips.touching((row, col, height, width))
        if not lost or in_every_frame:
            return [], notes
        effect = "; ".join(part.note for part in lost)
        return [Finding(flag="defects", effect=effect, remedy="sound frames only")], notes

    def region(self, row: int, col: int, height: int, width: int) -> "Stack":
        """Return the frames cut to a rectangle; one that leaves the image is a BadInput."""
        return replace(self, frames=self.frames.region(row, col, height, width))

    def black_level_dn(
        self, dark_dn: float | None, unlit: float = CLIPPING.unlit
    ) -> tuple[float, bool]:
        """Return the level without light, DN, and whether it is known.

        Parameters
        ----------
        dark_dn
            Mean of a dark stack, DN; None: there is none, and the file's own counts.
        unlit
            Quantile of the mean frame that stands for it where neither is known.
        """
        known = self.frames.black_level_dn if dark_dn is None else dark_dn
        return (
            (float(np.quantile(self.mean_frame_dn, unlit)), False)
            if known is None
            else (known, True)
        )

    def is_clipped(self, pixels: Mask | None = None) -> bool:
        """Return whether pixels, all or those of a mask (row, col), pile up at an end of the
        scale.
        """
        data = self.data if pixels is None else self.data[:, pixels]
        return clipping.is_clipped(data, self.ceiling_dn)

    def often_full(self, fraction: float = 1.0) -> Mask:
        """Return the pixels at a fraction of the top or above in so many frames that their mean
        underestimates their signal, shape (row, col).
        """
        return (self.data >= fraction * self.top_dn).mean(axis=0) > CLIPPING.max_full_frames
