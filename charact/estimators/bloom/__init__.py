"""Halo and blooming of overexposed point sources and illuminated edges."""

from dataclasses import replace

from charact.estimators.bloom.defects import with_sound_pixels
from charact.frames.stack import Stack
from charact.method import Context, choose
from charact.verdict import judge
from labdata import BadInput, Result, Session
from labdata.lazy_names import import_on_first_use

__all__ = ["measure"]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.estimators.bloom.bloom_map": "map_of spread_from",
        "charact.estimators.bloom.column_artefacts": (
            "column_artefact_mask streak_measurements streak_of"
        ),
        "charact.estimators.bloom.extent": "extent_at",
        "charact.estimators.bloom.lit_edge_halo": "measure_lit_edge",
        "charact.estimators.bloom.point_stack": "read_point_stacks",
        "charact.estimators.bloom.posterior_psf": "PosteriorPsf",
        "charact.estimators.bloom.series_consistency": "check_consistency",
        "charact.estimators.bloom.single_frame": "BEYOND_ONE_FRAME bare_session measure_frame",
        "charact.estimators.bloom.smear": "smear_measurement",
        "charact.estimators.bloom.source_view": "view_of",
    },
)

# Method for edges, see `charact.estimators.bloom.lit_edge_halo`.
EXTENDED = "lit-edge"


def measure(
    session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context
) -> Result:
    """Measure halo diameter, bloom diameter and streak length from the point sources of a session,
    else from its edges.

    Parameters
    ----------
    session
        Session with at least one stack of kind "point", or, for the halo alone, of kind "edge".
    method
        "auto" or the name of a registered method of kind "bloom"; "lit-edge" for edges.
    within_percent
        Tolerance that the automatic choice must meet, percent.
    context
        Settings common to all methods.

    Raises
    ------
    BadInput
        If the session has no point source, or the method is unknown.
    """
    if method == EXTENDED or (
        method == "auto" and session.of_kind("edge") and not session.of_kind("point")
    ):
        return choose(EXTENDED).function(session, context=context)
    session, bad = with_sound_pixels(session)
    chosen = choose("bloom", method, within_percent=within_percent)
    if not session.of_kind("point"):
        raise BadInput(
            "blooming needs stacks of kind point, got only "
            f"{sorted({s.kind for s in session.stacks})}"
        )
    result = chosen.function(session, context=context)
    note = f"{bad} stuck, hot or hit pixels are excluded or replaced by their neighbours' mean"
    noted = (m.with_(notes=(*m.notes, note)) if bad else m for m in result.measurements)
    lost = {
        entry.label: Stack.of(entry.read(), context).layout_findings(None)[0]
        for entry in session.of_kind("point")
    }
    every = [finding for findings in lost.values() for finding in findings]
    judged = (judge(m, every if m.stack is None else lost.get(m.stack, ())) for m in noted)
    return replace(result, measurements=tuple(judged))
