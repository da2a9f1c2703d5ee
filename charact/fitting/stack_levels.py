"""Mean level, temporal variance and fixed pattern of a session's darks and flats."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from charact.estimators.noise.illumination import gathering_s
from charact.fitting.readout_observations import readout_spectrum
from charact.fitting.thresholds import LEVELS
from charact.frames.components import shading
from labdata.conditions import Conditions
from labdata.session import Session, StackEntry


@dataclass(frozen=True, kw_only=True)
class StackMean:
    """Mean of one stack, its temporal variance and that of its fixed pattern."""

    label: str  # label of the stack
    mean_dn: float  # mean over frames and pixels, DN
    sd_dn: float  # its standard error, from the scatter of the frames' means, DN
    noise_dn: float  # robust noise of a pixel, DN: half the range of the central 68 %
    # illuminance_lux, gate_s, exposure_s, mcp_v: conditions; a dark has no illuminance, nan is
    # unknown
    illuminance_lux: float
    gate_s: float
    exposure_s: float
    mcp_v: float
    entry: StackEntry | None = None  # the stack
    full_scale_dn: float = np.nan  # highest code of the digitiser, DN
    step_dn: float = 1.0  # step of its codes, DN: above 1 of codes shifted left
    light_known: bool = True  # whether its light is stated; otherwise it shows noise alone
    # mean over pixels of the variance between frames, variance over pixels of the mean frame
    # without its noise and smooth shading, and the standard errors of both, DN^2; nan of a single
    # frame
    temporal_dn2: tuple[float, float] = (np.nan, np.nan)
    spatial_dn2: tuple[float, float] = (np.nan, np.nan)

    @property
    def conditions(self) -> Conditions:
        """Conditions of the stack."""
        return Conditions() if self.entry is None else self.entry.conditions

    @property
    def dark(self) -> bool:
        """Whether the stack is a dark."""
        return self.illuminance_lux == 0.0


def levels_of(session: Session) -> tuple[StackMean, ...]:
    """Return the means of the session's darks and flats within the linear range.

    Flats of unknown light are left out behind a tube; of a camera without one their noise is that
    of their signal.
    """
    levels = (_level(session, entry) for entry in session.of_kind("dark", "flat"))
    return tuple(level for level in levels if level is not None)


def note_on_exclusions(session: Session, levels: tuple[StackMean, ...]) -> str | None:
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


def dark_rise_dn_per_s(levels: tuple[StackMean, ...]) -> float:
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
    if not same_conditions or rise < max(3.0 * float(np.hypot(short.sd_dn, long.sd_dn)), 1.0):
        return 0.0
    return rise / (long.exposure_s - short.exposure_s)


def _level(session: Session, entry: StackEntry) -> StackMean | None:
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
    temporal, spatial = _variances(stack.data)
    return StackMean(
        label=entry.label,
        mean_dn=float(means.mean()),
        sd_dn=scatter,
        noise_dn=_noise_dn(stack.data[0]),
        illuminance_lux=float(illuminance),
        gate_s=float(gate_s),
        exposure_s=float(shutter_s),
        mcp_v=float(conditions.mcp_v or reference_v),
        entry=entry,
        temporal_dn2=temporal,
        spatial_dn2=spatial,
        light_known=light_known,
        full_scale_dn=top,
        step_dn=_step_dn(stack.data[0]),
    )


def _step_dn(frame: NDArray) -> float:
    """Return the greatest common divisor of the differences of codes, DN; 1 of codes that are no
    whole numbers.
    """
    if not np.issubdtype(frame.dtype, np.integer):
        return 1.0
    codes = np.unique(frame).astype(np.int64)
    return float(max(np.gcd.reduce(codes - codes[0]), 1))


def _variances(data: NDArray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return temporal variance and variance of the fixed pattern with their standard errors.

    Removed are the frames' offsets and, of the fixed pattern, shading of light and lens up to the
    fourth order, the offsets of rows, and interference, whose phases of few frames do not average
    to their expectation.

    Standard errors are from the scatter over pixels, taken as independent: for white noise.
    """
    count, pixels = len(data), data[0].size
    if count < 2:
        return (np.nan, np.nan), (np.nan, np.nan)
    sums = np.zeros((4, *data.shape[1:]))
    for frame in data:
        for index, axes in ((0, (0, 1)), (2, 1)):
            residuals = frame - frame.mean(axis=axes, keepdims=True, dtype=np.float64)
            sums[index] += residuals
            sums[index + 1] += residuals**2
    pixel_variance, in_rows = (
        (square - total**2 / count) / (count - 1) for total, square in (sums[:2], sums[2:])
    )
    spectrum = readout_spectrum(data)
    peak = None if spectrum is None else spectrum.interference
    pattern, noise_dn2 = _without_shading(sums[2] / count), in_rows
    if peak is not None:
        pattern, noise_dn2 = peak.remove_from(pattern), in_rows - peak.mean_square_dn2
    pattern_square = pattern**2 - noise_dn2 / count
    root = np.sqrt(pixels)
    return (
        (float(pixel_variance.mean()), float(pixel_variance.std() / root)),
        (float(pattern_square.mean()), float(pattern_square.std() / root)),
    )


def _without_shading(image: NDArray) -> NDArray:
    """Return an image without products of polynomials along rows and columns."""
    down, across = (np.column_stack([np.full(n, n**-0.5), shading(n)]) for n in image.shape)
    return image - down @ (down.T @ image @ across) @ across.T


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
