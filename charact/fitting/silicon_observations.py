"""Gain, levels and efficiency of a camera without a tube.

    mu = b + K g s (1 - c K g s / full scale),  s = eta p (1 + t0/t) (1 + 10 m)

b: black level; p: photons of a pixel in the exposure t; t0: offset of the shutter; eta: quantum
efficiency; m: smear of a spot of a tenth of the height, of a flat ten times as much; K g and c: see
`charact.observables.silicon`.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.gain.emva1288 import excess_of
from charact.estimators.noise.illumination import relative_sd_of, table_sensitivity_ua_per_lm
from charact.fitting.measured_quantity import Measured, MeasuredQuantity, photon_transfer_of
from charact.fitting.predicted_quantities import ELEMENTARY_CHARGE_C, in_columns
from charact.fitting.stack_levels import SessionStacks, dark_rise_dn_per_s
from charact.method import Context
from charact.observables import (
    Estimates,
    Observable,
    Values,
    columns,
    declare,
    observable,
    sd_of,
)
from charact.observables.fixed_pattern import PRNU_FRACTION, Prnu
from charact.observables.photon_transfer import PhotonTransfer
from charact.observables.silicon import (
    BLACK_LEVEL,
    COMPRESSION,
    DARK_CURRENT,
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
from labdata import Array
from labdata.camera.chip import Silicon

EFFICIENCY, PITCH = "ccd.quantum_efficiency", "ccd.pitch_x_um"


def electrons_per_lumen(silicon: Silicon) -> float:
    """Return the photoelectrons per lumen and second of 2856 K light for a highest quantum
    efficiency of 1.
    """
    relative = np.asarray(silicon.quantum_efficiency) / max(silicon.quantum_efficiency)
    sensitivity = table_sensitivity_ua_per_lm(silicon.wavelength_nm, relative.tolist())
    return sensitivity * 1e-6 / ELEMENTARY_CHARGE_C


def signal_of_light(
    values: Values,
    light: Array,
    in_lux: NDArray[np.bool_],
    gain: Array,
    exposure_s: Array,
    full_dn: float,
) -> Array:
    """Return the signal above black of evenly lit pixels, shape (n, level), DN.

    `light`: `electrons_per_efficiency` of each level, shape (level,); `in_lux`: whether that is per
    m2; `gain`: DN per photoelectron, shape (n, level); `exposure_s`: exposures, shape (level,).
    """
    of_chip = in_columns(values)
    area_m2 = of_chip[PITCH] * of_chip["ccd.pitch_y_um"] * 1e-12
    electrons = of_chip[EFFICIENCY] * np.where(in_lux, area_m2, 1.0) * light
    electrons = electrons * (1.0 + of_chip[OFFSET] / (1e6 * exposure_s))
    # A spot of a tenth of the height smears that fraction: a flat ten times as much.
    electrons = electrons * (1.0 + 10.0 * of_chip["ccd.smear_fraction"])
    signal = gain * electrons
    return signal * (1.0 - of_chip[COMPRESSION] * signal / full_dn)


def electrons_per_efficiency(silicon: Silicon, level: StackLevel) -> float:
    """Return the photoelectrons of a pixel, or per m2 where light is in lux, for a highest quantum
    efficiency of 1.
    """
    conditions = level.conditions
    relative = np.asarray(silicon.quantum_efficiency) / max(silicon.quantum_efficiency)
    if np.isfinite(level.illuminance_lux):
        return electrons_per_lumen(silicon) * level.illuminance_lux * level.gate_s
    relative_efficiency = float(
        np.interp(
            conditions.wavelength_nm or 0.0, silicon.wavelength_nm, relative, left=0.0, right=0.0
        )
    )
    return relative_efficiency * (conditions.photons_per_px or 0.0)


def transfer_slope(values: Values, shown: Measured) -> Array:
    """Return the slope of variance over signal, K g F^2, over the fitted range, shape (n,), DN.

    Least squares over 0..x of y (1 - 3 c y) has the slope 1 - 3 c x.
    """
    stacks, conditions = shown.stacks, shown.stacks.flat_conditions
    (signal,) = photon_transfer_of(stacks, "signal_dn")
    full = 2.0**stacks.camera.video.bit_depth - 1.0
    fitted_range = float(signal.max()) / full if signal.size else SILICON.emva_reach
    slope = dn_per_electron(values, conditions) * (1.0 - 3.0 * fitted_range * values[COMPRESSION])
    return slope * em_gain(values, conditions) * register_excess(values, conditions)


def system_gain(values: Values, shown: Measured) -> Array:
    """Return the slope over the excess noise factor that was divided out, shape (n,), DN."""
    context = Context(camera=shown.stacks.camera)
    return transfer_slope(values, shown) / excess_of(shown.stacks.flat_conditions, context).factor


def dark_slope(values: Values, shown: Measured) -> Array:
    """Return the rise of the dark level without a clamp, shape (n,), DN/s."""
    warm = shown.stacks.dark.conditions
    gain = dn_per_electron(values, warm) * em_gain(values, warm)
    return gain * dark_electrons(values, warm, 1.0)


def dark_slope_paths(stacks: SessionStacks) -> tuple[str, ...]:
    """Return the paths of the rise of the dark level."""
    warm = stacks.dark.conditions
    return (*amplification(warm), DARK_CURRENT, *cooling(warm))


SLOPE = MeasuredQuantity(
    name="gain",
    order=-7,
    tube=False,
    unless=(PhotonTransfer.name,),
    quantity="system_gain",
    unit="DN/e-",
    first=True,
    number=system_gain,
    relative_model_sd=0.001,
    paths=lambda stacks: (*amplification(stacks.flat_conditions), HEIGHTS, COMPRESSION),
)
declare(
    SLOPE,
    replace(
        SLOPE,
        name="gain of covariances",
        shown_as=SLOPE.name,
        order=-6,
        unless=(PhotonTransfer.name, SLOPE.name),
        quantity="covariance_gain",
        unit="DN",
        number=transfer_slope,
    ),
    # Where no dark and flat of known light show it.
    MeasuredQuantity(
        name="stated PRNU",
        shown_as=Prnu.name,
        order=36,
        tube=False,
        unless=(Prnu.name,),
        quantity="prnu",
        unit="%",
        factor=0.01,
        number=lambda values, shown: values[PRNU_FRACTION],
        relative_model_sd=SILICON.noise_model_sd,
        depends=(PRNU_FRACTION,),
    ),
    # A clamp removes an unknown fraction of the dark charge.
    MeasuredQuantity(
        name="rise of the dark level",
        order=39,
        tube=False,
        is_bound=True,
        quantity="dark_current",
        unit="DN/s",
        where=lambda shown: shown.stacks.darks and (shown.m.value or 0.0) > 3.0 * sd_of(shown.m),
        number=dark_slope,
        paths=dark_slope_paths,
    ),
    # Of light of unstated wavelength: a lower bound of the highest.
    MeasuredQuantity(
        name="quantum efficiency",
        order=41,
        tube=False,
        is_bound=True,
        quantity="quantum_efficiency",
        unit="%",
        factor=0.01,
        where=lambda shown: not any(flat.light_known for flat in shown.stacks.flats),
        number=lambda values, shown: values[EFFICIENCY],
        depends=(EFFICIENCY,),
    ),
)


@dataclass(frozen=True, kw_only=True)
class Lit:
    """Darks and flats of known light, with what their levels follow from."""

    levels: tuple[StackLevel, ...]
    light: Array  # `electrons_per_efficiency`, shape (level,)
    in_lux: NDArray[np.bool_]  # whether that is per m2
    full: float  # full scale, DN
    rise_dn_per_s: float  # rise of the dark level with exposure
    lit: tuple[StackLevel, ...]  # the flats
    of_lux: bool  # whether their light is stated in lux


@observable
class ChipLevels(Observable[Lit]):
    """Levels of darks and flats: an error of the light is common to all flats.

    The black level is that of the shortest exposure: of every stack the dark signal is taken off
    that its exposure has beyond that one (EMVA 1288 takes the dark of the same exposure).
    """

    name = "levels"
    order = 40
    tube = False

    def usable(self, stacks: SessionStacks) -> Lit | None:
        """Return flats of known light, and darks no longer than the flats: the level of a longer
        dark contains a dark charge that a clamp need not remove.
        """
        flats = stacks.session.of_kind("flat")
        longest_s = max((entry.conditions.exposure_s or 0.0 for entry in flats), default=0.0)
        lit = tuple(flat for flat in stacks.flats if flat.light_known)
        short = (dark for dark in stacks.all_darks if not longest_s or dark.exposure_s <= longest_s)
        levels, silicon = (*short, *lit), stacks.camera.silicon
        if not levels:
            return None
        return Lit(
            levels=levels,
            light=np.array([electrons_per_efficiency(silicon, level) for level in levels]),
            in_lux=np.array([np.isfinite(level.illuminance_lux) for level in levels]),
            full=float(2**stacks.camera.video.bit_depth - 1),
            rise_dn_per_s=dark_rise_dn_per_s(stacks.levels),
            lit=lit,
            of_lux=any(np.isfinite(flat.illuminance_lux) for flat in lit),
        )

    def measure(self, shown: Lit) -> Estimates:
        """Return the level of every stack without its rise, DN."""
        exposure_s = np.array([level.exposure_s for level in shown.levels])
        mean = np.array([level.mean_dn for level in shown.levels]) - shown.rise_dn_per_s * (
            exposure_s - exposure_s.min()
        )
        signal = np.where([level.dark for level in shown.levels], 0.0, mean - mean.min())
        unit = "lux" if shown.of_lux else "photons/px"
        lit = [level.conditions for level in shown.lit]
        shared = np.hypot(
            relative_sd_of(lit, unit)[0] if lit else 0.0,
            SILICON.lumen_model_sd if shown.of_lux else 0.0,
        )
        # Rounding of a level with little noise is biased by up to a tenth.
        rounding = [
            0.1 if level.noise_dn < SILICON.least_noise_dn else 0.03 for level in shown.levels
        ]
        level_sd = np.array([level.mean_sd_dn for level in shown.levels])
        variance = level_sd**2 + np.square(rounding) + (SILICON.level_model_sd * signal) ** 2
        return Estimates(
            value=mean, covariance=np.diag(variance) + shared**2 * np.outer(signal, signal)
        )

    def predict(self, values: Values, shown: Lit) -> Array:
        """Return the level of every stack, shape (n, level), DN."""
        gain = columns(
            *(
                dn_per_electron(values, level.conditions) * em_gain(values, level.conditions)
                for level in shown.levels
            )
        )
        exposure_s = np.array([level.gate_s for level in shown.levels])
        light = (shown.light, shown.in_lux, gain, exposure_s, shown.full)
        return values[BLACK_LEVEL][:, None] + signal_of_light(values, *light)

    def parameters(self, shown: Lit) -> tuple[str, ...]:
        if not shown.lit:
            return (BLACK_LEVEL,)
        gains = (path for level in shown.lit for path in amplification(level.conditions))
        # Of one exposure the shutter's offset is as good as more light.
        late = (OFFSET,) if len({level.gate_s for level in shown.lit}) > 1 else ()
        pitch = (PITCH,) if shown.of_lux else ()
        return (BLACK_LEVEL, *dict.fromkeys(gains), COMPRESSION, *late, EFFICIENCY, *pitch)
