"""Quantities of a gain sweep: gain law, knee, MCP saturation, excess noise, responsivity."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.method.stopwatch import with_timing
from charact.noise.checks import QUANTISED_DN2
from charact.noise.findings import flags_of, notes_of
from charact.noise.gain import emva1288
from charact.noise.provenance import provenance
from charact.noise.stack.stack_statistics import StackStatistics
from charact.noise.sweep.excess import bending_findings, reaches_saturation, relative_excess, saturation_limit
from charact.noise.sweep.figure_data import levels_figure_data, sweep_figure_data
from charact.noise.sweep.gain_control import GainControl
from charact.noise.sweep.joint import SweepJointFit, fit_sweep
from charact.noise.sweep.knee import STATED_PE, Knee, knee_of, outside_reason
from charact.noise.sweep.settings import Sweep, SweepSetting, sweep_of
from charact.noise.thresholds import SWEEP
from labdata.measurement import Measurement, Result, make_refusal, measurement_from_draws, measurement_from_sd

Array = NDArray[np.float64]
Fields = dict[str, Any]

METHOD = "gain-sweep"
DROWNS = "the slope of the gain law is not significant: the settings are too close, or the gain does not follow them"
ABSOLUTE = "absolute F2 needs a known illumination or the pulse heights of single photoelectrons"


@with_timing
def gain_sweep(darks: list[StackStatistics], flats: list[StackStatistics], *, context: Context) -> Result:
    """Return the quantities of a gain sweep; none if the gain was not varied.

    Parameters
    ----------
    darks, flats
        Stack statistics of a session with spectra.
    context
        Seed and settings; a sensor description gives the gain per electron.

    Returns
    -------
    Result
        Gain law, knee of read noise and scintillation, MCP saturation, relative excess noise of each setting; gain,
        blur factor, read noise and responsivity of each setting, whose `stack` is its brightest flat.
    """
    sweep = sweep_of(darks, flats, context=context)
    return Result() if sweep is None else measure_sweep(sweep, context=context)


def measure_sweep(sweep: Sweep, *, context: Context) -> Result:
    """Return the quantities of a gain sweep from its statistics, see `gain_sweep`."""
    fields: Fields = {"method": METHOD, "provenance": provenance(context, knob=sweep.knob.name)}
    if len(sweep.settings) < 2:
        reason = "; ".join(["the gain law needs usable flats at two settings at least", *sweep.left_out])
        return Result(measurements=(make_refusal(*_quantity_of(sweep.knob), reason, **fields),))
    joint = fit_sweep(sweep, context=context)
    knee = knee_of(joint.sweep.settings, joint.law, seed=context.seed) if joint.is_resolved else DROWNS
    out = [_rise(joint, fields), *_knee(joint, knee, fields)]
    out += [_saturation(joint, fields)] if sweep.knob.tube else []
    out += _excess(joint, context, fields) if sweep.knob.unit != "dB" else []
    for number, setting in enumerate(joint.sweep.settings):
        out += _of_setting(joint, number, setting, context, fields)
    evidence = {
        "noise-against-gain": sweep_figure_data(joint, knee if isinstance(knee, Knee) else None),
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
    many = len(joint.sweep.settings if joint.response is None else joint.lit)
    note = (
        f"from the {on} at {many} settings, which deviate from the law by {departure[0]:.2g} %, at 97.5 % by less than "
        f"{departure[1]:.2g} %"
    )
    notes = (*notes_of(joint.findings), note)
    if not joint.is_resolved:
        return make_refusal(quantity, unit, DROWNS, notes=notes, **fields)
    draws = np.log(2.0) / np.maximum(joint.rise, 1e-9) if quantity == "gain_doubling" else joint.rise
    return measurement_from_draws(quantity, unit, draws, flags=flags_of(joint.findings), notes=notes,
                      posterior=joint.source.posterior, **fields)  # fmt: skip


def _knee(joint: SweepJointFit, knee: Knee | str, fields: Fields) -> list[Measurement]:
    """Return setting and covariance gain at the knee."""
    knob = joint.sweep.knob
    reason = knee if isinstance(knee, str) else outside_reason(knee)
    if isinstance(knee, str) or reason is not None:
        return [make_refusal("gain_knee", unit, str(reason), **fields) for unit in (knob.unit, "DN")]
    note = (
        f"at {STATED_PE:g} effective photoelectron per pixel and exposure (n of unequal pulses count as "
        "n/F2); at n of them the covariance gain at the knee is smaller by the root of n"
    )
    own = {"flags": flags_of(joint.findings) + knee.flags, "notes": (note,), **fields}
    places = knob.value(joint.axis.middle + joint.axis.span * knee.place)
    return [
        measurement_from_draws("gain_knee", knob.unit, places, **own),
        measurement_from_draws("gain_knee", "DN", knee.gain_dn, **own),
    ]


def _saturation(joint: SweepJointFit, fields: Fields) -> Measurement:
    """Return the saturation signal of the MCP."""
    response = joint.response
    if response is None:
        reason = "MCP saturation needs light recorded at two settings at least"
        return make_refusal("plate_saturation", "DN", reason, **fields)
    if not reaches_saturation(response):
        return make_refusal("plate_saturation", "DN", saturation_limit(response), **fields)
    findings = [*joint.findings, *bending_findings(joint.responsivity_settings, response)]
    lost = response.lost_per_dn
    percent = 100.0 * float(np.median(response.posterior["lost"]))
    note = f"{percent:.2g} % of the gain is lost at the brightest level, {response.brightest_dn:.4g} DN above the dark"
    return measurement_from_draws("plate_saturation", "DN", 1.0 / lost[lost > 0], flags=flags_of(findings),
                      notes=(*notes_of(findings), note), posterior=response.posterior, **fields)  # fmt: skip


def _excess(joint: SweepJointFit, context: Context, fields: Fields) -> list[Measurement]:
    """Return the excess noise factor of every setting relative to the most precise one."""
    if joint.response is None:
        reason = (
            "covariance gain is proportional to gain times F2, and only light recorded at every setting gives the "
            f"gain alone: state illuminance_lux or photons_per_px; {ABSOLUTE}"
        )
        return [make_refusal("relative_excess_noise_factor", "1", reason, **fields)]
    settings, text = joint.responsivity_settings, joint.sweep.knob.text
    pulses = joint.law.pulses[:, list(joint.lit)]
    draws, reference = relative_excess(settings, pulses, joint.response, seed=context.seed)
    note = (
        f"F2 relative to {text(settings[reference].value)}, from the noise over the responsivity, for equal blur "
        f"within {100 * SWEEP.blur_relative_sd:g} %; {ABSOLUTE}"
    )
    shared = settings[reference].findings
    return [
        measurement_from_draws("relative_excess_noise_factor", "1", draws[:, i], flags=flags_of([*s.findings, *shared]),
                   notes=(f"at {text(s.value)}", note), stack=s.stack, **fields)
        for i, s in enumerate(settings) if i != reference
    ]  # fmt: skip


def _of_setting(
    joint: SweepJointFit, number: int, s: SweepSetting, context: Context, fields: Fields
) -> list[Measurement]:
    """Return responsivity, gain, blur factor and noise of a setting; only responsivity for the main setting."""
    knob = joint.sweep.knob
    own = {"flags": flags_of(s.findings), "notes": (f"at {knob.text(s.value)}: {', '.join(s.labels)}",), **fields}
    out: list[Measurement] = []
    if joint.response is not None and number in joint.lit:
        draws = joint.response.settings[:, joint.lit.index(number)]
        meter = s.light_relative_sd * np.random.default_rng([context.seed, 12]).standard_normal(len(draws))
        out.append(
            measurement_from_draws("responsivity", f"DN/{s.light_unit}", draws * np.exp(meter), stack=s.stack, **own)
        )
    if number == int(np.argmin([abs(other.value - joint.sweep.main) for other in joint.sweep.settings])):
        return out
    # Shrinkage towards an invalid law would bias the settings.
    gain = s.gain_dn if "nonlinear" in flags_of(joint.findings) else joint.law.settings[:, number]
    out.append(
        measurement_from_draws(
            *(("system_gain", "DN/e-") if s.white else ("covariance_gain", "DN")), gain, stack=s.stack, **own
        )
    )
    if not s.white:
        out.append(measurement_from_draws("blur_factor", "1", s.blur_factor, stack=s.stack, **own))
    if s.dark_variance_dn2 is not None and s.dark_variance_dn2 > 0:
        noise = emva1288.noise_of(s.dark_variance_dn2, s.dark_variance_sd_dn2)
        small = ("quantised",) if s.dark_variance_dn2 < QUANTISED_DN2 else ()
        own = {**own, "flags": flags_of(s.findings) + small}
        out.append(measurement_from_sd("read_noise", "DN", *noise, stack=s.dark, **own))
    return out
