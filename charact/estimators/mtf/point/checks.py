"""Checks of point sources: motion, undersampling, misfit and departures, nonlinear response; their
findings.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from charact.estimators.mtf.curve import FINE, CurveFinding, Undo, crossing_frequency
from charact.estimators.mtf.point.blur_models_2d import (
    BUMP_WIDTH,
    BUMPS,
    mtf_of_camera,
    pinhole,
)
from charact.estimators.mtf.point.model_fit import (
    BlurModelFit2D,
    PointFitter,
    WhitenedPixels,
    orthonormal,
)
from charact.estimators.mtf.point.nonlinearity import (
    POWERS,
    SpotNonlinearity,
    fit_nonlinearity,
    power_log_likelihoods,
)
from charact.estimators.mtf.point.source_pixels import SourcePixels, dark_noise
from charact.estimators.mtf.point.spot_image_matrix import COSINES, FREQUENCIES, pictures
from charact.estimators.mtf.point.spot_light import FREQUENCY
from charact.estimators.mtf.point.thresholds import ACCURACY, LIMITS
from charact.estimators.mtf.target_motion import TargetMotion
from charact.verdict import judge
from labdata import Array, Mask
from labdata.measurement import Measurement

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


def finding(flag: str, effect: str, undo: Undo | None = None) -> CurveFinding:
    """Return the finding of a flag; what has a bound lowers the MTF."""
    return CurveFinding(flag=flag, effect=effect, undo=undo, sign=0 if undo is None else -1)


def judge_by(
    findings: Iterable[CurveFinding], number: Measurement, frequency: Array, modulus: Array
) -> Measurement:
    """Judge a number by findings; `modulus`: the MTF at frequencies, shape (f,)."""
    return judge(
        number,
        [check.of_number(number, frequency, modulus, REMEDIES[check.flag]) for check in findings],
    )


def undersampled(
    numbers: Iterable[Measurement], step_px: dict[float, float]
) -> dict[float, CurveFinding]:
    """Return the finding of a spot with an MTF50 too close to the sampling limit, by direction,
    degrees; empty: it is not.

    `step_px`: pixel pitch along each direction, column pitches.

    Notes
    -----
    The position of the spot is fitted to first order. A spot of 0.15 px illuminates one pixel
    wherever it lies in it: MTF50 is 10 to 15 % low, and 30 % at the corner of four pixels. No spot
    has an MTF above |sinc(f p)|, that of the pixel's aperture of pitch p.
    """
    sharp = any(
        measurement.quantity == "mtf50"
        and measurement.interval95 is not None
        and measurement.interval95[1] * step_px[measurement.orientation_deg or 0.0]
        > LIMITS.max_mtf50
        for measurement in numbers
    )
    if not sharp:
        return {}
    effect = (
        f"MTF50 may lie above {LIMITS.max_mtf50:g} cycles per sample, where it is measured "
        "10 to 30 % low, and at most that of the pixel's aperture"
    )

    def aperture(pitch_px: float) -> Undo:
        return lambda frequency, modulus: np.maximum(modulus, np.abs(np.sinc(frequency * pitch_px)))

    return {
        angle: finding("aliased", effect, aperture(pitch_px)) for angle, pitch_px in step_px.items()
    }


def motion_findings(
    frames: Array, x: Array, y: Array, parity: Mask, radius_px: float = ACCURACY.motion_radius_px
) -> list[CurveFinding]:
    """Return `interlace-motion` for a displacement between fields, `drift` for one through the
    stack.

    `frames`: light around the source above its background, shape (frame, row, col), DN; `x`, `y`:
    positions of columns and rows from the source, column pitches; `parity`: field of every row,
    shape (row,); `radius_px`: distance from the source within which the fields are compared.
    """
    if len(frames) < 4:
        return []
    out, field_offset_px = [], _field_offset_px(frames, x, y, parity, radius_px)
    if field_offset_px > 0.0:
        effect = f"the fields are displaced by {field_offset_px:.2g} px"
        fields = TargetMotion(rms_px=0.5 * field_offset_px)
        out.append(finding("interlace-motion", effect, fields.undo))
    rms_px = _motion_rms_px(frames, x, y)
    if rms_px > 0.0:
        effect = f"the source moves by {rms_px:.2g} px rms"
        out.append(finding("drift", effect, TargetMotion(rms_px=rms_px).undo))
    return out


def noise_findings(chance: float) -> list[CurveFinding]:
    """Return `gamma` where a linear camera has such quiet lit pixels by this chance only."""
    if chance >= LIMITS.min_noise_chance:
        return []
    effect = (
        "lit pixels are quieter than dark ones, as behind a compressive response; one of exponent "
        "g changes MTF50 by about the root of g"
    )
    return [finding("gamma", effect)]


def _field_offset_px(frames: Array, x: Array, y: Array, parity: Mask, radius_px: float) -> float:
    """Return the distance between the columns in which odd and even rows show the source, px; 0:
    none.
    """
    weighted = (np.hypot(x[None, :], y[:, None]) < radius_px) * frames
    centre, error = [], []
    for rows in (parity, ~parity):
        light, moment = weighted[:, rows].sum(axis=(1, 2)), (weighted * x)[:, rows].sum(axis=(1, 2))
        if light.mean() < LIMITS.motion_sd * light.std(ddof=1) / np.sqrt(len(light)):
            return 0.0
        # The ratio of sums over frames: that of a single faint frame is unreliable.
        centre.append(moment.sum() / light.sum())
        off = moment - centre[-1] * light
        error.append(off.std(ddof=1) / np.sqrt(len(off)) / light.mean())
    offset_px = abs(centre[0] - centre[1])
    least_px = max(LIMITS.motion_sd * float(np.hypot(*error)), LIMITS.max_field_offset_px)
    return offset_px if offset_px > least_px else 0.0


def _motion_rms_px(frames: Array, x: Array, y: Array) -> float:
    """Return by how much the source moves steadily, or between frames beyond photon noise, along
    rows or columns, px rms; 0: not enough to matter.

    Notes
    -----
    Positions spread evenly over a travel t have the standard deviation t / sqrt(12).

    Photons of a spot S scatter its position by at most a sum(w^2 S) / sum(w^2)^2, w its slope and a
    the variance of the total light over that light. Pulses wider than a pixel scatter it less
    (Jensen); lamp flicker raises the bound. The mean frame is blurred by the mean square
    displacement, which reduces MTF50 by half its ratio to that of the blur.
    """
    from scipy.special import fdtrc

    mean, time = frames.mean(axis=0), np.linspace(-0.5, 0.5, len(frames))
    spot_area = np.hypot(x[None, :], y[:, None]) < 10.0
    light, freedom = frames[:, spot_area].sum(axis=1), len(frames) - 1
    per_light = light.var(ddof=1) / max(float(light.mean()), 1e-300)
    # The median of chi squared of one degree of freedom is 0.455.
    dark = (
        0.5 * float(np.median(np.diff(frames[:, ~spot_area], axis=0) ** 2)) / 0.455
        if not spot_area.all()
        else 0.0
    )
    area = (
        light.mean() / max(float(mean.max()), 1e-300) * float(np.diff(x[:2])[0] * np.diff(y[:2])[0])
    )
    squares = [0.0]
    for position, rise in _places(frames, x, y):
        travel = float(time @ position / (time @ time))
        residual = position - position.mean() - travel * time
        error = float(np.sqrt(residual @ residual / (freedom - 1) / (time @ time)))
        if abs(travel) > max(LIMITS.motion_sd * error, LIMITS.max_drift_px):
            squares.append(travel**2 / 12.0)
        power = float(np.sum(rise**2))
        if not power > 0 or not light.mean() > 0:
            # Light in a single pixel: its position is undefined.
            continue
        noise = per_light * float(np.sum(rise**2 * np.maximum(mean, 0.0))) / power**2 + dark / power
        square = position.var(ddof=1)
        lowered = np.pi * (square - noise) / area
        if (
            lowered > LIMITS.max_motion_loss
            and fdtrc(freedom, freedom, square / max(noise, 1e-300)) < LIMITS.motion_p_value
        ):
            squares.append(square - noise)
    return float(max(squares)) ** 0.5


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
    site: SourcePixels, fitter: PointFitter, fit: BlurModelFit2D
) -> list[CurveFinding]:
    """Return the findings of a fitted source."""
    window, out = site.window, []
    if window.clipped:
        out.append(
            finding(
                "clipped", "noise is clipped at black; MTF50 is half a standard uncertainty high"
            )
        )
    stands = fit.light / light_sd(fitter, fit)
    if stands < LIMITS.low_light_sd:
        effect = (
            f"light {stands:.1f} standard uncertainties; intervals are validated from "
            f"{LIMITS.low_light_sd:g}"
        )
        out.append(finding("low-signal", effect))
    if (
        fit.chi2 / fit.free > LIMITS.max_chi2 + LIMITS.max_chi2_sd * np.sqrt(2.0 / fit.free)
        or has_departures(site, fitter, fit)
        or _is_noise_of_misfit(site)
        or (fit.form.departures > 0.0 and _largest_departure(fit) > LIMITS.max_departure)
    ):
        effect = (
            f"residuals are {np.sqrt(fit.chi2 / fit.free):.2g} times the noise, or of a pattern "
            "that noise does not have"
        )
        out.append(finding("model-misfit", effect))
    elif (gap := _gap_to_light(site, fit)) > LIMITS.max_gap_sd:
        effect = (
            f"the MTF of the form lies {gap:.1f} standard uncertainties from that of the light "
            "itself"
        )
        out.append(finding("model-misfit", effect))
    along, down = _half_frequencies(fit)
    # Where the light itself shows no second source, an ellipse is one of an aberrated pupil.
    if site.spot is None and max(along / down, down / along) > LIMITS.max_elongation:
        effect = (
            f"MTF50 along rows is {along / down:.2f} times that along columns; light next to "
            f"the source has this effect"
        )
        out.append(finding("several-targets", effect))
    if window.cut or (site.screen and not window.holds_halo):
        effect = "light beyond the region is not included; MTF50 may be high by its fraction"
        out.append(finding("window-too-small", effect))
    at = np.min(np.abs(fit.point - fit.form.bounds.T), axis=0)
    bound = [name for name, distance in zip(fit.form.names, at, strict=True) if distance < 1e-6]
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
    out += noise_findings(site.noise_chance)
    if window.sound:
        frames = window.deviations.reshape(-1, *window.core.shape) + (
            window.core - float(np.median(window.core))
        )
        step_px, (x, y) = site.aperture.summed_px, window.centre
        parity = window.parity[:: window.x.size]
        out += motion_findings(frames, step_px * (window.x - x), step_px * (window.y - y), parity)
    return out


def _largest_departure(fit: BlurModelFit2D) -> float:
    """Return the largest amplitude of model departures, fraction of the transfer."""
    parameters = zip(fit.form.names, fit.point, strict=True)
    return float(max(abs(value) for name, value in parameters if name.startswith("departure_")))


def _is_noise_of_misfit(site: SourcePixels) -> bool:
    """Return whether the residuals of one frame, taken for noise of its light, exceed the scatter
    of neighbouring pixels.
    """
    if site.spot is None or site.pulses is None or site.window.frames > 1:
        return False
    gain_dn = site.pulses.gain * site.aperture.summed_px**2
    return gain_dn > LIMITS.max_noise_ratio * site.spot.gain_dn


def _half_frequencies(fit: BlurModelFit2D) -> tuple[float, float]:
    """Return MTF50 along rows and along columns, cycles per column pitch, without aperture."""
    along, down = crossing_frequency(
        FINE, fit.form.camera(fit.point[None], FINE, np.array([1.0, -1.0]))[0], 0.5
    )
    return float(along), float(down)


def _gap_to_light(site: SourcePixels, fit: BlurModelFit2D) -> float:
    """Return the largest difference of a form's MTF from that of the light without a form, standard
    uncertainties of the latter.
    """
    gaps, diameter, spot = [0.0], fit.form.pinhole_px, site.spot
    if isinstance(diameter, tuple) or spot is None:
        return 0.0
    # Forms take the logarithm of a frequency.
    frequency, step_px = np.maximum(FREQUENCY, 1e-6), site.aperture.summed_px
    source = pinhole(frequency, diameter * step_px)
    if len(spot.frames) == 1 and site.pulses is not None:
        # What the form leaves is no less than the noise.
        gain_dn = min(site.pulses.gain * step_px**2, spot.gain_dn)
        spot = replace(spot, light_gain_dn=gain_dn)
    for vertical in (False, True):
        form = source * mtf_of_camera(
            fit.form, fit.point[None], frequency, site.aperture, vertical=vertical
        )
        light = spot.transform(vertical=vertical)
        at = [int(np.argmax(form[0] < level)) for level in LIMITS.compared_levels]
        gaps += (np.abs(form[0] - light.modulus)[at] / np.maximum(light.sd[at], 1e-12)).tolist()
    return max(gaps)


def light_sd(fitter: PointFitter, fit: BlurModelFit2D) -> float:
    """Return the standard uncertainty of the light for a fixed model, DN px^2."""
    nodes = fit.form.nodes(fit.point[None])[0]
    return 1.0 / max(float(np.linalg.norm(fitter.pixels.matrix[:, : nodes.size] @ nodes)), 1e-300)


def has_departures(site: SourcePixels, fitter: PointFitter, fit: BlurModelFit2D) -> bool:
    """Return whether model departures reduce chi squared beyond noise.

    Departures are bumps of the transfer along frequency, a fourfold direction as of a square pupil,
    a rotation of the ellipse, and asymmetry in both directions, each to first order with all
    parameters free.
    """
    described = fit.form.nodes(fit.point[None])[0, : COSINES.size * FREQUENCIES.size]
    ratio = np.log(FREQUENCIES) - fit.point[0]
    bumps = np.exp(-0.5 * ((ratio - np.array(BUMPS)[:, None]) / BUMP_WIDTH) ** 2)
    # cos 4t of an angle t to the rows, whose cos 2t the directions have.
    fourfold = (2.0 * COSINES**2 - 1.0)[:, None] * np.exp(2.0 * ratio)
    shapes = np.concatenate(
        [np.broadcast_to(bumps[:, None], (len(bumps), *fourfold.shape)), fourfold[None]]
    )
    bumped = (described.reshape(1, *fourfold.shape) * shapes).reshape(len(shapes), -1)
    columns = [
        fitter.pixels.matrix[:, : described.size] @ bumped.T,
        _asymmetry_columns(site, fitter.pixels, described),
    ]
    residual, departed = fitter.beyond(fit, np.concatenate(columns, axis=1))
    gain = float(np.sum((orthonormal(departed).T @ residual) ** 2))
    count = departed.shape[1]
    return gain > count + LIMITS.max_departure_sd * np.sqrt(2.0 * count)


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


def camera_nonlinearity(site: SourcePixels, fit: BlurModelFit2D) -> SpotNonlinearity:
    """Return the nonlinearity from the frames' noise of a source."""
    if site.window.frames < 2 or site.pulses is None or not site.window.sound:
        return fit_nonlinearity(np.zeros(POWERS.size))
    mean = fit.light * pictures(site.aperture, fit.form.transfer(fit.point[None])[0], *site.axes)[0]
    pulses = site.pulses.covariance * site.memory.between_rows(site.window.parity)
    dark = dark_noise(site)
    # Larger noise than that makes quantisation add its own only.
    plain = (np.diag(pulses + dark) > LIMITS.min_variance_dn2) | np.isinf(site.window.quiet_sd)
    pixels = site.near[plain[site.near]]
    pairs = np.ix_(pixels, pixels)
    return fit_nonlinearity(
        power_log_likelihoods(
            site.window.contrasts[:, pixels], mean[pixels], pulses[pairs], dark[pairs]
        )
    )
