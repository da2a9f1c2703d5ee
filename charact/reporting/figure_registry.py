"""Figure registry: the plot function and report section of each kind of figure data; the figure of
a tube's resolution.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.reporting import (
    bloom_images,
    blooms,
    curves,
    emva_figures,
    gain_sweep,
    noise,
    session_curves,
)
from charact.reporting.figure_svg import as_svg
from charact.reporting.frequency_unit import unit_title
from charact.reporting.style import COLOURS, arms, first_array, panels, plot_line, report_style
from charact.reporting.summary import Frequency, in_cycles_per_pixel

Data = Mapping[str, Any]
DIRECTIONS = {0.0: "along rows", 90.0: "along columns"}
# Lights whose contrast is drawn, from the dimmest on.
MOST_LIGHTS = 4


def plot_resolution(data: Data) -> Any:
    """Plot limiting resolution against light in each direction, and the least contrast along the
    first one.
    """
    from matplotlib.ticker import NullFormatter

    figure, grid = panels(1, 2, size=(6.4, 3.4))
    limit_axes, contrast_axes = grid[0]
    light = first_array(data, "illuminance_lux")
    for colour, direction in zip(COLOURS, data["directions"], strict=False):
        known = [
            (lux, limit, *interval)
            for lux, limit, interval in zip(
                light, direction["limit_lp_per_mm"], direction["limit_interval95"], strict=True
            )
            if limit is not None
        ]
        lux, limit, low, high = zip(*known, strict=True)
        limit_axes.errorbar(
            lux,
            limit,
            yerr=arms(limit, low, high),
            color=colour,
            marker="o",
            markersize=3.5,
            label=DIRECTIONS[direction["orientation_deg"]],
        )
    limit_axes.set(
        xscale="log",
        xlabel="illuminance on the photocathode (lux)",
        ylabel="limiting resolution (lp/mm)",
    )
    limit_axes.xaxis.set_minor_formatter(NullFormatter())
    limit_axes.legend(fontsize=7)
    first = data["directions"][0]
    step = -(-len(light) // MOST_LIGHTS)
    for colour, lux, contrast in zip(
        COLOURS, light[::step], first["contrast"][::step], strict=False
    ):
        plot_line(
            contrast_axes,
            first["frequency_lp_per_mm"],
            contrast,
            color=colour,
            label=f"{lux:.2g} lux",
        )
    contrast_axes.set(
        yscale="log",
        ylim=(None, 1.0),
        xlabel=f"frequency {DIRECTIONS[first['orientation_deg']]} (lp/mm)",
        ylabel="least resolvable contrast (1)",
    )
    contrast_axes.legend(fontsize=7)
    return figure


# Kind of figure data: section of the report, plot function (data -> matplotlib figure) and caption.
FIGURES: dict[str, tuple[str, Callable[[Data], Any], str]] = {
    "edge-spread": (
        "mtf",
        curves.plot_edge_spread,
        "The edge spread function with the fitted model, and the residual below.",
    ),
    "sfr": (
        "mtf",
        session_curves.plot_sfr,
        "The conventional SFR of ISO 12233 and the MTF of the same edge.",
    ),
    "neq": (
        "mtf",
        session_curves.plot_neq,
        "Noise-equivalent quanta of edge and flats, with 95 % bands.",
    ),
    "through-focus": (
        "mtf",
        session_curves.plot_through_focus,
        "MTF50 against the position of the focus, with the fitted curve.",
    ),
    "bars": (
        "mtf",
        curves.plot_bars,
        "The profile across the bars with the fitted model, and the residual below.",
    ),
    "point-spread": (
        "mtf",
        blooms.plot_point_spread,
        "Profiles through the centre of the point source with the fitted model.",
    ),
    "agreement": (
        "mtf",
        curves.plot_mtf_differences,
        (
            "Differences between the MTFs of the targets at the bar frequencies; an interval that "
            "holds zero is agreement."
        ),
    ),
    "joint-mtf": (
        "mtf",
        curves.plot_joint_mtf,
        (
            "Distance of each target from the joint MTF; 95 % of the points lie in the band if the "
            "targets agree."
        ),
    ),
    "constancy": (
        "mtf",
        curves.plot_mtf_uniformity,
        (
            "MTF50 of the targets against place and settings; a slope shows that the MTF is not "
            "uniform."
        ),
    ),
    "stage-budget": (
        "mtf",
        curves.plot_mtf_budget,
        "MTF of every stage of the camera, their product, and the measured MTF.",
    ),
    "limiting-resolution": (
        "mtf",
        plot_resolution,
        "Limiting resolution against light with 95 % intervals, and the least contrast of bars "
        "that an observer resolves at several lights.",
    ),
    "bar-groups": (
        "mtf",
        curves.plot_bar_groups,
        "MTF of each group of bars and the curve through them.",
    ),
    "point-profile": (
        "bloom",
        blooms.plot_point_profile,
        "Mean signal in rings around the point source at several overloads, with the fitted model.",
    ),
    "bloom-series": (
        "bloom",
        blooms.plot_bloom_series,
        "Extent of the bloom against the exposure of the point source; bars and bands hold 95 %.",
    ),
    "halo-constancy": (
        "bloom",
        blooms.plot_halo_uniformity,
        "Halo diameter of each stack by itself; one camera has one halo.",
    ),
    "bloom-forms": (
        "bloom",
        blooms.plot_spread_models,
        "Evidence of the forms of spread that were tried; the smallest bar is the best.",
    ),
    "lit-edge": (
        "bloom",
        blooms.plot_illuminated_edge,
        "Signal on the dark side of the edge against distance, with the halo that fits it.",
    ),
    "bloom-smear": (
        "bloom",
        blooms.plot_smear,
        "Signal in the columns of the source, away from it, against the source's light.",
    ),
    "bloom-constancy": (
        "bloom",
        blooms.plot_series_stability,
        "Background level and place of the source through the series; drift would show as a slope.",
    ),
    "bloom-frames": (
        "bloom",
        bloom_images.plot_bloom_frames,
        "Frames of the series with the measured halo and bloom drawn.",
    ),
    "bloom-map": (
        "bloom",
        bloom_images.plot_bloom_map,
        "Fraction of each pixel's signal that is blooming.",
    ),
    "photon-transfer": (
        "noise",
        noise.plot_photon_transfer,
        "Temporal variance and summed covariance against the signal; the slopes are the gains.",
    ),
    "noise-spectrum": (
        "noise",
        noise.plot_noise_spectrum,
        "Noise power of the flats against frequency with the fitted post-gain MTF.",
    ),
    "post-gain-noise": (
        "noise",
        noise.plot_post_gain_noise,
        "Noise power added after the gain, along rows and columns.",
    ),
    "noise-against-gain": (
        "noise",
        gain_sweep.plot_noise_against_gain,
        "Gain against its setting, and the noise at each gain.",
    ),
    "noise-by-gain": (
        "noise",
        gain_sweep.plot_noise_by_gain,
        "Temporal noise against the signal at each gain setting.",
    ),
    "autocorrelation": (
        "noise",
        noise.plot_autocorrelation,
        (
            "Correlation of the noise between neighbouring pixels and between exposures; zero is "
            "white noise without lag."
        ),
    ),
    "predictive-frames": (
        "noise",
        noise.plot_predictive_checks,
        "Statistics of the frames and those that the fitted noise predicts.",
    ),
    "snr-light": (
        "noise",
        noise.plot_snr,
        "Signal-to-noise ratio against the light, and the light at which it is one.",
    ),
    "signal-transfer": (
        "noise",
        noise.plot_signal_transfer,
        (
            "Mean signal against the temperature of the black body, and the departure of each "
            "level from the fitted law."
        ),
    ),
    "three-dimensional-noise": (
        "noise",
        noise.plot_three_dimensional_noise,
        "Means of exposures, rows and columns, and the power of the frame mean against frequency.",
    ),
    "linearity": (
        "noise",
        emva_figures.plot_linearity,
        "Signal against the light with the line of EMVA 1288, and the deviation from it.",
    ),
    "signal-to-noise-ratio": (
        "noise",
        emva_figures.plot_signal_to_noise_ratio,
        "Signal-to-noise ratio of the levels, of the linear camera model and of an ideal camera.",
    ),
    "dark-current": (
        "noise",
        emva_figures.plot_dark_current,
        "Mean and temporal variance of the darks against their exposure; bars are ± 1 sd.",
    ),
    "spectrograms": (
        "noise",
        emva_figures.plot_spectrograms,
        "Standard deviation by frequency along rows and columns, of the dark and of the response, "
        "shading removed.",
    ),
    "profiles": (
        "noise",
        emva_figures.plot_profiles,
        "Middle line, mean, least and largest value over the picture, of the mean dark and of the "
        "mean flat above it.",
    ),
    "defect-histograms": (
        "noise",
        emva_figures.plot_defect_histograms,
        "Number of pixels by their deviation, and share of the pixels that deviate by more, of the "
        "dark and of the response, shading removed.",
    ),
    "pulse-heights": (
        "noise",
        noise.plot_pulse_heights,
        "Distribution of the pulse heights of single photoelectrons with the fitted law.",
    ),
}


# Titles of data whose names do not read as words.
TITLES = {
    "bloom-constancy": "stability of the point series",
    "bloom-forms": "forms of spread compared",
    "halo-constancy": "halo diameter of each stack",
    "joint-mtf": "targets against their joint MTF",
    "lit-edge": "halo of an edge",
    "post-gain-noise": "noise added after the gain",
    "snr-light": "signal-to-noise ratio against light",
    "three-dimensional-noise": "3-D noise",
}


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure of the page: its section, title and caption, and the SVG or the reason why there
    is none.
    """

    section: str
    title: str
    svg: str | None
    kind: str = ""
    caption: str = ""
    refusal_reason: str = ""


def figure_of(name: str, data: Data, frequency: Frequency = in_cycles_per_pixel) -> Figure:
    """Plot figure data, spatial frequencies in a unit; data that cannot be plotted, such as empty
    lists, have the reason instead.
    """
    kind = kind_of(name, data)
    section, draw, caption = FIGURES.get(kind, ("other", None, ""))
    caption = f"{caption} {data['the_curves_say']}." if "the_curves_say" in data else caption
    title, svg, why = figure_title(name, kind), None, f"no figure of the kind {kind!r}"
    if kind == "bloom-series" and len(data.get("label", ())) < 2:
        draw, why = None, "extent against exposure needs point sources of two exposures or more"
    if draw is not None:
        try:
            with report_style():
                figure = draw(data)
                _show_in_unit(figure, *frequency(1.0, None))
                svg, why = as_svg(figure, title), ""
        except (KeyError, ValueError, TypeError, IndexError) as error:
            why = f"its data cannot be plotted ({type(error).__name__}: {error})"
    return Figure(
        section=section, title=title, svg=svg, kind=kind, caption=caption, refusal_reason=why
    )


def _show_in_unit(figure: Any, per_cycle: float, unit: str) -> None:
    """Label the axes of spatial frequency, which are in cycles per column pitch, in another
    unit.
    """
    from matplotlib.ticker import AutoLocator, FuncFormatter

    class Locator(AutoLocator):
        """Round values of the unit."""

        def tick_values(self, vmin: float, vmax: float) -> Any:
            return np.asarray(super().tick_values(vmin * per_cycle, vmax * per_cycle)) / per_cycle

    for axes in figure.axes if unit != "cy/px" else ():
        for axis in (axes.xaxis, axes.yaxis):
            words = axis.label.get_text()
            shown = re.sub(r"\((cycles per column pitch|cy/px)\)", f"({unit_title(unit)})", words)
            if shown != words:
                axis.set_label_text(shown)
                axis.set_major_locator(Locator())
                axis.set_major_formatter(FuncFormatter(lambda at, _: f"{at * per_cycle:.4g}"))


def kind_of(name: str, data: Data) -> str:
    """Return the kind of figure data, a key of `FIGURES` if it is drawn."""
    kind = str(data.get("figure", name.partition(":")[0]))
    # Profiles through the centre of one source show the MTF, rings of a series the halo.
    return "point-spread" if kind == "point-profile" and "along_row_dn" in data else kind


def figure_title(name: str, kind: str) -> str:
    """Return the title of a figure: name of the data and, after the colon, its stack."""
    what, _, label = name.partition(":")
    text = TITLES.get(what, (what or kind or "figure").replace("-", " ").replace("_", " "))
    return f"{text}, {label}" if label else text
