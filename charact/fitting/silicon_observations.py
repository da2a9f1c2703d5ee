"""Observations of a camera without a tube: gain, dark noise, levels, fixed patterns, saturation."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.gain.emva1288 import excess_of
from charact.estimators.noise.illumination import relative_sd_of, table_sensitivity_ua_per_lm
from charact.fitting.mtf_observations import glare_observations, mtf_observations
from charact.fitting.observation import (
    NOISE_MODEL_SD,
    Observation,
    admissible_measurements,
    at_least,
    scalar_observation,
    sd_of,
)
from charact.fitting.predicted_quantities import ELEMENTARY_CHARGE_C, Values
from charact.fitting.readout_observations import (
    ROW_EXPONENT,
    ROW_NOISE,
    neighbour_variance,
    readout_observations,
)
from charact.fitting.stack_levels import StackMean, dark_rise_dn_per_s
from charact.fitting.thresholds import SILICON
from charact.method import Context
from labdata.camera.chip import Silicon, excess_noise_factor
from labdata.camera.description import Camera
from labdata.conditions import Conditions
from labdata.measurement import Result
from labdata.session import Session

Array = NDArray[np.float64]

LENS = ("optics.aberration_blur_um", "optics.f_number")
HEIGHTS = "register.pulse_height_shape"
READING = (HEIGHTS, "register.clock_induced_e", "ccd.dark_current_e_per_s", "ccd.read_noise_e")
COMPRESSION, OFFSET = "readout.compression_fraction", "readout.exposure_offset_us"
EMVA_SLOPE = 3.0 * SILICON.emva_reach
# Interference is asked where a dark shows its peak.
COLOURED = (ROW_NOISE, ROW_EXPONENT)


def em_gain(values: Values, conditions: Conditions) -> Array:
    """Return the multiplication of the register: that of the conditions, else the description's."""
    return (
        values["register.em_gain"] if conditions.em_gain is None else np.array([conditions.em_gain])
    )


def dn_per_electron(values: Values, conditions: Conditions) -> Array:
    """Return DN per electron behind the register at no signal, with the camera's gain in dB."""
    amplified = values["video.conversion_gain_dn_per_e"] * 10.0 ** (
        (conditions.camera_gain_db or 0.0) / 20.0
    )
    return amplified / (1.0 - EMVA_SLOPE * values[COMPRESSION])


def register_excess(values: Values, conditions: Conditions) -> Array:
    """Return F^2 = 1 + (F0^2 - 1) / shape of the register; F0^2 is that of exponential pulse
    heights.
    """
    gain, stages = em_gain(values, conditions), float(values["register.stages"][0])
    exponential = np.array([excess_noise_factor(float(draw_gain), stages) for draw_gain in gain])
    return 1.0 + (exponential - 1.0) / values["register.pulse_height_shape"]


def dark_electrons(values: Values, conditions: Conditions, seconds: float) -> Array:
    """Return the dark charge of an exposure at the camera's temperature, e-."""
    return values["ccd.dark_current_e_per_s"] * _warmth(values, conditions) * seconds


def _warmth(values: Values, conditions: Conditions) -> Array:
    """Return dark current over that at 25 C."""
    warmer = (
        0.0 if conditions.temperature_c is None else conditions.temperature_c - SILICON.reference_c
    )
    return 2.0 ** (warmer / values["ccd.dark_current_doubling_k"])


def _amplification(conditions: Conditions) -> tuple[str, ...]:
    """Return the paths of the gain from electrons to DN: that of a register only where none is
    stated.
    """
    register_gain = ("register.em_gain",) if conditions.em_gain is None else ()
    return ("video.conversion_gain_dn_per_e", *register_gain)


def _cooling(conditions: Conditions) -> tuple[str, ...]:
    """Return the path of the temperature law where a temperature other than the reference is
    stated.
    """
    return (
        ()
        if conditions.temperature_c in (None, SILICON.reference_c)
        else ("ccd.dark_current_doubling_k",)
    )


def dark_variance(values: Values, conditions: Conditions, seconds: float) -> Array:
    """Return the temporal variance of a dark frame, DN^2.

    K^2 (r^2 + g^2 F^2 (d + c)) + 1/12 with read noise r, gain g and excess noise factor F^2 of the
    register, dark charge d and clock-induced charge c.
    """
    charge = dark_electrons(values, conditions, seconds) + values["register.clock_induced_e"]
    multiplied = em_gain(values, conditions) ** 2 * register_excess(values, conditions) * charge
    return (
        dn_per_electron(values, conditions) ** 2 * (values["ccd.read_noise_e"] ** 2 + multiplied)
        + SILICON.rounding_dn2
    )


def electrons_per_efficiency(silicon: Silicon, level: StackMean) -> float:
    """Return the photoelectrons of a pixel, or per m2 where light is in lux, for a highest quantum
    efficiency of 1.
    """
    conditions = level.conditions
    relative = np.asarray(silicon.quantum_efficiency) / max(silicon.quantum_efficiency)
    if np.isfinite(level.illuminance_lux):
        per_lumen = (
            table_sensitivity_ua_per_lm(silicon.wavelength_nm, relative.tolist())
            * 1e-6
            / ELEMENTARY_CHARGE_C
        )
        return per_lumen * level.illuminance_lux * level.gate_s
    relative_efficiency = float(
        np.interp(
            conditions.wavelength_nm or 0.0, silicon.wavelength_nm, relative, left=0.0, right=0.0
        )
    )
    return relative_efficiency * (conditions.photons_per_px or 0.0)


def silicon_observations(
    session: Session, camera: Camera, result: Result, levels: tuple[StackMean, ...]
) -> tuple[Observation, ...]:
    """Return the observations of a session of a camera without a tube."""
    darks = [level for level in levels if level.dark and np.isfinite(level.temporal_dn2[1])]
    flats = session.of_kind("flat")
    flat_conditions = flats[0].conditions if flats else Conditions()
    observations = mtf_observations(session, camera, result, LENS)
    observations += glare_observations(session, darks[0].mean_dn) if darks else []
    observations += _photon_transfer(levels, darks, result) or _gain(
        camera, result, flat_conditions
    )
    observations += _dark_noise(darks)
    observations += _readout(darks)
    observations += _patterns(levels, darks, result)
    observations += _saturation(result, flat_conditions)
    observations += _dark_slope(result, darks)
    known = [level for level in levels if not level.dark and level.light_known]
    longest_s = max((entry.conditions.exposure_s or 0.0 for entry in flats), default=0.0)
    # The level of a longer dark contains a dark charge that a clamp need not remove.
    short = [
        level
        for level in levels
        if level.dark and (not flats or level.exposure_s <= longest_s or not longest_s)
    ]
    if known or short:
        observations.append(_levels(camera, (*short, *known), dark_rise_dn_per_s(levels)))
    if not known:
        observations += _efficiency(result)
    return tuple(observations)


def _gain(camera: Camera, result: Result, flat_conditions: Conditions) -> list[Observation]:
    """Observe the slope of the photon transfer curve, K g F^2, from the system gain or else from
    covariances.
    """
    factor = excess_of(flat_conditions, Context(camera=camera)).factor
    measured = [(m, factor) for m in admissible_measurements(result, "system_gain", "DN/e-")]
    measured = measured or [
        (m, 1.0) for m in admissible_measurements(result, "covariance_gain", "DN")
    ]
    curve = result.evidence.get("photon-transfer", {})
    signal = np.array(curve.get("signal_dn", ()), float)[np.array(curve.get("fitted", ()), bool)]
    fitted_range = (
        float(signal.max()) / (2.0**camera.video.bit_depth - 1.0)
        if signal.size
        else SILICON.emva_reach
    )

    def predict(values: Values) -> Array:
        # Least squares over 0..x of y (1 - 3 c y) has the slope 1 - 3 c x.
        slope = dn_per_electron(values, flat_conditions) * (
            1.0 - 3.0 * fitted_range * values[COMPRESSION]
        )
        return slope * em_gain(values, flat_conditions) * register_excess(values, flat_conditions)

    depends = (*_amplification(flat_conditions), HEIGHTS, COMPRESSION)
    return [
        scalar_observation(
            "gain",
            by * (m.value or 0.0),
            float(by * np.hypot(sd_of(m), 0.001 * (m.value or 0.0))),
            predict,
            depends,
        )
        for m, by in measured[:1]
    ]


def _photon_transfer(
    levels: tuple[StackMean, ...], darks: list[StackMean], result: Result
) -> list[Observation]:
    """Observe variance over signal of every flat, where the photon transfer curve of the session is
    admissible.

    Of a response y = s (1 - c s / full scale) shot noise has the variance K0 g F^2 s (1 - 2 c s /
    full scale)^2.
    """
    flats = [flat for flat in levels if not flat.dark and np.isfinite(flat.temporal_dn2[1])]
    admissible = [
        *admissible_measurements(result, "system_gain", "DN/e-"),
        *admissible_measurements(result, "covariance_gain", "DN"),
    ]
    if not darks or not admissible:
        return []
    dark = darks[0]
    usable = [
        flat for flat in flats if flat.mean_dn - dark.mean_dn > SILICON.least_signal * dark.noise_dn
    ]
    if len(usable) < SILICON.fewest_flats:
        return []
    signal = np.array([flat.mean_dn - dark.mean_dn for flat in usable])
    ratio = np.array([flat.temporal_dn2[0] - dark.temporal_dn2[0] for flat in usable]) / signal
    ratio_sd = np.array([flat.temporal_dn2[1] for flat in usable]) / signal
    level = ratio * np.array([np.hypot(flat.sd_dn, dark.sd_dn) for flat in usable]) / signal
    shared = dark.temporal_dn2[1] / signal
    full, rows = usable[0].full_scale_dn, _rows_of(dark)

    def predict(values: Values) -> Array:
        gains = [
            dn_per_electron(values, flat.conditions)
            * em_gain(values, flat.conditions)
            * register_excess(values, flat.conditions)
            for flat in usable
        ]
        c = values[COMPRESSION][:, None]
        linear_signal = (
            2.0 * signal / (1.0 + np.sqrt(np.maximum(1.0 - 4.0 * c * signal / full, 0.0)))
        )
        bend = (1.0 - 2.0 * c * linear_signal / full) ** 2
        # Noise of reading passes the bent response, that of rows and interference does not.
        read_dn2 = (
            dark.temporal_dn2[0]
            - SILICON.rounding_dn2 * dark.step_dn**2
            - neighbour_variance(values, rows)[:, None]
        )
        shot = np.stack(np.broadcast_arrays(*gains), axis=1) * linear_signal * bend
        return (shot + (bend - 1.0) * read_dn2) / signal

    depends = dict.fromkeys(
        path for flat in usable for path in (*_amplification(flat.conditions), HEIGHTS, COMPRESSION)
    )
    return [
        Observation(
            name="photon transfer",
            value=ratio,
            predict=predict,
            parameters=tuple(depends),
            covariance=np.diag(ratio_sd**2 + level**2 + (NOISE_MODEL_SD * ratio) ** 2)
            + np.outer(shared, shared),
        )
    ]


def _dark_noise(darks: list[StackMean]) -> list[Observation]:
    """Observe the temporal variance of every dark whose rounding is additive."""
    observations = []
    for dark in darks:
        variance, sd = dark.temporal_dn2
        if variance > (SILICON.least_noise_dn * dark.step_dn) ** 2:
            sd = float(np.hypot(sd, NOISE_MODEL_SD * variance))
            depends = (
                *_amplification(dark.conditions),
                *READING,
                *COLOURED,
                *_cooling(dark.conditions),
            )
            observations.append(
                scalar_observation(
                    f"dark noise of {dark.label}", variance, sd, _variance_of(dark), depends
                )
            )
    return observations


def _rows_of(level: StackMean) -> int:
    """Return the rows of a stack's frames."""
    return 1 if level.entry is None else level.entry.read().shape[1]


def _variance_of(dark: StackMean) -> Callable[[Values], Array]:
    """Return the temporal variance of a pixel under the conditions of a dark, DN^2."""
    rows, coarser_dn2 = _rows_of(dark), SILICON.rounding_dn2 * (dark.step_dn**2 - 1.0)

    def predict(values: Values) -> Array:
        return (
            dark_variance(values, dark.conditions, dark.exposure_s)
            + neighbour_variance(values, rows)
            + coarser_dn2
        )

    return predict


def _readout(darks: list[StackMean]) -> list[Observation]:
    """Observe rows, neighbours and interference in the dark with most frames, of these the shortest
    exposure.
    """
    usable = [
        dark
        for dark in darks
        if dark.entry is not None
        and dark.temporal_dn2[0] > (SILICON.least_noise_dn * dark.step_dn) ** 2
    ]
    if not usable:
        return []
    dark = min(
        usable, key=lambda level: (-len(level.entry.read()) if level.entry else 0, level.exposure_s)
    )

    def read_noise_dn(values: Values) -> Array:
        return dn_per_electron(values, dark.conditions) * values["ccd.read_noise_e"]

    data = dark.entry.read().data if dark.entry else np.zeros((0, 0, 0))
    return readout_observations(
        data, read_noise_dn, ("video.conversion_gain_dn_per_e", "ccd.read_noise_e")
    )


def _patterns(
    levels: tuple[StackMean, ...], darks: list[StackMean], result: Result
) -> list[Observation]:
    """Observe PRNU, and DSNU as the pattern of the dark with most frames and longest exposure.

    The error of a variance over pixels contains their kurtosis: a pattern of little dark charge is
    that of few pixels.
    """
    observations = _response_pattern(levels, darks) or _stated_response_pattern(result)
    if not darks:
        return observations
    dark = max(
        darks, key=lambda level: (len(level.entry.read()) if level.entry else 0, level.exposure_s)
    )

    def pattern(values: Values) -> Array:
        gain = dn_per_electron(values, dark.conditions) * em_gain(values, dark.conditions)
        return (gain * values["ccd.dsnu_e"] * _warmth(values, dark.conditions)) ** 2

    value, spatial_sd = dark.spatial_dn2
    sd = float(np.hypot(spatial_sd, 2.0 * NOISE_MODEL_SD * value))
    depends = (*_amplification(dark.conditions), "ccd.dsnu_e", *_cooling(dark.conditions))
    observations.append(scalar_observation("DSNU", value, sd, pattern, depends))
    return observations


def _response_pattern(levels: tuple[StackMean, ...], darks: list[StackMean]) -> list[Observation]:
    """Observe the squared PRNU in the flat with its smallest error.

    It is the fixed pattern less that of a dark, over signal squared.

    Shading of light and lens, which the PRNU of EMVA 1288 contains, is no part of it.
    """
    if not darks:
        return []
    dark, patterns = darks[0], []
    for flat in levels:
        signal = flat.mean_dn - dark.mean_dn
        if not flat.dark and np.isfinite(flat.spatial_dn2[1]) and signal > 0.0:
            value = (flat.spatial_dn2[0] - dark.spatial_dn2[0]) / signal**2
            patterns.append(
                (float(np.hypot(flat.spatial_dn2[1], dark.spatial_dn2[1])) / signal**2, value)
            )
    if not patterns:
        return []
    pattern_sd, value = min(patterns)
    sd = float(np.hypot(pattern_sd, 2.0 * NOISE_MODEL_SD * value))
    return [
        scalar_observation("PRNU", value, sd, lambda values: values["ccd.prnu"] ** 2, ("ccd.prnu",))
    ]


def _stated_response_pattern(result: Result) -> list[Observation]:
    """Observe the measured PRNU where no dark and flat of known light show it."""
    observations = []
    for m in admissible_measurements(result, "prnu", "%"):
        value = 0.01 * (m.value or 0.0)
        sd = float(np.hypot(0.01 * sd_of(m), NOISE_MODEL_SD * value))
        observations.append(
            scalar_observation("PRNU", value, sd, lambda values: values["ccd.prnu"], ("ccd.prnu",))
        )
    return observations


def _saturation(result: Result, flat_conditions: Conditions) -> list[Observation]:
    """Observe a lower bound of the full well: the digitiser may clip first, and few levels locate a
    peak badly.
    """
    depends = (*_amplification(flat_conditions), "ccd.full_well_e", "video.black_level_dn")

    def level(values: Values) -> Array:
        charge = values["ccd.full_well_e"] * em_gain(values, flat_conditions)
        return values["video.black_level_dn"] + dn_per_electron(values, flat_conditions) * charge

    curve = result.evidence.get("photon-transfer", {})
    means = np.array(curve.get("mean_dn", ()), float)
    for m in admissible_measurements(result, "saturation", "DN"):
        value = m.value or 0.0
        sd = float(np.hypot(sd_of(m), SILICON.saturation_model_sd * value))
        return [at_least("saturation", value, sd, level, depends)]
    linear = means[np.array(curve.get("fitted", ()), bool)]
    if not linear.size:
        return []
    brightest = float(linear.max())
    return [
        at_least(
            "brightest linear flat",
            brightest,
            SILICON.saturation_model_sd * brightest,
            level,
            depends,
        )
    ]


def _dark_slope(result: Result, darks: list[StackMean]) -> list[Observation]:
    """Observe the rise of the dark level as a lower bound of the dark current: a clamp removes an
    unknown fraction.
    """
    if not darks:
        return []
    warm = darks[0].conditions

    def slope(values: Values) -> Array:
        return (
            dn_per_electron(values, warm)
            * em_gain(values, warm)
            * dark_electrons(values, warm, 1.0)
        )

    depends = (*_amplification(warm), "ccd.dark_current_e_per_s", *_cooling(warm))
    return [
        at_least("rise of the dark level", m.value, sd_of(m), slope, depends)
        for m in admissible_measurements(result, "dark_current", "DN/s")
        if m.value is not None and m.value > 3.0 * sd_of(m)
    ]


def _efficiency(result: Result) -> list[Observation]:
    """Observe the quantum efficiency of light of unstated wavelength: a lower bound of the
    highest.
    """
    return [
        at_least(
            "quantum efficiency",
            0.01 * (m.value or 0.0),
            0.01 * sd_of(m),
            lambda values: values["ccd.quantum_efficiency"],
            ("ccd.quantum_efficiency",),
        )
        for m in admissible_measurements(result, "quantum_efficiency", "%")
    ]


def _levels(camera: Camera, levels: tuple[StackMean, ...], rise_dn_per_s: float) -> Observation:
    """Observe stack means: black level plus gain times photoelectrons; an error of the light is
    common to all flats.

    The black level is that of the shortest exposure; `rise_dn_per_s` is the rise of the dark level
    with exposure.
    """

    light = np.array([electrons_per_efficiency(camera.silicon, level) for level in levels])
    in_lux = np.array([np.isfinite(level.illuminance_lux) for level in levels])

    exposure_us = 1e6 * np.array([level.gate_s for level in levels])
    full = float(2**camera.video.bit_depth - 1)

    def predict(values: Values) -> Array:
        gains = [
            dn_per_electron(values, level.conditions) * em_gain(values, level.conditions)
            for level in levels
        ]
        area_m2 = values["ccd.pitch_x_um"] * values["ccd.pitch_y_um"] * 1e-12
        electrons = (
            values["ccd.quantum_efficiency"][:, None]
            * np.where(in_lux, area_m2[:, None], 1.0)
            * light
        )
        electrons = electrons * (1.0 + values[OFFSET][:, None] / exposure_us)
        # A spot of a tenth of the height smears that fraction: a flat ten times as much.
        electrons = electrons * (1.0 + 10.0 * values["ccd.smear_fraction"][:, None])
        c = values[COMPRESSION][:, None]
        linear_signal = np.stack(np.broadcast_arrays(*gains), axis=1) * electrons
        return values["video.black_level_dn"][:, None] + linear_signal * (
            1.0 - c * linear_signal / full
        )

    # The level of every stack less the dark signal that its exposure has beyond the shortest one's:
    # EMVA 1288 takes the dark of the same exposure.
    exposure_s = np.array([level.exposure_s for level in levels])
    mean = np.array([level.mean_dn for level in levels]) - rise_dn_per_s * (
        exposure_s - exposure_s.min()
    )
    black = float(mean.min())
    signal = np.where([level.dark for level in levels], 0.0, mean - black)
    level_sd = np.array([level.sd_dn for level in levels])
    lit = [level.conditions for level in levels if not level.dark]
    of_lux = bool(in_lux[signal > 0.0].any())
    relative_sd = relative_sd_of(lit, "lux" if of_lux else "photons/px")[0] if lit else 0.0
    shared = float(np.hypot(relative_sd, SILICON.lumen_model_sd if of_lux else 0.0))
    # Rounding of a level with little noise is biased by up to a tenth.
    rounding = np.array(
        [0.1 if level.noise_dn < SILICON.least_noise_dn else 0.03 for level in levels]
    )
    covariance = np.diag(
        level_sd**2 + rounding**2 + (SILICON.level_model_sd * signal) ** 2
    ) + shared**2 * np.outer(signal, signal)
    depends = ("video.black_level_dn",)
    if lit:
        gains = dict.fromkeys(path for conditions in lit for path in _amplification(conditions))
        # Of one exposure the shutter's offset is as good as more light.
        late = (OFFSET,) if len({level.gate_s for level in levels if not level.dark}) > 1 else ()
        depends += (
            *gains,
            COMPRESSION,
            *late,
            "ccd.quantum_efficiency",
            *(("ccd.pitch_x_um",) if of_lux else ()),
        )
    return Observation(
        name="levels", value=mean, covariance=covariance, predict=predict, parameters=depends
    )
