"""Rows of a data sheet of EMVA 1288 Release 4.0 Linear (16 June 2021): quantities under the names,
symbols and units of the standard.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import log2, log10
from typing import Any

from labdata.quantity import QUANTITIES, StandardRow

# How the note of a number begins that says what the standard makes of correlated noise.
BY_VARIANCE = "with the slope of the variance as gain, as EMVA 1288 has it: "
# Remarks on quantities that have two definitions, by the endings of their names. The first is that
# of the reference program of the EMVA 1288 group (1.0.2), whose elements have no ending; the second
# is new in Release 4.0 (6.6, 8.1).
SATURATIONS = {
    "": "saturation at the largest variance",
    "_full_scale": "saturation at 0.1 % of full pixels",
}
FILTERS = {
    "": "frames as recorded",
    "_filtered": "behind the high-pass filter of 8.1",
}
PARTS = {
    "": ("", "", ""),
    "_row": (" of rows", ".row", "_row"),
    "_column": (" of columns", ".col", "_col"),
    "_pixel": (" of pixels", ".pixel", "_pixel"),
}


def _decibel(ratio: float) -> float:
    return 20.0 * log10(ratio)


def _reciprocal(value: float) -> float:
    return 1.0 / value


def _row(
    quantity: str, unit: str, name: str, symbol: str, clause: str, element: str, **more: Any
) -> StandardRow:
    """Return a row; `element`: "part/name" in the results of the EMVA 1288 group's program."""
    part, _, name_of_part = element.partition("/")
    return StandardRow(
        quantity=quantity,
        unit=unit,
        name=name,
        symbol=symbol,
        clause=clause,
        element=(part, name_of_part),
        **more,
    )


def _in_decibel(row: StandardRow) -> StandardRow:
    """Return the row of a ratio in decibel."""
    part, name = row.element
    symbol = f"{row.symbol}.dB" if "_" in row.symbol else f"{row.symbol}_dB"
    element = (part, name.replace(row.symbol, f"{row.symbol}_dB"))
    return replace(
        row, symbol=symbol, element=element, shown_unit="dB", convert=_decibel, detail=True
    )


def _range_rows() -> Iterator[StandardRow]:
    """Yield saturation, largest signal-to-noise ratio and dynamic range by both definitions."""
    for suffix, remark in SATURATIONS.items():
        more = {"remark": remark, "detail": bool(suffix)}
        ratio = _row(
            f"snr_max{suffix}",
            "1",
            "Largest signal-to-noise ratio",
            "SNR_max",
            "2.6, eq. 55",
            f"sensitivity/SNR_max{suffix}",
            **more,
        )
        bits = replace(
            ratio,
            symbol="SNR_max.bit",
            element=("sensitivity", f"SNR_max_bit{suffix}"),
            shown_unit="bit",
            convert=log2,
            detail=True,
        )
        span = _row(
            f"dynamic_range{suffix}",
            "1",
            "Dynamic range",
            "DR",
            "eq. 28",
            f"sensitivity/DR{suffix}",
            **more,
        )
        capacity = f"saturation_capacity{suffix}"
        element = f"sensitivity/u_e_sat{suffix}"
        yield _row(capacity, "e-", "Saturation capacity", "μ_e.sat", "2.7, eq. 24", element, **more)
        yield _row(
            f"saturation_exposure{suffix}",
            "photons/px",
            "Saturation exposure",
            "μ_p.sat",
            "2.7, 6.6",
            f"sensitivity/u_p_sat{suffix}",
            shown_unit="photons",
            **(more | {"detail": True}),
        )
        yield from (ratio, _in_decibel(ratio), bits, span, _in_decibel(span))


def _nonuniformity_rows() -> Iterator[StandardRow]:
    """Yield DSNU and PRNU with their parts, as the frames are and behind the filter."""
    for suffix, remark in FILTERS.items():
        for name, unit, title, clause, mark in (
            ("dsnu", "e-", "Dark signal non-uniformity", "eq. 42, 66", ""),
            ("dsnu", "DN", "Dark signal non-uniformity", "eq. 42, 66", "_DN"),
            ("prnu", "%", "Photoresponse non-uniformity", "eq. 42, 67", ""),
        ):
            for part, (of_lines, index, element) in PARTS.items():
                if part and mark:
                    continue
                symbol = name.upper()
                yield _row(
                    f"{name}_1288{part}{suffix}",
                    unit,
                    title + of_lines,
                    f"{symbol}_1288{index}",
                    f"{clause}, 8.1" if suffix else clause,
                    f"spatial/{symbol}1288{element}{mark}{suffix}",
                    remark=remark,
                    detail=bool(part or suffix or mark),
                )


ELEMENTS = (
    _row("quantum_efficiency", "%", "Quantum efficiency", "η", "eq. 52", "sensitivity/QE"),
    _row("responsivity", "DN/photon", "Responsivity", "R", "eq. 49", "sensitivity/R"),
    _row("system_gain", "DN/e-", "System gain", "K", "eq. 50", "sensitivity/K"),
    _row(
        "system_gain",
        "DN/e-",
        "Inverse of the system gain",
        "1/K",
        "eq. 50",
        "sensitivity/inverse_K",
        shown_unit="e-/DN",
        convert=_reciprocal,
        detail=True,
    ),
    _row("read_noise", "e-", "Temporal dark noise", "σ_d", "eq. 53", "sensitivity/sigma_d"),
    _row(
        "read_noise",
        "DN",
        "Temporal dark noise",
        "σ_y.dark",
        "eq. 53",
        "sensitivity/sigma_y_dark",
    ),
    _row(
        "sensitivity_threshold",
        "photons/px",
        "Absolute sensitivity threshold",
        "μ_p.min",
        "eq. 26",
        "sensitivity/u_p_min",
        shown_unit="photons",
    ),
    _row(
        "sensitivity_threshold",
        "e-",
        "Absolute sensitivity threshold",
        "μ_e.min",
        "eq. 27",
        "sensitivity/u_e_min",
        detail=True,
    ),
    *_range_rows(),
    _row("linearity_error", "%", "Linearity error", "LE", "6.9, eq. 63", "linearity/LE"),
    _row(
        "linearity_error_min",
        "%",
        "Smallest deviation from linearity",
        "LE_min",
        "eq. 62",
        "linearity/LE_min",
        detail=True,
    ),
    _row(
        "linearity_error_max",
        "%",
        "Largest deviation from linearity",
        "LE_max",
        "eq. 62",
        "linearity/LE_max",
        detail=True,
    ),
    *_nonuniformity_rows(),
    _row(
        "defect_pixels",
        "px",
        "Defect pixels by the rule in the notes",
        "",
        "8.8",
        "defect_pixel/defects",
    ),
    _row(
        "dark_current",
        "e-/s",
        "Dark current from the mean",
        "μ_I.mean",
        "7.1, eq. 29",
        "dark_current/u_I_mean",
    ),
    _row(
        "dark_current",
        "DN/s",
        "Dark current from the mean",
        "μ_I.mean.DN",
        "7.1, eq. 29",
        "dark_current/u_I_mean_DN",
        detail=True,
    ),
    _row(
        "dark_current_from_variance",
        "e-/s",
        "Dark current from the variance",
        "μ_I.var",
        "7.1, eq. 30",
        "dark_current/u_I_var",
        detail=True,
    ),
    _row(
        "dark_current_from_variance",
        "DN/s",
        "Dark current from the variance",
        "μ_I.var.DN",
        "7.1, eq. 30",
        "dark_current/u_I_var_DN",
        detail=True,
    ),
    _row(
        "dark_doubling_temperature",
        "K",
        "Doubling temperature of the dark current",
        "T_d",
        "3.2",
        "dark_current/T_d",
    ),
)


def sheet_rows() -> list[StandardRow]:
    """Return the rows of the sheet in their order, and those of statistics declared later."""
    declared = (
        replace(row, quantity=name) for name, known in QUANTITIES.items() for row in known.standard
    )
    return [*ELEMENTS, *declared]
