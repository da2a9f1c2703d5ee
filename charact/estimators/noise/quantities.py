"""Quantities of darks and flats that need no blur model: noise, non-uniformity, EMVA 1288
quantities.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from charact.estimators.noise.data_sheet import missing_levels, ranges
from charact.estimators.noise.findings import (
    Remarks,
    bounded,
    clipping_effects,
    finding,
    findings_in,
    judged,
    posterior_findings,
    rounding_findings,
    scaled,
)
from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.gain.checks import dark_findings, gain_curvature, light_findings
from charact.estimators.noise.gain.series import FlatSeries, gain_obstacle, without_noise
from charact.estimators.noise.gain.stack_agreement import (
    averaging_notes,
    dark_level_findings,
    with_drift_of_darks,
)
from charact.estimators.noise.illumination import light_of_photons
from charact.estimators.noise.thresholds import CHECKS, CORRELATION
from charact.frames.rounding import (
    QUANTISATION_DN2,
    QUANTISED_DN2,
    rounding_sd,
)
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context
from charact.observables import Printed, Stacks, observables
from charact.observables.fixed_pattern import Dsnu, Prnu
from charact.verdict import Finding, judge
from labdata import QUANTITIES, Array
from labdata.data_sheet import BY_VARIANCE
from labdata.measurement import (
    Measurement,
    make_refusal,
    measurement_from_draws,
    measurement_from_sd,
)
from labdata.number_format import plus_minus

PAIR = "from two frames: includes any temporal correlation between them"


def printed_quantities(
    stacks: Stacks[StackStatistics],
    findings: Sequence[Finding],
    *,
    with_flats: bool,
    gain: Array | None = None,
    of_gain: Sequence[Finding] = (),
    of_pairs: Sequence[Finding] = (),
    **fields: Any,
) -> list[Measurement]:
    """Return the statistics that declare how they are printed, in the order of the catalogue.

    `stacks`: the last flat is printed with the dark of most frames; level and noise are those of
    the dark of the shortest exposure. `findings`: on all stacks. `gain`: draws, DN per electron.
    `of_gain`, `of_pairs`: findings on values in electrons, and on few frames.
    """
    out = []
    for statistic in observables():
        printed = statistic.printed
        if printed is None or printed.with_flats != with_flats or not stacks.darks:
            continue
        dark = (
            min(stacks.darks, key=lambda level: level.conditions.exposure_s or 0.0)
            if printed.kind in ("level", "noise")
            else max(stacks.darks, key=lambda level: level.frames)
        )
        shown = stacks.only(darks=[dark], flats=stacks.flats[-1:] if printed.of_flat else [])
        is_pattern = printed.kind == "pattern"
        of_stacks = _pattern_remarks(shown) if is_pattern else _dark_remarks(dark, printed.kind)
        remarks = [*findings, *of_stacks]
        if printed.of_flat and shown.flat.frames <= CORRELATION.few_frames:
            remarks += of_pairs
        gain_of_it = gain if printed.per_electron else None
        if gain_of_it is not None:
            remarks += of_gain
        remarks += [printed.note] if printed.note else []
        estimate = statistic.measure(shown).number
        out.append(_print(printed, shown, estimate, gain_of_it, remarks, **fields))
    catalogue = list(QUANTITIES)
    return sorted(out, key=lambda m: catalogue.index(m.quantity))


def _print(
    printed: Printed,
    shown: Stacks[StackStatistics],
    estimate: tuple[float, float],
    gain: Array | None,
    remarks: Remarks,
    **fields: Any,
) -> Measurement:
    """Return the number in its unit, in electrons with a gain; refused if a variance is hidden."""
    number, sd = estimate
    unit, scale = printed.unit, printed.factor
    if printed.kind == "level":
        sd = max(sd, (QUANTISED_DN2 / (shown.dark.pixels * shown.dark.frames)) ** 0.5)
    if printed.kind == "noise":
        sd = float(np.hypot(sd, rounding_sd(number)[1]))
        if number <= 0.0:
            reason = f"{shown.dark.label} does not change from frame to frame"
            return make_refusal(printed.quantity, unit, reason, **fields)
    if gain is not None:
        unit, scale = "e-", scale / float(np.median(gain))
        sd = float(np.hypot(sd, 2.0 * float(np.std(gain) / np.median(gain)) * number))
    if printed.kind == "pattern" and (number < 3.0 * sd or number <= 0):
        limit = scale * float(np.sqrt(max(number, 0.0) + 3.0 * sd))
        reason = (
            f"hidden by temporal noise; more frames are needed to detect less than "
            f"{limit:.3g} {unit}"
        )
        notes = tuple(entry for entry in remarks if isinstance(entry, str))
        return make_refusal(printed.quantity, unit, reason, notes=notes, **fields)
    if printed.kind in ("noise", "pattern"):
        number, sd = emva1288.noise_of(number, sd)
    m = measurement_from_sd(printed.quantity, unit, scale * number, scale * sd, **fields)
    return judged(m, remarks)


def _dark_remarks(dark: StackStatistics, kind: str) -> Remarks:
    """Return what was seen of a dark, with the bounds that are known of its level and noise.

    See `clipping_effects` and `rounding_findings`; the level contains its rounding.
    """
    noise_dn = max(dark.variance_dn2, 0.0) ** 0.5
    raised, lowered = clipping_effects(dark.low_fraction, noise_dn, dark.mean_dn)
    bound, sign = {"level": (raised, 1), "noise": (lowered, -1)}.get(kind, (None, 0))
    rounded = [] if kind == "level" else rounding_findings(dark.variance_dn2)
    of_kind = {
        "level": dark_level_findings(dark),
        "noise": [*averaging_notes([dark]), *_line_notes(dark)],
    }
    return [
        *dark_clipping(dark, bound, sign),
        *(rounded if kind == "noise" else bounded(rounded)),
        *of_kind.get(kind, []),
    ]


def _line_notes(dark: StackStatistics) -> list[str]:
    """Return notes on noise in time of complete rows and columns, which that of a pixel includes,
    with the noise of a pixel without it.
    """
    notes = []
    for name, lines in (("tv", "rows"), ("th", "columns")):
        of_lines = 0.0 if dark.cube is None else dark.cube.components[name].variance_dn2
        if of_lines > CHECKS.line_fraction * dark.variance_dn2:
            without = max(dark.variance_dn2 - of_lines, 0.0) ** 0.5
            notes.append(
                f"temporal noise of a pixel, that of complete {lines} included (noise_{name}, "
                f"{of_lines**0.5:.3g} DN); without it {without:.3g} DN"
            )
    return notes


def _pattern_remarks(shown: Stacks[StackStatistics]) -> Remarks:
    """Return what was seen of the fixed pattern of a flat, or of a dark alone.

    Slowly varying noise may count as fixed pattern, that of a dark for a flat where it weighs.
    """
    dark, remarks, levels = shown.dark, Remarks(), [*shown.flats]
    if shown.flats:
        relative = Prnu().measure(shown).number[0]
        weighs_from = CHECKS.dark_pattern_fraction * relative * float(shown.signal_dn[0]) ** 2
        levels += [dark] if sum(Dsnu().measure(shown).number) > weighs_from else []
    else:
        levels = [dark]
        remarks += bounded(rounding_findings(dark.variance_dn2))
        remarks += [PAIR] if dark.frames < CORRELATION.few_frames else []
    return remarks + [
        finding("lag", f"slowly varying noise of {level.label} may count as fixed pattern")
        for level in levels
        if not level.settled
    ]


def printed_stacks(series: FlatSeries) -> Stacks[StackStatistics]:
    """Return all darks, and last the flat of most frames nearest to half of saturation.

    Half of saturation is that of the standard; without saturation the brightest flat is taken,
    where PRNU is largest.
    """
    chosen = np.flatnonzero(series.fitted)
    middle = (
        series.signal_dn[chosen[-1]] if series.peak is None else 0.5 * series.signal_dn[series.peak]
    )
    best = max(chosen, key=lambda i: (series.flats[i].frames, -abs(series.signal_dn[i] - middle)))
    return series.stacks.only(flats=[series.flats[best]])


def dark_clipping(
    dark: StackStatistics, bound: float | None = None, sign: int = 0
) -> list[Finding]:
    """Return the finding of a dark with clipped values, with the bound of those cut off at 0 DN."""
    clipped = max(dark.low_fraction, dark.high_fraction)
    if clipped <= CHECKS.max_clipped_fraction:
        return []
    is_high = dark.high_fraction > CHECKS.max_clipped_fraction
    end = "0 DN" if clipped == dark.low_fraction else "full scale"
    effect = f"{100 * clipped:.2g} % of the values of {dark.label} are at {end}"
    return [finding("clipped", effect, bound=None if is_high else bound, sign=sign)]


def saturation_level(series: FlatSeries, findings: Sequence[Finding], **fields: Any) -> Measurement:
    """Return the level at which the temporal variance peaks."""
    if series.peak is None:
        reason = (
            f"the variance still rises at the brightest flat, {series.flats[-1].mean_dn:.4g} DN"
        )
        return make_refusal("saturation", "DN", reason, **fields)
    level = np.array([flat.mean_dn for flat in series.flats])
    peak_levels = level[max(0, series.peak - 1) : series.peak + 2]
    # The peak lies between the neighbouring levels: triangular distribution.
    sd = float(np.ptp(peak_levels)) / np.sqrt(24.0)
    saturation = measurement_from_sd("saturation", "DN", level[series.peak], sd, **fields)
    return judge(saturation, findings)


def electron_quantities(
    series: FlatSeries,
    gains: tuple[emva1288.GainLine, emva1288.GainLine],
    remarks: tuple[Remarks, Remarks],
    context: Context,
    fields: dict[str, Any],
) -> list[Measurement]:
    """Return the system gain and the EMVA 1288 quantities that follow from it: efficiency, noise,
    range.

    `gains`: slope of the standard, and gain per electron of the derived quantities. `remarks`: what
    was seen of each, with bounds relative to the slope.
    """
    plain, gain = gains
    out = _electron_quantities(series, gains, remarks, context, fields)
    if plain is gain:
        return out
    quick = replace(context, quick=True)
    standard = _electron_quantities(series, (plain, plain), remarks, quick, fields)
    by_name = {(m.quantity, m.unit): m for m in standard if m.value is not None}
    # The gain itself is that of the standard.
    return [out[0], *(_with_standard(m, by_name.get((m.quantity, m.unit))) for m in out[1:])]


def _electron_quantities(
    series: FlatSeries,
    gains: tuple[emva1288.GainLine, emva1288.GainLine],
    remarks: tuple[Remarks, Remarks],
    context: Context,
    fields: dict[str, Any],
) -> list[Measurement]:
    plain, gain = gains
    excess = emva1288.excess_of(series.flats[0].conditions, context)
    notes = () if excess.note is None else (excess.note,)
    slope_remarks, why = (
        [*parts, *posterior_findings(line.posterior), *notes]
        for parts, line in zip(remarks, gains, strict=True)
    )
    why = findings_in(bounded(why))
    system_gain = measurement_from_draws(
        "system_gain", "DN/e-", plain.slope, posterior=plain.posterior, **fields
    )
    out = [judged(system_gain, scaled(slope_remarks, system_gain.value or 0.0))]
    curvature = gain_curvature(series)
    if curvature is not None:
        bend = measurement_from_sd(
            "gain_curvature", "%", *(100.0 * part for part in curvature), **fields
        )
        # A bent response is what it measures.
        others = [
            entry
            for entry in findings_in(bounded(remarks[0]))
            if entry.flag not in ("nonlinear", "gamma")
        ]
        out.append(judge(bend, others))
    slope, light = gain.slope, light_findings(series)
    rng = np.random.default_rng([context.seed, 2])
    photons = emva1288.photons_of(series)
    efficiency = None
    if photons is not None and (photons > 0).all():
        response = emva1288.responsivity_line(series, photons, context=context)
        efficiency = rng.permutation(response.slope) / slope
        stated = light_of_photons(series.flats, photons)
        true = efficiency / stated.scale(context.seed, len(efficiency))
        words = (*notes, stated.note)
        quantum = measurement_from_draws(
            "quantum_efficiency", "%", 100 * true, notes=words, **fields
        )
        per_photon = response.slope / stated.scale(context.seed, len(response.slope))
        responsivity = measurement_from_draws("responsivity", "DN/photon", per_photon, **fields)
        out += [judge(m, [*why, *light]) for m in (quantum, responsivity)]
    if not series.all_darks:
        return out
    dark, dark_sd = emva1288.dark_noise_dn(series)
    # Rounding of so little noise may raise or lower its variance.
    steps = rounding_sd(dark**2)[1] * rng.standard_normal(len(slope))
    square = (dark + dark_sd * rng.standard_normal(len(slope))) ** 2 - QUANTISATION_DN2 + steps
    if np.quantile(square, 0.02) <= 0:
        reason = f"the noise of {dark:.3g} DN does not exceed the quantisation noise"
        return [*out, make_refusal("read_noise", "e-", reason, **fields)]
    dark_e2 = np.maximum(square, 0.0) / slope**2
    read = measurement_from_draws("read_noise", "e-", np.sqrt(dark_e2), notes=notes, **fields)
    electron_dn = float(np.median(slope))
    rounded = [
        replace(entry, bound=entry.bound and entry.bound / electron_dn)
        for entry in rounding_findings(dark**2, included_dn2=0.0)
    ]
    out.append(judge(with_drift_of_darks(read, series), [*why, *rounded]))
    return out + [
        judge(m, why) for m in ranges(series, efficiency, slope, dark_e2, excess.factor, **fields)
    ]


def _with_standard(m: Measurement, standard: Measurement | None) -> Measurement:
    """Return a number with a note on that of the standard, where they differ."""
    if m.value is None or standard is None or standard.value == m.value:
        return m
    return replace(m, notes=(*m.notes, f"{BY_VARIANCE}{plus_minus(standard)} {m.unit}"))


def without_flats(
    darks: Sequence[StackStatistics],
    series: FlatSeries | None,
    single: list[str],
    *,
    quantity: tuple[str, str] = ("system_gain", "DN/e-"),
    **fields: Any,
) -> list[Measurement]:
    """Return the quantities of darks alone, and the refusal of the gain."""
    if series is not None:
        reason = "; ".join(
            part for part in (gain_obstacle(series), without_noise(series.single)) if part
        )
    elif single:
        reason = f"noise needs stacks of at least two frames; {', '.join(single)} has one"
    else:
        reason = "there are no flats"
    refused = make_refusal(*quantity, reason, refusal="missing", **fields)
    findings = [] if series is None or not len(series.flats) else dark_findings(series)
    printed = printed_quantities(Stacks(darks=tuple(darks)), findings, with_flats=False, **fields)
    return [refused, *printed]


def transfer_figure_data(
    series: FlatSeries, *, gain: float | None = None, **more: Any
) -> dict[str, Any]:
    """Return the photon transfer curve: signal, variance and fitted range."""
    return {
        "figure": "photon-transfer",
        "label": [flat.label for flat in series.flats],
        "mean_dn": [flat.mean_dn for flat in series.flats],
        "signal_dn": series.signal_dn.tolist(),
        "variance_dn2": [flat.variance_dn2 for flat in series.flats],
        "variance_sd_dn2": series.variance_sd_dn2.tolist(),
        "fitted": series.fitted.tolist(),
        "system_gain_dn_per_e": gain,
        "reference": series.reference,
        "variance_above_dark_dn2": series.variance_dn2.tolist(),
        "dark_mean_dn": [dark.mean_dn for dark in series.darks],
        "dark_variance_dn2": [dark.variance_dn2 for dark in series.darks],
        "missing": missing_levels(series),
        **more,
    }
