"""Mean levels of darks and flats: what ties the camera's gain to the light it was given."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labdata.session import Session, StackEntry

# Pixels at the highest code pull the mean down; a mean near full scale is no longer a straight line of the light.
MOST_CLIPPED_SHARE = 1e-3
HIGHEST_SHARE_OF_FULL_SCALE = 0.85


@dataclass(frozen=True, kw_only=True)
class StackMean:
    """Mean level of one stack.

    Parameters
    ----------
    label
        The stack.
    mean_dn
        Mean over frames and pixels, DN.
    sd_dn
        Standard error of it, from the scatter of the frames' own means, DN.
    noise_dn
        Spread of a pixel about its mean that holds for most pixels, DN: half the range of the middle 68 %.
    illuminance_lux, gate_s, exposure_s, mcp_v
        Conditions; a dark has no illuminance.
    """

    label: str
    mean_dn: float
    sd_dn: float
    noise_dn: float
    illuminance_lux: float
    gate_s: float
    exposure_s: float
    mcp_v: float


def levels_of(session: Session) -> tuple[StackMean, ...]:
    """Return the levels of the session's darks and flats that are inside the straight part of the camera's range."""
    found = (_level(session, entry) for entry in session.of_kind("dark", "flat"))
    return tuple(level for level in found if level is not None)


def _level(session: Session, entry: StackEntry) -> StackMean | None:
    conditions = entry.conditions
    illuminance = 0.0 if entry.kind == "dark" else conditions.illuminance_lux
    if illuminance is None or session.sensor is None:
        return None
    stack = entry.read()
    top = stack.full_scale_dn or float(2**session.sensor.video.bit_depth - 1)
    means = stack.data.mean(axis=(1, 2), dtype=np.float64)
    if np.mean(stack.data >= top) > MOST_CLIPPED_SHARE or means.mean() > HIGHEST_SHARE_OF_FULL_SCALE * top:
        return None
    scatter = float(means.std(ddof=1)) / np.sqrt(len(means)) if len(means) > 1 else float(stack.data.std()) / 10.0
    field_s = 1.0 / float(session.sensor.video.field_rate_hz)
    exposure_s = conditions.exposure_s or field_s
    gate_s = exposure_s if conditions.gate_ns is None else min(conditions.gate_ns * 1e-9, exposure_s)
    reference_v = float(session.sensor.microchannel_plate.reference_v)
    return StackMean(
        label=entry.label,
        mean_dn=float(means.mean()),
        sd_dn=scatter,
        noise_dn=_noise_dn(stack.data[0]),
        illuminance_lux=float(illuminance),
        gate_s=float(gate_s),
        exposure_s=float(exposure_s),
        mcp_v=float(conditions.mcp_v or reference_v),
    )


def _noise_dn(frame: NDArray) -> float:
    """Return the width of the middle 68 % of whole DN; where most pixels show one code, what lies outside tells it."""
    codes, counts = np.unique(frame, return_counts=True)
    share = float(counts.max()) / frame.size
    if share < 0.38 or len(codes) < 2:
        low, high = np.quantile(frame, (0.16, 0.84))
        return float(high - low) / 2.0
    from scipy.special import erfinv

    return float(0.5 / (np.sqrt(2.0) * erfinv(min(share, 1.0 - 1e-9))))
