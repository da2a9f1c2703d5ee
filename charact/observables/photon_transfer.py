"""Photon transfer: temporal variance of darks, and variance over signal of flats.

    (s^2 - s_d^2) / mu = K F^2

s^2: temporal variance; mu: mean above the dark (EMVA 1288 Release 4.0, section 2.2). K is the slope
of variance against signal; the change of variance over signal along the levels is the curvature of
the response.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from charact.frames.rounding import rounding_sd
from charact.observables.admissible import admissible_measurements
from charact.observables.frame_view import FrameView, log
from charact.observables.observable import (
    Estimates,
    GivenOthers,
    MeasuredStack,
    Numbers,
    Observable,
    Printed,
    Stacks,
    Values,
    columns,
    observable,
)
from charact.observables.silicon import (
    COMPRESSION,
    DARK_CURRENT,
    HEIGHTS,
    READ_NOISE,
    ROW_EXPONENT,
    ROW_NOISE,
    amplification,
    cooling,
    dark_variance,
    dn_per_electron,
    em_gain,
    neighbour_variance,
    register_excess,
)
from charact.observables.size import LN_VARIANCE, VARIANCE, Size, relative
from charact.observables.stack_level import StackLevel
from charact.observables.thresholds import SILICON
from labdata import Array


def variance_errors(stacks: Stacks[MeasuredStack]) -> tuple[Array, float]:
    """Return the standard errors of the variances of flats above their darks, shape (flat,), and
    their common error, DN^2.

    Flats of one dark have its error in common, and the rounding of its variance; see
    `charact.frames.rounding`.
    """
    sd = np.array([flat.variance_sd_dn2 for flat in stacks.flats])
    darks = [dark for _, dark in stacks.pairs]
    of_dark = np.array(
        [np.hypot(dark.variance_sd_dn2, rounding_sd(dark.variance_dn2)[1]) for dark in darks]
    )
    if len({dark.label for dark in darks}) == 1:
        return sd, float(of_dark[0])
    return np.hypot(sd, of_dark), 0.0


def variance_over_signal(flat: FrameView | MeasuredStack, dark: FrameView | MeasuredStack) -> float:
    """Return the variance of a flat above the dark's over its signal, DN."""
    return (flat.variance_dn2 - dark.variance_dn2) / (flat.mean_dn - dark.mean_dn)


@observable
class PhotonTransfer(Observable[Any]):
    """Variance over signal of every flat.

    Of a response y = s (1 - c s / full scale) shot noise has the variance K0 g F^2 s (1 - 2 c s /
    full scale)^2.
    """

    name = "photon-transfer"
    order = 1
    tube = False
    relative_model_sd = SILICON.noise_model_sd
    title = "Variance of the dark, and variance over signal of the brightest flat"
    cause = "gain, excess noise, read noise, or blur after the gain"
    matters = "noise and detection limits"
    size = LN_VARIANCE

    def usable(self, stacks: Stacks[StackLevel]) -> Stacks[StackLevel] | None:
        """Return the flats brighter than the dark's noise, if there are enough.

        Flats of a session whose gain is not admissible do not follow the law.
        """
        gains = (("system_gain", "DN/e-"), ("covariance_gain", "DN"))
        if not any(admissible_measurements(stacks.result, *gain) for gain in gains):
            return None
        flats = [
            flat
            for flat in stacks.flats
            if stacks.darks
            and np.isfinite(flat.variance_sd_dn2)
            and flat.mean_dn - stacks.dark.mean_dn > SILICON.least_signal * stacks.dark.noise_dn
        ]
        chosen = stacks.only(darks=stacks.darks[:1], flats=flats)
        return chosen if len(flats) >= SILICON.fewest_flats else None

    def measure(self, stacks: Stacks[MeasuredStack]) -> Estimates:
        """Return variance over signal of each flat, DN."""
        signal = stacks.signal_dn
        ratio = np.array([variance_over_signal(flat, dark) for flat, dark in stacks.pairs])
        level_sd = np.array([np.hypot(f.mean_sd_dn, d.mean_sd_dn) for f, d in stacks.pairs])
        sd, shared = variance_errors(stacks)
        independent = (sd / signal) ** 2 + (ratio * level_sd / signal) ** 2
        return Estimates(
            value=ratio,
            covariance=np.diag(independent) + np.outer(shared / signal, shared / signal),
        )

    def predict(self, values: Values, stacks: Stacks[StackLevel]) -> Array:
        """Return variance over signal of each flat at its measured signal, shape (n, flat), DN."""
        gains = [
            dn_per_electron(values, flat.conditions)
            * em_gain(values, flat.conditions)
            * register_excess(values, flat.conditions)
            for flat in stacks.flats
        ]
        dark, full = stacks.dark, stacks.flats[0].full_scale_dn
        signal, c = stacks.signal_dn, values[COMPRESSION][:, None]
        linear_signal = (
            2.0 * signal / (1.0 + np.sqrt(np.maximum(1.0 - 4.0 * c * signal / full, 0.0)))
        )
        bend = (1.0 - 2.0 * c * linear_signal / full) ** 2
        # Noise of reading passes the bent response, that of rows and interference does not.
        read_dn2 = (
            dark.variance_dn2
            - SILICON.rounding_dn2 * dark.step_dn**2
            - neighbour_variance(values, dark.shape[1])[:, None]
        )
        shot = columns(*gains) * linear_signal * bend
        return (shot + (bend - 1.0) * read_dn2) / signal

    def parameters(self, stacks: Stacks[StackLevel]) -> tuple[str, ...]:
        known = ((*amplification(flat.conditions), HEIGHTS, COMPRESSION) for flat in stacks.flats)
        return tuple(dict.fromkeys(path for paths in known for path in paths))

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        dark, flat = stacks.dark, stacks.flat
        return {
            f"ln variance of {dark.label}": log(dark.variance_dn2),
            f"ln variance/signal of {flat.label}": log(variance_over_signal(flat, dark)),
        }


@observable
class Linearity(Observable[Stacks[FrameView]]):
    """Signal, and variance over signal, of each dimmer flat over that of the brightest.

    Neither depends on gain or sensitivity where the response is linear.
    """

    name = "linearity"
    order = 2
    title = "Signal, and variance over signal, of dimmer flats over the brightest"
    cause = (
        "a nonlinear response, saturation of the microchannel plate, automatic gain, or "
        "light other than stated"
    )
    matters = "radiometry over levels"

    def numbers(self, stacks: Stacks[FrameView]) -> Numbers:
        (*dimmer, brightest), dark = stacks.flats, stacks.dark
        numbers = {}
        for flat in dimmer:
            of = f"of {flat.label} over {brightest.label}"
            signal = (flat.mean_dn - dark.mean_dn) / (brightest.mean_dn - dark.mean_dn)
            ratio = variance_over_signal(flat, dark) / variance_over_signal(brightest, dark)
            numbers |= {f"signal {of}": signal, f"variance/signal {of}": ratio}
        return numbers

    def sizes(self, stacks: Stacks[FrameView]) -> Mapping[str, Size]:
        return {"signal": relative("% of level"), "variance/signal": VARIANCE}


def _read_noise(square: Array, sd: Array) -> Array:
    """Return the root of the positive solution x of x - sd^2/x = square: of a variance below that
    of the dark charge, by chance, what its error allows.
    """
    larger = 0.5 * (np.abs(square) + np.hypot(square, 2.0 * sd))
    return np.sqrt(np.where(square > 0.0, larger, sd**2 / larger))


@observable
class DarkNoise(Observable[Any]):
    """Temporal variance of darks: read noise, dark charge and the quantisation step."""

    name = "dark-noise"
    order = 30
    printed = Printed(
        quantity="read_noise",
        kind="noise",
        note="temporal noise of a dark frame: electronics, digitiser and dark scintillation",
    )
    tube = False
    relative_model_sd = SILICON.noise_model_sd
    given_others = GivenOthers(path=READ_NOISE, function=np.square, inverse=_read_noise)

    def usable(self, stacks: Stacks[StackLevel]) -> Stacks[StackLevel] | None:
        """Return the darks whose rounding is additive."""
        darks = [
            dark
            for dark in stacks.darks
            if dark.variance_dn2 > (SILICON.least_noise_dn * dark.step_dn) ** 2
        ]
        return stacks.only(darks=darks) if darks else None

    def measure(self, stacks: Stacks[MeasuredStack]) -> Estimates:
        """Return the variance of each dark, DN^2."""
        variance = np.array([dark.variance_dn2 for dark in stacks.darks])
        sd = np.array([dark.variance_sd_dn2 for dark in stacks.darks])
        return Estimates(value=variance, covariance=np.diag(sd**2))

    def predict(self, values: Values, stacks: Stacks[StackLevel]) -> Array:
        """Return the variance of a pixel under the conditions of each dark, shape (n, dark)."""
        coarser_dn2 = [SILICON.rounding_dn2 * (dark.step_dn**2 - 1.0) for dark in stacks.darks]
        variances = (
            dark_variance(values, dark.conditions, dark.exposure_s)
            + neighbour_variance(values, dark.shape[1])
            + more
            for dark, more in zip(stacks.darks, coarser_dn2, strict=True)
        )
        return columns(*variances)

    def parameters(self, stacks: Stacks[StackLevel]) -> tuple[str, ...]:
        reading = (HEIGHTS, "register.clock_induced_e", DARK_CURRENT, READ_NOISE)
        known = (
            (
                *amplification(dark.conditions),
                *reading,
                # Interference is asked where a dark shows its peak.
                ROW_NOISE,
                ROW_EXPONENT,
                *cooling(dark.conditions),
            )
            for dark in stacks.darks
        )
        return tuple(dict.fromkeys(path for paths in known for path in paths))
