"""Minimum illumination: the light at which the signal is as large as the noise of one exposure."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.findings import Finding, flags_of, notes_of
from charact.noise.snr.noise_law import NAMES, UNITS, NoiseLaw, SignalNoiseSeries, noise_law
from charact.noise.snr.stated_illumination import StatedIllumination
from labdata.measurement import Measurement, Posterior, make_refusal, measurement_from_draws

Array = NDArray[np.float64]

# The signal-to-noise ratio that defines it.
LEAST_SNR = 1.0
# The dark is a level as well, of no light and measured noise: between it and the dimmest flat the law is interpolated
# as long as a tenth of that flat's light is left. Farther below the dimmest flat, or above the brightest, than by the
# other factors no light is stated.
INTERPOLATED_BELOW, FARTHEST_BELOW, FARTHEST_ABOVE = 10.0, 100.0, 2.0
# Share of the draws that may not reach the ratio at any light.
NEVER_SHARE = 0.01
ALTERNATIVE = "the signal does not follow the light: an automatic gain or brightness control was at work"


@dataclass(frozen=True, kw_only=True)
class Scope:
    """What a ratio is stated for: a pixel or an area.

    Parameters
    ----------
    suffix
        What the names of its quantities end in.
    sentence
        What a note says of it.
    levels
        Signal and noise.
    law
        The law fitted to them.
    """

    suffix: str
    sentence: str
    levels: SignalNoiseSeries
    law: NoiseLaw


def scope_of(suffix: str, sentence: str, levels: SignalNoiseSeries, reference: int, context: Context) -> Scope:
    """Fit the law of a pixel or of an area; the read noise is that of the dark of the flat `reference`."""
    rng = np.random.default_rng([context.seed, 23, len(suffix)])
    law = noise_law(levels, rng, reference=int(levels.dark[reference]))
    return Scope(suffix=suffix, sentence=sentence, levels=levels, law=law)


def minimum_illumination(scope: Scope, light: StatedIllumination | str, response: Array | None, findings: list[Finding], *, seed: int,
            **fields: Any) -> Measurement:  # fmt: skip
    """Return the light at which signal over noise is `LEAST_SNR`, or why it is not known.

    Parameters
    ----------
    scope
        Pixel or area.
    light
        The light of the flats, or why it is not known.
    response
        Draws of the signal per light as recorded.
    findings
        What is wrong with the series.
    seed
        Seed of the light's own error.
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
    """What the fit of the law says against it."""
    return [] if law.misfit is None else [("model-misfit", law.misfit)]


def _time(light: StatedIllumination) -> str:
    return "" if light.seconds is None else f", light gathered for {light.seconds:.3g} s"


def _beyond(amount: Array, levels: SignalNoiseSeries, light: StatedIllumination) -> tuple[str | None, list[Finding]]:
    """Why no light is stated so far from the levels, or None; and the flag of one that lies not quite so far."""
    chosen = levels.fitted & levels.lit
    low, high = float(light.amount[chosen].min()), float(light.amount[chosen].max())
    if np.mean(~np.isfinite(amount)) > NEVER_SHARE:
        return f"the ratio may stay below {LEAST_SNR:g} at any light", []
    middle = float(np.median(amount))
    if middle > FARTHEST_ABOVE * high:
        return f"the ratio stays below {LEAST_SNR:g} up to the brightest flat, {high:.3g} {light.unit}", []
    if middle < low / FARTHEST_BELOW:
        return (
            f"it lies at about {middle:.1g} {light.unit}, too far below the dimmest flat of {low:.3g} {light.unit} for "
            "a straight response to be taken for granted"
        ), []
    if middle > high:
        return None, [("extrapolated", f"the brightest flat has {high:.3g} {light.unit}")]
    if middle < low:
        sentence = f"the dimmest flat has {low:.3g} {light.unit}; below it the response is taken for straight"
        return None, [("extrapolated" if middle < low / INTERPOLATED_BELOW else None, sentence)]
    return None, []
