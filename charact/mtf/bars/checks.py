"""Checks of a bar target: bar count, field motion, nonlinearity, misfit, sharpening, aliasing."""

import numpy as np
from numpy.typing import NDArray

from charact.mtf.bars.amplitudes import Amplitudes
from charact.mtf.bars.findings import REGION, misfit_finding
from charact.mtf.bars.fit import BarFit
from charact.mtf.bars.sharpening_test import sharpening
from charact.mtf.bars.target import BarTarget, core_margin_px
from charact.mtf.bars.thresholds import (
    DEPARTED,
    DOUBTFUL,
    FIELD_OFFSET_PX,
    MIN_ALIAS_DISTANCE,
    MIN_FLANK,
    MIN_TRAVEL_PX,
    MISFIT,
    SIGNIFICANT,
    STRAIGHT,
    STRAIGHT_SD,
    UPRIGHT,
)
from labdata.flags import Finding

Array = NDArray[np.float64]


def findings_of_sums(target: BarTarget, amplitudes: Amplitudes, second: float) -> list[Finding]:
    """Return the findings from the sums over a target: bar count, motion between fields, nonlinear response."""
    found = []
    noise = SIGNIFICANT / amplitudes.signal_to_noise
    if amplitudes.zeros > DOUBTFUL + noise or amplitudes.flank < MIN_FLANK - noise:
        effect = f"{100 * amplitudes.zeros:.0f} % of the fundamental lies where {target.bars} bars have no light"
        found.append(misfit_finding(f"{effect}: the MTF may be off by as much", f"--bars, --frequency; {REGION}"))
    apart = abs(amplitudes.fields_apart_px)
    # Bars along rows are aliased in each field, which resembles motion.
    upright = abs(np.sin(target.angle_rad)) < UPRIGHT
    if upright and apart > max(SIGNIFICANT * amplitudes.fields_apart_sd_px, FIELD_OFFSET_PX):
        found.append(_field_motion(apart, target.frequency))
    if abs(second) > STRAIGHT + STRAIGHT_SD / amplitudes.signal_to_noise:
        effect = (
            f"the second harmonic of the bars is {100 * abs(second):.1f} % of the first: the MTF may be off by as much"
        )
        remedy = "frames without gamma; bars wider or narrower than their gaps look alike"
        found.append(Finding(flag="gamma", effect=effect, remedy=remedy))
    return found


def findings_of_fit(fit: BarFit) -> list[Finding]:
    """Return the findings from a fitted image: misfit, model departure, sharpening, motion between fields."""
    found = []
    left = _profile_residual_rms(fit)
    if left > 0.0:
        share = 100.0 * left / abs(fit["level_dn"])
        found.append(
            misfit_finding(f"the profile departs by {share:.1f} % of the bars' height: the MTF may be off by as much")
        )
    away, known = abs(fit["departure"]), 1.0 / np.sqrt(fit.precision[fit.names.index("departure")])
    if away > DEPARTED * known:
        found.append(
            misfit_finding(
                f"the MTF of the bars lies {100 * away:.0f} % off the form that fits the rest of the picture"
            )
        )
    taken_off = sharpening(fit)
    if taken_off > 0.0:
        effect = f"{100 * taken_off:.1f} % of the light about the bars is taken off: the MTF may be too high by as much"
        found.append(Finding(flag="processed", effect=effect, remedy="frames without sharpening, raw"))
    upright = abs(np.sin(fit.target.angle_rad)) < UPRIGHT
    apart = _field_offset_px(fit) if fit.strip and upright else 0.0
    return [*found, _field_motion(apart, fit.target.frequency)] if apart else found


def _field_motion(apart_px: float, frequency: float) -> Finding:
    """Return the finding that the fields are displaced, with the loss of MTF in their mean."""
    lowered = 1.0 - np.cos(np.pi * frequency * apart_px)
    effect = f"odd rows show the bars {apart_px:.2f} px beside even ones: the MTF is {100 * lowered:.2g} % too low"
    return Finding(flag="interlace-motion", effect=effect, remedy="one field alone, or a target that stands still")


def light_in_standard_errors(fit: BarFit) -> float:
    """Return the bars' light in its standard uncertainties at fixed shape and position."""
    slope = fit.slope[[fit.names.index("level_dn"), fit.names.index("pedestal_dn")]]
    weighed = slope / fit.noise.variance
    estimator = np.asarray(np.linalg.solve(weighed @ slope.T, weighed), dtype=np.float64)
    return abs(fit["level_dn"]) / float(np.sqrt(fit.noise.spread(estimator, fit.window)[0, 0]))


def fundamental_in_standard_errors(fit: BarFit) -> float:
    """Return the fundamental of the bars' core in its standard uncertainties."""
    target, pixels = fit.target, fit.model_dn + fit.residual_dn - fit["pedestal_dn"]
    across, _ = target.coordinates((fit.window.shape[0], fit.window.shape[1]))
    core = target.box((fit.window.shape[0], fit.window.shape[1]), core_margin_px(target.frequency))[fit.window]
    phase = 2.0 * np.pi * target.frequency * across[fit.window]
    waves = np.where(core, np.stack([np.cos(phase), np.sin(phase)]), 0.0)
    spread = fit.noise.spread(waves, fit.window)
    modulus, sd = float(np.hypot(*(waves @ pixels))), float(np.sqrt(0.5 * np.trace(spread)))
    return modulus / max(sd, 1e-12 * modulus + 1e-30)


def _profile_residual_rms(fit: BarFit) -> float:
    """Return the rms of the mean residual profile across the bars, DN, where it exceeds noise and model tolerance.

    Averaging along the bars suppresses noise, also where the noise was estimated from these residuals.
    """
    across, _ = fit.target.coordinates((fit.window.shape[0], fit.window.shape[1]))
    near = np.abs(across[fit.window]) < fit.target.width_px / 2.0 + 1.0 / fit.target.frequency
    place = np.floor(across[fit.window][near]).astype(np.intp)
    place = place - place.min()
    count = np.bincount(place)
    shared = float(np.abs(fit.noise.correlation).sum()) * fit.noise.inflation
    mean = np.bincount(place, fit.residual_dn[near])[count > 0] / count[count > 0]
    expected = np.bincount(place, fit.noise.variance[near])[count > 0] * shared / count[count > 0] ** 2
    noise = SIGNIFICANT * np.sqrt(2.0 * float(np.sum(expected**2))) / mean.size
    square = float(np.mean(mean**2 - expected))
    return float(np.sqrt(square)) if square > (MISFIT * fit["level_dn"]) ** 2 + noise else 0.0


def _field_offset_px(fit: BarFit) -> float:
    """Return the displacement of odd rows from even rows across the bars, px, where it is significant."""
    odd = 1.0 - 2.0 * (np.nonzero(fit.window)[0] % 2)
    slope = fit.slope[fit.names.index("across_px")] * odd
    weight = 1.0 / float(slope @ slope)
    apart = 2.0 * weight * float(slope @ fit.residual_dn)
    sd = 2.0 * np.sqrt(weight * np.mean(fit.residual_dn**2))
    return abs(apart) if abs(apart) > max(SIGNIFICANT * sd, FIELD_OFFSET_PX) else 0.0


def not_identifiable(target: BarTarget, length_px: float) -> str | None:
    """Return why the fundamental cannot be separated from its alias; None where it can.

    Notes
    -----
    The alias of a component g along a grid axis lies at 1 - g. The spectrum of N bars is f/N wide on either side, so
    that the two overlap where 1 - 2 g < 2 f/N, unless the tilt of the bars covers the pixel's phases.
    """
    cosine, sine = abs(np.cos(target.angle_rad)), abs(np.sin(target.angle_rad))
    ratio = target.pitch_ratio
    cases = [
        (target.frequency * cosine, length_px * sine),
        (target.frequency * sine * ratio, length_px * cosine / ratio),
    ]
    for sampled, travel in cases:
        if 1.0 - 2.0 * sampled < MIN_ALIAS_DISTANCE * target.frequency / target.bars and travel < MIN_TRAVEL_PX:
            return (
                f"not identifiable: {sampled:.3g} cycles per sample have their alias at {1.0 - sampled:.3g}, and the "
                f"bars travel only {travel:.2g} px over their length; tilt them by a few degrees"
            )
    return None
