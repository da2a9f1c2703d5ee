"""MTF of what comes after the gain, from the noise of flats: no target is needed.

Scintillations are points of light that the tube itself makes: the power of their noise is the square of the transfer
of the screen, taper, chip and video. Lens and cathode gap, which move photoelectrons about before the gain, do not
show.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context, register
from charact.mtf.noise_spectrum.aliasing import PostGainBlur
from charact.mtf.noise_spectrum.checks import findings_of, misfit
from charact.mtf.noise_spectrum.model import (
    FAMILIES,
    SpectrumOptimum,
    optimum_under_model,
    readout_of,
    white_log_probability,
)
from charact.mtf.noise_spectrum.nonparametric_blur import NonparametricBlur
from charact.mtf.noise_spectrum.pooled_spectrum import SelectedFlats, select_flats, spectrum_of
from charact.mtf.noise_spectrum.result import DRAWS, SpectrumDraws, curves, figure_data, quantities
from charact.mtf.noise_spectrum.undetected_scatter import note as unseen_note
from charact.noise.provenance import provenance
from charact.posterior import laplace, sample_posterior
from labdata.measurement import Result, make_refusal
from labdata.session import Session

Array = NDArray[np.float64]

KIND = "post-gain"
NOTE = "MTF of what comes after the gain (screen, taper, chip, video): lens and cathode gap are not in it"
# Evidence, in ln, by which a blurred spectrum must beat a white one.
MIN_EVIDENCE = 8.0
# Forms of less than this share of the weight take no part.
MIN_WEIGHT = 0.02
QUANTITIES = ("post_gain_mtf50", "post_gain_mtf", "white_noise_share")


@register(
    KIND,
    "noise-spectrum",
    quantities=QUANTITIES,
    scope="Darks and flats of two levels and more, 4 frames each, some 100 x 100 px, of a camera that blurs after its "
    "gain to f2 = 0.08 to 0.4 cy/px; light scattered after the gain beyond that blur is not counted: a note says how "
    "much of it would not show. A curved response shows where levels of more than a photoelectron a pixel differ.",
)
def noise_spectrum(session: Session, *, context: Context) -> Result:
    """Measure the MTF after the gain with forms of the transfer, averaged by their evidence.

    Returns
    -------
    Result
        `post_gain_mtf50` and `post_gain_mtf` at pinned frequencies along rows (0 deg) and columns (90 deg),
        `white_noise_share`; curves "mtf_post_gain" and "mtf_post_gain_vertical", and the model-free ones beside them.

    Notes
    -----
    Power of the noise: white floor + k F^2 mu |H|^2, folded by sampling, fitted by Whittle's likelihood. See
    `charact.mtf.noise_spectrum.model`.
    """
    return _measure(session, FAMILIES, "noise-spectrum", context, beside=True)


@register(
    KIND,
    "noise-spectrum-free",
    quantities=QUANTITIES,
    scope="As noise-spectrum, for blur of any smooth falling form; intervals are wider.",
)
def noise_spectrum_free(session: Session, *, context: Context) -> Result:
    """Measure the MTF after the gain as a free smooth function; returns as `noise_spectrum`."""
    return _measure(session, (NonparametricBlur(),), "noise-spectrum-free", context, beside=False)


def _measure(
    session: Session, shapes: tuple[PostGainBlur, ...], method: str, context: Context, *, beside: bool
) -> Result:
    fields: dict[str, Any] = {"method": method, "provenance": provenance(context)}
    chosen = select_flats(session, context)
    reason = _selection_refusal(chosen)
    if reason is not None:
        return _refusal(reason, fields)
    spectrum = spectrum_of(session, chosen, context)
    if not np.mean(spectrum.power_dn2) > 1.001 * np.mean(spectrum.dark_dn2):
        return _refusal("the flats are no noisier than their darks: no light scintillates in them", fields)
    context.progress("noise spectrum of the flats", 0.9)
    known = readout_of(context)
    peaks = sorted((optimum_under_model(spectrum, known, shape) for shape in shapes), key=lambda p: -p.log_weight)
    gained = peaks[0].log_evidence - white_log_probability(peaks[0])
    if gained < MIN_EVIDENCE:
        return _refusal(
            f"the noise is white (evidence of blur exp({gained:.2g})): nothing blurs after the gain, or the flats are "
            "too few to show it",
            fields,
        )  # fmt: skip
    found = _draw_models(peaks, context)
    flags, notes = findings_of(spectrum, chosen, found.peaks[0], context)
    wrong = misfit(found.peaks[0], found.posteriors[0], np.random.default_rng([context.seed, 21]))
    own = {
        "flags": tuple({*flags, *wrong, *_chain_flags(found)}),
        "notes": (NOTE, *notes, unseen_note(_most_flexible(found)), f"form of the transfer: {_forms(found)}"),
        "posterior": found.posteriors[0], **fields,
    }  # fmt: skip
    result = quantities(spectrum, found, own)
    drawn_curves = result.curves
    if beside:
        free = _draw_models([optimum_under_model(spectrum, known, NonparametricBlur())], _quick(context))
        drawn_curves = {**drawn_curves, **{f"{name}_free": curve for name, curve in curves(spectrum, free).items()}}
    return replace(result, curves=drawn_curves, evidence={"post-gain-noise": figure_data(spectrum, found)})


def _selection_refusal(chosen: SelectedFlats) -> str | None:
    if chosen.pairs:
        return None
    left = ", ".join(chosen.left_out) or "none"
    return f"no flat of two frames or more lies inside the linear range; left out: {left}"


def _refusal(reason: str, fields: dict[str, Any]) -> Result:
    return Result(
        measurements=tuple(
            make_refusal("post_gain_mtf50", "cy/px", reason, orientation_deg=angle, **fields) for angle in (0.0, 90.0)
        )
    )


def _quick(context: Context) -> Context:
    return replace(context, quick=True)


def _draw_models(peaks: list[SpectrumOptimum], context: Context) -> SpectrumDraws:
    """Draw from the posteriors of the forms that have a say."""
    height = np.array([peak.log_weight for peak in peaks])
    share = np.exp(height - height.max())
    kept = share / share.sum() > MIN_WEIGHT
    share = share[kept] / share[kept].sum()
    own = [peak for peak, keep in zip(peaks, kept, strict=True) if keep]
    posteriors = tuple(
        (laplace if context.quick else sample_posterior)(
            peak.problem.log_probability, names=peak.problem.names, units=peak.problem.units, start=peak.point,
            covariance=peak.covariance, seed=context.seed, bounds=peak.problem.bounds, draws=DRAWS,
        )
        for peak in own
    )  # fmt: skip
    return SpectrumDraws(peaks=tuple(own), posteriors=posteriors, shares=share)


def _most_flexible(found: SpectrumDraws) -> SpectrumOptimum:
    """The form that takes up most of what scattered light would change."""
    return max(found.peaks, key=lambda peak: peak.point.size)


def _forms(found: SpectrumDraws) -> str:
    return ", ".join(
        f"{peak.problem.shape.name} {100 * share:.0f} %" for peak, share in zip(found.peaks, found.shares, strict=True)
    )


def _chain_flags(found: SpectrumDraws) -> tuple[str, ...]:
    """Flags of the chains; a wall that only the white floor or a form's exponent leans on is physics, no lack."""
    from charact.posterior.diagnostics import crowds_at_bound

    flags: set[str] = set()
    for peak, posterior in zip(found.peaks, found.posteriors, strict=True):
        flags |= set(posterior.flags) - {"prior-bound"}
        leaning = crowds_at_bound(posterior.draws, peak.problem.bounds)
        if leaning[peak.problem.names.index("ln_half_frequency")] or leaning[peak.problem.names.index("ln_anisotropy")]:
            flags.add("prior-bound")
    return tuple(flags)
