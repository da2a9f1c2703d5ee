"""One MTF fitted to all targets of a session: edges, bars, points, and the noise of flats as a bound."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import charact
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.mtf.blur_models.one_dimensional import Core, HaloComponent
from charact.mtf.curve import FINE, PINNED, REPORTED, crossing_frequency, curve_of
from charact.mtf.known_transfer import halo_diameters_px
from charact.mtf.session.constraints import MtfConstraint, constraints_from
from charact.mtf.session.joint_fit import ConsistencyTest, JointFit, JointLikelihood, consistency_test, fit_joint_model
from charact.mtf.session.joint_model import JointBlurModel, KnownCameraTransfer
from charact.posterior import importance_sample, sample_posterior
from labdata.measurement import Measurement, Posterior, Provenance, Result, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

METHOD = "joint"
# A form this much less probable than the best, as a share, adds nothing to the draws.
MIN_FRACTION = 0.02
DRAWS = 1000
# Steps of a Markov chain, where weighted draws are too few.
MAX_STEPS = 3000
# Chance below which targets lie outside their joint 95 % region, and below which one MTF is not believed.
OUTSIDE, MISFIT = 0.05, 0.01
# Targets within this of the rows' or columns' direction tell of it, degrees.
NEAR_DEG = 30.0
CORES: tuple[tuple[Core, bool], ...] = (
    ("gaussian", False), ("exponential", False), ("moffat", False), ("exponential", True),
)  # fmt: skip
NATURAL_BOUNDS = ("blur_px2", "halo_fraction", "halo_elastic_share", "moffat_exponent", "halo_diameter_px")


@dataclass(frozen=True, kw_only=True)
class JointMtf:
    """All that a joint fit found: forms with their share of the evidence and draws, and the test of the best."""

    fits: Sequence[JointFit]
    shares: Array
    posteriors: Sequence[Posterior]
    verdict: ConsistencyTest

    def mtf(self, frequency: Array, vertical: bool) -> Array:
        """Return drawn MTFs along rows or along columns, cycles per column pitch, shape (draw, f)."""
        none = np.zeros_like(frequency)
        fx, fy = (none, frequency) if vertical else (frequency, none)
        return np.concatenate([
            fit.problem.form.transfer(posterior.draws[: max(1, round(DRAWS * share))], fx, fy)
            for fit, posterior, share in zip(self.fits, self.posteriors, self.shares, strict=True)
        ])  # fmt: skip


@with_timing
def fit_joint_mtf(result: Result, kinds: Mapping[str, str], *, context: Context) -> Result:
    """Fit one MTF to what all targets of a session told and test whether they told of one.

    Parameters
    ----------
    result
        Measurements and curves of one session; only sound (ok) ones are used.
    kinds
        Kind of each stack ("edge", "bars", "point") by its label.
    context
        Seed, whether a Markov chain may be run, and the camera. Without a description of an intensifier no halo is
        looked for.

    Returns
    -------
    Result
        `mtf50`, `mtf10` and `mtf` at pinned frequencies, method "joint" and no stack, along each of rows (0 deg) and
        columns (90 deg) of which targets tell; curves "mtf_joint" and "mtf_joint_vertical"; evidence "joint MTF".
        All frequencies are cycles per column pitch. Empty where fewer than two targets are sound.

    Notes
    -----
    Likelihood normal in the principal components of each target's curve and in each bar group's value. The draws are
    those of every form of the core in proportion to its evidence (Laplace). Where chi squared of all targets has a
    chance under 0.05 a note says so and names the one that differs most; under 0.01 the flag is `model-misfit`.
    """
    sound, bounds = constraints_from(result, kinds, context)
    if len({one.target for one in sound}) < 2:
        return Result()
    found = _fit_and_draw(sound, bounds, context)
    common = {
        "method": METHOD,
        "flags": _flags(found),
        "notes": _notes(found),
        "provenance": Provenance(
            version=charact.__version__,
            seed=context.seed,
            settings={"quick": context.quick, "forms": _forms(found), "targets": list(found.verdict.targets)},
        ),
    }
    measurements: list[Measurement] = []
    curves = {}
    for vertical in _directions(sound):
        own = {**common, "orientation_deg": 90.0 if vertical else 0.0}
        fine = found.mtf(FINE, vertical)
        measurements += [
            _crossing_frequency(name, level, fine, found, own) for name, level in (("mtf50", 0.5), ("mtf10", 0.1))
        ]
        pinned = found.mtf(np.array(PINNED), vertical)
        measurements += [
            measurement_from_draws("mtf", "1", values, frequency_cy_per_px=frequency, **own)
            for frequency, values in zip(PINNED, pinned.T, strict=True)
        ]
        name = "mtf_joint_vertical" if vertical else "mtf_joint"
        curves[name] = curve_of(REPORTED, found.mtf(np.maximum(REPORTED, 1e-6), vertical))
    return Result(
        measurements=tuple(measurements),
        curves=curves,
        evidence={"joint MTF": _figure_data(found, sound)},
    )


def _directions(sound: Sequence[MtfConstraint]) -> list[bool]:
    """Whether rows (False) and columns (True) have targets that tell of them."""
    off = np.concatenate([np.abs((np.rad2deg(one.angle_rad) + 90.0) % 180.0 - 90.0) for one in sound])
    ways = [way for way, tells in ((False, np.any(off < NEAR_DEG)), (True, np.any(off > 90.0 - NEAR_DEG))) if tells]
    return ways or [False]


def _fit_and_draw(sound: Sequence[MtfConstraint], bounds: Sequence[MtfConstraint], context: Context) -> JointMtf:
    """Fit every form and draw from those that the data leave open."""
    elliptical = len(_directions(sound)) == 2
    known = KnownCameraTransfer.of(context)
    wide = _halo(sound, context)
    forms = [JointBlurModel(core=core, blurred=blurred, wide=wide, elliptical=elliptical, known=known)
             for core, blurred in CORES]  # fmt: skip
    fits = [fit_joint_model(JointLikelihood(form=form, told=sound, bounds=bounds)) for form in forms]
    fits.sort(key=lambda fit: -fit.log_evidence)
    shares = np.exp([fit.log_evidence - fits[0].log_evidence for fit in fits])
    shares /= shares.sum()
    kept = shares > MIN_FRACTION
    fits, shares = [fit for fit, keep in zip(fits, kept, strict=True) if keep], shares[kept] / shares[kept].sum()
    posteriors = [_posterior(fit, context, context.seed + number) for number, fit in enumerate(fits)]
    return JointMtf(fits=fits, shares=shares, posteriors=posteriors, verdict=consistency_test(fits[0]))


def _halo(sound: Sequence[MtfConstraint], context: Context) -> HaloComponent | None:
    """A described intensifier has a halo, which counts where a target saw all of it."""
    if context.sensor is None or all(one.within for one in sound):
        return None
    return HaloComponent(size_px=halo_diameters_px(context, transposed=False))


def _posterior(fit: JointFit, context: Context, seed: int) -> Posterior:
    """Draw from one form's posterior, by importance before a Markov chain.

    Two blurs in a row can be traded for each other along a bent ridge, of which the curvature knows the middle only,
    and along which a Markov chain is slow.
    """
    form = fit.problem.form
    asked = {
        "names": tuple(form.parameters),
        "units": tuple(unit for unit, _ in form.parameters.values()),
        "start": fit.point,
        "covariance": fit.covariance,
        "seed": seed,
        "bounds": form.bounds,
        "draws": DRAWS,
    }
    if context.quick:
        return importance_sample(fit.problem.log_probability, **asked)
    return sample_posterior(fit.problem.log_probability, **asked, max_steps=MAX_STEPS)


def _flags(found: JointMtf) -> tuple[str, ...]:
    """What is distrusted; a bound that nature sets, no halo or electrons all elastic, is one to lean on."""
    from charact.posterior.diagnostics import crowds_at_bound

    flags = {flag for posterior in found.posteriors for flag in posterior.flags if flag != "prior-bound"}
    for fit, posterior in zip(found.fits, found.posteriors, strict=True):
        chosen = np.array([name not in NATURAL_BOUNDS for name in posterior.names])
        if crowds_at_bound(posterior.draws, fit.problem.form.bounds)[chosen].any():
            flags.add("prior-bound")
    if found.verdict.probability < MISFIT or min(found.verdict.leave_one_out_p_value) < MISFIT / len(
        found.verdict.targets
    ):
        flags.add("model-misfit")
    return tuple(flags)


def _notes(found: JointMtf) -> tuple[str, ...]:
    test = found.verdict
    notes = [f"Fitted to what {', '.join(dict.fromkeys(test.targets))} told; form of the spread: {_forms(found)}."]
    if test.probability < OUTSIDE:
        notes.append(
            f"The targets lie outside their joint 95 % region (chi squared {test.chi2:.1f} for {test.freedom:.1f} "
            f"degrees of freedom, chance {test.probability:.2g}); {test.most_deviating} differs most from the others."
        )
    return tuple(notes)


def _forms(found: JointMtf) -> str:
    named = zip(found.fits, found.shares, strict=True)
    return ", ".join(f"{fit.problem.form.name} {100 * share:.0f} %" for fit, share in named)


def _crossing_frequency(quantity: str, level: float, fine: Array, found: JointMtf, common: dict) -> Measurement:
    """Return the frequency at which the MTF falls to a level; refused where it does not below the last one."""
    draws = crossing_frequency(FINE, fine, level)
    known = np.isfinite(draws)
    if np.mean(~known) > 0.02:
        lost = 100 * np.mean(~known)
        reason = f"the MTF must fall to {level:g} below {FINE[-1]:.1f} cy/px, and {lost:.0f} % of its draws do not"
        return make_refusal(quantity, "cy/px", reason, **common)
    return measurement_from_draws(quantity, "cy/px", draws[known], posterior=found.posteriors[0], **common)


def _figure_data(found: JointMtf, sound: Sequence[MtfConstraint]) -> dict:
    test = found.verdict
    kinds = {one.target: one.kind for one in sound}
    return {
        "figure": "joint-mtf",
        "counts_halo": found.fits[0].problem.form.wide is not None,
        "target": list(test.targets),
        "kind": [kinds.get(target, "noise spectrum") for target in test.targets],
        "values": list(test.values),
        "residuals_sd": [list(one) for one in test.residuals],
        "apart_chi_squared": list(test.leave_one_out_chi2),
        "apart_probability": list(test.leave_one_out_p_value),
        "chi_squared": test.chi2,
        "degrees_of_freedom": test.freedom,
        "probability": test.probability,
        "inside_joint_95_percent_region": bool(test.probability >= OUTSIDE),
        "differs_most": test.most_deviating,
        "forms": {fit.problem.form.name: float(share) for fit, share in zip(found.fits, found.shares, strict=True)},
    }
