"""Truth beside measured: opened only when nothing is measured any more."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from labdata.session import Session

if TYPE_CHECKING:
    from charact.report.truth import Truth, TruthComparison

# Not the read noise: a dark frame of an intensifier scintillates, and its noise is more than that of reading.
COMPARED_QUANTITIES = ("covariance_gain", "blur_factor", "photoelectron_gain", "excess_noise_factor", "halo_diameter")
# A bar target or an edge without a direction has vertical bars.
HORIZONTAL_DEG = 0.0


def of_bench(folder: Path, session: Session) -> "Truth":
    """Return the truth of a virtual bench for the quantities of its session, by the contract's names.

    The MTF is a function of frequency and direction; gains are those at the session's plate voltage, which must be one.
    """
    from labdata.errors import BadInput
    from simulate.iiccd import true_quantities
    from simulate.virtual_bench.true_sensor import TRUTH, read_truth

    sensor = read_truth(folder / TRUTH).sensor
    voltages = {stack.conditions.mcp_v for stack in session.of_kind("flat")}
    if len(voltages) != 1:
        raise BadInput(f"truth is stated for one plate voltage, got flats at {sorted(map(str, voltages))} V")
    conditions = session.of_kind("flat")[0].conditions
    at_level = partial(_at_level, sensor)
    found = true_quantities.true_quantities(sensor, conditions)
    return {
        **{name: found[name] for name in COMPARED_QUANTITIES},
        "mtf": lambda frequency, angle: true_quantities.true_mtf(
            sensor, frequency, HORIZONTAL_DEG if angle is None else angle
        ),
        "mtf50": at_level(0.5),
        "mtf10": at_level(0.1),
    }


def _at_level(sensor, level: float):
    from simulate.iiccd import true_quantities

    return lambda _, angle: true_quantities.true_crossing_frequency(
        sensor, level, HORIZONTAL_DEG if angle is None else angle
    )


def lines(rows: Sequence["TruthComparison"]) -> Iterator[str]:
    """The table for a terminal."""
    yield f"\n{'quantity':44} {'stack, or method':18} {'truth':>10} {'measured':>26} {'z':>6}  status"
    for row in rows:
        m = row.measurement
        name = m.quantity if m.frequency_cy_per_px is None else f"{m.quantity} at {m.frequency_cy_per_px:.3g} cy/px"
        name += "" if m.orientation_deg is None else f" along {m.orientation_deg:.3g} deg"
        unit = "" if m.unit == "1" else f" {m.unit}"
        measured = f"{row.value_text}{unit}"
        yield f"{name:44} {m.stack or m.method:18} {row.truth_text:>10} {measured:>26} {row.z:6.2f}  {m.status}"
