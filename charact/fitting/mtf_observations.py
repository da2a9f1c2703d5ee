"""Observations of MTF curves, bar targets and veiling glare of edges."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from charact.fitting.measured_quantity import Measured, MeasuredQuantity
from charact.fitting.predicted_quantities import BROADBAND_NM, mtf
from charact.fitting.stack_levels import SessionStacks
from charact.fitting.thresholds import ERRORS, LEVELS, LIMITS
from charact.observables import (
    Case,
    Estimates,
    Observable,
    Values,
    admissible_measurements,
    declare,
    observable,
)
from labdata import Array, Camera, Curve, Result, StackEntry

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
LENS = ("optics.aberration_blur_um", "optics.f_number")
GLARE = "optics.veiling_glare_fraction"


def mtf_paths(camera: Camera) -> tuple[str, ...]:
    """Return the paths of the parameters that an MTF depends on."""
    return SPREAD if camera.has_tube else LENS


@dataclass(frozen=True, kw_only=True)
class Points:
    """Points of the frequency plane along a direction, and the light that shows their MTF."""

    camera: Camera
    frequency: Array  # shape (point,), cy/px as the method of the stack counts pixels
    angle_deg: float  # from the row direction
    entry: StackEntry | None

    def mtf(self, values: Values) -> Array:
        """Return the MTF, shape (n, point), at the wavelength of the stack's light, else the centre
        of broadband light.
        """
        pitch_ratio = float(self.camera.ccd.pitch_y_um) / float(self.camera.ccd.pitch_x_um)
        angle = np.deg2rad(self.angle_deg)
        stated_nm = None if self.entry is None else self.entry.conditions.wavelength_nm
        is_edge = self.entry is not None and self.entry.kind == "edge"
        # Methods of edges count pixels along the axis nearest to the normal, others columns.
        in_rows = is_edge and abs(np.sin(angle)) > np.sqrt(0.5)
        frequency = self.frequency / pitch_ratio if in_rows else self.frequency
        return mtf(
            values,
            frequency * abs(np.cos(angle)),
            frequency * abs(np.sin(angle)) * pitch_ratio,
            stated_nm or BROADBAND_NM,
        )


@observable
class MtfCurve(Observable[Points]):
    """MTF along one direction, in points half the distance apart over which errors are
    correlated.
    """

    name = "mtf curve"
    order = -10
    model_sd = ERRORS.mtf

    def cases(self, stacks: SessionStacks) -> Iterator[Case[Points]]:
        """Yield the curves of stacks whose MTF50 is admissible."""
        admissible = {m.stack for m in admissible_measurements(stacks.result, "mtf50")}
        entries = {entry.label: entry for entry in stacks.session.stacks}
        for name, line in stacks.result.curves.items():
            kind, _, stack = name.partition(":")
            stack = line.stack or stack or None
            if (
                kind in ("mtf", "mtf_vertical")
                and line.interval68 is not None
                and stack in admissible
            ):
                entry = entries.get(stack or "")
                frequency, estimates = _in_points(line)
                points = Points(
                    camera=stacks.camera,
                    frequency=frequency,
                    angle_deg=_angle_deg(kind, stack, entry, stacks.result),
                    entry=entry,
                )
                yield Case(estimates=estimates, of=points, label=name)

    def predict(self, values: Values, shown: Points) -> Array:
        """Return the MTF at the points, shape (n, point)."""
        return shown.mtf(values)

    def parameters(self, shown: Points) -> tuple[str, ...]:
        return mtf_paths(shown.camera)


def _bars(shown: Measured) -> StackEntry | None:
    """Return the bar target of a measurement."""
    bars = shown.stacks.session.of_kind("bars")
    return next((entry for entry in bars if entry.label == shown.m.stack), None)


def _mtf_of_bars(values: Values, shown: Measured) -> Array:
    """Return the MTF of a bar target at its frequency, shape (n,)."""
    m, entry = shown.m, _bars(shown)
    assert entry is not None
    stated_deg = entry.target.angle_deg if m.orientation_deg is None else m.orientation_deg
    points = Points(
        camera=shown.stacks.camera,
        frequency=np.array([m.frequency_cy_per_px]),
        angle_deg=stated_deg or 0.0,
        entry=entry,
    )
    return points.mtf(values)[:, 0]


declare(
    MeasuredQuantity(
        name="mtf of bars",
        shown_as="mtf of {stack}",
        order=-9,
        quantity="mtf",
        where=lambda shown: _bars(shown) and shown.m.frequency_cy_per_px,
        number=_mtf_of_bars,
        model_sd=ERRORS.mtf,
        paths=lambda stacks: mtf_paths(stacks.camera),
    )
)


@observable
class VeilingGlare(Observable[None]):
    """Veiling glare at an edge of stated contrast.

    With the fraction v of the light spread evenly over the frame, of mean M, sides of the levels B
    and D far from the edge obey D - v M = d (B - v M), d the target's dark side over its bright one
    (ISO 9358 spreads the light alike).
    """

    name = "glare"
    order = -8
    tube = False
    depends = (GLARE,)
    relative_model_sd = ERRORS.glare

    def cases(self, stacks: SessionStacks) -> Iterator[Case[None]]:
        """Yield the glare of each edge whose sides are large enough, with the error of the
        contrast.
        """
        for entry in stacks.session.of_kind("edge") if stacks.darks else ():
            contrast, sides = entry.target.contrast, _sides_dn(entry, stacks.dark.mean_dn)
            if contrast is None or sides is None:
                continue
            (lower, upper, frame_level), ratio = sides, (1.0 - contrast) / (1.0 + contrast)
            scale = frame_level * (1.0 - ratio)
            of_contrast = 2.0 * ERRORS.contrast_sd / (1.0 + contrast) ** 2
            ratio_sd = ERRORS.opaque_transmittance if contrast == 1.0 else of_contrast
            glare = Estimates.of_number((lower - ratio * upper) / scale, ratio_sd * upper / scale)
            yield Case(estimates=glare, of=None, label=f"glare of {entry.label}")

    def number(self, values: Values, shown: None) -> Array:
        return values[GLARE]


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


def _in_points(line: Curve) -> tuple[Array, Estimates]:
    """Return the points of a curve, cy/px, and its values there: errors of points close together
    are correlated.
    """
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
    wanted, sd = wanted[usable], sd[usable]
    separation = np.abs(np.subtract.outer(wanted, wanted))
    correlation = np.exp(-separation / ERRORS.mtf_correlation_cy_per_px)
    return wanted, Estimates(value=value[usable], covariance=np.outer(sd, sd) * correlation)


def _angle_deg(kind: str, stack: str | None, entry: StackEntry | None, result: Result) -> float:
    """Return the direction of a curve's frequencies, degrees from the row direction."""
    if kind == "mtf_vertical":
        return 90.0
    if entry is not None and entry.kind == "point":
        return 0.0
    if entry is not None and entry.target.angle_deg is not None:
        return entry.target.angle_deg
    angles = (m.orientation_deg for m in result.find("mtf50") if m.stack == stack)
    return next((angle_deg for angle_deg in angles if angle_deg is not None), 0.0)
