"""The summary of a camera whose noise is white, in the words of EMVA 1288."""

from dataclasses import dataclass

from charact.report.tables import QuantityRow, quantity_row
from labdata.measurement import Measurement, Result

# Quantity, unit, the standard's name and symbol, and the section of its Release 3.1 that defines it.
NAMES = (
    ("quantum_efficiency", "%", "Quantum efficiency η", "2.1"),
    ("system_gain", "DN/e-", "Overall system gain K", "2.2"),
    ("read_noise", "e-", "Temporal dark noise σ_d", "2.2"),
    ("read_noise", "DN", "Temporal dark noise σ_y.dark", "2.2"),
    ("snr_max", "1", "Largest signal-to-noise ratio SNR_max", "2.3"),
    ("saturation_capacity", "e-", "Saturation capacity μ_e.sat", "2.4"),
    ("dynamic_range", "1", "Dynamic range DR", "2.4"),
    ("linearity_error", "%", "Linearity error LE", "6.7"),
    ("dark_current", "e-/s", "Dark current μ_I.mean", "3.1"),
    ("dark_doubling_temperature", "K", "Doubling temperature T_d", "3.2"),
    ("dsnu", "e-", "Dark signal non-uniformity DSNU_1288", "4.1"),
    ("prnu", "%", "Photoresponse non-uniformity PRNU_1288", "4.1"),
    ("defect_pixels", "px", "Defect pixels, by the rule in the notes", "4.3"),
)


@dataclass(frozen=True, kw_only=True)
class EmvaSummary:
    """The figures of the standard, or why there are none.

    Parameters
    ----------
    rows
        The standard's name, the section that defines it, and the measurement.
    left_out
        Names of what was not measured.
    reason
        Why the standard does not apply; "" where it does.
    """

    rows: tuple[tuple[str, str, QuantityRow], ...] = ()
    left_out: tuple[str, ...] = ()
    reason: str = ""


def emva_summary(result: Result) -> EmvaSummary | None:
    """Return the figures of the standard; None for a result without any gain.

    The standard's model is that of white noise: where neighbouring pixels share noise, as behind an intensifier, a
    variance is no count of electrons, and none of its figures is given.
    """
    gains = (*result.find("system_gain"), *result.find("covariance_gain"))
    if not any(m.value is not None for m in gains):
        return None
    white = [m for m in result.find("system_gain") if m.value is not None and "correlated-noise" not in m.flags]
    if not white:
        return EmvaSummary(
            reason="EMVA 1288 takes noise for white, and neighbouring pixels of this camera share theirs (as behind an "
            "intensifier): its photon transfer curve would read the gain low by the blur factor, and every figure in "
            "electrons with it. The covariance gain above takes its place."
        )
    rows, left_out = [], []
    for quantity, unit, name, section in NAMES:
        found = _best(result.find(quantity, unit=unit))
        if found is None:
            left_out.append(name)
        else:
            rows.append((name, section, quantity_row(found, found.stack or "")))
    return EmvaSummary(rows=tuple(rows), left_out=tuple(left_out))


def _best(found: tuple[Measurement, ...]) -> Measurement | None:
    """The first trusted measurement with a number, else the first with one."""
    known = [m for m in found if m.value is not None]
    return next((m for m in known if m.status == "ok"), known[0] if known else None)
