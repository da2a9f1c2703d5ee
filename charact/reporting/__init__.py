"""Report of a session as one self-contained HTML file, with a comparison to the truth where it is
known.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import lazy_names

if TYPE_CHECKING:
    from charact.reporting.annotated_image import (
        render_annotations,
        unusable_edges,
        write_annotated_image,
    )
    from charact.reporting.bloom_images import plot_bloom_frames, plot_bloom_map
    from charact.reporting.corner import corner_svg
    from charact.reporting.emva_sheet import emva_summary, emva_xml
    from charact.reporting.figure_registry import FIGURES, figure_of
    from charact.reporting.figure_svg import as_svg
    from charact.reporting.frequency_unit import FrequencyUnit
    from charact.reporting.front_page import leading, sheet, verdict
    from charact.reporting.number_format import round_to_spread
    from charact.reporting.session_page import fragment, page, write
    from charact.reporting.style import report_style, white_style
    from charact.reporting.tables import quantity_groups
    from charact.reporting.truth import compare_with_truth
    from charact.reporting.validation import validation_section

__all__ = [
    "FIGURES",
    "FrequencyUnit",
    "as_svg",
    "compare_with_truth",
    "corner_svg",
    "emva_summary",
    "emva_xml",
    "figure_of",
    "fragment",
    "leading",
    "page",
    "plot_bloom_frames",
    "plot_bloom_map",
    "quantity_groups",
    "render_annotations",
    "report_style",
    "round_to_spread",
    "sheet",
    "unusable_edges",
    "validation_section",
    "verdict",
    "white_style",
    "write",
    "write_annotated_image",
]

_HOMES = {
    "charact.reporting.annotated_image": (
        "render_annotations",
        "unusable_edges",
        "write_annotated_image",
    ),
    "charact.reporting.bloom_images": (
        "plot_bloom_frames",
        "plot_bloom_map",
    ),
    "charact.reporting.corner": ("corner_svg",),
    "charact.reporting.emva_sheet": (
        "emva_summary",
        "emva_xml",
    ),
    "charact.reporting.figure_registry": (
        "FIGURES",
        "figure_of",
    ),
    "charact.reporting.figure_svg": ("as_svg",),
    "charact.reporting.frequency_unit": ("FrequencyUnit",),
    "charact.reporting.front_page": (
        "leading",
        "sheet",
        "verdict",
    ),
    "charact.reporting.number_format": ("round_to_spread",),
    "charact.reporting.session_page": (
        "fragment",
        "page",
        "write",
    ),
    "charact.reporting.style": (
        "report_style",
        "white_style",
    ),
    "charact.reporting.tables": ("quantity_groups",),
    "charact.reporting.truth": ("compare_with_truth",),
    "charact.reporting.validation": ("validation_section",),
}

__getattr__ = lazy_names(__name__, _HOMES)
