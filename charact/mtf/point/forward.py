"""Forward method for points: the core's pixels fitted with correlated pulse noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context, register
from charact.mtf.curve import FINE, REPORTED, crossing_frequency, curve_of
from charact.mtf.known_transfer import halo_diameters_px
from charact.mtf.point import checks as point_checks
from charact.mtf.point import source as point_source
from charact.mtf.point.findings import finding
from charact.mtf.point.forward_fit import PointFit, fit
from charact.mtf.point.forward_model import KnownPointOptics
from charact.mtf.point.motion import motion_flags
from charact.mtf.point.source_window import Window, window_of
from charact.mtf.point.undersampled_spot import flag_undersampled
from charact.mtf.region import Region
from charact.posterior import importance_sample, sample_posterior
from charact.video_filter import VideoFilter
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

METHOD = "point-forward"
QUANTITIES = ("mtf50", "mtf10")
MIN_PX = 9
# Standard errors of its light that a source needs.
MIN_LIGHT_SD = 6.0
# Least share of the light that unspoilt pixels must hold.
MIN_USABLE_FRACTION = 0.3
# Effective draws by importance where a posterior is wanted quickly, and draws to begin with.
QUICK_ESS, QUICK_FIRST = 500.0, 1000
MAX_STEPS = 1200


@register(
    "point",
    METHOD,
    quantities=QUANTITIES,
    scope=(
        "Single point sources whose core stays below full scale, light over 6 standard errors, pixels of an "
        "intensifier or of an ordinary camera. A core beyond full scale is left out and flagged; motion and neighbours "
        "are told; MTF50 below 0.42 cycles per pixel. A camera that is not described is taken to have no halo: one "
        "that stands out by three standard errors is told, fainter ones raise MTF50 by some of its errors. Not told: "
        "a second source within the blur, and a curved response, which on one spot only scales the width (a gamma of g "
        "moves MTF50 by about the root of g)."
    ),
)
def point_forward(
    stack: FrameStack, *, region: Region | None = None, pinhole_px: float | None = None, context: Context
) -> Result:
    """Measure the horizontal and vertical MTF of a camera from the image of a point source.

    Parameters
    ----------
    stack
        Frames of one point source; they are averaged, and their differences give the noise.
    region
        ROW, COL, HEIGHT, WIDTH that contains the source; None: the whole frame.
    pinhole_px
        Diameter of the source's image, column pitches, whose transfer is divided out. None: a point.
    context
        Seed, speed and camera.

    Returns
    -------
    Result
        `mtf50` and `mtf10` in both directions, the curves "mtf" and "mtf_vertical", and the profile as figure data. All
        frequencies are cycles per column pitch.

    Raises
    ------
    BadInput
        If the pinhole's diameter is negative.

    Notes
    -----
    A pixel's mean is pedestal + light P(x, y), P the transform of pinhole x pixel x video x exp(-(f/fc)^n - 2 (pi f
    s)^2) x [(1 - q) + q H_halo]. Light and pedestal are marginalised in closed form.
    """
    if pinhole_px is not None and not 0 <= pinhole_px < 50:
        raise BadInput(f"pinhole_px must lie in [0, 50) column pitches, got {pinhole_px:g}")
    used = stack if region is None else stack.region(*region)
    where = region or (0, 0, *used.shape[1:])
    task = PointTask(context=context, where=where, pinhole_px=pinhole_px)
    if min(used.shape[1:]) < MIN_PX:
        return task.nothing(f"a point needs a region of at least {MIN_PX} x {MIN_PX} px, got {where[2:]}",
                            "window-too-small")  # fmt: skip
    source = point_source.detect_source(used.data, context.pitch_ratio)
    if isinstance(source, str):
        full = context.full_scale_dn or used.full_scale_dn
        if full is not None and used.data.max() >= full and np.median(used.data, axis=0).max() >= full:
            return task.nothing("the source is too bright: pixels stay at full scale and nothing is dark", "saturated")
        return task.nothing(source, "no-target")
    window = _window(used, source, context)
    kept = _usable_light_fraction(window)
    if kept < MIN_USABLE_FRACTION:
        return task.nothing(f"the source is too bright: {100 * (1 - kept):.0f} % of its core's light lies in pixels "
                            "that full scale spoils", "saturated")  # fmt: skip
    found = fit(window, context, _optics(context, pinhole_px or 0.0))
    if found is None:
        return task.nothing(
            "no target: what stands out of the background is not the picture of a point",
            "no-target",
            *_motion_flags(window),
        )
    if found.light < MIN_LIGHT_SD * found.light_sd:
        stands = point_source.round_down(found.light / found.light_sd)
        return task.nothing(
            f"no target: the light stands {stands:.1f} standard errors out of {MIN_LIGHT_SD:g} needed",
            "no-target",
            *_motion_flags(window),
        )
    return task.result(found, window, source, used, _posterior(found, context))


def _window(used: FrameStack, source: point_source.DetectedSource, context: Context) -> Window:
    halo = halo_diameters_px(context, transposed=False)[1] / 2.0 if context.sensor is not None else None
    return window_of(
        used.data, source.row, source.col, pitch_ratio=context.pitch_ratio,
        full_scale_dn=context.full_scale_dn or used.full_scale_dn, halo_radius_px=halo,
        filtered=context.sensor is not None,
    )  # fmt: skip


def _usable_light_fraction(window: Window) -> float:
    """Return the fraction of the core's light in valid pixels; invalid ones count with their clipped height."""
    height = np.maximum(window.core - np.median(window.core), 0.0)
    return float(height[window.keep].sum() / max(float(height.sum()), 1e-12))


def _motion_flags(window: Window) -> tuple[str, ...]:
    """Return the motion flags of a source that is too faint, or appears so by its motion."""
    if window.frames < 2 or not window.keep.all():
        return ()
    return tuple(motion_flags(window.frames_above(window.border_dn), *window.offsets_from_centre, window.row_parity))


def _optics(context: Context, pinhole_px: float) -> KnownPointOptics:
    """Return the known pixel aperture and video filter."""
    if context.sensor is None:
        rows = 2.0 if context.interlaced else 1.0
        return KnownPointOptics(width_px=1.0, height_px=rows, video=None, pinhole_px=pinhole_px, top=2.0)
    rows = 2.0 if context.interlaced else 1.0
    return KnownPointOptics(
        width_px=1.0,
        height_px=rows * context.pitch_ratio,
        video=VideoFilter.of(context.sensor),
        pinhole_px=pinhole_px,
        top=1.2,
    )


def _posterior(found: PointFit, context: Context) -> Posterior:
    """Sample the posterior, by importance sampling if quick."""
    prior = found.model.prior
    asked = {
        "names": prior.names,
        "units": prior.units,
        "start": found.point,
        "covariance": found.covariance,
        "seed": context.seed,
        "bounds": prior.bounds[prior.chosen],
    }
    if context.quick:
        return importance_sample(found.log_probability, **asked, enough=QUICK_ESS, first_draws=QUICK_FIRST)
    return sample_posterior(found.log_probability, **asked, max_steps=MAX_STEPS)


@dataclass(frozen=True, kw_only=True)
class PointTask:
    """Arguments of a measurement."""

    context: Context
    where: Region
    pinhole_px: float | None

    @property
    def provenance(self) -> Provenance:
        """Version, seed and settings."""
        settings = {"quick": self.context.quick, "pinhole_px": self.pinhole_px}
        return Provenance(version=charact.__version__, seed=self.context.seed, settings=settings)

    def nothing(self, reason: str, *flags: str) -> Result:
        """Return the refusal of all quantities."""
        common = {"method": METHOD, "flags": flags, "region": self.where}
        return Result(measurements=tuple(
            make_refusal(name, "cy/px", reason, orientation_deg=angle, provenance=self.provenance, **common)
            for name in QUANTITIES for angle in (0.0, 90.0)
        ))  # fmt: skip

    def result(
        self,
        found: PointFit,
        window: Window,
        source: point_source.DetectedSource,
        used: FrameStack,
        posterior: Posterior,
    ) -> Result:
        """Return measurements, curves and figure data of a fitted source."""
        findings = point_checks.fit_findings(found, window, source, self.context)
        if "not-converged" in posterior.flags:
            findings.append(finding("not-converged", "the interval comes from the curvature at the maximum"))
        common = {
            "method": METHOD,
            "notes": (
                *used.notes,
                *point_checks.fit_notes(found, window, self.context, self.pinhole_px),
            ),
            "region": self.where,
            "provenance": self.provenance,
        }
        measurements: list[Measurement] = []
        curves = {}
        for name, vertical in (("mtf", False), ("mtf_vertical", True)):
            fine = found.model.mtf(posterior.draws, FINE, vertical=vertical)
            angle = 90.0 if vertical else 0.0
            measurements += [_level(quantity, level, fine, posterior, {**common, "orientation_deg": angle})
                             for quantity, level in (("mtf50", 0.5), ("mtf10", 0.1))]  # fmt: skip
            curves[name] = curve_of(REPORTED, found.model.mtf(posterior.draws, REPORTED, vertical=vertical))
        measurements = [one.with_(findings=findings) for one in measurements]
        return Result(
            measurements=flag_undersampled(measurements, window),
            curves=curves,
            evidence={"point-profile": point_checks.fit_figure_data(found, window)},
        )


def _level(quantity: str, level: float, fine: Array, posterior: Posterior, common: dict) -> Measurement:
    """Return the frequency at which the MTF falls to a level; refused where it does not below 1.5 cy/px."""
    draws = crossing_frequency(FINE, fine, level)
    lost = float(np.mean(~np.isfinite(draws)))
    if lost > 0.02:
        reason = (
            f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px, and {100 * lost:.0f} % of its draws do not"
        )
        return make_refusal(quantity, "cy/px", reason, **common)
    return measurement_from_draws(quantity, "cy/px", draws[np.isfinite(draws)], posterior=posterior, **common)
