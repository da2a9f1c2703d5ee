"""Observations of a camera without a tube: gain, dark noise, levels, fixed patterns, saturation."""

import numpy as np

from charact.estimators.noise.gain.emva1288 import excess_of
from charact.estimators.noise.illumination import relative_sd_of, table_sensitivity_ua_per_lm
from charact.fitting.mtf_observations import glare_observations, mtf_observations
from charact.fitting.observation import (
    Observation,
    admissible_measurements,
    at_least,
    observations_of,
    scalar_observation,
    sd_of,
)
from charact.fitting.predicted_quantities import ELEMENTARY_CHARGE_C
from charact.fitting.stack_levels import dark_rise_dn_per_s
from charact.method import Context
from charact.observables import Stacks, Values
from charact.observables.fixed_pattern import Prnu
from charact.observables.photon_transfer import PhotonTransfer
from charact.observables.silicon import (
    COMPRESSION,
    HEIGHTS,
    OFFSET,
    amplification,
    cooling,
    dark_electrons,
    dn_per_electron,
    em_gain,
    register_excess,
)
from charact.observables.stack_level import StackLevel
from charact.observables.thresholds import SILICON
from labdata import Array, Camera, Conditions, Result, Session
from labdata.camera.chip import Silicon

LENS = ("optics.aberration_blur_um", "optics.f_number")


def electrons_per_efficiency(silicon: Silicon, level: StackLevel) -> float:
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
    session: Session, camera: Camera, result: Result, levels: tuple[StackLevel, ...]
) -> tuple[Observation, ...]:
    """Return the observations of a session of a camera without a tube."""
    stacks = Stacks(
        darks=tuple(level for level in levels if level.dark and np.isfinite(level.variance_sd_dn2)),
        flats=tuple(level for level in levels if not level.dark),
        camera=camera,
        result=result,
    )
    flats = session.of_kind("flat")
    flat_conditions = flats[0].conditions if flats else Conditions()
    observations = mtf_observations(session, camera, result, LENS)
    if stacks.darks:
        observations += glare_observations(session, stacks.dark.mean_dn)
    shown = observations_of(stacks)
    if PhotonTransfer.name not in shown:
        observations += _gain(camera, result, flat_conditions)
    observations += shown.values()
    if Prnu.name not in shown:
        observations += _stated_response_pattern(result)
    observations += _saturation(result, flat_conditions)
    observations += _dark_slope(result, stacks.darks)
    known = [level for level in stacks.flats if level.light_known]
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

    depends = (*amplification(flat_conditions), HEIGHTS, COMPRESSION)
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


def _stated_response_pattern(result: Result) -> list[Observation]:
    """Observe the measured PRNU where no dark and flat of known light show it."""
    observations = []
    for m in admissible_measurements(result, "prnu", "%"):
        value = 0.01 * (m.value or 0.0)
        sd = float(np.hypot(0.01 * sd_of(m), SILICON.noise_model_sd * value))
        observations.append(
            scalar_observation("PRNU", value, sd, lambda values: values["ccd.prnu"], ("ccd.prnu",))
        )
    return observations


def _saturation(result: Result, flat_conditions: Conditions) -> list[Observation]:
    """Observe a lower bound of the full well: the digitiser may clip first, and few levels locate a
    peak badly.
    """
    depends = (*amplification(flat_conditions), "ccd.full_well_e", "video.black_level_dn")

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


def _dark_slope(result: Result, darks: tuple[StackLevel, ...]) -> list[Observation]:
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

    depends = (*amplification(warm), "ccd.dark_current_e_per_s", *cooling(warm))
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


def _levels(camera: Camera, levels: tuple[StackLevel, ...], rise_dn_per_s: float) -> Observation:
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
    level_sd = np.array([level.mean_sd_dn for level in levels])
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
        gains = dict.fromkeys(path for conditions in lit for path in amplification(conditions))
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
