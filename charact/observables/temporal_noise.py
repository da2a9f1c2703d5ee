"""Noise in time of darks and flats: covariance, its spectrum, rows and columns, the field."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from charact.observables.frame_view import FrameView, band_sizes, bands_of, cube_root
from charact.observables.observable import Numbers, Observable, Stacks, observable
from charact.observables.size import CORRELATION, LN_VARIANCE, VARIANCE, Size, part_of_noise
from charact.observables.thresholds import FRAMES


@observable
class CovarianceSum(Observable[Stacks[FrameView]]):
    """Summed covariance over signal of each flat, DN.

    Of a dim flat the sum may be negative by chance, so that it has no logarithm.
    """

    name = "covariance"
    order = 3
    title = "Covariance summed within 6 px over signal, of each flat"
    cause = "gain and excess noise"
    matters = "detection limits of binned or filtered frames"
    size = VARIANCE

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark = stacks.dark
        return {
            f"covariance/signal of {flat.label}, DN": float(
                flat.covariance.sum() - dark.covariance.sum()
            )
            / (flat.mean_dn - dark.mean_dn)
            for flat in stacks.flats
        }


@observable
class Autocorrelation(Observable[Stacks[FrameView]]):
    """Correlation of neighbours in the brightest flat, and along rows and columns in the
    dark.
    """

    name = "autocorrelation"
    order = 4
    title = "Correlation of neighbouring pixels in time"
    cause = "blur after the gain, video bandwidth, sharpening, or interpolation"
    matters = "noise of filtered frames"
    size = CORRELATION
    over_frame = True

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark, flat = stacks.dark, stacks.flat
        numbers = {
            f"correlation at {row},{col} px of {flat.label}": float(
                flat.covariance[FRAMES.reach + row, FRAMES.reach + col]
            )
            / flat.variance_dn2
            for row, col in FRAMES.lags
        }
        for row, col in ((0, 1), (1, 0)):
            name = f"correlation at {row},{col} px of {dark.label}"
            numbers[name] = float(dark.covariance[FRAMES.reach + row, FRAMES.reach + col]) / max(
                dark.variance_dn2, 1e-12
            )
        return numbers


@observable
class NoiseOverField(Observable[Stacks[FrameView]]):
    """Difference of the noise near the corners of the brightest flat from that near its centre.

    The correlation of neighbours in time, and the logarithm of variance over signal: a blur that
    grows with the distance from the centre raises the first and lowers the second.
    """

    name = "field"
    order = 5
    title = "Noise near the corners of the brightest flat against that near its centre"
    cause = (
        "blur after the gain that grows off axis, or interpolation such as a correction of "
        "distortion"
    )
    matters = "detection near the corners"

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark, flat = stacks.dark, stacks.flat
        rows, cols = flat.mean.shape
        y, x = (np.linspace(-1.0, 1.0, size) for size in (rows, cols))
        square = (y[:, None] ** 2 + x[None, :] ** 2) / 2.0
        regions = [square < FRAMES.centre_square, square > FRAMES.corner_square]
        power = np.mean(flat.change**2, axis=0)
        variance = [max(float(power[region].mean()), 1e-12) for region in regions]
        numbers = {}
        for row, col in ((0, 1), (1, 0)):
            product = np.mean(
                flat.change[:, row:, col:] * flat.change[:, : rows - row, : cols - col], axis=0
            )
            middle, corner = (
                float(product[region[row:, col:]].mean()) / region_variance
                for region, region_variance in zip(regions, variance, strict=True)
            )
            numbers[
                f"correlation at {row},{col} px near the corners less the centre of {flat.label}"
            ] = corner - middle
        signal = [max(float(flat.mean[region].mean()) - dark.mean_dn, 1e-12) for region in regions]
        numbers[f"ln variance/signal near the corners over the centre of {flat.label}"] = float(
            np.log(variance[1] / signal[1]) - np.log(variance[0] / signal[0])
        )
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        return {"correlation": CORRELATION, "ln variance": LN_VARIANCE}


@observable
class NoiseSpectrum(Observable[Stacks[FrameView]]):
    """Temporal noise power over its mean in bands of both cuts and over all directions, and
    its peaks.
    """

    name = "noise-spectrum"
    order = 6
    title = "Horizontal and vertical cuts of the noise spectrum, and its peak"
    cause = "interference, banding, or blur after the gain"
    matters = "faint stripes and filtered frames"
    least_sd = 0.001

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        numbers: dict[str, float] = {}
        for stack in (stacks.dark, stacks.flat):
            numbers |= bands_of(
                stack.power,
                np.full_like(stack.power, stack.power.mean()),
                f"noise of {stack.label}",
            )
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        sizes: dict[str, Size] = {}
        for stack in (stacks.dark, stacks.flat):
            sizes |= band_sizes(stack.power.shape, f"noise of {stack.label}")
        return sizes


@observable
class RowsAndColumns(Observable[Stacks[FrameView]]):
    """Variances in time of means of frames, rows and columns of dark and brightest flat.

    Each is over that of white noise of the same variance. Cube roots of variances, and of powers,
    are nearly Gaussian (Wilson and Hilferty 1931).
    """

    name = "rows-and-columns"
    order = 7
    title = "Frame, row and column means in time"
    cause = "line noise of the read-out, flicker of the lamp, or hum"
    matters = "stripes and flicker"

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        numbers = {}
        for stack in (stacks.dark, stacks.flat):
            _, rows, cols = stack.change.shape
            variances = {
                "frames": float(stack.change.mean(axis=(1, 2)).var()),
                **stack.line_variances,
            }
            for (name, value), pixels in zip(
                variances.items(), (rows * cols, cols, rows), strict=True
            ):
                numbers[f"variance of means of {name} of {stack.label}"] = cube_root(
                    value * pixels / max(stack.variance_dn2, 1e-12)
                )
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        rows, cols = stacks.flat.mean.shape
        signal_dn = max(stacks.flat.mean_dn - stacks.dark.mean_dn, 1e-12)
        flicker = stacks.flat.variance_dn2 / (rows * cols) / signal_dn**2
        return {
            f"variance of means of frames of {stacks.flat.label}": replace(
                part_of_noise(flicker), unit="% of level"
            ),
            "variance of means of frames": part_of_noise(1.0 / (rows * cols)),
            "variance of means of rows": part_of_noise(1.0 / cols),
            "variance of means of columns": part_of_noise(1.0 / rows),
        }
