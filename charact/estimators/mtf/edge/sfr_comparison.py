"""Conventional SFR of ISO 12233 and another method's MTF of the same edge."""

import numpy as np

from charact.estimators.mtf.curve import crossing_frequency
from charact.method import Context, choose
from charact.verdict import inherited, judge
from labdata import Array, Curve, FrameStack, Measurement, Result, make_refusal
from labdata.errors import BadInput
from labdata.measurement import measurement_from_sd

METHOD = "edge-slanted"
Z95 = 1.959964
# Spacing of the line spread that the window weights, px.
STEP_PX = 0.25


def add_sfr(
    result: Result,
    stack: FrameStack,
    *,
    region: tuple[int, int, int, int] | None,
    context: Context,
) -> Result:
    """Return the result of an edge with its conventional SFR.

    Parameters
    ----------
    result
        MTF50 of the edge and the curve `mtf`, by another method than edge-slanted.
    stack, region, context
        Those that the method got.

    Returns
    -------
    Result
        With `sfr50`, the MTF50 of the SFR, `sfr50_difference`, its difference from `mtf50` with a
        note on its reasons, the curve `sfr` and the figure `sfr`.

    Raises
    ------
    BadInput
        If `result` is that of edge-slanted itself.
    """
    ours = result.find("mtf50")[0]
    if ours.method == METHOD:
        raise BadInput(f"`also` must be another estimate than that of `method` {METHOD}, got sfr")
    conventional = choose("edge", METHOD).function(stack, region=region, context=context)
    of_sfr = conventional.find("mtf50")[0]
    fields = {"stack": ours.stack, "region": of_sfr.region, "provenance": of_sfr.provenance}
    sfr50 = of_sfr.with_(quantity="sfr50")
    if ours.value is None or sfr50.value is None or "mtf" not in result.curves:
        reason = f"the MTF50 of both must be measured: {ours.reason or sfr50.reason}"
        lacking = make_refusal("sfr50_difference", "%", reason, method=METHOD, **fields)
        return result + Result(measurements=(sfr50, lacking))
    mtf, sfr = result.curves["mtf"], conventional.curves["mtf"]
    difference = _difference(ours, sfr50, mtf, sfr, fields)
    figure = {
        "figure": "sfr",
        "frequency_cy_per_px": sfr.frequency_cy_per_px.tolist(),
        "sfr": sfr.value.tolist(),
        "mtf": np.interp(sfr.frequency_cy_per_px, mtf.frequency_cy_per_px, mtf.value).tolist(),
        "method": ours.method,
        "the_curves_say": difference.notes[0].removesuffix("."),
    }
    return result + Result(
        measurements=(sfr50, difference), curves={"sfr": sfr}, evidence={"sfr": figure}
    )


def _difference(
    ours: Measurement, sfr50: Measurement, mtf: Curve, sfr: Curve, fields: dict
) -> Measurement:
    """Return how far the MTF50 of the SFR lies from ours, percent, with the reasons in a note."""
    assert ours.value is not None and sfr50.value is not None, "refusals have no difference"
    percent = 100.0 * (sfr50.value / ours.value - 1.0)
    # Both see the same noise: that the errors were independent makes the interval too wide.
    arms = [
        0.5 * (m.interval95[1] - m.interval95[0]) / ours.value
        for m in (ours, sfr50)
        if m.interval95 is not None
    ]
    joint = 100.0 * float(np.linalg.norm(arms))
    half_window_px = sfr50.provenance.settings["half_window_px"] if sfr50.provenance else np.inf
    causes = shifts_of_mtf50(mtf, sfr, half_window_px)
    remainder = percent - sum(causes.values())
    within = "within" if abs(percent) <= joint else "beyond"
    side = "above" if percent > 0 else "below"
    parts = ", ".join(f"{cause} {shift:+.2f} %" for cause, shift in causes.items())
    note = (
        f"The SFR of ISO 12233 has its MTF50 {abs(percent):.2g} % {side} that of {ours.method}, "
        f"{within} the joint 95 % interval of {joint:.2g} %: {parts}, others (noise, an edge that "
        f"is not straight) {remainder:+.2f} %; both divide by the transfer of their derivative, "
        "neither undoes gamma."
    )
    difference = measurement_from_sd(
        "sfr50_difference", "%", percent, joint / Z95, method=METHOD, **fields
    ).with_(notes=(note,))
    return judge(difference, inherited(ours, sfr50))


def shifts_of_mtf50(mtf: Curve, sfr: Curve, half_window_px: float) -> dict[str, float]:
    """Return by how many percent each step of the SFR moves the MTF50 of an edge.

    Parameters
    ----------
    mtf
        MTF of the edge.
    sfr
        SFR of the same edge, with the interval of its noise.
    half_window_px
        Half width of the SFR's Hamming window along the edge's normal, px.

    Notes
    -----
    Window: M(f) becomes sum_x L(x) w(x) cos(2 pi f x) / sum_x L(x) w(x), L the transform of M and w
    the Hamming window: the light outside is left out and the rest weighted. Bins: means over a
    quarter pixel pass sinc(f / 4), which the standard does not divide out. Noise: the modulus of a
    transform with the standard uncertainty s is larger by s^2 / (2 M) (Rice, Bell Syst. Tech. J. 24
    (1945) 46).
    """
    frequency, modulus = mtf.frequency_cy_per_px, mtf.value
    # The line spread of a sampled curve repeats after the inverse of its step.
    reach_px = min(half_window_px, 0.5 / float(frequency[1] - frequency[0]))
    x = np.arange(-reach_px, reach_px, STEP_PX) + 0.5 * STEP_PX
    cosines = np.cos(2.0 * np.pi * np.outer(x, frequency))
    weights = np.where(frequency == frequency[0], 0.5, 1.0)
    window = 0.54 + 0.46 * np.cos(np.pi * x / half_window_px)
    windowed = (cosines @ (weights * modulus)) * window @ cosines
    noise_sd = _sd_of(sfr, frequency)
    curves = {
        f"Hamming window of ±{half_window_px:.0f} px": windowed / windowed[0],
        "quarter-pixel bins": modulus * np.sinc(0.25 * frequency),
        "noise power": modulus + noise_sd**2 / (2.0 * np.maximum(modulus, 0.1)),
    }
    half, *halves = crossing_frequency(frequency, np.stack([modulus, *curves.values()]), 0.5)
    return {cause: 100.0 * (at / half - 1.0) for cause, at in zip(curves, halves, strict=True)}


def _sd_of(curve: Curve, frequency: Array) -> Array:
    """Return the standard uncertainty of a curve at frequencies, shape (f,)."""
    if curve.interval95 is None:
        return np.zeros_like(frequency)
    sd = (curve.interval95[1] - curve.interval95[0]) / (2.0 * Z95)
    return np.interp(frequency, curve.frequency_cy_per_px, sd)
