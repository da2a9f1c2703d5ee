"""MTF of what comes after the gain, from the noise of flats: no target is needed.

Scintillations are points of light that the tube itself makes: the power of their noise is the
square of the transfer of the screen, taper, chip and video. Lens and cathode gap, which move
photoelectrons about before the gain, do not show.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from charact.estimators.mtf.noise_spectrum.model import (
    FAMILIES,
    SCATTER_FRACTION,
    SCATTER_PX,
    SCATTER_SHARE,
    NonparametricBlur,
    PostGainBlur,
    SpectrumOptimum,
    optimum_under_model,
    readout_of,
    white_log_probability,
)
from charact.estimators.mtf.noise_spectrum.pooled_spectrum import (
    PooledSpectrum,
    SelectedFlats,
    select_flats,
    spectrum_of,
)
from charact.estimators.mtf.noise_spectrum.result import (
    DRAWS,
    SpectrumDraws,
    curves,
    figure_data,
    finding,
    noise_power,
    quantities,
)
from charact.estimators.mtf.noise_spectrum.result import note as unseen_note
from charact.estimators.mtf.noise_spectrum.thresholds import THRESHOLDS
from charact.estimators.noise.findings import fields_of
from charact.frames.rounding import QUANTISED_DN2
from charact.inference import laplace, predictive_check, sample_posterior
from charact.inference.diagnostics import crowds_at_bound
from charact.inference.gauss_newton import weigh_by_evidence
from charact.method import Context, register
from charact.transfer.blur_model import BlurModel
from charact.transfer.extended import ScatterComponent
from charact.verdict import Finding
from labdata import Array, Posterior, Result, Session, has_tube, make_refusal


def findings_of(
    spectrum: PooledSpectrum, chosen: SelectedFlats, peak: SpectrumOptimum, context: Context
) -> list[Finding]:
    """Return the findings of the flats and their spectrum, none of which has a bound."""
    lit = any(level.signal_dn for level in spectrum.levels)
    lowest_power_dn2 = min(float(np.mean(level.power_dn2)) for level in spectrum.levels)
    linear = (
        THRESHOLDS.max_mcp_saturation if has_tube(context.camera) else THRESHOLDS.max_nonlinearity
    )
    gamma = has_tube(context.camera) and float(context.camera.video.gamma) != 1.0
    checks = (
        (chosen.clipped, "clipped", "pixels of the flats or darks are at an end of the scale"),
        (
            chosen.flicker > THRESHOLDS.flicker,
            "flicker",
            f"the light changes by {100 * chosen.flicker:.2g} % from frame to frame",
        ),
        (
            spectrum.frames < THRESHOLDS.min_frames,
            "too-few-frames",
            (
                f"{spectrum.frames} frames cannot show whether exposures share light; "
                f"{THRESHOLDS.min_frames} can"
            ),
        ),
        (
            spectrum.lag_open,
            "lag",
            "earlier exposures still glow at the last lag that the frames allow",
        ),
        (
            not lit,
            "no-darks",
            "no darks: noise of the electronics was taken for white, and the response for straight",
        ),
        (
            lit and len(spectrum.levels) < 2,
            "too-few-frames",
            "one level of light only: whether the response is straight cannot be seen",
        ),
        (
            lowest_power_dn2 < QUANTISED_DN2,
            "quantised",
            f"a noise power of {lowest_power_dn2:.2g} DN2 is below that of rounding",
        ),
        (
            _is_nonlinear(spectrum, peak, linear),
            "gamma",
            "the noise power over the signal changes along the levels of light",
        ),
        (
            _has_scatter(spectrum, peak),
            "model-misfit",
            (
                "light seems to be scattered after the gain beyond the form's reach: the MTF may "
                "be too high"
            ),
        ),
        (
            _is_too_steep(peak),
            "model-misfit",
            (
                f"the transfer falls more steeply than exp(-(f/fc)^{THRESHOLDS.max_exponent:g}), "
                "as blurs do not"
            ),
        ),
        (gamma, "gamma", "the description states a gamma, under which pulses add unequally"),
    )
    return [finding(flag, effect) for is_raised, flag, effect in checks if is_raised]


def _notes_of(spectrum: PooledSpectrum, chosen: SelectedFlats) -> list[str]:
    """Return the notes on the flats used."""
    notes = []
    if chosen.left_out:
        names = ", ".join(chosen.left_out)
        notes.append(f"left out, at another gain, saturated or of a single frame: {names}")
    if len(spectrum.lag) and not spectrum.lag_open:
        notes.append(
            f"image lag between successive exposures (correlation {spectrum.lag[0]:.2g}); "
            "accounted for"
        )
    return notes


def _is_nonlinear(spectrum: PooledSpectrum, peak: SpectrumOptimum, expected_slope: float) -> bool:
    """Whether the power of pulses over the signal changes along the levels by more than a share, as
    under a gamma.
    """
    levels = [level for level in spectrum.levels if level.signal_dn]
    if len(levels) < 2:
        return False
    white, pulses = peak.problem.parts(peak.point[None])
    shape = (white + pulses)[0]
    signal = np.array([float(level.signal_dn or 1.0) for level in levels])
    weight = np.array([(shape / level.power_sd_dn2) ** 2 for level in levels])
    power = np.array(
        [
            float(np.average(level.power_dn2 / shape, weights=level_weight))
            for level, level_weight in zip(levels, weight, strict=True)
        ]
    )
    error = 1.0 / np.sqrt(weight.sum(axis=1))
    low, high = np.array([level.quantisation_noise_dn2 for level in levels]).T / (
        power * float(shape.mean())
    )
    ratio = power * (1.0 - 0.5 * (low + high)) / signal
    mean = float(np.average(ratio, weights=(signal / error) ** 2))
    sd = np.hypot(error / power, _pulse_height_error(spectrum, peak, signal, power))
    allowed = expected_slope + THRESHOLDS.nonlinearity_sd * sd + 0.5 * (high - low)
    return bool(np.any(np.abs(ratio / mean - 1.0) > allowed))


def _pulse_height_error(
    spectrum: PooledSpectrum, peak: SpectrumOptimum, signal_dn: Array, power: Array
) -> Array:
    """Relative error of each level's power by the heights of its pulses, shape (level,).

    All cells of a level share it. Of N pulses with heights h the power scatters by E h^4 / (E
    h^2)^2 / N; N from the signal and the power at frequency 0, k E h^2 / (E h)^2 per signal.
    """
    looks = np.array(
        [
            float(np.sum((level.power_dn2 / level.power_sd_dn2) ** 2))
            for level in spectrum.levels
            if level.signal_dn
        ]
    )
    at_zero = power * float(np.exp(peak.point[0]))
    pulses = THRESHOLDS.pulse_square * signal_dn**2 / at_zero * 2.0 * looks
    return np.sqrt(THRESHOLDS.pulse_kurtosis / np.maximum(pulses, 1.0))


def _is_too_steep(peak: SpectrumOptimum) -> bool:
    """Whether the exponent of the form is beyond those of blurs."""
    if "exponent" not in peak.problem.shape.names or peak.problem.shape.name == "free":
        return False
    exponent_index = peak.problem.names.index("exponent")
    sd = float(np.sqrt(peak.covariance[exponent_index, exponent_index]))
    return float(peak.point[exponent_index]) > THRESHOLDS.max_exponent + THRESHOLDS.exponent_sd * sd


def _has_scatter(spectrum: PooledSpectrum, peak: SpectrumOptimum) -> bool:
    """Whether scattered light makes the data much likelier, where the image is large enough to show
    it.
    """
    longest = SCATTER_SHARE * spectrum.shorter_px
    if longest < 2.0 * SCATTER_PX:
        return False
    veil = ScatterComponent(size_px=(SCATTER_PX, longest), fraction=SCATTER_FRACTION)
    veiled = optimum_under_model(
        spectrum, peak.problem.known, BlurModel(core="exponential", wide=veil), neighbour=peak
    )
    gain = veiled.problem.log_likelihood_at(veiled.point) - peak.problem.log_likelihood_at(
        peak.point
    )
    return gain > THRESHOLDS.scatter_ln_likelihood


def misfit(
    peak: SpectrumOptimum, posterior: Posterior, rng: np.random.Generator
) -> tuple[str, ...]:
    """Return `model-misfit` where the spectrum, in the order of radius, departs from its model by
    more than noise.
    """
    problem = peak.problem
    spectrum, looks = problem.spectrum, problem.looks
    order = np.argsort(np.hypot(spectrum.column_cy_per_px, spectrum.row_cy_per_px))
    best = problem.model(peak.point[None])[0]
    # The cube root of a gamma variable is nearly normal (Wilson & Hilferty 1931), its mean lower by
    # 1/(9 n).
    data = np.cbrt(spectrum.power_dn2 / best)
    # Where the posterior bends, its mean is no fit: what matters is how far draws may lie from the
    # best one.
    drawn = np.cbrt(problem.model(posterior.draws[:300]) / best)
    drawn = (1.0 + drawn - drawn.mean(axis=0)) * (1.0 - 1.0 / (9.0 * looks))
    noise = 1.0 / (3.0 * np.sqrt(looks))
    level = THRESHOLDS.misfit_p_value
    return predictive_check(data[order], drawn[:, order], noise[order], rng=rng, level=level).flags


KIND = "post-gain"
# Effects of the flags of the predictive check and of the chains.
EFFECTS = {
    "model-misfit": "the spectrum, in the order of radius, departs from its model beyond noise",
    "not-converged": "interval from the curvature at the optimum",
    "prior-bound": "the half frequency or its ratio between directions lies at its bound",
    "several-modes": "two transfers fit about equally well",
}
NOTE = (
    "MTF of what comes after the gain (screen, taper, chip, video): lens and cathode gap are "
    "not in it"
)


@register(KIND, "noise-spectrum")
def noise_spectrum(session: Session, *, context: Context) -> Result:
    """Measure the MTF after the gain with forms of the transfer, averaged by their evidence.

    Returns
    -------
    Result
        `post_gain_mtf50` and `post_gain_mtf` at pinned frequencies along rows (0 deg) and columns
        (90 deg), `white_noise_fraction`; curves "mtf_post_gain" and "mtf_post_gain_vertical", and
        the non-parametric ones.

    Notes
    -----
    Power of the noise: white floor + k F^2 mu |H|^2, folded by sampling, fitted by Whittle's
    likelihood. See `charact.estimators.mtf.noise_spectrum.model`.
    """
    return _measure(session, FAMILIES, "noise-spectrum", context, with_free_curves=True)


@register(KIND, "noise-spectrum-free")
def noise_spectrum_free(session: Session, *, context: Context) -> Result:
    """Measure the MTF after the gain as a free smooth function; returns as `noise_spectrum`."""
    return _measure(
        session, (NonparametricBlur(),), "noise-spectrum-free", context, with_free_curves=False
    )


def _measure(
    session: Session,
    shapes: tuple[PostGainBlur, ...],
    method: str,
    context: Context,
    *,
    with_free_curves: bool,
) -> Result:
    fields = fields_of(method, context)
    chosen = select_flats(session, context)
    if not chosen.pairs:
        left_out = ", ".join(chosen.left_out) or "none"
        reason = f"no flat of two frames or more lies inside the linear range; left out: {left_out}"
        return _refusal(reason, fields)
    spectrum = spectrum_of(chosen, context)
    if not np.mean(spectrum.power_dn2) > 1.001 * np.mean(spectrum.dark_dn2):
        return _refusal(
            "the flats are no noisier than their darks: no light scintillates in them", fields
        )
    context.progress("noise spectrum of the flats", 0.9)
    shown: dict[str, dict[str, Any]] = {"noise-power": noise_power(spectrum)}
    known = readout_of(context)
    peaks = sorted(
        (optimum_under_model(spectrum, known, shape) for shape in shapes),
        key=lambda p: -p.log_weight,
    )
    gained = peaks[0].log_evidence - white_log_probability(peaks[0])
    if gained < THRESHOLDS.min_blur_ln_evidence:
        return _refusal(
            f"the noise is white (evidence of blur exp({gained:.2g})): nothing blurs after the "
            "gain, or the flats are too few to show it",
            fields,
        ) + Result(evidence=shown)
    drawn = _draw_models(peaks, context)
    findings = findings_of(spectrum, chosen, drawn.peaks[0], context)
    rng = np.random.default_rng([context.seed, 21])
    flags = {*misfit(drawn.peaks[0], drawn.posteriors[0], rng), *_chain_flags(drawn)}
    findings += [finding(flag, EFFECTS[flag]) for flag in sorted(flags)]
    # The form that absorbs most of what scattered light would change.
    flexible = max(drawn.peaks, key=lambda peak: peak.point.size)
    forms = ", ".join(
        f"{peak.problem.shape.name} {100 * weight:.0f} %"
        for peak, weight in zip(drawn.peaks, drawn.shares, strict=True)
    )
    common = {
        "notes": (
            NOTE,
            *_notes_of(spectrum, chosen),
            unseen_note(flexible),
            f"form of the transfer: {forms}",
        ),
        "posterior": drawn.posteriors[0],
        **fields,
    }
    result = quantities(spectrum, drawn, common, findings)
    drawn_curves = result.curves
    if with_free_curves:
        free = _draw_models(
            [optimum_under_model(spectrum, known, NonparametricBlur())],
            replace(context, quick=True),
        )
        drawn_curves = {
            **drawn_curves,
            **{f"{name}_free": curve for name, curve in curves(spectrum, free).items()},
        }
    shown["post-gain-noise"] = figure_data(spectrum, drawn)
    return replace(result, curves=drawn_curves, evidence=shown)


def _refusal(reason: str, fields: dict[str, Any]) -> Result:
    return Result(
        measurements=tuple(
            make_refusal("post_gain_mtf50", "cy/px", reason, orientation_deg=angle, **fields)
            for angle in (0.0, 90.0)
        )
    )


def _draw_models(peaks: list[SpectrumOptimum], context: Context) -> SpectrumDraws:
    """Draw from the posteriors of the forms that have a say."""
    weights = weigh_by_evidence(
        [peak.log_weight for peak in peaks], min_weight=THRESHOLDS.min_model_weight
    )
    likely_peaks = tuple(peaks[i] for i, _ in weights)
    posterior_weights = np.array([weight for _, weight in weights])
    posteriors = tuple(
        (
            laplace
            if context.quick
            else partial(sample_posterior, effort=max(weight, THRESHOLDS.min_effort))
        )(
            peak.problem.log_probability,
            names=peak.problem.names,
            units=peak.problem.units,
            start=peak.point,
            covariance=peak.covariance,
            seed=context.seed,
            bounds=peak.problem.bounds,
            draws=DRAWS,
        )
        for peak, weight in zip(
            likely_peaks, posterior_weights / posterior_weights.sum(), strict=True
        )
    )
    return SpectrumDraws(
        peaks=likely_peaks,
        posteriors=posteriors,
        shares=posterior_weights / posterior_weights.sum(),
    )


def _chain_flags(drawn: SpectrumDraws) -> set[str]:
    """Flags of the chains; a bound that only the white floor or a form's exponent reaches is
    physical.
    """
    flags: set[str] = set()
    for peak, posterior in zip(drawn.peaks, drawn.posteriors, strict=True):
        leaning = crowds_at_bound(posterior.draws, peak.problem.bounds)
        blur_indices = [
            peak.problem.names.index(name) for name in ("ln_half_frequency", "ln_anisotropy")
        ]
        flags |= {*posterior.flags} - {"prior-bound"} | (
            {"prior-bound"} if leaning[blur_indices].any() else set()
        )
    return flags
