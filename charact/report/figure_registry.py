"""Figure registry: the plot function and report section of each kind of figure data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from charact.report import bloom_images, blooms, curves, noise
from charact.report.number_format import short_text
from charact.report.style import as_svg, report_style

Data = Mapping[str, Any]
# Kind of figure data: section of the report and plot function (data -> matplotlib figure).
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
    """One figure of the page: its section, title and single values, and the SVG or the reason why there is none."""

    section: str
    title: str
    svg: str | None
    numbers: tuple[tuple[str, str], ...] = ()
    refusal_reason: str = ""


def figure_of(name: str, data: Data) -> Figure:
    """Plot figure data; data that cannot be plotted, such as empty lists, are listed by their single values."""
    kind = str(data.get("figure", name.partition(":")[0]))
    # Profiles through the centre of one source show the MTF, rings of a series the halo.
    kind = "point-spread" if kind == "point-profile" and "along_row_dn" in data else kind
    section, draw = FIGURES.get(kind, ("other", None))
    title, svg, why = figure_title(name, kind), None, f"no figure of the kind {kind!r}"
    if draw is not None:
        try:
            with report_style():
                svg, why = as_svg(draw(data), title), ""
        except (KeyError, ValueError, TypeError, IndexError) as error:
            why = f"its data cannot be plotted ({type(error).__name__}: {error})"
    return Figure(section=section, title=title, svg=svg, numbers=scalars(data), refusal_reason=why)


def figure_title(name: str, kind: str) -> str:
    """Return the title of a figure: name of the data and, after the colon, its stack."""
    what, _, label = name.partition(":")
    text = (what or kind or "figure").replace("-", " ").replace("_", " ")
    return f"{text}, {label}" if label else text


UNITS = {
    "_dn_px2": "DN px²", "_cy_per_px": "cy/px", "_dn_per_e": "DN/e-", "_dn2": "DN²", "_dn": "DN", "_px": "px",
    "_deg": "°", "_s": "s", "_lux": "lux",
}  # fmt: skip


def scalars(data: Data) -> tuple[tuple[str, str], ...]:
    """Return the single values of figure data, with the unit that the name ends in."""
    single = (int, float, str, bool)
    found = {key: value for key, value in data.items() if key != "figure" and isinstance(value, single)}
    return tuple(_with_unit(key, value) for key, value in found.items())


def _with_unit(key: str, value: Any) -> tuple[str, str]:
    for suffix, unit in UNITS.items():
        if key.endswith(suffix):
            return key.removesuffix(suffix).replace("_", " "), f"{short_text(value)} {unit}"
    return key.replace("_", " "), short_text(value)
