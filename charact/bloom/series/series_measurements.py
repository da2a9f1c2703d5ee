"""What a fitted series tells: halo, encircled light, glare and plate, each with what its form leaves out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.bloom import transfer
from charact.bloom.point_stack import PointStack
from charact.bloom.series.derived_halo import energy_radii, glare, halo_of
from charact.bloom.series.leak import find_leak
from charact.bloom.series.likelihood import AmplitudeSolution
from charact.bloom.series.mcp_saturation import SaturatingSeriesLikelihood
from charact.bloom.series.model_selection import FittedHaloModel
from charact.posterior.diagnostics import crowds_at_bound
from labdata.measurement import Measurement, Posterior, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

OF_THE_HALO = (("halo_diameter", "px"), ("halo_fraction", "1"), ("halo_plateau", "1/px2"), ("halo_rim", "1"))
# Relative error that forms leave out of a number: of any source, and as multiples of the shares of the light by which
# rings are off beyond the core and about it. The first is as closed-form series with wings show it, the others as
# simulated cameras do: about the core all levels are off alike, and what that does to its light does not average away.
LEFT_OUT = {
    "halo_fraction": (0.012, 3.0, 0.7),
    "halo_plateau": (0.012, 3.0, 0.7),
    "halo_rim": (0.013, 1.0, 0.0),
    "encircled_radius_50": (0.006, 1.0, 0.3),
    "encircled_radius_90": (0.015, 1.0, 1.0),
    "veiling_glare": (0.05, 3.0, 0.7),
    "plate_saturation_density": (0.03, 6.0, 0.7),
}
# Distance in ln of the densities that two forms of the core ask for beyond which neither is told.
MOST_UNLIKE = float(np.log(4.0))
# A best fit so near a bound, as a share of the range, is pressed against it.
AT_BOUND = 1e-3
# Draws for which the glare is worked out, and what belongs to it as well.
OF_GLARE = 200
LEAKS = "light that leaks through the target beside its pinhole counts as glare"
# Draws for which derived numbers are worked out.
DERIVED = 400
# Share of a halo's diameter by which another's that overlaps it moves its edge.
OVERLAPPED = 0.005
# Fraction by which a diameter is off, as a standard error, where a rim on a flat disc is a ring: noise-free discs with
# rings of 5 to 30 % of their radius are at most 0.8 % off.
RIM_WIDTH = 0.004
# What the diameter of any disc is off by besides, px: drawn flat discs whose noise leaves 0.03 px scatter by so much.
DISC_PX = 0.05
# Degrees of freedom that the noise has at least: rings of single frames tell it, too.
LEAST_FREEDOM = 3
# Standard error below which a level's own diameter counts as no better.
LEAST_SD_PX = 0.1


def nearest_px(group: tuple[PointStack, ...]) -> float:
    """Distance of the nearest other source that any stack shows, column pitches; inf where there is none."""
    return min(
        (
            float(np.hypot((other.row - one.row) * one.row_pitch, other.col - one.col))
            for one in group
            for other in one.others
        ),
        default=np.inf,
    )


def several_flag(group: tuple[PointStack, ...]) -> tuple[str, ...]:
    """The flag of numbers that another source's light moves."""
    return ("several-targets",) if np.isfinite(nearest_px(group)) else ()


def levels_apart(own: tuple[Array, Array, Array]) -> tuple[float, int]:
    """How far the levels' own diameters lie from their mean, as chi squared with its freedom.

    All of them share the core and the profile of the likeliest point: the median of a skewed posterior is not theirs.
    """
    seen = np.isfinite(own[0])
    sd = np.maximum(own[1][seen], LEAST_SD_PX)
    mean = np.sum(own[0][seen] / sd**2) / max(float(np.sum(sd**-2.0)), 1e-300)
    return float(np.sum(((own[0][seen] - mean) / sd) ** 2)), max(int(seen.sum()) - 1, 0)


def halo_measurements(best: FittedHaloModel, posterior: Posterior, own: tuple[Array, Array, Array], group: tuple[PointStack, ...],
          flags: tuple[str, ...], notes: tuple[str, ...], fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """The halo's diameter, share, plateau and rim; the diameter's interval is wider where levels scatter more.

    Light of another source lies on the rings of this one: only the place of the edge stands apart from it.
    """
    beside = several_flag(group)
    middle = float(np.median(posterior["halo_diameter"]))
    apart, freedom = levels_apart(own)
    wider = np.sqrt(max(1.0, apart / freedom)) if freedom else 1.0
    wider = wider * _noise_unknown(group, len(posterior.draws), posterior.seed)
    draws = {"halo_diameter": middle + wider * (posterior["halo_diameter"] - middle)}
    if nearest_px(group) < middle:
        rng = np.random.default_rng([posterior.seed or 0, 1])
        draws["halo_diameter"] += OVERLAPPED * middle * rng.standard_normal(len(posterior.draws))
    draws["halo_diameter"] += _form_unknown(posterior, middle)
    halo = halo_of(best.form, posterior.draws[:DERIVED])
    of_light = {"halo_fraction": posterior["halo_fraction"], "halo_plateau": halo.plateau, "halo_rim": halo.rim}
    draws |= {name: one * _model_error_factors(best, name, len(one), posterior) for name, one in of_light.items()}
    blind = () if shows_core(best, posterior) else ("prior-bound",)
    flags_of = {
        "halo_diameter": flags,
        "halo_fraction": flags + beside + blind,
        "halo_plateau": flags + beside + blind,
        "halo_rim": flags + beside,
    }
    return [
        measurement_from_draws(
            quantity, unit, draws[quantity], flags=flags_of[quantity], notes=notes, posterior=posterior, **fields
        )
        for quantity, unit in OF_THE_HALO
    ]


def _form_unknown(posterior: Posterior, diameter_px: float) -> Array:
    """Errors of a diameter by the unknown width of a rim on a flat disc, and of any disc, px, shape (draw,)."""
    profile = np.stack([posterior[name] for name in transfer.PROFILE], axis=1)
    elastic, rim, flat = profile[:, 0], profile[:, 3], 1.0 - profile.sum(axis=1)
    rimmed = np.clip(4.0 * np.maximum(elastic, rim) * flat, 0.0, 1.0)
    sd = np.hypot(RIM_WIDTH * rimmed * diameter_px, DISC_PX)
    return sd * np.random.default_rng([posterior.seed or 0, 3]).standard_normal(len(profile))


def _noise_unknown(group: tuple[PointStack, ...], draws: int, seed: int | None) -> Array:
    """Factors for a noise that is itself known from so many frames only (Student's), shape (draw,)."""
    freedom = max(min(one.frames for one in group) - 1, LEAST_FREEDOM)
    return np.sqrt(freedom / np.random.default_rng(seed).chisquare(freedom, draws))


def _model_error_factors(best: FittedHaloModel, quantity: str, draws: int, posterior: Posterior) -> Array:
    """Factors for what a form leaves out of a quantity: that of any, and that of a source that is not round."""
    of_any, beyond, of_core = LEFT_OUT[quantity]
    misfit = best.problem.misfit
    sd = np.linalg.norm([of_any, beyond * misfit.share, of_core * misfit.core])
    return np.exp(sd * np.random.default_rng(posterior.seed).standard_normal(draws))


def shows_core(best: FittedHaloModel, posterior: Posterior) -> bool:
    """Whether the source's whole light is known: where every core is cut, it may be anything that makes its halo."""
    if best.form.halo == "none":
        return True
    share = best.form.names.index("halo_fraction")
    bounds = best.form.bounds[[share]]
    pressed = np.abs(bounds - best.peak.point[share]).min() < AT_BOUND * np.ptp(bounds)
    return not pressed and not crowds_at_bound(posterior.draws[:, [share]], bounds).any()


def energy_radius_measurements(best: FittedHaloModel, posterior: Posterior, flags: tuple[str, ...], notes: tuple[str, ...],
            fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Radii that hold half and nine tenths of the light."""
    reach = float(best.problem.series.radius_px[-1])
    radii = energy_radii(best.form, posterior.draws[:DERIVED], (0.5, 0.9), reach)
    flags = flags if shows_core(best, posterior) else (*flags, "prior-bound")
    out = []
    for quantity, draws in zip(("encircled_radius_50", "encircled_radius_90"), radii.T, strict=True):
        if np.isnan(draws).any():
            reason = f"some of this light lies beyond the {reach:.0f} px about the source that were looked at"
            out.append(make_refusal(quantity, "px", reason, **fields))
        else:
            draws = draws * _model_error_factors(best, quantity, len(draws), posterior)
            out.append(measurement_from_draws(quantity, "px", draws, flags=flags, notes=notes, **fields))
    return out


def glare_measurements(best: FittedHaloModel, posterior: Posterior, group: tuple[PointStack, ...], flags: tuple[str, ...],
           notes: tuple[str, ...], fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Light of the source that lies evenly over the frame, from the backgrounds of all levels."""
    settings = {(one.conditions.mcp_v, one.conditions.camera_gain_db, one.conditions.gain_control) for one in group}
    if len(settings) > 1:
        return [make_refusal("veiling_glare", "%", "the levels were taken at different gains", **fields)]
    solved = best.problem.solve_amplitudes(posterior.draws[:OF_GLARE])
    rows, cols = group[0].image.shape
    area = rows * cols * best.form.pitch_ratio
    sd = _background_sd(solved)
    found = [
        glare(light, background, error, area)
        for light, background, error in zip(solved.amplitudes[:, 0].T, solved.amplitudes[:, 1].T, sd.T, strict=True)
    ]
    told = np.array([one for one in found if one is not None])
    if not len(told):
        return [make_refusal("veiling_glare", "%", "the backgrounds of three levels at least would tell it", **fields)]
    rng = np.random.default_rng([posterior.seed, 1])
    beside = told[:, 0] + told[:, 1] * rng.standard_normal(len(told))
    beside = beside * _model_error_factors(best, "veiling_glare", len(beside), posterior)
    draws = 100.0 * beside / (1.0 + np.maximum(beside, 0.0))
    reach = float(best.problem.series.radius_px[-1])
    light = np.median(solved.amplitudes[:, 0], axis=1)
    near = (float(np.median(beside)), float(np.hypot(beside.std(), np.median(told[:, 1]))))
    number = measurement_from_draws("veiling_glare", "%", draws, flags=flags, notes=(*notes, LEAKS), **fields)
    return [number.with_(findings=find_leak(group, light, reach, area, near))]


def mcp_saturation_measurements(forms: list[FittedHaloModel], posterior: Posterior, flags: tuple[str, ...], notes: tuple[str, ...],
           fields: dict[str, Any]) -> list[Measurement]:  # fmt: skip
    """Density of light at which the plate's gain has halved, and what is left of each level's light behind it.

    Cores of different forms ask for densities that differ by factors: how far apart they lie is an error of each.
    """
    best = forms[0]
    if not isinstance(best.problem, SaturatingSeriesLikelihood):
        reason = "cores keep their share of the light at all levels: a plate at rest says all they show"
        return [make_refusal("plate_saturation_density", "DN", reason, **fields)]
    unlike = _unlike_cores(forms)
    if unlike > MOST_UNLIKE:
        reason = (
            f"forms of the core ask for densities that differ by a factor of {np.exp(unlike):.2g}: describe the camera"
        )
        return [make_refusal("plate_saturation_density", "DN", reason, **fields)]
    load = best.form.names.index("plate_load")
    if crowds_at_bound(posterior.draws[:, [load]], best.form.bounds[[load]]).any():
        flags = (*flags, "prior-bound")
    # Of two cores as likely, their distance over root two is the error of either.
    rng = np.random.default_rng([posterior.seed, 2])
    factors = np.exp(unlike / np.sqrt(2.0) * rng.standard_normal(len(posterior.draws)))
    points = posterior.draws.copy()
    points[:, load] = np.clip(points[:, load] / factors, *best.form.bounds[load])
    density = 1.0 / np.maximum(points[:, load], 1e-9)
    density = density * _model_error_factors(best, "plate_saturation_density", len(density), posterior)
    out = [measurement_from_draws("plate_saturation_density", "DN", density, flags=flags, notes=notes, **fields)]
    left = best.problem.compression(points[:DERIVED])
    for label, draws in zip(best.problem.series.labels, left, strict=True):
        out.append(measurement_from_draws("core_compression", "1", draws, flags=flags, stack=label, **fields))
    return out


def _unlike_cores(forms: list[FittedHaloModel]) -> float:
    """Return how far apart, in ln, the densities lie that cores of other forms ask for from that of the best."""
    loads = [
        float(one.peak.point[one.form.names.index("plate_load")])
        for one in forms
        if isinstance(one.problem, SaturatingSeriesLikelihood)
    ]
    ln = np.log(np.maximum(loads, 1e-9))
    return float(np.abs(ln - ln[0]).max())


def _background_sd(solved: AmplitudeSolution) -> Array:
    """Standard error of each level's background, shape (level, point)."""
    normal = solved.normal
    determinant = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
    return np.sqrt(np.maximum(normal[:, 0, 0] / np.maximum(determinant, 1e-300), 1e-12))
