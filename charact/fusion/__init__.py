"""Fusion of visible and thermal frames: rules, registration, noise reduction and scores."""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from charact.fusion.alignment import align_bands, common_field, crop_band, crop_bands
    from charact.fusion.bands import Band, display_planes
    from charact.fusion.fused import MARKS, Fused, level_uncertainty
    from charact.fusion.geometry import CameraGeometry, place_pixels
    from charact.fusion.noise_aware import (
        ColourTable,
        fuse_by_table,
        fuse_levels,
        fuse_noise_aware,
        make_colour_table,
    )
    from charact.fusion.noise_law import blur_px_of, estimate_noise, measure_noise
    from charact.fusion.pictures import (
        COLOURED,
        filtered_law,
        fuse,
        fuse_all,
        fuse_sequence,
        pair_frames,
        reduce_noise,
        variance_ratio,
    )
    from charact.fusion.pyramid import (
        collapse,
        decompose,
        fill_holes,
        level_count,
        noise_gains,
        resized,
    )
    from charact.fusion.registration import residual_shift
    from charact.fusion.scores import Score, score
    from charact.fusion.sources import Source, band_of, read_source
    from charact.fusion.truth import (
        FusionTruth,
        artefact_share,
        detectability2,
        fit_to_truth,
        object_channels,
        restoration_errors,
        truth_scores,
    )

__all__ = [
    "COLOURED",
    "MARKS",
    "Band",
    "CameraGeometry",
    "ColourTable",
    "Fused",
    "FusionTruth",
    "Score",
    "Source",
    "align_bands",
    "artefact_share",
    "band_of",
    "blur_px_of",
    "collapse",
    "common_field",
    "crop_band",
    "crop_bands",
    "decompose",
    "detectability2",
    "display_planes",
    "estimate_noise",
    "fill_holes",
    "filtered_law",
    "fit_to_truth",
    "fuse",
    "fuse_all",
    "fuse_by_table",
    "fuse_levels",
    "fuse_noise_aware",
    "fuse_sequence",
    "level_count",
    "level_uncertainty",
    "make_colour_table",
    "measure_noise",
    "noise_gains",
    "object_channels",
    "pair_frames",
    "place_pixels",
    "read_source",
    "reduce_noise",
    "residual_shift",
    "resized",
    "restoration_errors",
    "score",
    "truth_scores",
    "variance_ratio",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.fusion.alignment": "align_bands common_field crop_band crop_bands",
        "charact.fusion.bands": "Band display_planes",
        "charact.fusion.fused": "Fused MARKS level_uncertainty",
        "charact.fusion.geometry": "CameraGeometry place_pixels",
        "charact.fusion.noise_aware": (
            "ColourTable fuse_by_table fuse_levels fuse_noise_aware make_colour_table"
        ),
        "charact.fusion.noise_law": "blur_px_of estimate_noise measure_noise",
        "charact.fusion.pictures": (
            "COLOURED filtered_law fuse fuse_all fuse_sequence pair_frames reduce_noise "
            "variance_ratio"
        ),
        "charact.fusion.pyramid": "collapse decompose fill_holes level_count noise_gains resized",
        "charact.fusion.registration": "residual_shift",
        "charact.fusion.scores": "Score score",
        "charact.fusion.sources": "Source band_of read_source",
        "charact.fusion.truth": (
            "FusionTruth artefact_share detectability2 fit_to_truth object_channels "
            "restoration_errors truth_scores"
        ),
    },
)
