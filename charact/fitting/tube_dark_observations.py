"""Observations of a tube's darks: noise and level between pulses, DSNU and background
illumination.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from charact.fitting import predicted_quantities as predicted
from charact.fitting.prior import values_of_description
from charact.fitting.stack_levels import SessionStacks
from charact.fitting.thresholds import DARK_ERRORS, DARKS, FRAMES
from charact.fitting.tube_darks import Darks, level_and_sd, thresholds_of
from charact.fitting.tube_frames import block_sums
from charact.fitting.tube_ions import (
    IONS,
    SHAPE,
    moment_below,
    single_pulse_limit,
    sizes_of_pulses,
    square_below,
    weak_ions,
)
from charact.fitting.tube_light import field_light, field_products
from charact.fitting.tube_time_observations import diagonal_means
from charact.observables import Case, Estimates, Observable, Values, columns, observable
from charact.observables.fixed_pattern import DSNU_E
from charact.observables.silicon import BLACK_LEVEL, CONVERSION_GAIN, READ_NOISE
from labdata import Array

EBI = "photocathode.ebi_lm_per_cm2"


@observable
class NoiseBetweenPulses(Observable[Darks]):
    """Level, DN, and variance, DN^2, of the pixels between pulses before rounding."""

    name = "noise between pulses"
    order = 73
    tube = True
    depends = (BLACK_LEVEL, READ_NOISE, EBI, CONVERSION_GAIN)

    def cases(self, stacks: SessionStacks) -> Iterator[Case[Darks]]:
        """Yield level and noise of enough quiet pixels.

        Their errors are by jackknife over blocks: fractions near one and near zero enter together.
        """
        darks = stacks.quiet_darks
        if darks is None or darks.quiet.mean() <= DARKS.least_quiet:
            return
        levels = thresholds_of(darks.data[darks.quiet])
        if levels is None:
            return
        count = block_sums(darks.quiet.sum(axis=0))
        counts_below = np.stack(
            [block_sums(((darks.data < at) & darks.quiet).sum(axis=0)) for at in levels], axis=1
        )
        occupied, total = count > 0, counts_below.sum(axis=0)
        level_dn, sd_dn = level_and_sd(total / count.sum(), levels)
        parts = np.array(
            [
                level_and_sd((total - block_below) / (count.sum() - block_count), levels)
                for block_below, block_count in zip(
                    counts_below[occupied], count[occupied], strict=True
                )
            ]
        )
        if np.isfinite(parts).all():
            covariance = np.cov(parts.T) * (len(parts) - 1) ** 2 / len(parts)
            turn, value = np.array([1.0, 2.0 * sd_dn]), np.array([level_dn, sd_dn**2])
            estimates = Estimates(value=value, covariance=covariance * np.outer(turn, turn))
            yield Case(estimates=estimates, of=darks)

    def model_covariance(self, estimates: Estimates, shown: Darks) -> Array:
        """Return the covariance by pulses too weak to be seen, as described, and coarse codes."""
        sheet = values_of_description(shown.sensor)
        hidden = max(float(shown.light_below_threshold(sheet)[0]) - DARK_ERRORS.wing, 0.0)
        light_sd = np.hypot(DARK_ERRORS.wing_sd, 0.3 * np.sqrt(hidden))
        unsure_dn = light_sd * float(shown.background(sheet)[0])
        quiet_sd = DARK_ERRORS.coarse_quiet_sd if shown.is_coarse else DARK_ERRORS.quiet_sd
        hidden_dn2 = float(shown.variance_below_threshold(sheet)[0])
        return np.diag(
            [
                unsure_dn**2 + (DARK_ERRORS.level_sd_dn * shown.is_coarse) ** 2,
                (quiet_sd * estimates.value[1]) ** 2 + (0.5 * hidden_dn2) ** 2,
            ]
        )

    def predict(self, values: Values, shown: Darks) -> Array:
        light = shown.light_below_threshold(values) * shown.background(values)
        return columns(values[BLACK_LEVEL] + light, quiet_variance(values, shown))


def quiet_variance(values: Values, darks: Darks) -> Array:
    """Return the variance of pixels between pulses before rounding, shape (n,), DN^2.

    Read noise, dark charge and its pattern behind the video filter, line noise, and half of what
    hidden pulses would add to noise that was not located by its lower side.
    """
    warmth = darks.warmth(values)
    reading = predicted.reading_variance(values, (values[DSNU_E] * warmth) ** 2, warmth)
    return reading + predicted.line_variance(values) + 0.5 * darks.variance_below_threshold(values)


class OfDarks(Observable[Darks]):
    """A number of the darks, observed where `estimate` has one of `least_sds` standard errors."""

    tube = True
    least_sds = 3.0

    def cases(self, stacks: SessionStacks) -> Iterator[Case[Darks]]:
        """Yield the number, if it stands out of its error."""
        darks = stacks.quiet_darks
        estimate = None if darks is None else self.estimate(darks)
        if darks and estimate and estimate[0] > self.least_sds * estimate[1]:
            yield Case(estimates=Estimates.of_number(*estimate), of=darks)

    def estimate(self, darks: Darks) -> tuple[float, float] | None:
        """Return the number and its error; None where the darks cannot show it."""
        raise NotImplementedError


@observable
class DarkPattern(OfDarks):
    """DSNU behind the video filter: covariance of the quiet pixels' means in the two halves of the
    frames, DN^2.
    """

    name = "DSNU"
    order = 74
    depends = (DSNU_E, CONVERSION_GAIN)
    least_sds = -np.inf

    def estimate(self, darks: Darks) -> tuple[float, float] | None:
        """Return the covariance, unless rounding hides it."""
        half, quiet = len(darks.data) // 2, darks.quiet
        counts = [quiet[:half].sum(axis=0), quiet[half:].sum(axis=0)]
        is_usable = np.minimum(*counts) >= max(half // 2, 1)
        slope, sd = with_error(rounding_slope, darks)
        if is_usable.mean() < DARKS.least_quiet or slope < DARK_ERRORS.least_slope:
            return None
        deviations = np.where(quiet, darks.data - darks.level_dn, 0.0)
        means = [
            part.sum(axis=0) / np.maximum(count, 1)
            for part, count in zip((deviations[:half], deviations[half:]), counts, strict=True)
        ]
        number = np.maximum(block_sums(is_usable), 1.0)
        first, second, product = (
            block_sums(np.where(is_usable, image, 0.0)) / number
            for image in (*means, means[0] * means[1])
        )
        covariance = (product - first * second)[number > 0.1 * is_usable.size / number.size]
        if covariance.size < FRAMES.blocks[0]:
            return None
        value = float(covariance.mean())
        scatter = float(covariance.std(ddof=1) / np.sqrt(covariance.size))
        coarse = DARK_ERRORS.coarse_pattern_dn**2 * darks.is_coarse
        error = float(np.hypot.reduce([scatter, 2.0 * sd / slope * value, coarse]))
        return value / slope**2, error / slope**2

    def number(self, values: Values, darks: Darks) -> Array:
        pattern = values[CONVERSION_GAIN] * values[DSNU_E] * darks.warmth(values)
        return pattern**2 * predicted.filter_covariance(values, 1)[:, 0]


def rounding_slope(level_dn: float, noise_dn: float) -> float:
    """Return the slope of the mean of rounded noise against its level, 1 of much noise,
    dimensionless.

    1 + 2 sum_k (-1)^k exp(-2 (pi k s)^2) cos(2 pi k level), the derivative of the mean of the
    rounded value.
    """
    order = np.arange(1, 8)
    wave = (-1.0) ** order * np.exp(-2.0 * (np.pi * order * noise_dn) ** 2)
    return float(1.0 + 2.0 * np.sum(wave * np.cos(2.0 * np.pi * order * level_dn)))


def with_error(effect: Callable[[float, float], float], darks: Darks) -> tuple[float, float]:
    """Return an effect of rounding at the level and noise of the darks, and its error by those of
    both.

    Noise well above a step is not changed by rounding.
    """
    if not darks.is_coarse:
        return 1.0, 0.0
    level, noise = darks.level_dn, darks.noise_dn
    nominal = effect(level, noise)
    shifted = (
        effect(level - DARK_ERRORS.level_sd_dn, noise),
        effect(level, (1.0 - darks.noise_relative_sd) * noise),
    )
    return nominal, float(np.hypot(shifted[0] - nominal, shifted[1] - nominal))


@observable
class PulsesOfDarks(OfDarks):
    """Background illumination by the summed covariance of neighbours in time, DN^2."""

    name = "dark events"
    order = 75
    depends = (EBI, *IONS)

    def estimate(self, darks: Darks) -> tuple[float, float] | None:
        """Return the covariance before rounding."""
        if not darks.ions.are_sparse:
            return None
        value, sd = _neighbour_covariance(darks, neighbours_of(darks))
        rounding_factor, kept_sd = with_error(partial(covariance_after_rounding, darks), darks)
        covariance_sd = (
            DARK_ERRORS.coarse_covariance_sd if darks.is_coarse else DARK_ERRORS.covariance_sd
        )
        model = np.hypot.reduce(
            [
                covariance_sd,
                DARK_ERRORS.rounding_sd * (rounding_factor - 1.0) / rounding_factor,
                kept_sd / rounding_factor,
            ]
        )
        value = value / rounding_factor
        return value, float(np.hypot(sd / rounding_factor, model * value))

    def number(self, values: Values, darks: Darks) -> Array:
        event = darks.gain(values) * predicted.excess_noise_factor(values)
        small = square_below(values[SHAPE], single_pulse_limit(values, darks.ions))
        light = event * darks.background(values) * small + weak_ions(values, darks.ions)[1]
        count, step = len(darks.data), darks.sensor.fields
        products = field_products(values, darks.level.gate_s, count * step)[:, ::step]
        spread = predicted.pulse_covariance(values, neighbours_of(darks)).sum(axis=1)
        # About the mean of all frames.
        lasting = products @ diagonal_means(count, (0,), 0)[0] * count / (count - 1.0)
        return light * spread * lasting


@observable
class LightOfDarks(OfDarks):
    """Background illumination by the mean of all pixels that no ion reaches above the level between
    pulses, DN, of fine digitisers.
    """

    name = "mean of dark events"
    order = 76
    depends = (EBI, BLACK_LEVEL, *IONS)

    def estimate(self, darks: Darks) -> tuple[float, float] | None:
        if darks.is_coarse or not darks.ions.are_sparse:
            return None
        is_usable = ~darks.ions.reached
        mean = darks.data.mean(axis=0, dtype=np.float64) - darks.level_dn
        number, total = block_sums(is_usable), block_sums(mean * is_usable)
        occupied = number > 0.1 * number.max()
        block_mean = total[occupied] / number[occupied]
        value = float(total.sum() / number.sum())
        scatter = block_mean.std(ddof=1) / np.sqrt(block_mean.size)
        return value, float(np.hypot(scatter, DARK_ERRORS.wing_sd * value))

    def number(self, values: Values, darks: Darks) -> Array:
        small = moment_below(values[SHAPE], 1.0, single_pulse_limit(values, darks.ions), 1)
        pulses = darks.background(values) * (small - darks.light_below_threshold(values))
        return pulses + weak_ions(values, darks.ions)[0]


def neighbours_of(darks: Darks) -> tuple[tuple[int, int], ...]:
    """Return the columns and field rows between neighbours: without those that a video filter
    correlates.
    """
    analog = darks.sensor.video.low_pass is not None
    return ((0, 1), (1, 1)) if analog else ((1, 0), (0, 1), (1, 1))


def _neighbour_covariance(
    darks: Darks, separations: tuple[tuple[int, int], ...]
) -> tuple[float, float]:
    """Return the sum of the covariances of neighbours in time, and its standard error by the
    scatter over blocks.
    """
    is_usable = ~darks.ions.reached
    count, rows, columns = darks.data.shape
    x = np.empty_like(darks.data)
    for parity in range(darks.sensor.fields):
        field = darks.data[:, parity :: darks.sensor.fields]
        x[:, parity :: darks.sensor.fields] = (
            field - field[:, is_usable[parity :: darks.sensor.fields]].mean(axis=1)[:, None, None]
        )
    x = (x - x.mean(axis=0)) * is_usable
    total, number = np.zeros((2, FRAMES.blocks[0] * FRAMES.blocks[1]))
    for right, down in separations:
        down *= darks.sensor.fields
        first, second = x[:, : rows - down, : columns - right], x[:, down:, right:]
        total += block_sums(np.einsum("frc,frc->rc", first, second) / (count - 1.0))
        number += block_sums(is_usable[: rows - down, : columns - right] & is_usable[down:, right:])
    occupied = number > 0.1 * number.max()
    block_covariance = total[occupied] / number[occupied] * len(separations)
    mean = float(total[occupied].sum() / number[occupied].sum() * len(separations))
    return mean, float(block_covariance.std(ddof=1) / np.sqrt(block_covariance.size))


def covariance_after_rounding(darks: Darks, level_dn: float, noise_dn: float) -> float:
    """Return the covariance of rows due to pulses after rounding, over that before.

    The mean of a rounded pixel with the light a of a pulse is m(a) = a + sum_k (-1)^k/(pi k) exp(-2
    (pi k s)^2) sin(2 pi k (level + a)). Pulses are Gaussians of the described blur with exponential
    heights, and pulses apart.
    """
    values = values_of_description(darks.sensor)
    width, height_px = sizes_of_pulses(values)
    height = darks.ions.event_dn / (1.0 + 1.0 / float(values[SHAPE][0]))
    node, weight = np.polynomial.laguerre.laggauss(16)
    light = (field_light(values, darks.level.gate_s, 3)[0, :, None] * node * height).ravel()[
        :, None, None
    ]
    x, y = (
        np.arange(-4.0 * width, 4.0 * width, 0.25),
        np.arange(-4.0 * height_px, 4.0 * height_px + 1.0, 0.2)[:, None],
    )
    spot, next_row = (
        np.exp(-0.5 * ((x / width) ** 2 + ((y - row) / height_px) ** 2))
        / (2.0 * np.pi * width * height_px)
        for row in (0.0, 1.0)
    )

    def change(light_dn: Array) -> Array:
        total = light_dn.copy()
        for order in (1, 2, 3):
            wave = (
                (-1.0) ** order / (np.pi * order) * np.exp(-2.0 * (np.pi * order * noise_dn) ** 2)
            )
            phase = 2.0 * np.pi * order * level_dn
            total += wave * (np.sin(phase + 2.0 * np.pi * order * light_dn) - np.sin(phase))
        return total

    weights = np.tile(weight, 3)
    rounded, unrounded = (
        weights @ np.sum(of(light * spot) * of(light * next_row), axis=(1, 2))
        for of in (change, lambda light_dn: light_dn)
    )
    return float(rounded / unrounded)
