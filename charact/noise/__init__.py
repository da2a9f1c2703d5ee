"""Noise and gain from dark and uniformly illuminated frames."""

from charact.method import Context, choose
from charact.method.stopwatch import with_timing
from labdata.errors import BadInput
from labdata.measurement import Result
from labdata.session import Session

__all__ = ["measure"]


@with_timing
def measure(session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context) -> Result:
    """Measure noise and gain from darks and flats, 3-D noise, and single photoelectrons in intensified darks.

    Parameters
    ----------
    session
        Session with at least one dark or flat stack.
    method
        "auto" or the name of a registered method of kind "flats".
    within_percent
        Tolerance that the automatic choice must meet, percent.
    context
        Settings of the method.

    Raises
    ------
    BadInput
        If the session has neither darks nor flats, or the method is unknown.
    """
    chosen = choose("flats", method, within_percent=within_percent)
    if not session.of_kind("dark", "flat"):
        raise BadInput(f"noise needs dark or flat stacks, got only {sorted({s.kind for s in session.stacks})}")
    from charact.noise.gain_separation import add_event_gains
    from charact.noise.prepared_session import defect_pixels, prepare

    ready = prepare(session, context=context)
    session, context = ready.session, ready.context
    result = add_event_gains(chosen.function(session, context=context), session, context=context)
    return ready.in_dn(result) + defect_pixels(session, ready.surveys, ready.found, context=context)
