"""Charge that frames show pixels to hold, a lower bound of the full well W.

    W >= s / (K g),  y - b = s (1 - c s / full scale)

y: grey value that a thousandth of the pixels of a frame reach, without their read noise; b: black
level; K g and c: see `charact.observables.silicon`. No pixel holds more than its well, whether it
is saturated or not.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from charact.fitting.observation import has_automatic_gain
from charact.fitting.prior import prior_of
from charact.fitting.thresholds import LIMITS, SAMPLING
from charact.observables import Values
from charact.observables.silicon import (
    BLACK_LEVEL,
    COMPRESSION,
    CONVERSION_GAIN,
    dn_per_electron,
    em_gain,
)
from charact.observables.stack_level import StackLevel
from labdata import Array, Camera, Conditions, Session, StackEntry, open_lazy_stack

FULL_WELL = "ccd.full_well_e"


@dataclass(frozen=True, kw_only=True)
class ShownLevel:
    """Grey value that pixels of a stack reach."""

    label: str  # of the stack
    level_dn: float
    conditions: Conditions

    def charge(self, values: Values, full_dn: float) -> Array:
        """Return the charge of such a pixel for n draws, shape (n,), e-."""
        signal = self.level_dn - values[BLACK_LEVEL]
        if COMPRESSION not in values:
            return signal / values[CONVERSION_GAIN]
        bend = np.maximum(1.0 - 4.0 * values[COMPRESSION] * signal / full_dn, 0.0)
        gain = dn_per_electron(values, self.conditions) * em_gain(values, self.conditions)
        return 2.0 * signal / (1.0 + np.sqrt(bend)) / gain


def shown_levels(session: Session, levels: tuple[StackLevel, ...]) -> tuple[ShownLevel, ...]:
    """Return the level of every lit stack of fixed gain, but of flats in the linear range that of
    the brightest of a gain.

    `levels`: darks and flats in the linear range.
    """
    noise_dn = min((level.noise_dn for level in levels if level.dark), default=0.0)
    brightest = {
        (level.conditions.camera_gain_db, level.conditions.em_gain): level.label
        for level in sorted(levels, key=lambda level: level.mean_dn)
    }
    dimmer = {level.label for level in levels} - set(brightest.values())
    lit = (
        entry
        for entry in session.stacks
        if entry.kind != "dark"
        and entry.label not in dimmer
        and not has_automatic_gain(entry.conditions)
    )
    return tuple(
        ShownLevel(
            label=entry.label,
            level_dn=_level_of(entry, entry.bit_depth or session.bit_depth, noise_dn),
            conditions=entry.conditions,
        )
        for entry in lit
    )


def _level_of(entry: StackEntry, bit_depth: int | None, noise_dn: float) -> float:
    """Return the level of the first frame of a stack: full scale where enough pixels reach it, and
    a point source where one does.
    """
    frame = open_lazy_stack(entry).frames(0, 1)[0]
    full_dn = np.inf if bit_depth is None else 2.0**bit_depth - 1.0
    if entry.kind == "point" and frame.max() >= full_dn:
        return full_dn
    # Multiplied electrons vary by more than their number.
    multiplied = entry.conditions.em_gain not in (None, 1.0)
    level_dn = float(
        frame.mean() if multiplied else np.quantile(frame, 1.0 - LIMITS.brightest_fraction)
    )
    margin_dn = LIMITS.read_noise_margin * noise_dn + 0.5
    return level_dn if level_dn >= full_dn else level_dn - margin_dn


def full_well_draws(
    sensor: Camera, values: Values, shown: Iterable[ShownLevel], rng: np.random.Generator
) -> Array | None:
    """Return the full well for each of n draws, e-: the prior, truncated below the charge that
    frames show, or that charge where nothing remains; None where no frames show any.
    """
    prior, full_dn = prior_of(sensor, (FULL_WELL,)), 2.0**sensor.video.bit_depth - 1.0
    charges = [level.charge(values, full_dn) for level in shown]
    if not prior.names or not charges:
        return None
    least_charge = np.max(np.broadcast_arrays(*charges), axis=0)
    tried = np.sort(prior.parameters(prior.draw(rng, SAMPLING.candidates))[:, 0])
    first = np.searchsorted(tried, least_charge)
    picked = first + np.floor(rng.random(least_charge.size) * (SAMPLING.candidates - first)).astype(
        int
    )
    return np.where(
        first < SAMPLING.candidates,
        tried[np.minimum(picked, SAMPLING.candidates - 1)],
        least_charge,
    )
