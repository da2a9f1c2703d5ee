"""Mean level, temporal variance and fixed pattern of a session's darks and flats."""

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.illumination import gathering_s
from charact.fitting.thresholds import LEVELS
from charact.frames.rounding import rounding_step
from charact.observables.stack_level import StackLevel, variances_of
from labdata import Conditions, Session, StackEntry


def levels_of(session: Session) -> tuple[StackLevel, ...]:
    """Return the means of the session's darks and flats within the linear range.

    Flats of unknown light are left out behind a tube; of a camera without one their noise is that
    of their signal.
    """
    levels = (_level(session, entry) for entry in session.of_kind("dark", "flat"))
    return tuple(level for level in levels if level is not None)


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
        "of the pixels clip at an end of the scale, or the level is above "
        f"{LEVELS.highest_level:.0%} of it"
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
    conditions, camera, light_known = entry.conditions, session.camera, True
    illuminance = 0.0 if entry.kind == "dark" else conditions.illuminance_lux
    if camera is None or camera.is_thermal:
        return None
    if not camera.has_tube:
        if illuminance is None and conditions.photons_per_px and conditions.wavelength_nm:
            illuminance = np.nan
        light_known = illuminance is not None
        illuminance = np.nan if illuminance is None else illuminance
        reference_v, field_s = 0.0, 1.0 / float(camera.video.field_rate_hz)
        shutter_s = gathering_s(conditions) or field_s
    else:
        reference_v, field_s = (
            float(camera.microchannel_plate.reference_v),
            1.0 / float(camera.video.field_rate_hz),
        )
        shutter_s = conditions.exposure_s or field_s
    if illuminance is None:
        return None
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
        illuminance_lux=float(illuminance),
        gate_s=float(gate_s),
        exposure_s=float(shutter_s),
        mcp_v=float(conditions.mcp_v or reference_v),
        entry=entry,
        light_known=light_known,
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
