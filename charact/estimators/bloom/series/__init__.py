"""Forward model of a point series: ring means, blur models, their selection and their
measurements.
"""

from typing import TYPE_CHECKING

from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from charact.estimators.bloom.series.halo_models import HaloModel
    from charact.estimators.bloom.series.likelihood import SeriesLikelihood, series_of
    from charact.estimators.bloom.series.model_selection import candidates
    from charact.estimators.bloom.series.ring_loops import (
        best_step,
        lost_at_top,
        residuals_and_slopes,
        ring_means,
        whiten_rings,
    )
    from charact.estimators.bloom.series.ring_series import build_ring_series
    from charact.estimators.bloom.series.rings import geometry_of, level_of, noise_of

__all__ = [
    "HaloModel",
    "SeriesLikelihood",
    "best_step",
    "build_ring_series",
    "candidates",
    "geometry_of",
    "level_of",
    "lost_at_top",
    "noise_of",
    "residuals_and_slopes",
    "ring_means",
    "series_of",
    "whiten_rings",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.estimators.bloom.series.halo_models": "HaloModel",
        "charact.estimators.bloom.series.likelihood": "SeriesLikelihood series_of",
        "charact.estimators.bloom.series.model_selection": "candidates",
        "charact.estimators.bloom.series.ring_loops": (
            "best_step lost_at_top residuals_and_slopes ring_means whiten_rings"
        ),
        "charact.estimators.bloom.series.ring_series": "build_ring_series",
        "charact.estimators.bloom.series.rings": "geometry_of level_of noise_of",
    },
)
