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
from charact.mtf.noise_spectrum.checks import findings_of, misfit
from charact.mtf.noise_spectrum.data import Chosen, chosen_of, spectrum_of
from charact.mtf.noise_spectrum.folding import Shape
from charact.mtf.noise_spectrum.free import FreeForm
from charact.mtf.noise_spectrum.model import FAMILIES, Peak, known_of, peak_of, white_log_probability
from charact.mtf.noise_spectrum.result import DRAWS, Drawn, curves, evidence, quantities
from charact.mtf.noise_spectrum.unseen import note as unseen_note
from charact.noise.provenance import provenance
from charact.posterior import draw, laplace
from labdata.measurement import Result, refused
from labdata.session import Session

Array = NDArray[np.float64]

KIND = "post-gain"
NOTE = "MTF of what comes after the gain (screen, taper, chip, video): lens and cathode gap are not in it"
# Evidence, in ln, by which a blurred spectrum must beat a white one.
LEAST_EVIDENCE = 8.0
# Forms of less than this share of the weight take no part.
LEAST_WEIGHT = 0.02
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
    return _measured(session, FAMILIES, "noise-spectrum", context, beside=True)


@register(
    KIND,
    "noise-spectrum-free",
    quantities=QUANTITIES,
    scope="As noise-spectrum, for blur of any smooth falling form; intervals are wider.",
)
def noise_spectrum_free(session: Session, *, context: Context) -> Result:
    """Measure the MTF after the gain as a free smooth function; returns as `noise_spectrum`."""
    return _measured(session, (FreeForm(),), "noise-spectrum-free", context, beside=False)


def _measured(session: Session, shapes: tuple[Shape, ...], method: str, context: Context, *, beside: bool) -> Result:
    fields: dict[str, Any] = {"method": method, "provenance": provenance(context)}
    chosen = chosen_of(session, context)
    reason = _too_little(chosen)
    if reason is not None:
        return _refusal(reason, fields)
    spectrum = spectrum_of(session, chosen, context)
    if not np.mean(spectrum.power_dn2) > 1.001 * np.mean(spectrum.dark_dn2):
        return _refusal("the flats are no noisier than their darks: no light scintillates in them", fields)
    context.progress("noise spectrum of the flats", 0.9)
    known = known_of(context)
    peaks = sorted((peak_of(spectrum, known, shape) for shape in shapes), key=lambda p: -p.log_weight)
    gained = peaks[0].log_evidence - white_log_probability(peaks[0])
    if gained < LEAST_EVIDENCE:
        return _refusal(
            f"the noise is white (evidence of blur exp({gained:.2g})): nothing blurs after the gain, or the flats are "
            "too few to show it",
            fields,
        )  # fmt: skip
    found = _drawn(peaks, context)
    flags, notes = findings_of(spectrum, chosen, found.peaks[0], context)
    wrong = misfit(found.peaks[0], found.posteriors[0], np.random.default_rng([context.seed, 21]))
    own = {
        "flags": tuple({*flags, *wrong, *_of_chain(found)}),
        "notes": (NOTE, *notes, unseen_note(_freest(found)), f"form of the transfer: {_forms(found)}"),
        "posterior": found.posteriors[0], **fields,
    }  # fmt: skip
    result = quantities(spectrum, found, own)
    drawn_curves = result.curves
    if beside:
        free = _drawn([peak_of(spectrum, known, FreeForm())], _quickly(context))
        drawn_curves = {**drawn_curves, **{f"{name}_free": curve for name, curve in curves(spectrum, free).items()}}
    return replace(result, curves=drawn_curves, evidence={"post-gain-noise": evidence(spectrum, found)})


def _too_little(chosen: Chosen) -> str | None:
    if chosen.pairs:
        return None
    left = ", ".join(chosen.left_out) or "none"
    return f"no flat of two frames or more lies inside the linear range; left out: {left}"


def _refusal(reason: str, fields: dict[str, Any]) -> Result:
    return Result(
        measurements=tuple(
            refused("post_gain_mtf50", "cy/px", reason, orientation_deg=angle, **fields) for angle in (0.0, 90.0)
        )
    )


def _quickly(context: Context) -> Context:
    return replace(context, quick=True)


def _drawn(peaks: list[Peak], context: Context) -> Drawn:
    """Draw from the posteriors of the forms that have a say."""
    height = np.array([peak.log_weight for peak in peaks])
    share = np.exp(height - height.max())
    kept = share / share.sum() > LEAST_WEIGHT
    share = share[kept] / share[kept].sum()
    own = [peak for peak, keep in zip(peaks, kept, strict=True) if keep]
    posteriors = tuple(
        (laplace if context.quick else draw)(
            peak.problem.log_probability, names=peak.problem.names, units=peak.problem.units, start=peak.point,
            covariance=peak.covariance, seed=context.seed, bounds=peak.problem.bounds, draws=DRAWS,
        )
        for peak in own
    )  # fmt: skip
    return Drawn(peaks=tuple(own), posteriors=posteriors, shares=share)


def _freest(found: Drawn) -> Peak:
    """The form that takes up most of what scattered light would change."""
    return max(found.peaks, key=lambda peak: peak.point.size)


def _forms(found: Drawn) -> str:
    return ", ".join(
        f"{peak.problem.shape.name} {100 * share:.0f} %" for peak, share in zip(found.peaks, found.shares, strict=True)
    )


def _of_chain(found: Drawn) -> tuple[str, ...]:
    """Flags of the chains; a wall that only the white floor or a form's exponent leans on is physics, no lack."""
    from charact.posterior.diagnostics import leans_on_bound

    flags: set[str] = set()
    for peak, posterior in zip(found.peaks, found.posteriors, strict=True):
        flags |= set(posterior.flags) - {"prior-bound"}
        leaning = leans_on_bound(posterior.draws, peak.problem.bounds)
        if leaning[peak.problem.names.index("ln_half_frequency")] or leaning[peak.problem.names.index("ln_anisotropy")]:
            flags.add("prior-bound")
    return tuple(flags)
