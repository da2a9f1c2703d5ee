"""Numbers of a chip of several amplifiers: each amplifier's, and the chip's with their spread.

Fixed patterns of the chip are the root mean square over its amplifiers, its other numbers their
mean, so that no step between them counts. Where the numbers x_i of the amplifiers differ by more
than their errors, the chip's holds them all: max |x_i - x| is the bound of a finding.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from charact.estimators.noise.findings import finding
from charact.estimators.noise.thresholds import CHECKS
from charact.frames.layout import BORDER, Layout
from charact.verdict import judge
from labdata import Measurement, Result

SHOWN = (
    "system_gain",
    "covariance_gain",
    "read_noise",
    "dark_signal",
    "dsnu",
    "prnu",
    "saturation_capacity",
)
MEANS = {1: "mean of the amplifiers", 2: "root mean square over the amplifiers"}
PATTERNS = ("dsnu", "prnu", "noise_v", "noise_h", "noise_vh")
GAINS = ("system_gain", "covariance_gain")


def with_amplifiers(chip: Result, amplifiers: Sequence[Result], layout: Layout) -> Result:
    """Return the result of a chip with those of its amplifiers, in the order of the layout."""
    border = "; ".join(part.note for part in layout.of(BORDER))
    step = 0.5 * max(part.step for part in layout.of(BORDER))
    out = [
        _of_chip(
            m,
            [
                like
                for result in amplifiers
                for like in result.find(m.quantity, unit=m.unit, stack=m.stack)[:1]
            ],
            len(amplifiers),
            border,
            step,
        )
        for m in chip.measurements
    ]
    out += [
        replace(m, amplifier=number, region=layout.amplifiers[number - 1])
        for number, result in enumerate(amplifiers, 1)
        for m in result.measurements
        if m.quantity in SHOWN
    ]
    return replace(chip, measurements=tuple(out))


def _of_chip(
    m: Measurement, parts: Sequence[Measurement], count: int, border: str, step: float
) -> Measurement:
    """Return a number of the chip by the same numbers of its amplifiers."""
    values = np.array([part.value for part in parts if part.value is not None], float)
    is_pattern = m.quantity in PATTERNS and len(parts) == count
    if is_pattern or (m.quantity in SHOWN and len(values) == count):
        m = _mean(m, parts, 2 if is_pattern else 1)
    if is_pattern or m.value is None:
        return m
    bound = 0.0
    if len(values) == count:
        sds = [0.5 * float(np.ptp(part.interval68 or (0.0, 0.0))) for part in parts]
        unlike = any(
            abs(values[i] - values[j]) > CHECKS.unlike_sd * np.hypot(sds[i], sds[j])
            for i, j in combinations(range(count), 2)
        )
        bound = float(np.abs(values - m.value).max()) if unlike else 0.0
    elif m.quantity in GAINS:
        bound = step * abs(m.value)
    if not bound:
        return m
    effect = f"{border}; the amplifiers have {', '.join(f'{x:.4g}' for x in values)} {m.unit}"
    return judge(m, [finding("amplifiers", effect, bound=bound)])


def _mean(m: Measurement, parts: Sequence[Measurement], power: int) -> Measurement:
    """Return the mean of a number over the amplifiers, or of its square; refused where one is."""
    refused = [part for part in parts if part.value is None]
    if refused:
        return replace(refused[0], posterior=None)
    values = np.array([part.value for part in parts], float)
    value = float(np.mean(values**power) ** (1.0 / power))
    # dx = sum(x_i^(p - 1) dx_i) / (N x^(p - 1)), independent between amplifiers.
    weight = (values / value) ** (power - 1) / len(values) if value else np.ones(len(values))
    limits = []
    for name in ("interval68", "interval95"):
        ends = np.array([getattr(part, name) for part in parts], float)
        low, high = np.sqrt(weight**2 @ (ends - values[:, None]) ** 2)
        limits.append((value - float(low), value + float(high)))
    mean = replace(
        parts[0], value=value, interval68=limits[0], interval95=limits[1], posterior=m.posterior
    )
    findings = [
        finding(flag, f"of amplifier {number}")
        for number, part in enumerate(parts[1:], 2)
        for flag in part.flags
        if flag not in parts[0].flags
    ]
    return judge(mean.with_(notes=(*m.notes, MEANS[power])), findings)
