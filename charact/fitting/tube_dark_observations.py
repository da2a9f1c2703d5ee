"""Observations of a tube's darks: noise and level between pulses, DSNU and background
illumination.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from charact.fitting import predicted_quantities as predicted
from charact.fitting.observation import Observation, scalar_observation
from charact.fitting.prior import values_of_description
from charact.fitting.thresholds import DARK_ERRORS, DARKS, FRAMES
from charact.fitting.tube_darks import Darks, darks_of, level_and_sd, thresholds_of
from charact.fitting.tube_ions import (
    IONS,
    IonEvents,
    ion_observation,
    moment_below,
    single_pulse_limit,
    weak_ions,
)
from charact.fitting.tube_time_observations import (
    LINE_NOISE,
    block_sums,
    field_light,
    field_products,
    filter_covariance,
    pulse_covariance,
)
from charact.observables import Values
from labdata import Array

EBI, READ, DSNU, BLACK = (
    "photocathode.ebi_lm_per_cm2",
    "ccd.read_noise_e",
    "ccd.dsnu_e",
    "video.black_level_dn",
)
CONVERSION = "video.conversion_gain_dn_per_e"
SHAPE = "microchannel_plate.pulse_height_shape"


def dark_observations(ions: IonEvents | None) -> list[Observation]:
    """Return the observations of a dark, one of each that its frames can show."""
    if ions is None:
        return []
    darks, sparse = darks_of(ions), ions.reached.mean() < DARK_ERRORS.most_reached
    observations = [ion_observation(ions)] if sparse else []
    if darks is not None:
        observations += [*_quiet(darks), *_pattern(darks), *(_events(darks) if sparse else [])]
    return observations


def _gain(values: Values, darks: Darks) -> Array:
    reference_v = float(darks.sensor.microchannel_plate.reference_v)
    return predicted.photoelectron_gain(values, darks.level.mcp_v, reference_v)


def _background(values: Values, darks: Darks) -> Array:
    """Return the mean signal of the background illumination, shape (n,), DN."""
    return _gain(values, darks) * predicted.background_rate(values) * darks.level.gate_s


def _unseen(values: Values, darks: Darks) -> Array:
    """Return the heights, in mean detected pulses, below which a pulse is hidden by the noise,
    shape (n,).
    """
    height = _gain(values, darks) / values["microchannel_plate.detection_probability"]
    peak = (
        2.0
        * pulse_covariance(values, ((0.0, 0.0),))[:, 0]
        * np.sqrt(field_products(values, darks.level.gate_s, 1)[:, 0])
    )
    return max(DARKS.pulse_dn, DARKS.pulse_sd * darks.noise_dn) / np.maximum(height * peak, 1e-9)


def _warmth(values: Values, darks: Darks) -> Array:
    """Return dark current over that at 25 C."""
    temperature_c = darks.level.conditions.temperature_c
    warmer = 0.0 if temperature_c is None else temperature_c - 25.0
    return 2.0 ** (warmer / values["ccd.dark_current_doubling_k"])


def quiet_variance(values: Values, darks: Darks) -> Array:
    """Return the variance of pixels between pulses before rounding, shape (n,), DN^2.

    Read noise, dark charge and its pattern behind the video filter, line noise, and half of what
    hidden pulses would add to noise that was not located by its lower side.
    """
    dark_e = (
        predicted.rows_per_pixel(values)
        * values["ccd.dark_current_e_per_s"]
        / values["video.field_rate_hz"]
    )
    warmth = _warmth(values, darks)
    charge = values[READ] ** 2 + dark_e * warmth + (values[DSNU] * warmth) ** 2
    reading = values[CONVERSION] ** 2 * charge * filter_covariance(values, 1)[:, 0]
    return (
        reading
        + values.get(LINE_NOISE, np.zeros(1)) ** 2
        + 0.5 * _variance_below_threshold(values, darks)
    )


def _variance_below_threshold(values: Values, darks: Darks) -> Array:
    """Return the variance of the pulses that are hidden by the noise, shape (n,), DN^2."""
    shape = values[SHAPE]
    hidden = moment_below(shape, 1.0, _unseen(values, darks), 2) / (1.0 + 1.0 / shape)
    event = _gain(values, darks) * predicted.excess_noise_factor(values)
    blur = pulse_covariance(values, ((0.0, 0.0),))[:, 0]
    return (
        hidden
        * event
        * _background(values, darks)
        * blur
        * field_products(values, darks.level.gate_s, 1)[:, 0]
    )


def _light_below_threshold(values: Values, darks: Darks) -> Array:
    """Return the fraction of the background illumination that falls on quiet pixels, shape (n,)."""
    shape = values[SHAPE]
    return np.minimum(moment_below(shape, 1.0, _unseen(values, darks), 1) + DARK_ERRORS.wing, 1.0)


def _quiet(darks: Darks) -> list[Observation]:
    """Observe level and variance of the pixels between pulses."""
    levels = (
        thresholds_of(darks.data[darks.quiet]) if darks.quiet.mean() > DARKS.least_quiet else None
    )
    if levels is None:
        return []
    count = block_sums(darks.quiet.sum(axis=0))
    counts_below = np.stack(
        [block_sums(((darks.data < level) & darks.quiet).sum(axis=0)) for level in levels], axis=1
    )
    occupied = count > 0
    best = np.array(level_and_sd(counts_below.sum(axis=0) / count.sum(), levels))
    # Jackknife over blocks: fractions near one and near zero enter together.
    parts = np.array(
        [
            level_and_sd(
                (counts_below.sum(axis=0) - block_below) / (count.sum() - block_count), levels
            )
            for block_below, block_count in zip(
                counts_below[occupied], count[occupied], strict=True
            )
        ]
    )
    if not np.isfinite(parts).all():
        return []
    jackknife = np.cov(parts.T) * (len(parts) - 1) ** 2 / len(parts)
    sheet = values_of_description(darks.sensor)
    light, hidden = (
        float(_background(sheet, darks)[0]),
        float(_light_below_threshold(sheet, darks)[0]),
    )
    unsure_dn = (
        np.hypot(DARK_ERRORS.wing_sd, 0.3 * np.sqrt(max(hidden - DARK_ERRORS.wing, 0.0))) * light
    )
    turn = np.array([1.0, 2.0 * best[1]])
    value = np.array([best[0], best[1] ** 2])
    coarse = darks.noise_dn <= DARK_ERRORS.coarse_dn
    quiet_sd = DARK_ERRORS.coarse_quiet_sd if coarse else DARK_ERRORS.quiet_sd
    level_sd = [unsure_dn, DARK_ERRORS.level_sd_dn * coarse]
    variance_sd = [quiet_sd * value[1], 0.5 * float(_variance_below_threshold(sheet, darks)[0])]
    model = np.diag([float(np.sum(np.square(sds))) for sds in (level_sd, variance_sd)])

    def predict(values: Values) -> Array:
        level = values[BLACK] + _light_below_threshold(values, darks) * _background(values, darks)
        return np.stack(np.broadcast_arrays(level, quiet_variance(values, darks)), axis=1)

    covariance = jackknife * np.outer(turn, turn) + model
    return [
        Observation(
            name="noise between pulses",
            value=value,
            covariance=covariance,
            predict=predict,
            parameters=(BLACK, READ, EBI, CONVERSION),
        )
    ]


def rounding_slope(level_dn: float, noise_dn: float) -> float:
    """Return the slope of the mean of rounded noise against its level, 1 of much noise,
    dimensionless.

    1 + 2 sum_k (-1)^k exp(-2 (pi k s)^2) cos(2 pi k level), the derivative of the mean of the
    rounded value.
    """
    order = np.arange(1, 8)
    wave = (-1.0) ** order * np.exp(-2.0 * (np.pi * order * noise_dn) ** 2)
    return float(1.0 + 2.0 * np.sum(wave * np.cos(2.0 * np.pi * order * level_dn)))


def _pattern(darks: Darks) -> list[Observation]:
    """Observe the DSNU: the covariance of the quiet pixels' means in the two halves of the
    frames.
    """
    half, quiet = len(darks.data) // 2, darks.quiet
    counts = [quiet[:half].sum(axis=0), quiet[half:].sum(axis=0)]
    is_usable = np.minimum(*counts) >= max(half // 2, 1)
    slope, sd = with_error(rounding_slope, darks)
    if is_usable.mean() < DARKS.least_quiet or slope < DARK_ERRORS.least_slope:
        return []
    quiet_deviations = np.where(quiet, darks.data - darks.level_dn, 0.0)
    means = [
        part.sum(axis=0) / np.maximum(count, 1)
        for part, count in zip(
            (quiet_deviations[:half], quiet_deviations[half:]), counts, strict=True
        )
    ]
    number = np.maximum(block_sums(is_usable), 1.0)
    centre = [block_sums(np.where(is_usable, mean, 0.0)) / number for mean in means]
    product = (
        block_sums(np.where(is_usable, means[0] * means[1], 0.0)) / number - centre[0] * centre[1]
    )
    product = product[number > 0.1 * is_usable.size / number.size]
    if product.size < FRAMES.blocks[0]:
        return []
    value, scatter = float(product.mean()), float(product.std(ddof=1) / np.sqrt(product.size))

    def predict(values: Values) -> Array:
        pattern = values[CONVERSION] * values[DSNU] * _warmth(values, darks)
        return pattern**2 * filter_covariance(values, 1)[:, 0]

    coarse = DARK_ERRORS.coarse_pattern_dn**2 * (darks.noise_dn <= DARK_ERRORS.coarse_dn)
    error = float(np.hypot.reduce([scatter, 2.0 * sd / slope * value, coarse])) / slope**2
    return [scalar_observation("DSNU", value / slope**2, error, predict, (DSNU, CONVERSION))]


def with_error(effect: Callable[[float, float], float], darks: Darks) -> tuple[float, float]:
    """Return an effect of rounding at the level and noise of the darks, and its error by those of
    both.

    Noise well above a step is not changed by rounding.
    """
    if darks.noise_dn > DARK_ERRORS.coarse_dn:
        return 1.0, 0.0
    level, noise = darks.level_dn, darks.noise_dn
    nominal = effect(level, noise)
    shifted = (
        effect(level - DARK_ERRORS.level_sd_dn, noise),
        effect(level, (1.0 - darks.noise_relative_sd) * noise),
    )
    return nominal, float(np.hypot(shifted[0] - nominal, shifted[1] - nominal))


def _events(darks: Darks) -> list[Observation]:
    """Observe the background illumination by the covariance of neighbours, and of fine digitisers
    by its mean.
    """
    separations = (
        ((0, 1), (1, 1)) if darks.sensor.video.low_pass is not None else ((1, 0), (0, 1), (1, 1))
    )
    value, sd = _neighbour_covariance(darks, separations)
    rounding_factor, rounding_factor_sd = with_error(
        partial(covariance_after_rounding, darks), darks
    )
    covariance_sd = (
        DARK_ERRORS.covariance_sd
        if darks.noise_dn > DARK_ERRORS.coarse_dn
        else DARK_ERRORS.coarse_covariance_sd
    )
    model = np.hypot.reduce(
        [
            covariance_sd,
            DARK_ERRORS.rounding_sd * (rounding_factor - 1.0) / rounding_factor,
            rounding_factor_sd / rounding_factor,
        ]
    )
    value, sd = value / rounding_factor, float(np.hypot(sd, model * value)) / rounding_factor
    pixel_separations = tuple((float(columns), float(rows)) for columns, rows in separations)

    def spread(values: Values) -> Array:
        products = field_products(values, darks.level.gate_s, darks.fields)[:, :: darks.step]
        return pulse_covariance(values, pixel_separations).sum(axis=1) * (
            products @ _without_mean(len(darks.data))
        )

    def predict(values: Values) -> Array:
        event = _gain(values, darks) * predicted.excess_noise_factor(values)
        small = moment_below(values[SHAPE], 1.0, single_pulse_limit(values, darks.ions), 2) / (
            1.0 + 1.0 / values[SHAPE]
        )
        return (
            event * _background(values, darks) * small + weak_ions(values, darks.ions)[1]
        ) * spread(values)

    observations = (
        [scalar_observation("dark events", value, sd, predict, (EBI, *IONS))]
        if value > 3.0 * sd
        else []
    )
    if darks.noise_dn > DARK_ERRORS.coarse_dn:
        observations += _mean_of_events(darks)
    return observations


def _without_mean(count: int) -> Array:
    """Return the weights of the covariances at each lag in the variance about the mean of all
    frames, (count,).
    """
    lag = np.arange(count)
    total = np.where(lag == 0, count, 2.0 * (count - lag)) / count**2
    return ((lag == 0) - total) * count / (count - 1.0)


def _neighbour_covariance(
    darks: Darks, separations: tuple[tuple[int, int], ...]
) -> tuple[float, float]:
    """Return the sum of the covariances of neighbours in time, and its standard error by the
    scatter over blocks.
    """
    is_usable = ~darks.ions.reached
    count, rows, columns = darks.data.shape
    x = np.empty_like(darks.data)
    for parity in range(darks.step):
        field = darks.data[:, parity :: darks.step]
        x[:, parity :: darks.step] = (
            field - field[:, is_usable[parity :: darks.step]].mean(axis=1)[:, None, None]
        )
    x = (x - x.mean(axis=0)) * is_usable
    total, number = (
        np.zeros(FRAMES.blocks[0] * FRAMES.blocks[1]),
        np.zeros(FRAMES.blocks[0] * FRAMES.blocks[1]),
    )
    for right, down in separations:
        down *= darks.step
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
    blur = pulse_covariance(values, ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))[0]
    width, height_px = (1.0 / np.sqrt(4.0 * np.log(blur[0] / neighbour)) for neighbour in blur[1:])
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


def _mean_of_events(darks: Darks) -> list[Observation]:
    """Observe the mean of all pixels that no ion reaches above the level between pulses."""
    is_usable = ~darks.ions.reached
    mean = darks.data.mean(axis=0, dtype=np.float64) - darks.level_dn
    number = block_sums(is_usable)
    occupied = number > 0.1 * number.max()
    block_mean = block_sums(mean * is_usable)[occupied] / number[occupied]
    value = float(block_sums(mean * is_usable).sum() / number.sum())
    sd = float(
        np.hypot(block_mean.std(ddof=1) / np.sqrt(block_mean.size), DARK_ERRORS.wing_sd * value)
    )

    def predict(values: Values) -> Array:
        small = moment_below(values[SHAPE], 1.0, single_pulse_limit(values, darks.ions), 1)
        pulses = _background(values, darks) * (small - _light_below_threshold(values, darks))
        return pulses + weak_ions(values, darks.ions)[0]

    return (
        [scalar_observation("mean of dark events", value, sd, predict, (EBI, BLACK, *IONS))]
        if value > 3.0 * sd
        else []
    )
