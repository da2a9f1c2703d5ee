"""MTF of edges, bar targets, point sources and flat-field noise."""

from charact.estimators.mtf.dispatch import (
    LocatedTarget,
    drop_duplicate_frames,
    measure,
    measure_all,
    measure_flats,
    spread_over_frame,
)
from labdata.lazy_names import import_on_first_use

__all__ = [
    "LocatedTarget",
    "drop_duplicate_frames",
    "measure",
    "measure_all",
    "measure_flats",
    "spread_over_frame",
]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.estimators.mtf.bars.group_curve": "fit_group_curve frame_curves session_curves",
        "charact.estimators.mtf.curve": "FINE REPORTED crossing_frequency curve_of",
        "charact.estimators.mtf.edge.checks": "edge_findings",
        "charact.estimators.mtf.edge.conventional": "edge_gradient",
        "charact.estimators.mtf.edge.parametric": "edge_parametric",
        "charact.estimators.mtf.edge.pixels.prepare_edge": "PreparedEdge prepare_edge",
        "charact.estimators.mtf.mean_frame": "usable_black_level",
        "charact.estimators.mtf.point.forward": "point_forward",
        "charact.estimators.mtf.point.parametric": "point_parametric",
        "charact.estimators.mtf.point.spot_transform": "point_spread",
        "charact.estimators.mtf.session.consistency": "mtf_consistency mtf_uniformity",
        "charact.estimators.mtf.session.joint": "fit_joint_mtf",
        "charact.estimators.mtf.session.mtf_budget": (
            "MeasuredCurve MeasuredCurves add_mtf_budget fit_mtf_budget"
        ),
        "charact.estimators.mtf.session.stage_transfers": "Direction",
        "charact.estimators.mtf.target_detection": (
            "DetectedEdge find_bar_groups find_edges find_pinholes"
        ),
        "charact.estimators.mtf.target_motion": "TargetMotion measure_target_motion",
    },
)
