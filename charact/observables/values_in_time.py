"""Values of single pixels and frames in time: tails, low bits, events, drift."""

from collections.abc import Mapping

import numpy as np

from charact.observables.frame_view import FrameView, correlations_of, cube_root, highest, log
from charact.observables.observable import Numbers, Observable, Stacks, observable
from charact.observables.size import CORRELATION, Size, relative
from charact.observables.thresholds import FRAMES


@observable
class Histogram(Observable[Stacks[FrameView]]):
    """Means of the tails of temporal noise over its standard deviation, and shares of ones
    of the low bits beyond those of the level.

    Notes
    -----
    The mean of a tail changes smoothly where the values are few whole DN, unlike its quantile. A
    bit that is stuck or left out has no ones or no zeros.
    """

    name = "histogram"
    order = 8
    title = "Tails of the noise in time, and low bits"
    cause = "pulse heights, clipping, rounding, stuck bits, or a nonlinear response"
    matters = "rare values and thresholds"
    least_sd = 0.002

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        numbers = {}
        for stack in (stacks.dark, *stacks.flats):
            ordered = stack.ordered / np.float32(np.sqrt(max(stack.variance_dn2, 1e-12)))
            for fraction in FRAMES.tails:
                size = max(1, round(fraction * ordered.size))
                numbers[f"mean of the lowest {100.0 * fraction:g} % of {stack.label}"] = float(
                    ordered[:size].mean()
                )
                numbers[f"mean of the highest {100.0 * fraction:g} % of {stack.label}"] = float(
                    ordered[-size:].mean()
                )
        flat = stacks.flat
        return numbers | {
            f"excess ones of bit {bit} of {flat.label}": float(x)
            for bit, x in enumerate(flat.excess_ones)
        }

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        # Steps of more than the noise follow the level, whose departure has a size of its own.
        bits = range(1 + int(np.log2(max(stacks.flat.robust_sd, 1.0))))
        return {"mean of the": Size(unit="% of noise", over=np.abs)} | {
            f"excess ones of bit {bit}": Size(unit="% of values") for bit in bits
        }


@observable
class DarkEvents(Observable[Stacks[FrameView]]):
    """Roots of the number of bright and dark events of the dark, and the height of the
    highest.
    """

    name = "dark-events"
    order = 9
    title = "Bright and dark events of the dark frames"
    cause = "EBI, ion feedback, cosmic rays, or clock-induced charge"
    matters = "false alarms in the dark"
    least_sd = 0.5

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark, sd = stacks.dark, stacks.dark.robust_sd
        numbers = {}
        for limit in FRAMES.event_sd:
            for sign, name in ((1.0, "bright"), (-1.0, "dark")):
                hit = sign * dark.change > limit * sd
                numbers[f"root of {name} events above {limit:g} sd of {dark.label}"] = float(
                    np.sqrt(np.sum(hit) + 0.375)
                )
        numbers[f"ln height of the highest events of {dark.label}"] = log(
            highest(dark.change, FRAMES.highest_events) / sd
        )
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        few = max(FRAMES.few_events * stacks.dark.change.size, FRAMES.least_events)
        events = Size(
            unit="% of events",
            of=lambda root: np.maximum(root, 0.0) ** 2,
            over=lambda root: np.maximum(root**2, few),
        )
        return {"root of": events, "ln height": relative("% of their height", np.exp)}


@observable
class TimeCourse(Observable[Stacks[FrameView]]):
    """Correlations of frames, and of fields of interlaced video, with each other, and
    changes in time.

    Correlations are those of successive ones and the largest of any two, without pulses: a few of
    them would rule.
    """

    name = "time"
    order = 13
    title = "Correlation of frames and fields with each other, and drift"
    cause = "image lag, repeated or averaged frames, or drift of lamp or gain"
    matters = "moving scenes and averaged frames"

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark = stacks.dark
        numbers = {}
        for stack in (dark, stacks.flat):
            limit = FRAMES.event_sd[0] * stack.robust_sd
            change = np.clip(stack.change, -limit, limit)
            numbers |= correlations_of(
                change, (1, 2), f"{'dark ' if stack is dark else ''}frames of {stack.label}"
            )
            if stack.interlaced:
                count, rows, cols = change.shape
                fields = (
                    change[:, : rows - rows % 2].reshape(count, rows // 2, 2, cols).swapaxes(1, 2)
                )
                numbers |= correlations_of(
                    fields.reshape(2 * count, rows // 2, cols), (1,), f"fields of {stack.label}"
                )
            means = stack.change.mean(axis=(1, 2))
            at = np.arange(len(means)) - (len(means) - 1) / 2.0
            numbers[f"drift of {stack.label}, DN a frame"] = float(at @ means / (at @ at))
            variances = np.log(np.maximum(change.var(axis=(1, 2)), 1e-12))
            numbers[f"range of the variances of frames of {stack.label}"] = cube_root(
                float(np.ptp(variances))
            )
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        dark, flat = stacks.dark, stacks.flat
        steps = len(flat.change) - 1.0
        return {
            f"drift of {flat.label}, DN": Size(
                unit="% of level", factor=100.0 * steps / max(flat.mean_dn - dark.mean_dn, 1e-12)
            ),
            "drift": Size(unit="DN", factor=len(dark.change) - 1.0),
            # The cube root of a range of logarithms of variances.
            "range": relative("% of noise", lambda root: np.exp(root**3 / 2.0)),
            "": CORRELATION,
        }
