"""Checks of point sources: motion, undersampling, misfit and departures, nonlinear response; their
findings.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from charact.estimators.mtf.curve import FINE, crossing_frequency
from charact.estimators.mtf.point.blur_models_2d import BUMP_WIDTH, BUMPS
from charact.estimators.mtf.point.model_fit import BlurModelFit2D, PointFitter, WhitenedPixels
from charact.estimators.mtf.point.model_selection import (
    DEPARTURES,
    EvidenceWeightedModels2D,
    start_from,
)
from charact.estimators.mtf.point.nonlinearity import (
    SpotNonlinearity,
    fit_nonlinearity,
    power_log_likelihoods,
)
from charact.estimators.mtf.point.source_pixels import SourcePixels, dark_noise
from charact.estimators.mtf.point.source_window import Window
from charact.estimators.mtf.point.spot_image_matrix import COSINES, FREQUENCIES, pictures
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.verdict import Finding, judge
from labdata.measurement import Measurement

Array = NDArray[np.float64]

REMEDIES = {
    "clipped": "an offset that keeps the noise of dark pixels above 0 DN",
    "saturated": "less light or a shorter exposure, so that no pixel approaches full scale",
    "low-signal": "more light, a longer exposure or more frames",
    "model-misfit": (
        "`roi` around one source on a uniform background, focus, and no gamma or sharpening"
    ),
    "several-targets": "`roi` around one source, or sources further apart",
    "window-too-small": "a larger `roi` around the source",
    "prior-bound": "another focus or magnification, so that the spot is 1 to 10 px wide",
    "interlace-motion": "a stationary source and camera, or frames of one field",
    "drift": "a stationary source and camera, or fewer frames",
    "gamma": "frames with a linear response (gamma 1)",
    "aliased": "a spot blurred over more pixels: larger magnification or f-number",
    "not-converged": "another `seed`",
}


def finding(flag: str, effect: str) -> Finding:
    """Return the finding of a flag with its effect and remedy."""
    return Finding(flag=flag, effect=effect, remedy=REMEDIES[flag])


def motion_findings(names: tuple[str, ...]) -> list[Finding]:
    """Return the findings of motion flags."""
    lowered = f"MTF50 is lowered by {100.0 * LIMITS.max_motion_loss:g} % or more"
    effects = {
        "interlace-motion": (
            f"the fields are displaced by at least {LIMITS.max_field_offset_px:g} px; {lowered}"
        ),
        "drift": (
            f"the source moves by {LIMITS.max_drift_px:g} px over the frames, or moves "
            f"between frames; {lowered}"
        ),
    }
    return [finding(name, effects[name]) for name in names]


def flag_undersampled(
    measurements: Iterable[Measurement], window: Window
) -> tuple[Measurement, ...]:
    """Flag measurements of a spot as `aliased` where MTF50 may be too close to the sampling limit.

    Notes
    -----
    The position of the spot is fitted to first order. A spot of 0.15 px illuminates one pixel
    wherever it lies in it: MTF50 is 10 to 15 % low, and 30 % at the corner of four pixels.
    """
    numbers = tuple(measurements)
    step_px = {0.0: float(window.x[1] - window.x[0]), 90.0: float(window.y[1] - window.y[0])}
    sharp = any(
        measurement.quantity == "mtf50"
        and measurement.interval95 is not None
        and measurement.interval95[1] * step_px[measurement.orientation_deg or 0.0]
        > LIMITS.max_mtf50
        for measurement in numbers
    )
    if not sharp:
        return numbers
    effect = (
        f"MTF50 may lie above {LIMITS.max_mtf50:g} cycles per sample, where it is measured "
        f"10 to 30 % low"
    )
    return tuple(judge(measurement, [finding("aliased", effect)]) for measurement in numbers)


def motion_flags(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> tuple[str, ...]:
    """Return `interlace-motion` for a displacement between fields, `drift` for one through the
    stack.

    `frames`: light around the source above its background, shape (frame, row, col), DN; `x`, `y`:
    positions of columns and rows from the source, column pitches; `parity`: field of every row,
    shape (row,).
    """
    if len(frames) < 4:
        return ()
    moves = _drifts(frames, x, y) or _shakes(frames, x, y)
    checks = (("interlace-motion", _has_field_offset(frames, x, y, parity)), ("drift", moves))
    return tuple(name for name, is_raised in checks if is_raised)


def _has_field_offset(frames: Array, x: Array, y: Array, parity: NDArray[np.bool_]) -> bool:
    """Return whether odd and even rows show the source in different columns."""
    weighted = (np.hypot(x[None, :], y[:, None]) < ACCURACY.motion_radius_px) * frames
    centre, error = [], []
    for rows in (parity, ~parity):
        light, moment = weighted[:, rows].sum(axis=(1, 2)), (weighted * x)[:, rows].sum(axis=(1, 2))
        if light.mean() < LIMITS.motion_sd * light.std(ddof=1) / np.sqrt(len(light)):
            return False
        # The ratio of sums over frames: that of a single faint frame is unreliable.
        centre.append(moment.sum() / light.sum())
        off = moment - centre[-1] * light
        error.append(off.std(ddof=1) / np.sqrt(len(off)) / light.mean())
    return bool(
        abs(centre[0] - centre[1])
        > max(LIMITS.motion_sd * float(np.hypot(*error)), LIMITS.max_field_offset_px)
    )


def _drifts(frames: Array, x: Array, y: Array) -> bool:
    """Return whether the source moves steadily along rows or columns."""
    time = np.linspace(-0.5, 0.5, len(frames))
    for position, _ in _places(frames, x, y):
        travel = float(time @ position / (time @ time))
        residual = position - position.mean() - travel * time
        error = float(np.sqrt(residual @ residual / (len(frames) - 2) / (time @ time)))
        if abs(travel) > max(LIMITS.motion_sd * error, LIMITS.max_drift_px):
            return True
    return False


def _shakes(frames: Array, x: Array, y: Array) -> bool:
    """Return whether the source moves between frames beyond photon noise, and enough to matter.

    Notes
    -----
    Photons of a spot S scatter its position by at most a sum(w^2 S) / sum(w^2)^2, w its slope and a
    the variance of the total light over that light. Pulses wider than a pixel scatter it less
    (Jensen); lamp flicker raises the bound. The mean frame is blurred by the mean square
    displacement, which reduces MTF50 by half its ratio to that of the blur.
    """
    from scipy.special import fdtrc

    mean = frames.mean(axis=0)
    spot_area = np.hypot(x[None, :], y[:, None]) < 10.0
    light, freedom = frames[:, spot_area].sum(axis=1), len(frames) - 1
    if not light.mean() > 0:
        return False
    per_light = light.var(ddof=1) / light.mean()
    # The median of chi squared of one degree of freedom is 0.455.
    dark = (
        0.5 * float(np.median(np.diff(frames[:, ~spot_area], axis=0) ** 2)) / 0.455
        if not spot_area.all()
        else 0.0
    )
    area = (
        light.mean() / max(float(mean.max()), 1e-300) * float(np.diff(x[:2])[0] * np.diff(y[:2])[0])
    )
    for position, rise in _places(frames, x, y):
        power = float(np.sum(rise**2))
        if not power > 0:
            # Light in a single pixel: its position is undefined.
            continue
        noise = per_light * float(np.sum(rise**2 * np.maximum(mean, 0.0))) / power**2 + dark / power
        square = position.var(ddof=1)
        lowered = np.pi * (square - noise) / area
        if (
            lowered > LIMITS.max_motion_loss
            and fdtrc(freedom, freedom, square / max(noise, 1e-300)) < LIMITS.motion_p_value
        ):
            return True
    return False


def _places(frames: Array, x: Array, y: Array) -> list[tuple[Array, Array]]:
    """Return displacements of each frame along rows and columns, and the slopes used."""
    mean = frames.mean(axis=0)
    mask = (np.hypot(x[None, :], y[:, None]) < ACCURACY.motion_radius_px) & (
        mean > 0.1 * mean.max()
    )
    displacements = []
    for slope in (np.gradient(mean, x, axis=1), np.gradient(mean, y, axis=0)):
        rise = np.where(mask, slope, 0.0)
        position = -np.sum((frames - mean) * rise, axis=(1, 2)) / max(
            float(np.sum(rise**2)), 1e-300
        )
        displacements.append((position, rise))
    return displacements


def source_findings(
    sites: list[SourcePixels], fitter: PointFitter, models: list[EvidenceWeightedModels2D]
) -> list[Finding]:
    """Return the findings of fitted sources."""
    fit, out = models[0].fit, []
    if any(site.window.clipped for site in sites):
        out.append(
            finding(
                "clipped", "noise is clipped at black; MTF50 is half a standard uncertainty high"
            )
        )
    stands = float((fit.light / light_sd(fitter, fit)).min())
    if stands < LIMITS.low_light_sd:
        effect = (
            f"light {stands:.1f} standard uncertainties; intervals are validated from "
            f"{LIMITS.low_light_sd:g}"
        )
        out.append(finding("low-signal", effect))
    if fit.chi2 / fit.free > LIMITS.max_chi2 + LIMITS.max_chi2_sd * np.sqrt(
        2.0 / fit.free
    ) or has_departures(sites, fitter, fit):
        out.append(finding("model-misfit", _misfit_effect(fitter, fit)))
    along, down = _half_frequencies(fit)
    if max(along / down, down / along) > LIMITS.max_elongation:
        effect = (
            f"MTF50 along rows is {along / down:.2f} times that along columns; light next to "
            f"the source has this effect"
        )
        out.append(finding("several-targets", effect))
    if any(site.window.cut or (site.screen and not site.window.holds_halo) for site in sites):
        effect = "light beyond the region is not included; MTF50 may be high by its fraction"
        out.append(finding("window-too-small", effect))
    at = np.min(np.abs(fit.point - fit.form.bounds.T), axis=0)
    bound = [
        name for name, distance in zip(fit.form.parameters, at, strict=True) if distance < 1e-6
    ]
    if {"ln_half_frequency", "stretch"} & set(bound):
        out.append(
            finding(
                "prior-bound", f"{', '.join(bound)} at its bound; MTF50 may lie anywhere beyond"
            )
        )
    for name, mean, sd in fit.form.known:
        if name == "ln_half_frequency" and abs(fit.point[0] - mean) > LIMITS.max_prior_sd * sd:
            effect = (
                f"the core is more than {LIMITS.max_prior_sd:g} standard deviations from the "
                f"description"
            )
            out.append(finding("prior-bound", effect))
    for window in (site.window for site in sites if site.window.sound):
        frames = window.deviations.reshape(-1, *window.core.shape) + (
            window.core - float(np.median(window.core))
        )
        x, y = window.centre
        out += motion_findings(
            motion_flags(frames, window.x - x, window.y - y, window.parity[:: window.x.size])
        )
    return out


def _half_frequencies(fit: BlurModelFit2D) -> tuple[float, float]:
    """Return MTF50 along rows and along columns, cycles per column pitch, without aperture."""
    along, down = crossing_frequency(
        FINE, fit.form.camera(fit.point[None], FINE, np.array([1.0, -1.0]))[0], 0.5
    )
    return float(along), float(down)


def _misfit_effect(fitter: PointFitter, fit: BlurModelFit2D) -> str:
    """Return the effect of a misfit: the change of MTF50 by fitted model departures."""
    form = replace(fit.form, departures=max(DEPARTURES))
    free = fitter.fit(form, start_from(fit, form))
    moves = [
        abs(b / a - 1.0)
        for a, b in zip(_half_frequencies(fit), _half_frequencies(free), strict=True)
    ]
    residual_ratio = np.sqrt(fit.chi2 / fit.free)
    return (
        f"residuals are {residual_ratio:.2g} times the noise; model departures change MTF50 by "
        f"{100 * max(moves):.2g} %"
    )


def light_sd(fitter: PointFitter, fit: BlurModelFit2D) -> Array:
    """Return the standard uncertainty of each light for a fixed model, DN px^2."""
    nodes = fit.form.nodes(fit.point[None])
    return np.array(
        [
            np.sum((whitened.matrix[:, : nodes.size] @ nodes[0]) ** 2) ** -0.5
            for whitened in fitter.pixels
        ]
    )


def has_departures(sites: list[SourcePixels], fitter: PointFitter, fit: BlurModelFit2D) -> bool:
    """Return whether model departures reduce chi squared beyond noise.

    Departures are bumps of the transfer along frequency, a rotation of the ellipse, and asymmetry
    in both directions, each to first order with all parameters free.
    """
    bounds = fit.form.bounds
    moves = np.where(fit.point > bounds.mean(axis=1), -1e-5, 1e-5) * (bounds[:, 1] - bounds[:, 0])
    nodes = fit.form.nodes(np.concatenate([fit.point[None], fit.point + np.diag(moves)]))
    ratio = np.log(FREQUENCIES) - fit.point[0]
    bumps = np.exp(-0.5 * ((ratio - np.array(BUMPS)[:, None]) / BUMP_WIDTH) ** 2)
    described = nodes[0, : COSINES.size * FREQUENCIES.size]
    bumped = (described.reshape(1, -1, FREQUENCIES.size) * bumps[:, None]).reshape(len(bumps), -1)
    unit_columns, more, residual = [], [], []
    for site, whitened, light in zip(sites, fitter.pixels, fit.light, strict=True):
        matrix = whitened.matrix[:, : nodes.shape[1]]
        unit, departed = matrix @ nodes[0], matrix[:, : described.size] @ bumped.T
        unit_columns.append(
            np.concatenate(
                [unit[:, None], light * (matrix @ (nodes[1:] - nodes[0]).T) / moves], axis=1
            )
        )
        more.append(
            light
            * np.concatenate([departed, _asymmetry_columns(site, whitened, described)], axis=1)
        )
        residual.append(whitened.data - light * unit)
    gain = _chi2_explained(
        np.concatenate([_blocks(unit_columns), np.concatenate(more)], axis=1),
        np.concatenate(residual),
    )
    gain -= _chi2_explained(_blocks(unit_columns), np.concatenate(residual))
    count = more[0].shape[1]
    return bool(gain > count + LIMITS.max_departure_sd * np.sqrt(2.0 * count))


def _asymmetry_columns(site: SourcePixels, whitened: WhitenedPixels, nodes: Array) -> Array:
    """Return the effect of rotation and asymmetry on the whitened pixels at unit light, shape
    (value, 3).
    """
    transfer = nodes.reshape(COSINES.size, -1)
    half = float(np.interp(-0.5, -transfer[0], FREQUENCIES))
    sharp = pictures(site.aperture, transfer * (FREQUENCIES / half) ** 2, *site.axes)
    tilted = pictures(site.aperture, transfer, *site.axes)[3]
    columns = np.stack([tilted, sharp[1], sharp[2]], axis=1)
    columns = np.concatenate([columns, np.zeros((site.window.ring_dn.size, 3))])
    return whitened.whiten(columns[site.value_mask])


def _blocks(columns: list[Array]) -> Array:
    """Return design columns of all sources: separate lights, common model parameters."""
    lights = np.zeros((sum(len(part) for part in columns), len(columns)))
    first = 0
    for index, part in enumerate(columns):
        lights[first : first + len(part), index] = part[:, 0]
        first += len(part)
    return np.concatenate([lights, np.concatenate([part[:, 1:] for part in columns])], axis=1)


def _chi2_explained(columns: Array, residual: Array) -> float:
    """Return the chi squared of a residual that columns explain."""
    basis, values, _ = np.linalg.svd(
        columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False
    )
    basis = basis[:, values > 1e-6 * values[0]]
    return float(np.sum((basis.T @ residual) ** 2))


def camera_nonlinearity(sites: list[SourcePixels], fit: BlurModelFit2D) -> SpotNonlinearity:
    """Return the nonlinearity from the frames' noise of sources."""
    transfer = fit.form.transfer(fit.point[None])[0]
    profiles = []
    for site, light in zip(sites, fit.light, strict=True):
        if site.window.frames < 2 or site.pulses is None or not site.window.sound:
            continue
        mean = light * pictures(site.aperture, transfer, *site.axes)[0]
        pulses, dark = (
            site.pulses.covariance * site.memory.between_rows(site.window.parity),
            dark_noise(site),
        )
        # Larger noise than that makes quantisation add its own only.
        plain = (np.diag(pulses + dark) > LIMITS.min_variance_dn2) | np.isinf(site.window.quiet_sd)
        near_pixels = site.near[plain[site.near]]
        near_pairs = np.ix_(near_pixels, near_pixels)
        profiles.append(
            power_log_likelihoods(
                site.window.contrasts[:, near_pixels],
                mean[near_pixels],
                pulses[near_pairs],
                dark[near_pairs],
            )
        )
    return fit_nonlinearity(profiles)
