"""The joint analysis of a gain sweep: the law of its gain, the response to light, and what speaks against either."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.noise.findings import Finding, flag_of, note_of
from charact.noise.gain.single_setting import WIDEST_SHARE
from charact.noise.sweep.excess import correct_saturation
from charact.noise.sweep.gain_law import (
    BENT,
    BENT_ERRORS,
    BLUR,
    DEPARTURE,
    ELECTRON_SHARE,
    Axis,
    GainLaw,
    Gains,
    law_of,
    line_departure,
    weighted_line,
)
from charact.noise.sweep.responsivity import SweepResponsivity, response_of
from charact.noise.sweep.settings import Sweep, SweepSetting

Array = NDArray[np.float64]

# Least rise of the law with the knob that passes for a gain that follows it, by the knob's unit: an exponent, none,
# an exponent, dB per dB.
FOLLOWS = {"V": 1.0, "count": 0.0, "1": 0.5, "dB": 0.5}
# What the errors of settings hold already; and what only adds to the scatter of levels, where there are levels.
ALLOWED = ("quantised",)
IN_THE_SCATTER = ("drift", "flicker")
# Errors off the law, counted with one and a half usual departures, beyond which a setting is no chance.
STRAY_ERRORS = 5.0
STRAY = 1.5 * DEPARTURE


@dataclass(frozen=True, kw_only=True)
class SweepJointFit:
    """What all settings tell together.

    Parameters
    ----------
    sweep
        The settings, their gains at small signals where the plate was seen to tire.
    axis
        Their places.
    law
        Law of the covariance gain.
    lit
        Which settings have their light known in one unit.
    response
        Signal against light at those; None where fewer than two have it.
    findings
        What speaks for or against quantities of all settings.
    """

    sweep: Sweep
    axis: Axis
    law: GainLaw
    lit: tuple[int, ...]
    response: SweepResponsivity | None
    findings: tuple[Finding, ...] = ()

    @property
    def rise(self) -> Array:
        """Draws of the rise of the logarithm of the gain per unit of the knob's place."""
        return self.source.posterior["rise"] / self.axis.span

    @property
    def source(self) -> GainLaw | SweepResponsivity:
        """What the law of the gain is taken from: signal over light, which is the surer, where it is known."""
        return self.law if self.response is None else self.response

    @property
    def responsivity_settings(self) -> tuple[SweepSetting, ...]:
        """The settings of the response."""
        return tuple(self.sweep.settings[i] for i in self.lit)

    @property
    def is_resolved(self) -> bool:
        """Whether the rise stands out of its noise."""
        return bool(np.std(self.rise) <= WIDEST_SHARE * abs(np.median(self.rise)))


def fit_sweep(sweep: Sweep, *, context: Context) -> SweepJointFit:
    """Fit response and law to the settings of a sweep, at least two."""
    axis = Axis.of(sweep.knob.place(np.array([s.value for s in sweep.settings])))
    lit = _lit_indices(sweep.settings)
    response = None
    if len(lit) > 1:
        of_lit = tuple(sweep.settings[i] for i in lit)
        response = response_of(of_lit, axis.x[list(lit)], seed=context.seed + 1, quick=context.quick)
        sweep = replace(sweep, settings=correct_saturation(sweep.settings, lit, response, seed=context.seed))
    gains = _gains(sweep.settings)
    share = _share(sweep, float(gains.covariance.min()), context)
    law = law_of(axis.x, gains, share=share, seed=context.seed, quick=context.quick)
    joint = SweepJointFit(sweep=sweep, axis=axis, law=law, lit=lit, response=response)
    allowed = ALLOWED if response is None else ALLOWED + IN_THE_SCATTER
    own = [(flag_of(one), note_of(one)) for s in sweep.settings for one in s.findings]
    findings: list[Finding] = [(None if flag in allowed else flag, note) for flag, note in own]
    findings += _law_findings(joint)
    return replace(joint, findings=(*findings, *((None, sentence) for sentence in sweep.left_out)))


def _gains(settings: tuple[SweepSetting, ...]) -> Gains:
    """What the noise of every setting tells of its gain."""
    log_gain, sd = np.array([s.log_gain for s in settings]).T
    if settings[0].white:
        return Gains(covariance=log_gain, covariance_sd=sd)
    variance, variance_sd = np.array([(s.log_variance, s.log_variance_sd) for s in settings]).T
    return Gains(covariance=log_gain, covariance_sd=sd, variance=variance, variance_sd=variance_sd)


def _lit_indices(settings: tuple[SweepSetting, ...]) -> tuple[int, ...]:
    """Settings whose light is known in one and the same unit."""
    units = [s.light_unit for s in settings if s.light is not None]
    unit = max(sorted(set(units)), key=units.count) if units else ""
    return tuple(i for i, s in enumerate(settings) if s.light is not None and s.light_unit == unit)


def _share(sweep: Sweep, least: float, context: Context) -> tuple[float, float] | None:
    """Prior of the electrons' own gain over the least covariance gain; None where the knob acts on it, too."""
    if not sweep.knob.tube:
        return None
    if context.sensor is None:
        return 0.0, ELECTRON_SHARE
    known = context.sensor.video.conversion_gain_dn_per_e
    share = float(known) / float(np.exp(least))
    spread = 0.0 if known.low is None or known.high is None else (known.high - known.low) / 3.92 / float(known)
    return share, max(spread, 0.05) * share


def _law_findings(joint: SweepJointFit) -> list[Finding]:
    """What speaks against one law for all settings."""
    knob = joint.sweep.knob
    found: list[Finding] = []
    if len(joint.sweep.settings) < 3:
        found.append(("too-few-frames", "only 2 settings: that the law holds between them is taken on trust"))
    found += [(flag, "see the posterior") for flag in joint.law.posterior.flags + joint.source.posterior.flags]
    found += _curvature_findings(joint) + _outlier_findings(joint) + _blur_findings(joint)
    if np.quantile(joint.rise, 0.975) < FOLLOWS[knob.unit]:
        found.append(("agc", f"the gain does not follow the {knob.words}: something else holds it"))
    return found


def _curvature_findings(joint: SweepJointFit) -> list[Finding]:
    """Whether the law is no straight line, from the gain that is known best."""
    x, log_gain, sd = _own_gains(joint)
    told = line_departure(x, log_gain, sd)
    if told is None or abs(told[0]) <= BENT_ERRORS * told[1]:
        return []
    leaves, slope = told[0], weighted_line(x, log_gain, sd)[1] / joint.axis.span
    ends = [slope + side * 8.0 * leaves / joint.axis.span for side in (-1.0, 1.0)]
    words = f"from {ends[0]:.3g} at the lowest setting to {ends[1]:.3g} at the highest"
    flag = "nonlinear" if abs(leaves) > BENT else None
    return [(flag, f"the law of the gain is bent by {100 * abs(leaves):.1f} %: its slope goes {words}")]


def _own_gains(joint: SweepJointFit) -> tuple[Array, Array, Array]:
    """Places of settings, the logarithms of their own gains without the law, and their errors."""
    if joint.response is not None:
        return joint.axis.x[list(joint.lit)], joint.response.own, joint.response.own_sd
    own = np.log(joint.law.pulses)
    # Blur and electrons in common move all settings together, which bends no law.
    away = own - own.mean(axis=1, keepdims=True)
    return joint.axis.x, np.median(own, axis=0), np.std(away, axis=0)


def _outlier_findings(joint: SweepJointFit) -> list[Finding]:
    """Settings that lie off the law by more than departures and noise allow."""
    found: list[Finding] = []
    x, own, sd = _own_gains(joint)
    law = np.polyval(np.polyfit(x, own, 1, w=1.0 / np.hypot(sd, STRAY)), x)
    for value, off, error in zip(_places(joint), own - law, sd, strict=True):
        if abs(off) > STRAY_ERRORS * np.hypot(error, STRAY):
            text = f"the gain at {joint.sweep.knob.text(value)} is {np.exp(off):.2f} times that of the law"
            found.append(("model-misfit", text))
    return found


def _places(joint: SweepJointFit) -> list[float]:
    """Values of the settings whose own gains are known best."""
    settings = joint.sweep.settings if joint.response is None else joint.responsivity_settings
    return [s.value for s in settings]


def _blur_findings(joint: SweepJointFit) -> list[Finding]:
    """Settings whose blur is not that of the others."""
    if joint.sweep.settings[0].white:
        return []
    settings = joint.sweep.settings
    own = np.log([float(np.median(s.blur_factor)) for s in settings])
    sd = np.array([float(np.std(np.log(np.maximum(s.blur_factor, 1e-6)))) for s in settings])
    unsure = [s.unsure_dn / np.exp(s.log_variance) for s in settings]
    sd = np.hypot(np.hypot(sd, unsure), BLUR)
    # At low gain the electrons' white noise adds to the variance.
    electrons = np.median(joint.law.electron_gain_dn[:, None] / joint.law.settings, axis=0)
    left = np.exp(float(np.median(joint.law.posterior["log_blur"])))
    expected = np.log1p(electrons * (1.0 - left) / left)
    expected = expected + np.average(own - expected, weights=1.0 / sd**2)
    return [
        ("model-misfit", f"at {joint.sweep.knob.text(s.value)} the blur factor is {np.exp(o):.3g}, not {np.exp(e):.3g}")
        for s, o, e, error in zip(settings, own, expected, sd, strict=True)
        if abs(o - e) > STRAY_ERRORS * error
    ]
