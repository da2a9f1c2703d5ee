"""Minimum illumination: light at which the SNR of one exposure is 1."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.snr.noise_law import NAMES, UNITS, NoiseLaw, SignalNoiseSeries, noise_law
from charact.noise.snr.stated_illumination import StatedIllumination
from charact.noise.thresholds import SNR
from labdata.measurement import Measurement, Posterior, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

# Defining signal-to-noise ratio.
LEAST_SNR = 1.0
ALTERNATIVE = "the signal is not proportional to the light: an automatic gain or brightness control was active"


@dataclass(frozen=True, kw_only=True)
class Scope:
    """A signal-to-noise ratio of a pixel or an area.

    Parameters
    ----------
    suffix
        Suffix of the quantity names.
    sentence
        Description for notes.
    levels
        Signal and noise.
    law
        Fitted noise law.
    """

    suffix: str
    sentence: str
    levels: SignalNoiseSeries
    law: NoiseLaw


def scope_of(suffix: str, sentence: str, levels: SignalNoiseSeries, reference: int, context: Context) -> Scope:
    """Fit the noise law of a pixel or an area; its read noise is that of the dark of flat `reference`."""
    rng = np.random.default_rng([context.seed, 23, len(suffix)])
    law = noise_law(levels, rng, reference=int(levels.dark[reference]))
    return Scope(suffix=suffix, sentence=sentence, levels=levels, law=law)


def minimum_illumination(
    scope: Scope,
    light: StatedIllumination | str,
    response: Array | None,
    findings: list[Finding],
    *,
    seed: int,
    **fields: Any,
) -> Measurement:
    """Return the light at which the SNR is `LEAST_SNR`, or a refusal.

    Parameters
    ----------
    scope
        Pixel or area.
    light
        Light of the flats, or why it is unknown.
    response
        Draws of the signal per recorded light.
    findings
        Findings of the series.
    seed
        Seed of the error of the light.
    """
    name = f"minimum_illumination{scope.suffix}"
    if isinstance(light, str) or response is None:
        return make_refusal(name, "lux", str(light), **fields)
    if "agc" in flags_of(findings):
        return make_refusal(name, light.unit, ALTERNATIVE, **fields)
    amount = scope.law.signal_at(LEAST_SNR) / response
    reason, farther = _beyond(amount, scope.levels, light)
    if reason is not None:
        return make_refusal(name, light.unit, reason, **fields)
    scale = light.scale(seed, len(amount))
    found = [*findings, *farther, *law_findings(scope.law)]
    unequal = ", unequal pixels counted" if scope.levels.pattern_sd else ""
    sentence = f"signal-to-noise ratio {LEAST_SNR:g} {scope.sentence}{unequal}{_time(light)}"
    notes = (sentence, light.note, *notes_of(found))
    posterior = Posterior(
        names=(*NAMES, "response", "light_scale", name),
        units=(*UNITS, f"DN/{light.unit}", "1", light.unit),
        draws=np.column_stack([scope.law.posterior.draws, response, scale, amount * scale]),
        sampler="laplace",
        seed=seed,
    )
    return measurement_from_draws(
        name, light.unit, amount * scale, flags=flags_of(found), notes=notes, posterior=posterior, **fields
    )


def law_findings(law: NoiseLaw) -> list[Finding]:
    """Return the findings of the noise law."""
    return [] if law.misfit is None else [("model-misfit", law.misfit)]


def _time(light: StatedIllumination) -> str:
    return "" if light.seconds is None else f", light gathered for {light.seconds:.3g} s"


def _beyond(amount: Array, levels: SignalNoiseSeries, light: StatedIllumination) -> tuple[str | None, list[Finding]]:
    """Return the reason to refuse an extrapolation, or None, and the findings of a smaller one."""
    chosen = levels.fitted & levels.lit
    low, high = float(light.amount[chosen].min()), float(light.amount[chosen].max())
    if np.mean(~np.isfinite(amount)) > SNR.max_unreached:
        return f"the ratio may stay below {LEAST_SNR:g} at any light", []
    middle = float(np.median(amount))
    if middle > SNR.max_factor_above * high:
        return f"the ratio stays below {LEAST_SNR:g} up to the brightest flat, {high:.3g} {light.unit}", []
    if middle < low / SNR.max_factor_below:
        return (
            f"it is about {middle:.1g} {light.unit}, too far below the dimmest flat of {low:.3g} {light.unit} to "
            "assume a linear camera response"
        ), []
    if middle > high:
        return None, [("extrapolated", f"the brightest flat has {high:.3g} {light.unit}")]
    if middle < low:
        sentence = f"the dimmest flat has {low:.3g} {light.unit}; below it the camera response is assumed linear"
        return None, [("extrapolated" if middle < low / SNR.interpolation_factor else None, sentence)]
    return None, []
