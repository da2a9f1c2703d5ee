"""Fixed pattern: dark signal and photoresponse non-uniformity, and defects.

    DSNU^2 = s_dark^2 / K^2,  PRNU^2 = (s_flat^2 - s_dark^2) / mu^2

s^2: variance over pixels of the mean frame, less its residual temporal noise; mu: mean above the
dark (EMVA 1288 Release 4.0, eq. 66, 67).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.observables.frame_view import (
    FrameView,
    band_sizes,
    bands_of,
    cube_root,
    highest,
    log,
)
from charact.observables.observable import (
    Estimates,
    MeasuredStack,
    Numbers,
    Observable,
    Printed,
    Stacks,
    Values,
    observable,
)
from charact.observables.silicon import amplification, cooling, dn_per_electron, em_gain, warmth
from charact.observables.size import Size, part_of_noise, relative
from charact.observables.stack_level import StackLevel
from charact.observables.thresholds import FRAMES, SILICON
from labdata import Array

DSNU_E, PRNU_FRACTION = "ccd.dsnu_e", "ccd.prnu"
SHADING = ("slope x", "slope y", "x²", "y²", "xy")


@observable
class Prnu(Observable[Any]):
    """Squared photoresponse non-uniformity, of the last flat."""

    name = "PRNU"
    order = 34
    printed = Printed(
        quantity="prnu",
        kind="pattern",
        unit="%",
        factor=100.0,
        with_flats=True,
        of_flat=True,
        note="includes shading of illumination and lens",
    )
    tube = False
    depends = (PRNU_FRACTION,)
    relative_model_sd = 2.0 * SILICON.noise_model_sd

    def usable(self, stacks: Stacks[MeasuredStack]) -> Stacks[MeasuredStack] | None:
        """Return the flat of the smallest error."""
        shown = [
            stacks.only(darks=stacks.darks[:1], flats=[flat])
            for flat in stacks.flats
            if stacks.darks
            and np.isfinite(flat.spatial_sd_dn2)
            and flat.mean_dn > stacks.dark.mean_dn
        ]
        return min(shown, key=lambda lit: self.measure(lit).covariance[0, 0], default=None)

    def measure(self, stacks: Stacks[MeasuredStack]) -> Estimates:
        """Return the variance of the flat's pattern above the first dark's over its squared
        signal.
        """
        flat, dark, square = stacks.flat, stacks.dark, float(stacks.signal_dn[-1]) ** 2
        return Estimates.of_number(
            (flat.spatial_variance_dn2 - dark.spatial_variance_dn2) / square,
            float(np.hypot(flat.spatial_sd_dn2, dark.spatial_sd_dn2)) / square,
        )

    def number(self, values: Values, shown: Stacks[MeasuredStack]) -> Array:
        return values[PRNU_FRACTION] ** 2


@observable
class Dsnu(Observable[Any]):
    """Variance of the fixed pattern of the dark, DN^2.

    The error of a variance over pixels contains their kurtosis: a pattern of little dark charge is
    that of few pixels.
    """

    name = "DSNU"
    order = 35
    printed = Printed(quantity="dsnu", kind="pattern", with_flats=True, per_electron=True)
    tube = False
    relative_model_sd = 2.0 * SILICON.noise_model_sd

    def usable(self, stacks: Stacks[StackLevel]) -> Stacks[StackLevel] | None:
        """Return the dark with most frames and the longest exposure."""
        if not stacks.darks:
            return None
        chosen = max(stacks.darks, key=lambda dark: (dark.shape[0], dark.exposure_s))
        return stacks.only(darks=[chosen])

    def measure(self, stacks: Stacks[MeasuredStack]) -> Estimates:
        """Return the variance of the first dark's pattern, DN^2."""
        return Estimates.of_number(stacks.dark.spatial_variance_dn2, stacks.dark.spatial_sd_dn2)

    def number(self, values: Values, shown: Stacks[MeasuredStack]) -> Array:
        """Return the variance of the pattern at the dark's temperature, shape (n,), DN^2."""
        conditions = shown.dark.conditions
        gain = dn_per_electron(values, conditions) * em_gain(values, conditions)
        return (gain * values[DSNU_E] * warmth(values, conditions)) ** 2

    def parameters(self, stacks: Stacks[MeasuredStack]) -> tuple[str, ...]:
        conditions = stacks.dark.conditions
        return (*amplification(conditions), DSNU_E, *cooling(conditions))


@observable
class FixedPattern(Observable[Stacks[FrameView]]):
    """Fixed over temporal variance of pixels, rows and columns, and of bands of their
    spectra.

    The fixed part is the mean frame, with its residual temporal noise; over the temporal
    variance, neither gain nor light enters where there is no fixed pattern. The difference of odd
    and even rows, and columns, over the level shows fields or taps of unequal gain.
    """

    name = "fixed-pattern"
    order = 10
    title = "Fixed noise of pixels, rows and columns, and its spectrum"
    cause = "DSNU, PRNU, fibre pattern, dust, ghost images, or interference in step with the frames"
    matters = "averaged frames and faint objects"
    least_sd = 0.001
    over_frame = True

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        numbers: dict[str, float] = {}
        for stack in (stacks.dark, stacks.flat):
            rows, cols = stack.pattern.mean(axis=1), stack.pattern.mean(axis=0)
            fixed = {
                "pixels": (stack.pattern - rows[:, None] - cols).var(),
                "rows": rows.var(),
                "columns": cols.var(),
            }
            temporal = {"pixels": stack.variance_dn2, **stack.line_variances}
            for name, variance in fixed.items():
                ratio = float(variance) * len(stack.change) / max(temporal[name], 1e-12)
                numbers[f"fixed over temporal variance of {name} of {stack.label}"] = cube_root(
                    ratio
                )
            for name, line in (("rows", rows), ("columns", cols)):
                numbers[f"odd less even {name} of {stack.label}"] = float(
                    line[1::2].mean() - line[::2].mean()
                ) / max(stack.mean_dn, 1e-12)
            numbers |= bands_of(
                FrameView.spectrum(stack.pattern[None]),
                stack.power,
                f"fixed pattern of {stack.label}",
            )
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        sizes = {"odd less even": Size(unit="% of level")}
        for stack in (stacks.dark, stacks.flat):
            pixel_dn2 = stack.variance_dn2
            sizes |= {
                f"fixed over temporal variance of {name} of {stack.label}": part_of_noise(
                    variance_dn2 / pixel_dn2 / len(stack.change)
                )
                for name, variance_dn2 in {"pixels": pixel_dn2, **stack.line_variances}.items()
            }
            fixed = float(stack.pattern.var()) / pixel_dn2
            sizes |= band_sizes(stack.power.shape, f"fixed pattern of {stack.label}", fixed)
        return sizes


@observable
class Defects(Observable[Stacks[FrameView]]):
    """Logarithms of the heights and depths of the most deviating pixels and spots, of dark
    and brightest flat.

    Notes
    -----
    Pixels are those of the mean of each pixel's middle values less the median of 5 x 5 pixels,
    spots those of the mean frame behind a difference of Gaussians, both of what departs from the
    maps of the specimen: dust that has moved is as dark and bright as it was dark. The mean of
    several highest values is a smooth number, with a narrow distribution where nothing is
    defective; a count of pixels above a limit is 0 in nearly all sets, and its distribution
    unknown.
    """

    name = "defects"
    order = 11
    title = "Most deviating pixels and spots of the mean frames"
    cause = "hot, dead or stuck pixels, dust, or blemishes"
    matters = "point targets"
    size = relative("% of their height", np.exp)
    least_sd = 0.05
    over_frame = True

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        import cv2

        numbers = {}
        for stack in (stacks.dark, stacks.flat):
            pattern, steady = stack.pattern - stack.known, stack.steady - stack.known
            inner, outer = (cv2.GaussianBlur(pattern, (0, 0), size) for size in FRAMES.spot_px)
            pixels, spots = (
                steady - cv2.medianBlur(steady, 5),
                (inner - outer)[::3, ::3],
            )
            for name, local, count in (
                ("pixels", pixels, FRAMES.highest_pixels),
                ("spots", spots, FRAMES.highest_spots),
            ):
                for sign, side in ((1.0, "bright"), (-1.0, "dark")):
                    # Half a step of whole DN keeps the logarithm smooth where all pixels are equal.
                    height = highest(sign * local, count) + 0.5
                    numbers[f"ln height of the {count} most {side} {name} of {stack.label}, DN"] = (
                        log(height)
                    )
        return numbers


@observable
class Shading(Observable[Stacks[FrameView]]):
    """Slopes and curvatures of the mean frames over the picture: of flats over the signal,
    of the dark in DN.
    """

    name = "shading"
    order = 12
    title = "Slope and curvature of the mean frames over the picture"
    cause = "vignetting, uneven light, glow of an amplifier, or stray light"
    matters = "radiometry over the field"
    over_frame = True

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark = stacks.dark
        numbers = {}
        for stack in (dark, stacks.flat):
            scale = 1.0 if stack is dark else stack.mean_dn - dark.mean_dn
            for name, value in zip(SHADING, stack.shading, strict=True):
                numbers[f"{name} of {stack.label}"] = float(value) / scale
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        dark_dn, of_level = Size(unit="DN", factor=1.0), Size(unit="% of level")
        return {
            f"{name} of {label}": size
            for label, size in ((stacks.dark.label, dark_dn), (stacks.flat.label, of_level))
            for name in SHADING
        }
