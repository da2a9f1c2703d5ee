"""Noise and gain from dark and uniformly illuminated frames."""

from dataclasses import replace
from typing import TYPE_CHECKING

from charact.method import Context, Method, choose
from charact.method.stopwatch import with_timing
from labdata import BadInput, Measurement, Result, Session, open_lazy_stack
from labdata.lazy_names import import_on_first_use

if TYPE_CHECKING:
    from charact.estimators.noise.prepared_session import Prepared

__all__ = ["measure"]

__getattr__ = import_on_first_use(
    __name__,
    {
        "charact.estimators.noise.events.event_measurements": "measure_events pulses_of_darks",
        "charact.estimators.noise.findings": "step_finding",
        "charact.estimators.noise.gain.emva1288": "gain_line",
        "charact.estimators.noise.gain.series": "read_levels series_of",
        "charact.estimators.noise.gain.single_setting": "fit_single_setting",
        "charact.estimators.noise.gain_separation": (
            "add_event_gains posterior_of separate_gains snr_from_specification"
        ),
        "charact.estimators.noise.illumination": (
            "photoelectrons_per_photon table_sensitivity_ua_per_lm"
        ),
        "charact.estimators.noise.sweep.settings": "KNOBS Sweep",
        "charact.estimators.noise.sweep.sweep": "measure_sweep",
    },
)


@with_timing
def measure(
    session: Session, *, method: str = "auto", within_percent: float = 2.0, context: Context
) -> Result:
    """Measure noise and gain from darks and flats, 3-D noise, and single photoelectrons in
    intensified darks.

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
        If the session has neither darks nor flats, or flats of a black body, or the method or the
        context's amplifier is unknown.
    """
    chosen = choose("flats", method, within_percent=within_percent)
    if not session.of_kind("dark", "flat"):
        raise BadInput(
            f"noise needs dark or flat stacks, got only {sorted({s.kind for s in session.stacks})}"
        )
    heated = [
        entry.label for entry in session.of_kind("flat") if entry.conditions.blackbody_c is not None
    ]
    if heated:
        raise BadInput(
            f"noise against light needs flats of light, got {', '.join(heated)} of a black body "
            "(blackbody_c): measure the session with charact.noise(SESSION) or "
            "charact.measure(SESSION)"
        )
    from charact.estimators.noise.amplifiers import with_amplifiers
    from charact.estimators.noise.prepared_session import prepare

    by_name = method != "auto"
    ready = prepare(session, context=context)
    result = _measured(ready, chosen, by_name=by_name)
    if context.amplifier is not None:
        return replace(
            result,
            measurements=tuple(
                replace(m, amplifier=context.amplifier) for m in result.measurements
            ),
        )
    if ready.layout is not None and ready.layout.amplifiers:
        parts = [
            _measured(part, chosen, by_name=by_name)
            for part in (
                ready.of_amplifier(number, replace(context, quick=True))
                for number in range(1, len(ready.layout.amplifiers) + 1)
            )
        ]
        result = with_amplifiers(result, parts, ready.layout)
    return result


def _measured(ready: "Prepared", chosen: Method, *, by_name: bool) -> Result:
    """Return the measurements of a prepared session."""
    from charact.estimators.noise.gain_separation import add_event_gains
    from charact.estimators.noise.prepared_session import defect_pixels
    from charact.estimators.noise.uneven_scene import suits

    session, context = ready.session, ready.context
    counts = defect_pixels(session, ready.surveys, ready.defects, context=context)
    scene = Result()
    if chosen.name != "uneven-scene" and suits(session, ready.surveys, context):
        scene = choose("flats", "uneven-scene").function(session, context=context)
    if (
        not by_name
        and chosen.name == "covariance-sum"
        and _has_small_white_frames(session, context)
    ):
        chosen = choose("flats", "variance")
    # Where pixels are full, the mean of a frame is no level of the line.
    is_full = any(m.value is not None for m in scene.find("saturation"))
    if is_full and not by_name:
        return ready.in_dn(scene) + counts
    result = chosen.function(session, context=context)
    if is_full:
        result = replace(
            result, measurements=tuple(_of_full_pixels(m, session) for m in result.measurements)
        )
    elif not by_name:
        binned = {
            (m.quantity, m.unit): m
            for m in scene.measurements
            if m.value is not None and not m.stack
        }
        numbers = (
            m if m.stack else binned.get((m.quantity, m.unit), m) for m in result.measurements
        )
        evidence = result.evidence | scene.evidence
        result = replace(result, measurements=tuple(numbers), evidence=evidence)
    return ready.in_dn(add_event_gains(result, session, context=context)) + counts


def _of_full_pixels(m: Measurement, session: Session) -> Measurement:
    """Return a number of flats of which some pixels are full, suspect, or one of darks as it is."""
    from charact.estimators.noise.findings import finding
    from charact.verdict import judge

    of_darks = (m.quantity in ("read_noise", "dark_signal") and m.unit == "DN") or m.stack in [
        entry.label for entry in session.of_kind("dark")
    ]
    effect = "part of the pixels of an uneven flat are full, which lowers mean and variance"
    full = finding("saturated", effect, "`method` uneven-scene, or flats of less light")
    return m if of_darks or m.value is None else judge(m, [full])


def _has_small_white_frames(session: Session, context: Context) -> bool:
    """Return whether frames are too small for a covariance sum, of a camera without an
    intensifier.
    """
    from charact.estimators.noise.covariance_sum import image_size_obstacle
    from charact.estimators.noise.gain.series import has_intensifier
    from charact.frames.frame_block import bins_of_run

    entries = session.of_kind("dark", "flat")
    bins = [
        bins_of_run(open_lazy_stack(entry).shape, context, spectra=True) for entry in entries[:1]
    ]
    return bool(image_size_obstacle(bins)) and not has_intensifier(
        [entry.conditions for entry in entries], context
    )
