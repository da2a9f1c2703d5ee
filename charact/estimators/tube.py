"""Limiting resolution, minimum resolvable contrast and figure of merit, from MTF and noise.

An observer sees a bar of width 1/(2f) and length 7/(2f) for the time t. Its signal is the mean over
the bar of the fundamental of the square wave, 8/pi^2 of its amplitude, times the MTF M(f); its
noise is that of bar and space. With n photoelectrons per area and second, counted as noise does
(signal squared over the variance summed over pixels and exposures), the signal-to-noise ratio at
contrast C is

    SNR = 2 C M(f) (8/pi^2) sqrt(n a t / 2),    a = 7/(4 f^2)

(Rosell and Willson 1973; de Vries 1943, Rose 1948). Bars are resolved where SNR and modulation C M
exceed their thresholds, `DETECTION`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from charact.estimators.noise.findings import fields_of, finding
from charact.estimators.noise.illumination import (
    gathering_s,
    lognormal_draws,
    pixel_area_m2,
    relative_sd_of,
)
from charact.method import Context
from charact.verdict import Finding, inherited, judge
from labdata import (
    Array,
    Camera,
    Conditions,
    Curve,
    Measurement,
    Result,
    has_tube,
    make_refusal,
    measurement_from_draws,
)

METHOD = "bar-detection"
NYQUIST = 0.5
# Directions of the frequency vector, deg, with the curves that show them, best first.
CURVES = {
    0.0: ("mtf_joint", "mtf", "mtf_bars"),
    90.0: ("mtf_joint_vertical", "mtf_vertical", "mtf_bars_vertical"),
}
NEAR_AXIS_DEG = 25.0


@dataclass(frozen=True)
class DetectionThresholds:
    """Define when a bar target is resolved, and where its contrast is reported."""

    # Least signal-to-noise ratio of a bar (Rosell and Willson, in Perception of Displayed
    # Information, 1973).
    snr: float = 2.8
    # Least modulation of the image: where makers state the limiting resolution of a tube.
    modulation: float = 0.03
    seconds: float = 0.1  # Integration time of the eye, s (same source)
    bar_aspect: float = 7.0  # Length of a bar over its width (STANAG 4349)
    # Frequencies of the minimum resolvable contrast, over the Nyquist frequency.
    shares_of_nyquist: tuple[float, ...] = (0.25, 0.5, 0.75)
    draws: int = 2000  # Draws of a quantity without a posterior


DETECTION = DetectionThresholds()


def contrast_threshold(
    mtf: Array,
    frequency_lp_per_mm: Array,
    effective_per_mm2_s: Array,
    seconds: float = DETECTION.seconds,
) -> Array:
    """Return the least contrast of resolved bars, dimensionless; above 1 no bars are resolved.

    Parameters
    ----------
    mtf
        MTF at the frequencies.
    frequency_lp_per_mm
        Spatial frequencies, lp/mm; positive.
    effective_per_mm2_s
        Photoelectrons per mm2 and second that have the relative noise of the signal: n over the
        excess noise factor.
    seconds
        Integration time, s.

    Examples
    --------
    >>> contrast_threshold(np.array([0.5]), np.array([10.0]), np.array([1e6]))
    array([0.11677873])
    """
    bar_mm2 = DETECTION.bar_aspect / (4.0 * frequency_lp_per_mm**2)
    snr = 2.0 * mtf * 8.0 / np.pi**2 * np.sqrt(effective_per_mm2_s * bar_mm2 * seconds / 2.0)
    return np.maximum(
        DETECTION.snr / np.maximum(snr, 1e-12), DETECTION.modulation / np.maximum(mtf, 1e-12)
    )


def highest_resolved(threshold: Array, frequency: Array) -> Array:
    """Return the frequency at which the least contrast reaches 1, shape (draw,); the last one if it
    does not.

    `threshold`: shape (draw, frequency); `frequency`: shape (draw, frequency), increasing. NaN
    where no bars of the lowest frequency are resolved.
    """
    unresolved = threshold > 1.0
    first = np.where(unresolved.any(axis=1), unresolved.argmax(axis=1), threshold.shape[1] - 1)
    rows = np.arange(len(threshold))
    before = np.maximum(first - 1, 0)
    high, low = np.log(threshold[rows, first]), np.log(threshold[rows, before])
    fraction = np.where(high > 0, -low / np.maximum(high - low, 1e-12), 1.0)
    crossing = frequency[rows, before] + fraction * (
        frequency[rows, first] - frequency[rows, before]
    )
    return np.where(first > 0, crossing, np.nan)


@dataclass(frozen=True, kw_only=True)
class MtfDraws:
    """MTF along one direction of the frequency vector."""

    orientation_deg: float
    frequency_cy_per_px: Array  # positive, shape (f,)
    draws: Array  # shape (draw, f)
    lp_per_mm: Array  # lp/mm at the photocathode per cycle per pixel, shape (draw,)
    findings: tuple[Finding, ...]  # on the curve's MTF50

    @property
    def frequency_lp_per_mm(self) -> Array:
        """Frequencies at the photocathode, shape (draw, f)."""
        return self.lp_per_mm[:, None] * self.frequency_cy_per_px


@dataclass(frozen=True, kw_only=True)
class NoiseLevel:
    """Photoelectrons of one flat, counted as its noise does."""

    label: str
    illuminance_lux: float
    effective_per_mm2_s: Array  # shape (draw,)


def add_resolution(
    result: Result, conditions: Mapping[str, Conditions], *, context: Context
) -> Result:
    """Return the result with limiting resolution, minimum resolvable contrast and figure of merit
    of the tube.

    Parameters
    ----------
    result
        MTF curves and noise of a session.
    conditions
        Conditions of its stacks, by label.
    context
        Seed, and the description of the sensor; without a tube the result is returned unchanged.

    Notes
    -----
    `limiting_resolution` at the light of each flat, and in bright light (modulation alone, without
    a stack); `mrc` at the light of each flat and fractions of the Nyquist frequency;
    `figure_of_merit`, the limiting resolution in bright light times `tube_snr`. They are those of
    the camera with its lens, fibre optics and detector, so that those of the tube alone are higher.
    """
    if not has_tube(context.camera):
        return result
    fields = fields_of(METHOD, context)
    rng = np.random.default_rng([context.seed, 61])
    curves = _curves(result, context.camera, rng)
    levels, missing = _levels(result, conditions, context, rng)
    if not curves:
        missing = "it needs the MTF: an edge, bars or a point source in the session"
        return result + Result(measurements=tuple(_refused(missing, fields)))
    noise_findings = inherited(*result.find("covariance_gain"))
    measurements = [_in_bright_light(curve, fields) for curve in curves]
    measurements.append(_figure_of_merit(curves[0], result, fields, rng))
    if missing:
        measurements += _refused(missing, fields)[:2]
        return result + Result(measurements=tuple(measurements))
    figure: dict[str, Any] = {
        "figure": "limiting-resolution",
        "illuminance_lux": [level.illuminance_lux for level in levels],
        "directions": [],
    }
    for curve in curves:
        curve_fields = {**fields, "orientation_deg": curve.orientation_deg}
        thresholds = [
            contrast_threshold(
                curve.draws, curve.frequency_lp_per_mm, level.effective_per_mm2_s[:, None]
            )
            for level in levels
        ]
        limits = [
            _limiting(level, threshold, curve, curve_fields)
            for level, threshold in zip(levels, thresholds, strict=True)
        ]
        contrasts = [
            contrast
            for level, threshold in zip(levels, thresholds, strict=True)
            for contrast in _contrasts(level, threshold, curve, curve_fields)
        ]
        findings = [*curve.findings, *noise_findings]
        measurements += [
            m if m.value is None else judge(m, findings) for m in (*limits, *contrasts)
        ]
        figure["directions"].append(_figure_data(curve, thresholds, limits))
    return result + Result(
        measurements=tuple(measurements), evidence={"limiting resolution": figure}
    )


def _figure_data(
    curve: MtfDraws, thresholds: list[Array], limits: list[Measurement]
) -> dict[str, Any]:
    """Return limiting resolutions and median least contrasts of one direction."""
    return {
        "orientation_deg": curve.orientation_deg,
        "limit_lp_per_mm": [limit.value for limit in limits],
        "limit_interval95": [
            None if limit.interval95 is None else list(limit.interval95) for limit in limits
        ],
        "frequency_lp_per_mm": np.median(curve.frequency_lp_per_mm, axis=0).tolist(),
        "contrast": [np.median(threshold, axis=0).tolist() for threshold in thresholds],
        "mtf": np.median(curve.draws, axis=0).tolist(),
    }


def _refused(reason: str, fields: dict[str, Any]) -> list[Measurement]:
    units = {"limiting_resolution": "lp/mm", "mrc": "1", "figure_of_merit": "lp/mm"}
    return [
        make_refusal(name, unit, reason, refusal="missing", **fields)
        for name, unit in units.items()
    ]


def _curves(result: Result, sensor: Camera, rng: np.random.Generator) -> list[MtfDraws]:
    """Return the MTF along rows and columns, as far as it was measured."""
    curves = []
    for orientation, names in CURVES.items():
        curve, m = _best_curve(result, names, orientation)
        if curve is None:
            continue
        pitch_um = float(sensor.ccd.pitch_x_um if orientation == 0.0 else sensor.ccd.pitch_y_um)
        demagnification = lognormal_draws(sensor.taper.demagnification, rng, DETECTION.draws)
        at_cathode_um = pitch_um * demagnification / float(sensor.tube.magnification)
        shown = curve.frequency_cy_per_px > 0.0
        curves.append(
            MtfDraws(
                orientation_deg=orientation,
                frequency_cy_per_px=curve.frequency_cy_per_px[shown],
                draws=_draws_of(curve, rng)[:, shown],
                lp_per_mm=1e3 / at_cathode_um,
                findings=tuple(inherited(*m)),
            )
        )
    return curves


def _best_curve(
    result: Result, names: tuple[str, ...], orientation: float
) -> tuple[Curve | None, tuple[Measurement, ...]]:
    """Return the first curve of the names along a direction, with its MTF50."""
    for name in names:
        for key, curve in result.curves.items():
            kind, _, label = key.partition(":")
            if kind != name and not (kind == "mtf" and orientation):
                continue
            candidates = [
                m for m in result.find("mtf50") if m.value is not None and (m.stack or "") == label
            ]
            candidates = [m for m in candidates if kind != "mtf_joint" or m.method == "joint"]
            along = tuple(m for m in candidates if _is_along(m.orientation_deg, orientation))
            if along and curve.interval68 is not None:
                return curve, along[:1]
    return None, ()


def _is_along(angle_deg: float | None, orientation: float) -> bool:
    """Return whether a direction is close to an axis."""
    return (
        angle_deg is not None
        and abs((angle_deg - orientation + 90.0) % 180.0 - 90.0) < NEAR_AXIS_DEG
    )


def _draws_of(curve: Curve, rng: np.random.Generator) -> Array:
    """Return draws of a curve; without a posterior its intervals are normal and common to all
    frequencies.
    """
    if curve.draws is not None:
        return np.maximum(rng.choice(curve.draws, DETECTION.draws), 1e-6)
    assert curve.interval68 is not None
    sd = (curve.interval68[1] - curve.interval68[0]) / 2.0
    return np.maximum(curve.value + rng.standard_normal(DETECTION.draws)[:, None] * sd, 1e-6)


def _levels(
    result: Result, conditions: Mapping[str, Conditions], context: Context, rng: np.random.Generator
) -> tuple[list[NoiseLevel], str]:
    """Return the flats with known noise and light, or what is missing.

    Signal squared over the variance, per pixel and exposure; the variance is the light's summed
    over pixels and exposures, and that of the dark.
    """
    transfer = result.evidence.get("photon-transfer", {})
    if not transfer.get("covariance_dn2") or transfer.get("reference") != "dark":
        return (
            [],
            (
                "it needs the noise of the light: darks and flats of several frames, of 100 x 100 "
                "px and more"
            ),
        )
    lit = [
        label for label, fitted in zip(transfer["label"], transfer["fitted"], strict=True) if fitted
    ]
    known = {label: conditions[label] for label in lit if label in conditions}
    if (
        not all(light.illuminance_lux and gathering_s(light) for light in known.values())
        or not known
    ):
        return [], "it needs the light: illuminance_lux and exposure_s or gate_ns of every flat"
    relative_sd, _ = relative_sd_of(list(known.values()), "lux")
    # The light may be brighter than stated; the noise at the stated light is then higher.
    scale = np.exp(relative_sd * rng.standard_normal(DETECTION.draws))
    area_mm2 = 1e6 * pixel_area_m2(context, rng, DETECTION.draws)
    rows = zip(
        *(
            transfer[name]
            for name in (
                "label",
                "signal_dn",
                "covariance_dn2",
                "covariance_sd_dn2",
                "dark_variance_dn2",
            )
        ),
        strict=True,
    )
    levels = []
    for label, signal, variance, sd, dark in rows:
        if label not in known or not signal > 0:
            continue
        noise = (
            np.maximum(variance + sd * rng.standard_normal(DETECTION.draws), 1e-3 * variance) + dark
        )
        seconds, lux = gathering_s(known[label]), known[label].illuminance_lux
        assert seconds is not None and lux is not None
        levels.append(
            NoiseLevel(
                label=label,
                illuminance_lux=lux,
                effective_per_mm2_s=signal**2 / noise / (area_mm2 * seconds * scale),
            )
        )
    return sorted(
        levels, key=lambda level: level.illuminance_lux
    ), "" if levels else "no flat is brighter than its dark"


def _in_bright_light(curve: MtfDraws, fields: dict[str, Any]) -> Measurement:
    """Return the limiting resolution where noise is negligible."""
    limit = highest_resolved(DETECTION.modulation / curve.draws, curve.frequency_lp_per_mm)
    notes = (
        "in bright light",
        f"modulation of {100 * DETECTION.modulation:g} %",
        *_sampling_note(limit, curve),
    )
    highest = measurement_from_draws(
        "limiting_resolution",
        "lp/mm",
        limit,
        orientation_deg=curve.orientation_deg,
        notes=notes,
        **fields,
    )
    return judge(highest, curve.findings)


def _sampling_note(limit: Array, curve: MtfDraws) -> tuple[str, ...]:
    """Return a note if the pixels limit the resolution."""
    nyquist = curve.lp_per_mm * curve.frequency_cy_per_px[-1]
    if np.median(limit) < np.median(nyquist) * (1.0 - 1e-6):
        return ()
    return ("limited by the Nyquist frequency of the pixels: the optics and the tube resolve more",)


def _limiting(
    level: NoiseLevel, threshold: Array, curve: MtfDraws, curve_fields: dict[str, Any]
) -> Measurement:
    """Return the limiting resolution at the light of one flat, or a refusal."""
    limit = highest_resolved(threshold, curve.frequency_lp_per_mm)
    notes = (
        f"at {level.illuminance_lux:.3g} lux on the photocathode, contrast 1, signal-to-noise "
        f"ratio {DETECTION.snr:g} of a bar in {DETECTION.seconds:g} s",
        *_sampling_note(limit, curve),
    )
    if np.isnan(limit).any():
        lowest = float(np.median(curve.frequency_lp_per_mm[:, 0]))
        reason = (
            f"at {level.illuminance_lux:.3g} lux not even bars of {lowest:.2g} lp/mm are resolved"
        )
        return make_refusal(
            "limiting_resolution", "lp/mm", reason, stack=level.label, **curve_fields
        )
    return measurement_from_draws(
        "limiting_resolution", "lp/mm", limit, stack=level.label, notes=notes, **curve_fields
    )


def _contrasts(
    level: NoiseLevel, threshold: Array, curve: MtfDraws, curve_fields: dict[str, Any]
) -> list[Measurement]:
    """Return the minimum resolvable contrast at the light of one flat."""
    contrasts = []
    for nyquist_fraction in DETECTION.shares_of_nyquist:
        index = int(np.abs(curve.frequency_cy_per_px - nyquist_fraction * NYQUIST).argmin())
        frequency = float(curve.frequency_cy_per_px[index])
        point = {"stack": level.label, "frequency_cy_per_px": frequency}
        draws = threshold[:, index]
        if np.median(draws) > 1.0:
            reason = (
                f"not resolved at {level.illuminance_lux:.3g} lux: a contrast of "
                f"{np.median(draws):.2g} is needed"
            )
            contrasts.append(
                make_refusal("mrc", "1", reason, refusal="not-applicable", **point, **curve_fields)
            )
            continue
        lp_per_mm = float(np.median(curve.lp_per_mm)) * frequency
        notes = (
            (
                f"at {level.illuminance_lux:.3g} lux on the photocathode and {lp_per_mm:.3g} lp/mm "
                f"there"
            ),
        )
        contrasts.append(
            measurement_from_draws("mrc", "1", draws, notes=notes, **point, **curve_fields)
        )
    return contrasts


def _figure_of_merit(
    curve: MtfDraws, result: Result, fields: dict[str, Any], rng: np.random.Generator
) -> Measurement:
    """Return the limiting resolution in bright light times the signal-to-noise ratio of the
    tube.
    """
    snr = [m for m in result.find("tube_snr") if m.value is not None and m.interval68 is not None]
    if not snr:
        reasons = [m.reason for m in result.find("tube_snr") if m.reason]
        reason = (
            "it needs the tube's signal-to-noise ratio: "
            f"{reasons[0] if reasons else 'flats of known light'}"
        )
        return make_refusal("figure_of_merit", "lp/mm", reason, refusal="missing", **fields)
    best = min(snr, key=lambda m: m.status != "ok")
    assert best.value is not None and best.interval68 is not None
    ratio = best.value + (best.interval68[1] - best.interval68[0]) / 2.0 * rng.standard_normal(
        DETECTION.draws
    )
    highest = highest_resolved(DETECTION.modulation / curve.draws, curve.frequency_lp_per_mm)
    draws = highest * ratio
    findings = [*curve.findings, *inherited(best)]
    if _sampling_note(highest, curve):
        effect = (
            f"the pixels limit the resolution to {np.median(highest):.3g} lp/mm; the figure of "
            "merit of the tube alone is higher"
        )
        remedy = "a camera or relay with more pixels a millimetre of the cathode"
        findings.append(finding("aliased", effect, remedy))
    notes = (
        "limiting resolution of the camera in bright light, along "
        f"{'rows' if curve.orientation_deg == 0.0 else 'columns'}, times tube_snr; that of the "
        "tube alone is higher",
    )
    merit = measurement_from_draws(
        "figure_of_merit",
        "lp/mm",
        draws,
        orientation_deg=curve.orientation_deg,
        notes=notes,
        **fields,
    )
    return judge(merit, findings)
