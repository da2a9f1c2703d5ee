"""Objective minimum resolvable temperature difference (MRTD) from NETD and MTF, for each scan
direction: of a two-way scanner each has a place and an electronic delay of its own.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from charact.estimators.infrared.thresholds import INFRARED
from charact.estimators.noise.findings import fields_of
from charact.method import Context
from charact.verdict import Finding, judge
from labdata import (
    Array,
    Curve,
    FrameStack,
    Measurement,
    Result,
    Session,
    StackEntry,
    make_refusal,
    measurement_from_draws,
    open_lazy_stack,
)
from labdata.camera.description import is_thermal
from labdata.camera.thermal import SCAN_DIRECTIONS

Region = tuple[int, int, int, int]
METHOD = "objective-mrtd"
# pi^2 / (4 sqrt 14): four bars of 7:1 and an eye that integrates over the bar.
FOUR_BARS = np.pi**2 / (4.0 * np.sqrt(14.0))
# Frequencies at which MRTD is reported, cy/px: quarters of Nyquist.
FREQUENCIES = (0.125, 0.25, 0.375, 0.5)


def mrtd(
    frequency: ArrayLike,
    mtf: ArrayLike,
    netd_k: ArrayLike,
    *,
    frame_rate_hz: float,
    footprint: float = 1.0,
    snr: float = INFRARED.snr,
    eye_s: float = INFRARED.eye_s,
) -> Array:
    """Return the objective MRTD of a four-bar target, K.

    Parameters
    ----------
    frequency
        Spatial frequency, cycles per angle (or per pixel).
    mtf
        MTF at that frequency, dimensionless.
    netd_k
        Temporal noise-equivalent temperature difference, K.
    frame_rate_hz
        Frames per second.
    footprint
        Root of the product of both sides of the detector's footprint, in the angle (or pixel) of
        the frequency.
    snr
        Signal-to-noise ratio at the threshold of detection, dimensionless.
    eye_s
        Integration time of the eye, s.

    Notes
    -----
    .. math::

        MRTD(f) = \\frac{\\pi^2}{4\\sqrt{14}}
        \\frac{SNR \\; NETD \\; f \\sqrt{a b}}{MTF(f) \\sqrt{t_e F}}

    For bars of seven widths' length, as in STANAG 4349; Lloyd, *Thermal Imaging Systems* (1975),
    5.4. It is a figure of the camera: observers differ from it, and from one another, by a factor
    of two. It does not hold beyond Nyquist.

    Examples
    --------
    >>> # cy/mrad, 1.8 mrad
    >>> round(float(mrtd(0.05, 0.938, 0.1, frame_rate_hz=30.0, footprint=1.8)), 4)
    0.0065
    """
    frequency, mtf, netd_k = (np.asarray(value, np.float64) for value in (frequency, mtf, netd_k))
    return FOUR_BARS * snr * netd_k * frequency * footprint / (mtf * np.sqrt(eye_s * frame_rate_hz))


def add_mrtd(
    session: Session, flats: tuple[StackEntry, ...], result: Result, *, context: Context
) -> Result:
    """Return the MRTD of every edge of a session whose NETD is known, or one refusal.

    Parameters
    ----------
    session
        The session.
    flats
        Its black-body flats, whose time stamps give the frame rate.
    result
        Measurements of the session, with `netd` and the MTF of its edges.
    context
        Settings; an imager gives the footprint, and the frame rate where there are no time stamps.
    """
    fields = fields_of(METHOD, context, snr=INFRARED.snr, eye_s=INFRARED.eye_s)
    netd = next(iter(result.find("netd")), None)
    rate = _frame_rate_hz(flats, context)
    edges = [
        (m, curve)
        for m in result.find("mtf50")
        if m.value is not None
        for curve in _curve_of(m, session, result)
    ]
    if netd is None or netd.value is None or netd.posterior is None:
        reason = "MRTD needs the NETD, which was not measured" + (
            "" if netd is None else f": {netd.reason}"
        )
    elif not edges:
        reason = (
            "MRTD needs an MTF: add an edge stack (a half-moon plate before the black body, 5 to "
            "10 K apart, tilted by some degrees)"
        )
    elif rate is None:
        reason = (
            "MRTD needs the frame rate: frames with time stamps, or an infrared sensor in "
            "session.toml"
        )
    else:
        return result + Result(
            measurements=tuple(
                measurement
                for m, curve in edges
                for measurement in _of_edge(netd, m, curve, rate, context=context, **fields)
            )
        )
    return result + Result(
        measurements=(make_refusal("mrtd", "K", reason, refusal="missing", **fields),)
    )


def _frame_rate_hz(flats: tuple[StackEntry, ...], context: Context) -> float | None:
    """Return the frame rate by time stamps, else that of the imager's description, Hz."""
    for entry in flats:
        time_s = open_lazy_stack(entry).time_s
        if len(time_s) > 1 and (step := float(np.median(np.diff(time_s)))) > 0:
            return 1.0 / step
    return context.camera.frame_rate_hz if is_thermal(context.camera) else None


def _curve_of(m: Measurement, session: Session, result: Result) -> Iterator[Curve]:
    """Yield the MTF curve of an edge's MTF50, of a scanner that of one direction."""
    labels = {
        name
        for entry in session.of_kind("edge")
        for name in (
            entry.label,
            *(f"{entry.label}, lines {direction}" for direction in SCAN_DIRECTIONS),
        )
    }
    if m.stack in labels and (curve := result.curves.get(f"mtf:{m.stack}")) is not None:
        yield curve


def _of_edge(
    netd: Measurement,
    edge: Measurement,
    curve: Curve,
    frame_rate_hz: float,
    *,
    context: Context,
    **fields,
) -> Iterator[Measurement]:
    """Yield the MRTD at each frequency from independent draws of NETD and MTF."""
    assert netd.posterior is not None
    rng = np.random.default_rng([context.seed, 46])
    netd_k = 1e-3 * rng.permutation(netd.posterior["netd"])
    footprint, of_footprint = _footprint_px(edge, context)
    notes = (
        f"Objective MRTD of four bars (7:1): signal-to-noise ratio {INFRARED.snr:g}, eye "
        f"{INFRARED.eye_s:g} s, {frame_rate_hz:.4g} frames/s{of_footprint}. STANAG 4349 and ASTM "
        "E1213 ask observers, who differ by a factor of two.",
        *(note for note in netd.notes if note.startswith(("Background", "The background"))),
    )
    where = {"stack": edge.stack, "region": edge.region, "orientation_deg": edge.orientation_deg}
    findings = [
        Finding(flag=flag, effect=f"the {name} is suspect", remedy=f"what settles it of the {name}")
        for m, name in ((netd, "NETD"), (edge, "MTF"))
        for flag in m.flags
    ]
    for frequency in FREQUENCIES:
        labels = {**fields, **where, "frequency_cy_per_px": frequency}
        mtf = _mtf_draws(curve, frequency, len(netd_k), rng)
        if np.quantile(mtf, 0.025) < INFRARED.min_mtf:
            reason = (
                f"the MTF of {np.median(mtf):.2g} at {frequency:g} cy/px is not "
                f"distinguished from zero"
            )
            yield make_refusal("mrtd", "K", reason, **labels)
            continue
        draws = mrtd(frequency, mtf, netd_k, frame_rate_hz=frame_rate_hz, footprint=footprint)
        number = measurement_from_draws("mrtd", "K", draws, notes=notes, **labels)
        yield judge(number, findings)


def _mtf_draws(curve: Curve, frequency: float, count: int, rng: np.random.Generator) -> Array:
    """Return draws of the MTF at a frequency: of its posterior, else normal ones of its 68 %
    interval.
    """
    known = curve.frequency_cy_per_px
    if curve.draws is not None:
        drawn = curve.draws[rng.integers(len(curve.draws), size=count)]
        return np.array([np.interp(frequency, known, mtf) for mtf in drawn])
    ends = np.array([curve.value, curve.value]) if curve.interval68 is None else curve.interval68
    value, low, high = (float(np.interp(frequency, known, line)) for line in (curve.value, *ends))
    return value + 0.5 * (high - low) * rng.standard_normal(count)


def _footprint_px(edge: Measurement, context: Context) -> tuple[float, str]:
    """Return the footprint of the detector in pixels along the edge's normal, and the words of the
    note.
    """
    if not is_thermal(context.camera):
        return 1.0, ", footprint of one pixel (no sensor described)"
    upright = abs(((edge.orientation_deg or 0.0) % 180.0) - 90.0) < 45.0
    side, pitch = context.camera.footprint_mrad, context.camera.pitch_mrad[0 if upright else 1]
    if upright and context.camera.scanner is not None:
        pitch *= 2.0  # edges of a scan direction are of every second line
    return (
        side / pitch,
        (
            f", footprint of {side:.3g} mrad ({side / pitch:.3g} px), 1 cy/px = {1.0 / pitch:.4g} "
            f"cy/mrad"
        ),
    )


def scan_directions(
    stack: FrameStack, region: Region | None, *, context: Context
) -> Iterator[tuple[str, FrameStack, Region | None, Context]]:
    """Yield the frames of each scan direction with the region and the context that belong to them.

    A camera that is no two-way scanner has one direction, "". Of a scanner, successive lines of a
    field alternate: rows 4 n and 4 n + 1 of an interlaced frame, of either field, are scanned to
    the right, 4 n + 2 and 4 n + 3 to the left; 2 n and 2 n + 1 of a frame without fields. The
    frames of one direction are interlaced like the whole ones, at twice their row pitch.

    Parameters
    ----------
    stack
        Frames, shape (frame, row, col).
    region
        ROW, COL, HEIGHT, WIDTH in these frames, px; None: the whole frame.
    context
        Settings, with the description of the imager.
    """
    imager = context.camera
    if imager is None or imager.scanner is None:
        yield "", stack, region, context
        return
    fields = 2 if context.interlaced else 1
    scanner = replace(imager.scanner, lines_per_field=max(imager.scanner.lines_per_field // 2, 1))
    direction_context = replace(context, camera=replace(imager, scanner=scanner))
    rows = 2 * fields * (stack.shape[1] // (2 * fields))
    cut = None if region is None else (region[0] // 2, region[1], region[2] // 2, region[3])
    for number, direction in enumerate(SCAN_DIRECTIONS):
        sets = stack.data[:, :rows].reshape(len(stack), -1, 2, fields, stack.shape[2])[:, :, number]
        yield (
            direction,
            replace(stack, data=sets.reshape(len(stack), -1, stack.shape[2])),
            cut,
            direction_context,
        )
