"""What lies behind the numbers, drawn: each kind of evidence has its figure, an unknown kind its plain numbers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from charact.report import bloom_images, blooms, curves, noise
from charact.report.number_format import short_text
from charact.report.style import as_svg, report_style

Data = Mapping[str, Any]
# Kind of evidence: section of the report and the function that draws it (data -> matplotlib figure).
FIGURES: dict[str, tuple[str, Callable[[Data], Any]]] = {
    "edge-spread": ("mtf", curves.plot_edge_spread),
    "bars": ("mtf", curves.plot_bars),
    "point-spread": ("mtf", blooms.plot_point_spread),
    "agreement": ("mtf", curves.plot_mtf_differences),
    "joint-mtf": ("mtf", curves.plot_joint_mtf),
    "constancy": ("mtf", curves.plot_mtf_uniformity),
    "stage-budget": ("mtf", curves.plot_mtf_budget),
    "bar-groups": ("mtf", curves.plot_bar_groups),
    "point-profile": ("bloom", blooms.plot_point_profile),
    "bloom-series": ("bloom", blooms.plot_bloom_series),
    "halo-constancy": ("bloom", blooms.plot_halo_uniformity),
    "bloom-forms": ("bloom", blooms.plot_spread_models),
    "lit-edge": ("bloom", blooms.plot_illuminated_edge),
    "bloom-smear": ("bloom", blooms.plot_smear),
    "bloom-constancy": ("bloom", blooms.plot_series_stability),
    "bloom-frames": ("bloom", bloom_images.plot_bloom_frames),
    "bloom-map": ("bloom", bloom_images.plot_bloom_map),
    "photon-transfer": ("noise", noise.plot_photon_transfer),
    "noise-spectrum": ("noise", noise.plot_noise_spectrum),
    "post-gain-noise": ("noise", noise.plot_post_gain_noise),
    "noise-against-gain": ("noise", noise.plot_noise_against_gain),
    "noise-by-gain": ("noise", noise.plot_noise_by_gain),
    "autocorrelation": ("noise", noise.plot_autocorrelation),
    "predictive-frames": ("noise", noise.plot_predictive_checks),
    "snr-light": ("noise", noise.plot_snr),
    "three-dimensional-noise": ("noise", noise.plot_three_dimensional_noise),
    "pulse-heights": ("noise", noise.plot_pulse_heights),
}


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure of the page.

    Parameters
    ----------
    section
        "mtf", "noise", "bloom" or "other".
    title
        What it is evidence for.
    svg
        The drawing; None where the kind has none.
    numbers
        Single numbers that belong to it, name and text.
    why_not
        Why there is no drawing.
    """

    section: str
    title: str
    svg: str | None
    numbers: tuple[tuple[str, str], ...] = ()
    why_not: str = ""


def figure_of(name: str, data: Data) -> Figure:
    """Draw one piece of evidence.

    Evidence that its figure cannot draw, for a list is missing or empty, is shown by its numbers, and the page says so.
    """
    kind = str(data.get("figure", name.partition(":")[0]))
    # One source through its centre tells of the MTF, a series of rings of the halo.
    kind = "point-spread" if kind == "point-profile" and "along_row_dn" in data else kind
    section, draw = FIGURES.get(kind, ("other", None))
    title, numbers = figure_title(name, kind), scalars(data)
    if draw is None:
        return Figure(
            section=section, title=title, svg=None, numbers=numbers, why_not=f"no figure of the kind {kind!r}"
        )
    try:
        with report_style():
            svg = as_svg(draw(data), title)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        why = f"its data cannot be drawn ({type(error).__name__}: {error})"
        return Figure(section=section, title=title, svg=None, numbers=numbers, why_not=why)
    return Figure(section=section, title=title, svg=svg, numbers=numbers)


def figure_title(name: str, kind: str) -> str:
    """Title of a figure: the evidence's name and, after the colon, its stack."""
    what, _, label = name.partition(":")
    text = (what or kind or "evidence").replace("-", " ").replace("_", " ")
    return f"{text}, {label}" if label else text


UNITS = {
    "_dn_px2": "DN px²", "_cy_per_px": "cy/px", "_dn_per_e": "DN/e-", "_dn2": "DN²", "_dn": "DN", "_px": "px",
    "_deg": "°",
    "_s": "s",
    "_lux": "lux",
}  # fmt: skip


def scalars(data: Data) -> tuple[tuple[str, str], ...]:
    """The single numbers and words among the evidence, each with the unit that its name ends in."""
    single = (int, float, str, bool)
    found = {key: value for key, value in data.items() if key != "figure" and isinstance(value, single)}
    return tuple(_with_unit(key, value) for key, value in found.items())


def _with_unit(key: str, value: Any) -> tuple[str, str]:
    for suffix, unit in UNITS.items():
        if key.endswith(suffix):
            return key.removesuffix(suffix).replace("_", " "), f"{short_text(value)} {unit}"
    return key.replace("_", " "), short_text(value)
