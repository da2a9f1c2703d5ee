"""Joint fit of a gain sweep: gain law, responsivity, findings."""

from dataclasses import dataclass, replace

import numpy as np

from charact.estimators.noise.findings import Remarks, finding, posterior_findings
from charact.estimators.noise.sweep.gain_law import Axis, GainLaw, law_of, line_departure, line_fit
from charact.estimators.noise.sweep.responsivity import (
    SweepResponsivity,
    correct_saturation,
    response_of,
)
from charact.estimators.noise.sweep.settings import Sweep, SweepSetting
from charact.estimators.noise.thresholds import GAIN, SWEEP
from charact.method import Context
from charact.verdict import Finding
from labdata import Array
from labdata.camera.description import has_tube

# Smallest slope of the gain law of a working control, by its unit: exponent, none, exponent, dB per
# dB.
FOLLOWS = {"V": 1.0, "count": 0.0, "1": 0.5, "dB": 0.5}
# Flags covered by the errors of settings; and flags that only add to the scatter of levels.
ALLOWED = ("quantised",)
IN_THE_SCATTER = ("drift", "flicker")
STRAY = 1.5 * SWEEP.departure


@dataclass(frozen=True, kw_only=True)
class SweepJointFit:
    """Joint fit of all settings."""

    # the settings, with gains corrected to small signals if MCP saturation was measured
    sweep: Sweep
    axis: Axis  # positions of the settings
    law: GainLaw  # law of the covariance gain
    lit: tuple[int, ...]  # indices of settings with light in one unit
    response: SweepResponsivity | None  # responsivity of those settings; None for fewer than two
    remarks: tuple[Finding | str, ...] = ()  # what concerns quantities of all settings

    @property
    def rise(self) -> Array:
        """Draws of the slope of ln gain per unit of the control's position."""
        return self.source.posterior["rise"] / self.axis.span

    def setting_at(self, position: Array) -> Array:
        """Return the values of the control at positions on the axis."""
        return self.sweep.knob.value(self.axis.middle + self.axis.span * position)

    @property
    def source(self) -> GainLaw | SweepResponsivity:
        """Source of the gain law: responsivity, which is more precise, if available."""
        return self.law if self.response is None else self.response

    @property
    def responsivity_settings(self) -> tuple[SweepSetting, ...]:
        """Settings of the responsivity fit."""
        return tuple(self.sweep.settings[i] for i in self.lit)

    @property
    def is_resolved(self) -> bool:
        """Whether the slope is significant."""
        return bool(np.std(self.rise) <= GAIN.max_relative_sd * abs(np.median(self.rise)))


def fit_sweep(sweep: Sweep, *, context: Context) -> SweepJointFit:
    """Fit responsivity and gain law to the settings of a sweep, at least two."""
    axis = Axis.of(sweep.knob.place(np.array([s.value for s in sweep.settings])))
    # Settings with light in the most frequent unit.
    units = [s.light_unit for s in sweep.settings if s.light is not None]
    unit = max(sorted(set(units)), key=units.count) if units else ""
    lit = tuple(
        i for i, s in enumerate(sweep.settings) if s.light is not None and s.light_unit == unit
    )
    response = None
    if len(lit) > 1:
        of_lit = tuple(sweep.settings[i] for i in lit)
        response = response_of(
            of_lit, axis.x[list(lit)], seed=context.seed + 1, quick=context.quick
        )
        sweep = replace(
            sweep, settings=correct_saturation(sweep.settings, lit, response, seed=context.seed)
        )
    gains, sd = np.array([s.log_gain for s in sweep.settings]).T
    variance = None
    if not sweep.settings[0].white:
        variance = tuple(np.array([(s.log_variance, s.log_variance_sd) for s in sweep.settings]).T)
    electron_share = _share(sweep, float(gains.min()), context)
    law = law_of(
        axis.x,
        (gains, sd),
        variance,
        electron_share=electron_share,
        seed=context.seed,
        quick=context.quick,
    )
    joint = SweepJointFit(sweep=sweep, axis=axis, law=law, lit=lit, response=response)
    allowed = ALLOWED if response is None else ALLOWED + IN_THE_SCATTER
    remarks = [
        entry.note if entry.flag in allowed else entry
        for s in sweep.settings
        for entry in s.findings
    ]
    return replace(joint, remarks=(*remarks, *_law_remarks(joint), *sweep.left_out))


def _share(sweep: Sweep, log_smallest_gain: float, context: Context) -> tuple[float, float] | None:
    """Return the prior of the electron gain over the smallest covariance gain; None if the control
    changes it.
    """
    if not sweep.knob.tube:
        return None
    if not has_tube(context.camera):
        return 0.0, SWEEP.electron_fraction
    known = context.camera.video.conversion_gain_dn_per_e
    electron_share = float(known) / float(np.exp(log_smallest_gain))
    spread = (
        0.0
        if known.low is None or known.high is None
        else (known.high - known.low) / 3.92 / float(known)
    )
    return electron_share, max(spread, 0.05) * electron_share


def _law_remarks(joint: SweepJointFit) -> Remarks:
    """Return what speaks against one law for all settings."""
    knob = joint.sweep.knob
    remarks: Remarks = []
    if len(joint.sweep.settings) < 3:
        effect = "only 2 settings: the law between them cannot be checked"
        remarks.append(finding("too-few-frames", effect, "flats at a third setting"))
    remarks += posterior_findings(joint.law.posterior) + posterior_findings(joint.source.posterior)
    remarks += _curvature(joint) + _outlier_findings(joint) + _blur_findings(joint)
    if np.quantile(joint.rise, 0.975) < FOLLOWS[knob.unit]:
        effect = f"the gain does not follow the {knob.words}: possible automatic control"
        remarks.append(finding("agc", effect))
    return remarks


def _curvature(joint: SweepJointFit) -> Remarks:
    """Return what was seen of a curved gain law."""
    x, log_gain, sd = _own_gains(joint)
    departure = line_departure(x, log_gain, sd)
    if departure is None or abs(departure[0]) <= SWEEP.curvature_sd * departure[1]:
        return []
    leaves, slope = departure[0], line_fit(x, log_gain, sd)[1] / joint.axis.span
    ends = [slope + side * 8.0 * leaves / joint.axis.span for side in (-1.0, 1.0)]
    effect = (
        f"the gain law is curved by {100 * abs(leaves):.1f} %: its slope changes from "
        f"{ends[0]:.3g} at the lowest setting to {ends[1]:.3g} at the highest"
    )
    is_large = abs(leaves) > SWEEP.curvature
    return [finding("nonlinear", effect, "settings of a smaller range") if is_large else effect]


def _own_gains(joint: SweepJointFit) -> tuple[Array, Array, Array]:
    """Return positions of settings, ln of their gains without the law, and the errors."""
    if joint.response is not None:
        return (
            joint.axis.x[list(joint.lit)],
            joint.response.log_responses,
            joint.response.log_responses_sd,
        )
    log_gains = np.log(joint.law.pulses)
    # Common errors of blur and electron gain leave the curvature unchanged.
    centred = log_gains - log_gains.mean(axis=1, keepdims=True)
    return joint.axis.x, np.median(log_gains, axis=0), np.std(centred, axis=0)


def _outlier_findings(joint: SweepJointFit) -> list[Finding]:
    """Return findings of settings that deviate significantly from the law."""
    findings: list[Finding] = []
    x, log_gains, sd = _own_gains(joint)
    settings = joint.sweep.settings if joint.response is None else joint.responsivity_settings
    law = np.polyval(np.polyfit(x, log_gains, 1, w=1.0 / np.hypot(sd, STRAY)), x)
    for value, off, error in zip([s.value for s in settings], log_gains - law, sd, strict=True):
        if abs(off) > SWEEP.outlier_sd * np.hypot(error, STRAY):
            at = joint.sweep.knob.text(value)
            effect = f"the gain at {at} is {np.exp(off):.2f} times that of the law"
            findings.append(finding("model-misfit", effect, "this setting again"))
    return findings


def _blur_findings(joint: SweepJointFit) -> list[Finding]:
    """Return findings of settings with a deviating blur factor."""
    if joint.sweep.settings[0].white:
        return []
    settings = joint.sweep.settings
    log_blur = np.log([float(np.median(s.blur_factor)) for s in settings])
    sd = np.array([float(np.std(np.log(np.maximum(s.blur_factor, 1e-6)))) for s in settings])
    unsure = [s.unsure_dn / np.exp(s.log_variance) for s in settings]
    sd = np.hypot(np.hypot(sd, unsure), SWEEP.blur_relative_sd)
    # At low gain the white noise of electrons adds to the variance.
    electrons = np.median(joint.law.electron_gain_dn[:, None] / joint.law.settings, axis=0)
    blur = np.exp(float(np.median(joint.law.posterior["log_blur"])))
    expected = np.log1p(electrons * (1.0 - blur) / blur)
    expected = expected + np.average(log_blur - expected, weights=1.0 / sd**2)
    return [
        finding(
            "model-misfit",
            f"at {joint.sweep.knob.text(s.value)} the blur factor is {np.exp(o):.3g}, not "
            f"{np.exp(e):.3g}",
            "this setting again",
        )
        for s, o, e, error in zip(settings, log_blur, expected, sd, strict=True)
        if abs(o - e) > SWEEP.outlier_sd * error
    ]
