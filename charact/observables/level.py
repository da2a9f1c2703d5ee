"""Level of darks and flats.

    mu = b + K g eta p (EMVA 1288 Release 4.0, eq. 6), behind a response that may be compressed

b: black level; p: photons of a pixel; eta: quantum efficiency.
"""

from collections.abc import Mapping
from typing import Any

from charact.observables.frame_view import FrameView, log
from charact.observables.observable import (
    Estimates,
    MeasuredStack,
    Numbers,
    Observable,
    Printed,
    Stacks,
    observable,
)
from charact.observables.size import LN_LEVEL, Size


@observable
class Level(Observable[Any]):
    """Level of the dark, DN, and the logarithm of the brightest flat's signal above it."""

    name = "level"
    order = 0
    title = "Level of the dark, and signal of the brightest flat"
    cause = "sensitivity, gain, black level, EBI, dark current, or the light meter"
    matters = "radiometry and exposure"
    printed = Printed(quantity="dark_signal", kind="level")

    def measure(self, stacks: Stacks[MeasuredStack]) -> Estimates:
        """Return the level of the first dark, DN."""
        return Estimates.of_number(stacks.dark.mean_dn, stacks.dark.mean_sd_dn)

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark, flat = stacks.dark, stacks.flat
        return {
            f"level of {dark.label}, DN": dark.mean_dn,
            f"ln signal of {flat.label}": log(flat.mean_dn - dark.mean_dn),
        }

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        return {"level": Size(unit="DN", factor=1.0), "ln signal": LN_LEVEL}
