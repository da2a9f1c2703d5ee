"""System gain from the variance of pixels, for white noise (EMVA 1288 Release 4)."""

from typing import Any

import numpy as np

from charact.estimators.noise.dark_current import dark_current
from charact.estimators.noise.data_sheet import data_sheet
from charact.estimators.noise.findings import (
    bounded,
    fields_of,
    findings_in,
    posterior_findings,
)
from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.gain.checks import (
    bend_allowance,
    correlation_findings,
    exposure_findings,
    findings_of_darks,
    slope_findings,
    variance_ratio_changes,
)
from charact.estimators.noise.gain.series import (
    FlatSeries,
    gain_obstacle,
    has_intensifier,
    read_levels,
    series_of,
)
from charact.estimators.noise.gain.stack_agreement import as_single_frames
from charact.estimators.noise.gain.undetected_correlation import (
    allowance_of,
    spatially_correlated_fraction,
    temporally_correlated_fraction,
)
from charact.estimators.noise.quantities import (
    electron_quantities,
    printed_quantities,
    printed_stacks,
    saturation_level,
    transfer_figure_data,
    without_flats,
)
from charact.estimators.noise.three_dimensional import three_dimensional
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context, register
from labdata import Result, Session

METHOD = "variance"


@register("flats", METHOD)
def variance(session: Session, *, context: Context) -> Result:
    """Measure gain, efficiency, noise and range from the variance and mean of darks and flats.

    Parameters
    ----------
    session
        Session with dark and flat stacks of at least two frames each.
    context
        Seed and settings.
    """
    darks, flats, single = read_levels(session, context=context, spectra=False, cubes=True)
    darks, flats = as_single_frames(darks, flats)
    series = series_of(flats, darks, single) if flats else None
    return white_noise(darks, flats, single, series, context, fields_of(METHOD, context))


def white_noise(
    darks: list[StackStatistics],
    flats: list[StackStatistics],
    single: list[str],
    series: FlatSeries | None,
    context: Context,
    fields: dict[str, Any],
) -> Result:
    """Return all quantities of white noise.

    `series`: the flats, or bins of their pixels, in which case patterns of the flats are no
    non-uniformity of the chip.
    """
    cubes = three_dimensional([*darks, *flats], context=context)
    if series is None or gain_obstacle(series) is not None:
        result = Result(measurements=tuple(without_flats(darks, series, single, **fields))) + cubes
        return result + dark_current(darks, result, context=context)
    complete = series_of(flats, darks)
    of_pixels = complete if len(complete.flats) else series
    neighbours, exposures = (
        spatially_correlated_fraction(of_pixels),
        temporally_correlated_fraction(of_pixels),
    )
    common = slope_findings(series)
    remarks = common + variance_ratio_changes(series) + correlation_findings(neighbours, exposures)
    tube = has_intensifier([level.conditions for level in (*darks, *flats)], context)
    allowance = float(
        np.hypot(allowance_of(neighbours, exposures, tube=tube), bend_allowance(series))
    )
    gain = emva1288.gain_line(series, context=context, allowance=allowance)
    first, *out = electron_quantities(series, (gain, gain), (remarks, remarks), context, fields)
    findings = findings_in(bounded(common))
    stacks = printed_stacks(series)
    of_darks = printed_quantities(stacks, findings_of_darks(series), with_flats=False, **fields)
    out = [first, *of_darks, saturation_level(series, findings, **fields), *out]
    of_gain = findings_in(bounded([*remarks, *posterior_findings(gain.posterior)]))
    out += printed_quantities(
        stacks,
        findings,
        with_flats=True,
        gain=gain.slope,
        of_gain=of_gain,
        of_pairs=findings_in(bounded(exposure_findings(exposures))),
        **fields,
    )
    if series.flats[-1].label not in [flat.label for flat in flats]:
        out = [m for m in out if m.quantity != "prnu"]
        stacks = stacks.only(flats=[])
    evidence = {"photon-transfer": transfer_figure_data(series, gain=float(np.median(gain.slope)))}
    result = Result(measurements=tuple(out), evidence=evidence)
    result += data_sheet(series, stacks, gain.slope, of_gain, context.seed, **fields)
    result += cubes
    return result + dark_current(darks, result, context=context)
