"""What every method of blooming tells besides the halo: extents of each stack, and what did not stay as it was."""

from typing import Any

from charact.bloom.extent_measurements import bloom_measurements, series_evidence
from charact.bloom.point_stack import PointStack
from charact.bloom.series_consistency import check_consistency
from charact.bloom.smear import smear_measurement
from charact.method import Context
from labdata.measurement import Measurement, Result
from labdata.session import Session


def add_common_measurements(
    session: Session,
    spots: tuple[PointStack, ...],
    of_series: list[Measurement],
    evidence: dict[str, Any],
    *,
    context: Context,
    **fields: Any,
) -> Result:
    """Add extents, streaks, depressions and flags of inconstancy to what a method says of the series.

    Parameters
    ----------
    session, spots
        The session and its point sources.
    of_series, evidence
        Measurements of the method, of all stacks together or with their stack's label, and what the report draws.
    context
        What the method was told.
    fields
        Method and provenance.
    """
    steady = check_consistency(session, spots, context, **fields)
    smear, of_smear = smear_measurement(spots, context, **fields)
    extents = bloom_measurements(spots, square=context.sensor is None, sensor=context.sensor, **fields)
    said = [*of_series, smear, *extents]
    told = [_add_flags(one, steady.flags.get(one.stack or "", steady.halo_flags)) for one in said]
    own = evidence.get("halo-constancy")
    halos = dict(zip(own["label"], own["halo_diameter_px"], strict=True)) if own else {}
    drawn = {"bloom-series": series_evidence(spots, halos)} | evidence | of_smear | steady.evidence
    return Result(measurements=(*told, *steady.measurements), evidence=drawn)


def _add_flags(measurement: Measurement, flags: tuple[str, ...]) -> Measurement:
    return measurement if measurement.status == "refused" else measurement.with_(flags=flags)
