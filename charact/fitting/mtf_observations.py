"""Observations of MTF curves and bar targets, each along its own direction."""

from functools import partial

import numpy as np

from charact.fitting import predicted_quantities
from charact.fitting.observation import (
    Observation,
    admissible_measurements,
    scalar_observation,
    sd_of,
)
from charact.fitting.prior import Camera
from charact.fitting.thresholds import ERRORS, LEVELS, LIMITS
from labdata import Array, Curve, Result, Session, StackEntry

SPREAD = (
    "optics.aberration_blur_um",
    "photocathode.gap_mm",
    "photocathode.halo_fraction",
    "photocathode.halo_elastic_share",
    "tube.mtf_frequency_lp_per_mm",
    "tube.mtf_exponent",
    "taper.demagnification",
    "taper.interface_mtf_lp_per_mm",
    "video.bandwidth_mhz",
)
GLARE = "optics.veiling_glare_fraction"


def mtf_observations(
    session: Session, sensor: Camera, result: Result, depends: tuple[str, ...] = SPREAD
) -> list[Observation]:
    """Return the observations of MTF curves and bar targets, each along its own direction.

    `depends`: paths of the parameters that the MTF depends on.
    """
    stacks = {m.stack for m in admissible_measurements(result, "mtf50")}
    observations = [
        _curve(name, line, session, sensor, result, depends)
        for name, line in result.curves.items()
        if name.split(":")[0] in ("mtf", "mtf_vertical")
        and line.interval68 is not None
        and _stack_of(name, line) in stacks
    ]
    bars = {entry.label: entry for entry in session.of_kind("bars")}
    for m in admissible_measurements(result, "mtf"):
        if m.stack in bars and m.frequency_cy_per_px:
            angle_deg = (
                m.orientation_deg
                if m.orientation_deg is not None
                else bars[m.stack].target.angle_deg
            )
            fx, fy = _components(np.array([m.frequency_cy_per_px]), angle_deg or 0.0, sensor)
            sd = float(np.hypot(sd_of(m), ERRORS.mtf))
            predict = partial(
                predicted_quantities.mtf,
                across=fx,
                along=fy,
                wavelength_nm=_wavelength_nm(bars[m.stack]),
            )
            observations.append(
                scalar_observation(
                    f"mtf of {m.stack}",
                    m.value or 0.0,
                    sd,
                    lambda v, f=predict: f(v)[:, 0],
                    depends,
                )
            )
    return observations


def glare_observations(session: Session, dark_dn: float) -> list[Observation]:
    """Observe the veiling glare at edges of stated contrast, of a camera without a tube; `dark_dn`:
    level of the dark.

    With the fraction v of the light spread evenly over the frame, of mean M, sides of the levels B
    and D far from the edge obey D - v M = d (B - v M), d the target's dark side over its bright one
    (ISO 9358 spreads the light alike).
    """
    observations = []
    for entry in session.of_kind("edge"):
        sides = _sides_dn(entry, dark_dn)
        if entry.target.contrast is None or sides is None:
            continue
        contrast = entry.target.contrast
        (lower, upper, frame_level), ratio = sides, (1.0 - contrast) / (1.0 + contrast)
        value = (lower - ratio * upper) / (frame_level * (1.0 - ratio))
        of_contrast = 2.0 * ERRORS.contrast_sd / (1.0 + contrast) ** 2
        ratio_sd = ERRORS.opaque_transmittance if contrast == 1.0 else of_contrast
        sd = float(np.hypot(ERRORS.glare * value, ratio_sd * upper / (frame_level * (1.0 - ratio))))
        observations.append(
            scalar_observation(
                f"glare of {entry.label}", value, sd, lambda values: values[GLARE], (GLARE,)
            )
        )
    return observations


def _sides_dn(entry: StackEntry, dark_dn: float) -> tuple[float, float, float] | None:
    """Return levels above dark of the sides far from an edge, and of the frame, DN; None of too
    small a side.
    """
    import cv2

    stack = entry.read()
    if stack.full_scale_dn and np.mean(stack.data >= stack.full_scale_dn) > LEVELS.most_clipped:
        return None
    mean_frame = stack.data.mean(axis=0, dtype=np.float64) - dark_dn
    row, col, height, width = entry.target.region or (0, 0, *mean_frame.shape)
    mean = mean_frame[row : row + height, col : col + width]
    smooth = cv2.GaussianBlur(mean, (0, 0), 2.0)
    bright = (smooth > np.quantile(smooth, (0.02, 0.98)).mean()).astype(np.uint8)
    far_sides = [
        cv2.distanceTransform(side, cv2.DIST_L2, 5) > LIMITS.glare_px
        for side in (1 - bright, bright)
    ]
    if min(int(side.sum()) for side in far_sides) < LIMITS.glare_pixels:
        return None
    lower, upper = (float(mean[side].mean()) for side in far_sides)
    return lower, upper, float(mean_frame.mean())


def _stack_of(name: str, line: Curve) -> str | None:
    """Return the stack of a curve."""
    return line.stack or (name.split(":", 1)[1] if ":" in name else None)


def _curve(
    name: str,
    line: Curve,
    session: Session,
    sensor: Camera,
    result: Result,
    depends: tuple[str, ...],
) -> Observation:
    """Observe an MTF curve at frequencies far enough apart."""
    frequency = np.asarray(line.frequency_cy_per_px, float)
    # A curve of a wide blur has fallen at the usual spacing.
    low = np.asarray(line.value) < 0.5
    half = float(frequency[np.argmax(low)]) if low.any() else np.inf
    spacing = min(LIMITS.mtf_spacing_cy_per_px, half / 2.0)
    wanted = np.arange(spacing, LIMITS.mtf_highest_cy_per_px + 1e-9, spacing)
    low, high = np.asarray(line.interval68, float)
    value = np.interp(wanted, frequency, line.value)
    sd = np.interp(wanted, frequency, (high - low) / (2.0 * 0.994458))
    usable = (wanted >= frequency[0]) & (wanted <= frequency[-1]) & (value > LIMITS.least_mtf)
    angle_deg = _angle_deg(name, line, session, result)
    fx, fy = _components(wanted[usable], angle_deg, sensor)
    # Errors are correlated: closely spaced points add little information.
    separation, sd = np.abs(np.subtract.outer(wanted[usable], wanted[usable])), sd[usable]
    covariance = np.outer(sd, sd) * np.exp(
        -separation / ERRORS.mtf_correlation_cy_per_px
    ) + ERRORS.mtf**2 * np.eye(sd.size)
    entry = next((entry for entry in session.stacks if entry.label == _stack_of(name, line)), None)
    predict = partial(
        predicted_quantities.mtf, across=fx, along=fy, wavelength_nm=_wavelength_nm(entry)
    )
    return Observation(
        name=name, value=value[usable], covariance=covariance, parameters=depends, predict=predict
    )


def _angle_deg(name: str, line: Curve, session: Session, result: Result) -> float:
    """Return the direction of a curve's frequencies, degrees from the row direction."""
    if name.startswith("mtf_vertical"):
        return 90.0
    stack = _stack_of(name, line)
    entry = next((entry for entry in session.stacks if entry.label == stack), None)
    if entry is not None and entry.kind == "point":
        return 0.0
    if entry is not None and entry.target.angle_deg is not None:
        return entry.target.angle_deg
    angles = [
        m.orientation_deg
        for m in result.find("mtf50")
        if m.orientation_deg is not None and m.stack == stack
    ]
    return angles[0] if angles else 0.0


def _wavelength_nm(entry: StackEntry | None) -> float:
    """Return the wavelength of a stack's light, nm: the stated one, else the centre of broadband
    light.
    """
    stated = None if entry is None else entry.conditions.wavelength_nm
    return stated or predicted_quantities.BROADBAND_NM


def _components(frequency: Array, angle_deg: float, sensor: Camera) -> tuple[Array, Array]:
    """Split frequencies in cy per column pitch: along rows in the same, along columns in cy per row
    pitch.
    """
    pitch_ratio = float(sensor.ccd.pitch_y_um) / float(sensor.ccd.pitch_x_um)
    angle = np.deg2rad(angle_deg)
    return frequency * abs(np.cos(angle)), frequency * abs(np.sin(angle)) * pitch_ratio
