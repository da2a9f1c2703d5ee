"""Quantities of a gain sweep: gain law, knee, MCP saturation, excess noise, responsivity."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.estimators.noise.findings import (
    Unmeasurable,
    bounded,
    fields_of,
    finding,
    findings_in,
    judged,
    rounding_findings,
)
from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.sweep.gain_law import GainLaw
from charact.estimators.noise.sweep.joint import SweepJointFit, fit_sweep
from charact.estimators.noise.sweep.responsivity import (
    bending_remarks,
    reaches_saturation,
    relative_excess,
    saturation_limit,
)
from charact.estimators.noise.sweep.settings import GainControl, Sweep, SweepSetting, sweep_of
from charact.estimators.noise.thresholds import SWEEP
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.verdict import Finding, judge
from labdata import Array
from labdata.measurement import (
    Measurement,
    Result,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
)

# Signal of the stated knee, effective photoelectrons per pixel and exposure.
STATED_PE = 1.0


@dataclass(frozen=True, kw_only=True)
class Knee:
    """Gain of equal read noise and scintillation noise."""

    read_noise_dn: Array  # draws of the read noise without dark scintillation, shape (draw,), DN
    gain_dn: Array  # draws of the covariance gain at the knee, shape (draw,), DN
    # draws of its position on the axis of the sweep, between -1/2 and 1/2 inside the sweep, shape
    # (draw,)
    position: Array
    findings: tuple[Finding, ...] = ()  # findings on the read noise


def knee_of(settings: tuple[SweepSetting, ...], law: GainLaw, *, seed: int) -> Knee:
    """Return the knee of a sweep; Unmeasurable without read noise."""
    rng = np.random.default_rng([seed, 9])
    dark = {s.dark: i for i, s in enumerate(settings) if s.dark_variance_dn2 is not None}
    if not dark:
        raise Unmeasurable(
            "the knee needs darks at one setting at least: the read noise is unknown"
        )
    dark_settings = [settings[i] for i in dark.values()]
    floor = _floor(law.settings[:, list(dark.values())], dark_settings, rng)
    if np.quantile(floor, 0.025) <= 0:
        raise Unmeasurable("dark scintillation at every setting hides the read noise and the knee")
    floor = np.maximum(floor, np.quantile(floor, 0.01).clip(1e-9))
    pulses = _pulses_at(floor, law)
    position = (np.log(pulses) - law.posterior["log_gain"]) / law.posterior["rise"]
    smallest_dn2 = min(s.dark_variance_dn2 or 0.0 for s in dark_settings)
    findings = findings_in(bounded(rounding_findings(smallest_dn2)))
    if len(dark_settings) < 2:
        effect = "the dark of one setting does not separate read noise from scintillation"
        findings.append(finding("unlike-conditions", effect))
    return Knee(
        read_noise_dn=np.sqrt(floor),
        gain_dn=pulses + law.electron_gain_dn,
        position=position,
        findings=tuple(findings),
    )


def _check_inside(knee: Knee) -> None:
    """Refuse a knee outside the sweep."""
    middle = float(np.median(knee.position))
    if abs(middle) <= 0.5:
        return
    low, high = np.quantile(knee.gain_dn, [0.025, 0.975])
    is_below = middle < 0
    larger, other = ("scintillation", "read noise") if is_below else ("read noise", "scintillation")
    raise Unmeasurable(
        f"not reached in the sweep: {larger} outweighs {other} at every setting at {STATED_PE:g} "
        f"photoelectron per pixel; the knee is where the covariance gain is {low:.3g} to "
        f"{high:.3g} DN, {'is_below' if is_below else 'above'} the sweep"
    )


def _pulses_at(floor_dn2: Array, law: GainLaw) -> Array:
    """Return draws of the pulse gain P, DN, at which (K + S P)(K + P) n is the squared read noise,
    K the electron gain.
    """
    blur, electrons = law.blur, law.electron_gain_dn
    half = 0.5 * (1.0 + blur) * electrons
    root = np.sqrt(np.maximum(half**2 - blur * (electrons**2 - floor_dn2 / STATED_PE), half**2))
    return np.maximum(root - half, 1e-6 * root) / blur


def _floor(gain: Array, settings: list[SweepSetting], rng: np.random.Generator) -> Array:
    """Return draws of the dark variance at zero gain, shape (draw,), DN^2: D = r^2 + c C^2, c for
    scintillation.
    """
    variance = np.array([s.dark_variance_dn2 for s in settings], float)
    sd = np.hypot([s.dark_variance_sd_dn2 for s in settings], SWEEP.dark_model_sd * variance)
    drawn = variance + sd * rng.standard_normal(gain.shape)
    weight, square = 1.0 / sd**2, gain**2
    total, mean = weight.sum(), (drawn @ weight) / weight.sum()
    if len(settings) < 2:
        return mean
    centred = square - (square @ weight)[:, None] / total
    slope = ((drawn * centred) @ weight) / ((centred**2) @ weight)
    return np.where(slope > 0, mean - slope * (square @ weight) / total, mean)


def sweep_figure_data(joint: SweepJointFit, knee: Knee | None) -> dict[str, Any]:
    """Return gains and read noise against the control, the gain law with its interval, and the
    knee.
    """
    sweep, law = joint.sweep, joint.law
    log_gains = np.array([s.log_gain for s in sweep.settings])
    x = np.linspace(-0.5, 0.5, 41)
    pulses = np.exp(law.posterior["log_gain"][:, None] + law.posterior["rise"][:, None] * x)
    low, middle, high = np.quantile(
        pulses + law.electron_gain_dn[:, None], [0.025, 0.5, 0.975], axis=0
    )
    electrons = law.electron_gain_dn[:, None]
    stated = np.sqrt((electrons + law.blur[:, None] * pulses) * (electrons + pulses) * STATED_PE)
    shrunk = np.quantile(law.settings, [0.025, 0.5, 0.975], axis=0)
    dark = [s.dark_variance_dn2 for s in sweep.settings]
    figure: dict[str, Any] = {
        "figure": "noise-against-gain",
        "knob": sweep.knob.words,
        "knob_unit": sweep.knob.unit,
        "logarithmic": sweep.knob.logarithmic,
        "setting": [s.value for s in sweep.settings],
        "gain_dn": np.exp(log_gains[:, 0]).tolist(),
        "gain_relative_sd": log_gains[:, 1].tolist(),
        "joint_gain_dn": shrunk[1].tolist(),
        "joint_interval95_dn": shrunk[[0, 2]].tolist(),
        "blur_factor": [float(np.median(s.blur_factor)) for s in sweep.settings],
        "dark_noise_dn": [None if v is None else float(np.sqrt(max(v, 0.0))) for v in dark],
        "law_setting": joint.setting_at(x).tolist(),
        "law_gain_dn": middle.tolist(),
        "law_interval95_dn": [low.tolist(), high.tolist()],
        "departure_percent": 100.0 * float(np.median(np.exp(law.posterior["log_departure"]))),
        "stated_signal_pe": STATED_PE,
        "stated_noise_dn": np.quantile(stated, [0.025, 0.5, 0.975], axis=0).tolist(),
    }
    if knee is not None:
        knee_positions = np.quantile(knee.position, [0.025, 0.5, 0.975])
        figure["read_noise_dn"] = float(np.median(knee.read_noise_dn))
        figure["knee_gain_dn"] = float(np.median(knee.gain_dn))
        figure["knee_setting"] = joint.setting_at(knee_positions).tolist()
    return figure


def levels_figure_data(joint: SweepJointFit) -> dict[str, Any]:
    """Return noise of a pixel and signal over light at every level of every setting."""
    sweep, response = joint.sweep, joint.response
    figure: dict[str, Any] = {
        "figure": "noise-by-gain",
        "knob": sweep.knob.words,
        "setting": [sweep.knob.text(s.value) for s in sweep.settings],
        "signal_dn": [s.signal_dn.tolist() for s in sweep.settings],
        "noise_dn": [
            np.sqrt(np.maximum(s.variance_dn2 + (s.dark_variance_dn2 or 0.0), 0.0)).tolist()
            for s in sweep.settings
        ],
        "dark_noise_dn": [
            None if s.dark_variance_dn2 is None else float(np.sqrt(max(s.dark_variance_dn2, 0.0)))
            for s in sweep.settings
        ],
        "light_unit": next((s.light_unit for s in sweep.settings if s.light is not None), ""),
        "light": [None if s.light is None else s.light.tolist() for s in sweep.settings],
    }
    if response is not None:
        figure["lost_percent"] = 100.0 * float(np.median(response.posterior["lost"]))
        figure["saturation_limit_dn"] = float(
            1.0 / max(np.quantile(response.lost_per_dn, 0.975), 1e-12)
        )
    return figure


Fields = dict[str, Any]
METHOD = "gain-sweep"
DROWNS = (
    "the slope of the gain law is not significant: the settings are too close, or the gain "
    "does not follow them"
)
ABSOLUTE = "absolute F2 needs a known illumination or the pulse heights of single photoelectrons"


@with_timing
def gain_sweep(
    darks: list[StackStatistics], flats: list[StackStatistics], *, context: Context
) -> Result:
    """Return the quantities of a gain sweep; none if the gain was not varied.

    Returns gain law, knee of read noise and scintillation, MCP saturation, relative excess noise of
    each setting; gain, blur factor, read noise and responsivity of each setting, whose `stack` is
    its brightest flat.
    """
    sweep = sweep_of(darks, flats, context=context)
    return Result() if sweep is None else measure_sweep(sweep, context=context)


def measure_sweep(sweep: Sweep, *, context: Context) -> Result:
    """Return the quantities of a gain sweep from its statistics, see `gain_sweep`."""
    fields: Fields = {**fields_of(METHOD, context, knob=sweep.knob.name)}
    if len(sweep.settings) < 2:
        reason = "; ".join(
            ["the gain law needs usable flats at two settings at least", *sweep.left_out]
        )
        return Result(measurements=(make_refusal(*_quantity_of(sweep.knob), reason, **fields),))
    joint = fit_sweep(sweep, context=context)
    at_knee, knee = _knee(joint, context.seed, fields)
    out = [_rise(joint, fields), *at_knee]
    out += [_saturation(joint, fields)] if sweep.knob.tube else []
    out += _excess(joint, context, fields) if sweep.knob.unit != "dB" else []
    for number, setting in enumerate(joint.sweep.settings):
        out += _of_setting(joint, number, setting, context, fields)
    evidence = {
        "noise-against-gain": sweep_figure_data(joint, knee),
        "noise-by-gain": levels_figure_data(joint),
    }
    return Result(measurements=tuple(out), evidence=evidence)


def _quantity_of(knob: GainControl) -> tuple[str, str]:
    """Return quantity and unit of the gain law of a control."""
    if knob.logarithmic:
        return "gain_exponent", "1"
    return ("gain_slope", "dB/dB") if knob.unit == "dB" else ("gain_doubling", knob.unit)


def _rise(joint: SweepJointFit, fields: Fields) -> Measurement:
    """Return exponent, doubling or slope of the gain law."""
    quantity, unit = _quantity_of(joint.sweep.knob)
    departure = 100.0 * np.exp(np.quantile(joint.source.posterior["log_departure"], [0.5, 0.975]))
    on = "covariance gain" if joint.response is None else "signal over light"
    settings = len(joint.sweep.settings if joint.response is None else joint.lit)
    note = (
        f"from the {on} at {settings} settings, which deviate from the law by {departure[0]:.2g} "
        "%, "
        f"at 97.5 % by less than {departure[1]:.2g} %"
    )
    if not joint.is_resolved:
        known = [entry if isinstance(entry, str) else entry.note for entry in joint.remarks]
        return make_refusal(quantity, unit, DROWNS, notes=(*known, note), **fields)
    draws = (
        np.log(2.0) / np.maximum(joint.rise, 1e-9) if quantity == "gain_doubling" else joint.rise
    )
    rise = measurement_from_draws(quantity, unit, draws, posterior=joint.source.posterior, **fields)
    return judged(rise, [*joint.remarks, note])


def _knee(joint: SweepJointFit, seed: int, fields: Fields) -> tuple[list[Measurement], Knee | None]:
    """Return setting and covariance gain at the knee, and the knee itself, which may lie outside
    the sweep.
    """
    knob, knee = joint.sweep.knob, None
    try:
        if not joint.is_resolved:
            raise Unmeasurable(DROWNS)
        knee = knee_of(joint.sweep.settings, joint.law, seed=seed)
        _check_inside(knee)
    except Unmeasurable as reason:
        return [
            make_refusal("gain_knee", unit, str(reason), **fields) for unit in (knob.unit, "DN")
        ], knee
    note = (
        f"at {STATED_PE:g} effective photoelectron per pixel and exposure (n of unequal pulses "
        "count as n/F2); at n of them the covariance gain at the knee is smaller by the root of n"
    )
    findings = [*findings_in(joint.remarks), *knee.findings]
    return [
        judge(measurement_from_draws("gain_knee", unit, draws, notes=(note,), **fields), findings)
        for unit, draws in ((knob.unit, joint.setting_at(knee.position)), ("DN", knee.gain_dn))
    ], knee


def _saturation(joint: SweepJointFit, fields: Fields) -> Measurement:
    """Return the saturation signal of the MCP."""
    response = joint.response
    if response is None:
        reason = "MCP saturation needs light recorded at two settings at least"
        return make_refusal("mcp_saturation", "DN", reason, **fields)
    if not reaches_saturation(response):
        return make_refusal("mcp_saturation", "DN", saturation_limit(response), **fields)
    lost = response.lost_per_dn
    percent = 100.0 * float(np.median(response.posterior["lost"]))
    note = (
        f"{percent:.2g} % of the gain is lost at the brightest level, {response.brightest_dn:.4g} "
        "DN above the dark"
    )
    limit = measurement_from_draws(
        "mcp_saturation", "DN", 1.0 / lost[lost > 0], posterior=response.posterior, **fields
    )
    bend = bending_remarks(joint.responsivity_settings, response)
    return judged(limit, [*joint.remarks, *bend, note])


def _excess(joint: SweepJointFit, context: Context, fields: Fields) -> list[Measurement]:
    """Return the excess noise factor of every setting relative to the most precise one."""
    if joint.response is None:
        reason = (
            "covariance gain is proportional to gain times F2, and only light recorded at every "
            f"setting gives the gain alone: state illuminance_lux or photons_per_px; {ABSOLUTE}"
        )
        return [make_refusal("relative_excess_noise_factor", "1", reason, **fields)]
    settings, text = joint.responsivity_settings, joint.sweep.knob.text
    pulses = joint.law.pulses[:, list(joint.lit)]
    draws, reference = relative_excess(settings, pulses, joint.response, seed=context.seed)
    note = (
        f"F2 relative to {text(settings[reference].value)}, from the noise over the responsivity, "
        f"for equal blur within {100 * SWEEP.blur_relative_sd:g} %; {ABSOLUTE}"
    )
    shared = settings[reference].findings
    return [
        judge(
            measurement_from_draws(
                "relative_excess_noise_factor",
                "1",
                draws[:, i],
                notes=(f"at {text(s.value)}", note),
                stack=s.stack,
                **fields,
            ),
            [*s.findings, *shared],
        )
        for i, s in enumerate(settings)
        if i != reference
    ]


def _of_setting(
    joint: SweepJointFit, number: int, s: SweepSetting, context: Context, fields: Fields
) -> list[Measurement]:
    """Return responsivity, gain, blur factor and noise of a setting; only responsivity for the main
    setting.
    """
    knob = joint.sweep.knob
    labels = {"notes": (f"at {knob.text(s.value)}: {', '.join(s.labels)}",), **fields}
    out: list[Measurement] = []
    if joint.response is not None and number in joint.lit:
        draws = joint.response.settings[:, joint.lit.index(number)]
        meter = s.light_relative_sd * np.random.default_rng([context.seed, 12]).standard_normal(
            len(draws)
        )
        out.append(
            measurement_from_draws(
                "responsivity", f"DN/{s.light_unit}", draws * np.exp(meter), stack=s.stack, **labels
            )
        )
    main = np.argmin([abs(other.value - joint.sweep.main) for other in joint.sweep.settings])
    if number != main:
        # Shrinkage towards an invalid law would bias the settings.
        is_bent = any(entry.flag == "nonlinear" for entry in findings_in(joint.remarks))
        gain = s.gain_dn if is_bent else joint.law.settings[:, number]
        name = ("system_gain", "DN/e-") if s.white else ("covariance_gain", "DN")
        out.append(measurement_from_draws(*name, gain, stack=s.stack, **labels))
        if not s.white:
            out.append(
                measurement_from_draws("blur_factor", "1", s.blur_factor, stack=s.stack, **labels)
            )
        if s.dark_variance_dn2 is not None and s.dark_variance_dn2 > 0:
            noise = emva1288.noise_of(s.dark_variance_dn2, s.dark_variance_sd_dn2)
            read = measurement_from_sd("read_noise", "DN", *noise, stack=s.dark, **labels)
            out.append(judged(read, rounding_findings(s.dark_variance_dn2)))
    return [judge(m, s.findings) for m in out]
