"""Stacks of a session as its fit sees them: mean level, temporal variance, fixed pattern, events of
darks.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.illumination import gathering_s
from charact.fitting.thresholds import LEVELS
from charact.fitting.tube_darks import Darks, darks_of
from charact.fitting.tube_ions import IonEvents, ions_of
from charact.frames.rounding import rounding_step
from charact.observables import Stacks
from charact.observables.stack_level import StackLevel, variances_of
from labdata import Camera, Conditions, Result, Session, StackEntry


@dataclass(frozen=True, kw_only=True)
class SessionStacks(Stacks[StackLevel]):
    """Darks of known noise and flats of a session of a described camera, and what it measured."""

    session: Session
    camera: Camera  # pyright: ignore[reportGeneralTypeIssues] - no default, unlike that of the base
    levels: tuple[StackLevel, ...]  # all darks and flats within the linear range

    @property
    def all_darks(self) -> tuple[StackLevel, ...]:
        """Darks, also of a single frame, whose noise is unknown."""
        return tuple(level for level in self.levels if level.dark)

    @property
    def brightest(self) -> list[StackLevel]:
        """Flats, the brightest first."""
        return sorted(self.flats, key=lambda level: -level.mean_dn)

    @property
    def black_dn(self) -> float:
        """Level of the darkest dark, else the black level of the description, DN."""
        described_dn = float(self.camera.video.black_level_dn)
        return min((dark.mean_dn for dark in self.all_darks), default=described_dn)

    @property
    def flat_conditions(self) -> Conditions:
        """Conditions of the first flat."""
        flats = self.session.of_kind("flat")
        return flats[0].conditions if flats else Conditions()

    @cached_property
    def ions(self) -> IonEvents | None:
        """Ion events of the dark behind a tube."""
        return ions_of(self.camera, self.result, self.levels)

    @cached_property
    def quiet_darks(self) -> Darks | None:
        """Frames of that dark, and what is quiet in them."""
        return None if self.ions is None else darks_of(self.ions)


def stacks_of(
    session: Session, camera: Camera, result: Result, levels: tuple[StackLevel, ...]
) -> SessionStacks:
    """Return the stacks of a session of a camera with the measurements of it."""
    return SessionStacks(
        session=session,
        camera=camera,
        result=result,
        levels=levels,
        darks=tuple(level for level in levels if level.dark and np.isfinite(level.variance_sd_dn2)),
        flats=tuple(level for level in levels if not level.dark),
    )


def levels_of(session: Session) -> tuple[StackLevel, ...]:
    """Return the means of the session's darks and flats within the linear range.

    Flats of unknown light are left out behind a tube; of a camera without one their noise is that
    of their signal, and flats of full wells are left out, at whatever code they end.
    """
    entries = session.of_kind("dark", "flat")
    levels = tuple(level for entry in entries if (level := _level(session, entry)) is not None)
    if session.camera is None or session.camera.has_tube:
        return levels
    return tuple(level for level in levels if not _is_full(level, levels))


def _is_full(level: StackLevel, levels: tuple[StackLevel, ...]) -> bool:
    """Whether a flat has far less noise than a dimmer one of the same amplification."""
    return not level.dark and any(
        not dimmer.dark
        and dimmer.mean_dn < level.mean_dn
        and dimmer.conditions.camera_gain_db == level.conditions.camera_gain_db
        and dimmer.conditions.em_gain == level.conditions.em_gain
        and level.variance_dn2 + LEVELS.full_sd * level.variance_sd_dn2
        < LEVELS.full_variance * dimmer.variance_dn2
        for dimmer in levels
    )


def note_on_exclusions(session: Session, levels: tuple[StackLevel, ...]) -> str | None:
    """Return the note on darks and flats that are out of the linear range, None where there are
    none.
    """
    used_labels = {level.label for level in levels}
    labels = [
        entry.label
        for entry in session.of_kind("dark", "flat")
        if entry.label not in used_labels and (entry.kind == "dark" or _is_lit(entry.conditions))
    ]
    if not labels:
        return None
    return (
        f"Left out of levels and noise: {', '.join(labels)}; more than {LEVELS.most_clipped:.1%} "
        "of the pixels clip at an end of the scale, the level is above "
        f"{LEVELS.highest_level:.0%} of it, or its variance is below {LEVELS.full_variance:.0%} of "
        "that of a dimmer one, as of full wells: flats of less light show more"
    )


def _is_lit(conditions: Conditions) -> bool:
    return bool(
        conditions.illuminance_lux or (conditions.photons_per_px and conditions.wavelength_nm)
    )


def dark_rise_dn_per_s(levels: tuple[StackLevel, ...]) -> float:
    """Return the rise of the dark level between the shortest and the longest exposure of equal
    conditions, DN/s.

    0 where a clamp removes the dark charge, or where it is below three standard errors or a
    rounding step.
    """
    stated = [level for level in levels if level.dark and level.conditions.exposure_s]
    if len(stated) < 2:
        return 0.0
    short, long = (pick(stated, key=lambda level: level.exposure_s) for pick in (min, max))
    same_conditions = (
        short.conditions.temperature_c,
        short.conditions.em_gain,
        short.conditions.camera_gain_db,
    ) == (
        long.conditions.temperature_c,
        long.conditions.em_gain,
        long.conditions.camera_gain_db,
    )
    rise = long.mean_dn - short.mean_dn
    if not same_conditions or rise < max(
        3.0 * float(np.hypot(short.mean_sd_dn, long.mean_sd_dn)), 1.0
    ):
        return 0.0
    return rise / (long.exposure_s - short.exposure_s)


def _level(session: Session, entry: StackEntry) -> StackLevel | None:
    conditions, camera = entry.conditions, session.camera
    if camera is None or camera.is_thermal:
        return None
    illuminance = 0.0 if entry.kind == "dark" else conditions.illuminance_lux
    if illuminance is None and camera.has_tube:
        return None
    reference_v, shutter_s = (
        (float(camera.microchannel_plate.reference_v), conditions.exposure_s)
        if camera.has_tube
        else (0.0, gathering_s(conditions))
    )
    shutter_s = shutter_s or 1.0 / float(camera.video.field_rate_hz)
    stack = entry.read()
    top = stack.full_scale_dn or float(2**camera.video.bit_depth - 1)
    means = stack.data.mean(axis=(1, 2), dtype=np.float64)
    clipped = max(np.mean(stack.data >= top), np.mean(stack.data <= 0))
    if clipped > LEVELS.most_clipped or means.mean() > LEVELS.highest_level * top:
        return None
    scatter = (
        float(means.std(ddof=1)) / np.sqrt(len(means))
        if len(means) > 1
        else float(stack.data.std()) / 10.0
    )
    gate_s = shutter_s if conditions.gate_ns is None else min(conditions.gate_ns * 1e-9, shutter_s)
    return StackLevel(
        label=entry.label,
        mean_dn=float(means.mean()),
        mean_sd_dn=scatter,
        noise_dn=_noise_dn(stack.data[0]),
        illuminance_lux=np.nan if illuminance is None else float(illuminance),
        gate_s=float(gate_s),
        exposure_s=float(shutter_s),
        mcp_v=float(conditions.mcp_v or reference_v),
        entry=entry,
        light_known=illuminance is not None
        or bool(conditions.photons_per_px and conditions.wavelength_nm),
        full_scale_dn=top,
        step_dn=rounding_step([stack.data[0]]) or 1.0,
        **variances_of(stack.data),
    )


def _noise_dn(frame: NDArray) -> float:
    """Return half the width of the central 68 % of the grey values, sub-DN where one value
    dominates.
    """
    codes, counts = np.unique(frame, return_counts=True)
    modal_fraction = float(counts.max()) / frame.size
    if modal_fraction < 0.38 or len(codes) < 2:
        low, high = np.quantile(frame, (0.16, 0.84))
        return float(high - low) / 2.0
    from scipy.special import erfinv

    return float(0.5 / (np.sqrt(2.0) * erfinv(min(modal_fraction, 1.0 - 1e-9))))
