"""Report of a session as one self-contained HTML file, with a comparison to the truth where it is
known.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from charact.reporting.annotated_image import (
        VERDICT_COLOURS,
        place_captions,
        render_annotations,
        unusable_edges,
        write_annotated_image,
    )
    from charact.reporting.bloom_images import add_extent_data, plot_bloom_frames, plot_bloom_map
    from charact.reporting.corner import corner_svg, varying
    from charact.reporting.emva_page import write_sheet
    from charact.reporting.emva_sheet import emva_summary, emva_xml, in_standard_unit, sheet_rows
    from charact.reporting.figure_registry import FIGURES, figure_of
    from charact.reporting.figure_svg import as_svg
    from charact.reporting.frequency_unit import FrequencyUnit
    from charact.reporting.front_page import is_tube, leading, sheet, verdict
    from charact.reporting.report_images import bright_region, representative
    from charact.reporting.session_page import fragment, page, write
    from charact.reporting.style import report_style, white_style
    from charact.reporting.summary import rows_of_file, sparkline, summary_of
    from charact.reporting.tables import quantity_groups
    from charact.reporting.truth import TruthComparison, compare_with_truth
    from charact.reporting.validation import blind_pair, validation_section
    from charact.reporting.validation_figures import (
        chance_limit,
        deviations,
        missing_figures,
        worst_numbers,
    )
    from charact.reporting.validation_text import headline_of, sentence_of
    from labdata.number_format import round_to_spread

__all__ = [
    "FIGURES",
    "VERDICT_COLOURS",
    "FrequencyUnit",
    "TruthComparison",
    "add_extent_data",
    "as_svg",
    "blind_pair",
    "bright_region",
    "chance_limit",
    "compare_with_truth",
    "corner_svg",
    "deviations",
    "emva_summary",
    "emva_xml",
    "figure_of",
    "fragment",
    "headline_of",
    "in_standard_unit",
    "is_tube",
    "leading",
    "missing_figures",
    "page",
    "place_captions",
    "plot_bloom_frames",
    "plot_bloom_map",
    "quantity_groups",
    "render_annotations",
    "report_style",
    "representative",
    "round_to_spread",
    "rows_of_file",
    "sentence_of",
    "sheet",
    "sheet_rows",
    "sparkline",
    "summary_of",
    "unusable_edges",
    "validation_section",
    "varying",
    "verdict",
    "white_style",
    "worst_numbers",
    "write",
    "write_annotated_image",
    "write_sheet",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.reporting.annotated_image": (
            "VERDICT_COLOURS place_captions render_annotations unusable_edges write_annotated_image"
        ),
        "charact.reporting.bloom_images": "add_extent_data plot_bloom_frames plot_bloom_map",
        "charact.reporting.corner": "corner_svg varying",
        "charact.reporting.emva_page": "write_sheet",
        "charact.reporting.emva_sheet": "emva_summary emva_xml in_standard_unit sheet_rows",
        "charact.reporting.figure_registry": "FIGURES figure_of",
        "charact.reporting.figure_svg": "as_svg",
        "charact.reporting.frequency_unit": "FrequencyUnit",
        "charact.reporting.front_page": "is_tube leading sheet verdict",
        "labdata.number_format": "round_to_spread",
        "charact.reporting.report_images": "bright_region representative",
        "charact.reporting.session_page": "fragment page write",
        "charact.reporting.style": "report_style white_style",
        "charact.reporting.summary": "rows_of_file sparkline summary_of",
        "charact.reporting.tables": "quantity_groups",
        "charact.reporting.truth": "TruthComparison compare_with_truth",
        "charact.reporting.validation": "blind_pair validation_section",
        "charact.reporting.validation_text": "headline_of sentence_of",
        "charact.reporting.validation_figures": (
            "chance_limit deviations missing_figures worst_numbers"
        ),
    },
)
