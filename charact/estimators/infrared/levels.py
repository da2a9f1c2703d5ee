"""Levels of a black body: which of them count, and what is found about them."""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from charact.estimators.infrared.signal_transfer import ZERO_C, Response, SignalTransfer
from charact.estimators.infrared.thresholds import INFRARED
from charact.estimators.noise.findings import Unmeasurable
from charact.estimators.noise.gain.series import gain_of
from charact.frames.components import shading
from charact.frames.rounding import QUANTISED_DN2, rounding_sd
from charact.frames.stack_statistics import StackStatistics
from charact.verdict import Finding
from labdata import Array, Measurement
from labdata.measurement import intervals_of

ONE_WAY = (
    "Levels were taken in the order of their temperature: a steady drift of the offset between "
    "them (10 to 50 mK/min of an uncooled camera without shutter corrections) would change SiTF "
    "unseen; some levels taken again show it."
)


# Response whose radiance grows fastest with temperature.
WORST = Response(low_um=3.0, high_um=5.0)


def kelvin_of(level: StackStatistics) -> float:
    """Return the temperature of a level's black body, K."""
    assert level.conditions.blackbody_c is not None
    return level.conditions.blackbody_c + ZERO_C


def variance_draws(level: StackStatistics, name: str, rng: np.random.Generator) -> Array:
    """Return draws of the variance of a component, shape (draw,), DN^2."""
    assert level.cube is not None
    return level.cube.components[name].draws(rng, INFRARED.draws)


def choose_levels(
    flats: list[StackStatistics], single: list[str]
) -> tuple[list[StackStatistics], list[str], list[Finding]]:
    """Return the levels of one setting in order of temperature, and notes and findings on those
    left out.

    `single`: labels of stacks of one frame. Fewer than two temperatures are Unmeasurable.
    """
    settings: dict[tuple, list[StackStatistics]] = {}
    for level in flats:
        key = (*gain_of(level.conditions), level.conditions.exposure_s)
        settings.setdefault(key, []).append(level)
    # Of the gain and exposure with most temperatures.
    of_setting = max(
        settings.values(), key=lambda levels: len({kelvin_of(flat) for flat in levels}), default=[]
    )
    labels = {level.label for level in of_setting}
    clipped = [level.label for level in of_setting if _is_clipped(level)]
    exclusions = {
        "other gain or exposure": [level.label for level in flats if level.label not in labels],
        "single frame, no noise": single,
        "values at 0 DN or full scale": clipped,
    }
    notes = [f"excluded ({why}): {', '.join(out)}" for why, out in exclusions.items() if out]
    steps = np.sign(np.diff([kelvin_of(level) for level in of_setting]))
    if len(of_setting) > 2 and np.all(steps) and np.ptp(steps) == 0:
        notes.append(ONE_WAY)
    chosen = sorted((level for level in of_setting if not _is_clipped(level)), key=kelvin_of)
    saturated = _drop_saturated(chosen)
    if len(temperatures := sorted({kelvin_of(level) - ZERO_C for level in chosen})) < 2:
        known = f"one, at {temperatures[0]:.1f} °C" if temperatures else "none"
        other = f"{temperatures[0] + 5.0:.0f} °C" if temperatures else "20 and 30 °C"
        reasons = "".join(f"; {note}" for note in [*notes, *(check.note for check in saturated)])
        raise Unmeasurable(
            "SiTF needs two or more black-body levels (flats with blackbody_c, neither clipped "
            f"nor single frames), got {known}{reasons}: add 8 or more frames at {other}; "
            f"{INFRARED.advised_levels} levels also show drift and bend"
        )
    return chosen, notes, saturated


def _is_clipped(level: StackStatistics) -> bool:
    return max(level.low_fraction, level.high_fraction) > INFRARED.max_clipped_fraction


def _drop_saturated(levels: list[StackStatistics]) -> list[Finding]:
    """Take off the levels at either end whose noise collapses, and return the findings of that."""
    findings = []
    for end, inner in ((-1, -2), (0, 1)):
        while (
            len(levels) > 2
            and levels[end].variance_dn2 < INFRARED.saturated_noise**2 * levels[inner].variance_dn2
        ):
            gone = levels.pop(end)
            ratio = np.sqrt(gone.variance_dn2 / levels[end].variance_dn2)
            effect = (
                f"noise of {gone.label} falls to {ratio:.2g} of the next level's, so it was "
                f"excluded"
            )
            findings.append(finding("saturated", effect, "levels within the span of the camera"))
    return findings


def finding(flag: str, effect: str, remedy: str) -> Finding:
    """Return an unbounded finding."""
    return Finding(flag=flag, effect=effect, remedy=remedy)


def mean_sd_of(level: StackStatistics) -> float:
    """Return the standard error of a level's mean by temporal noise, its slow part counted, and
    rounding, DN.
    """
    means = level.frame_mean_dn - level.mean_dn
    variance = float(means @ means) / max(len(means) - 1, 1)
    successive = float(means[:-1] @ means[1:]) / max(len(means) - 1, 1)
    correlation = float(np.clip(successive / variance, 0.0, 0.95)) if variance > 0 else 0.0
    mean_variance = variance / len(means) * (1.0 + correlation) / (1.0 - correlation)
    rounding, _ = rounding_sd(level.variance_dn2 + max(level.spatial_variance_dn2, 0.0))
    white = level.variance_dn2 / (level.frames * level.pixels)
    return float(np.sqrt(max(mean_variance, white) + rounding**2))


def require_order(kelvin: Array, mean: Array, sd: Array) -> None:
    """Raise Unmeasurable if the means do not order with temperature: the gain or level followed the
    scene.
    """
    steps, error = np.diff(mean), np.hypot(sd[1:], sd[:-1])
    is_warmer = np.diff(kelvin) > 2.0 * np.sqrt(2.0) * INFRARED.blackbody_sd_k
    turned = is_warmer & (steps * np.sign(mean[-1] - mean[0]) < -INFRARED.significant_sd * error)
    if turned.any():
        i = int(np.argmax(turned))
        raise Unmeasurable(
            f"the mean turns back by {abs(steps[i]):.3g} DN from {kelvin[i] - ZERO_C:.1f} to "
            f"{kelvin[i + 1] - ZERO_C:.1f} °C: gain or level followed the scene, or the offset "
            "was corrected between the levels; switch automatic gain off and take each level "
            "after one shutter correction"
        )


@dataclass(frozen=True, kw_only=True)
class BlackbodyBackground:
    """Temperature at which SiTF and NETD are stated."""

    kelvin: float | None  # None: unknown
    note: str
    span_k: float = 0.0  # range of the stated temperatures

    def findings_of(self, measurement: Measurement) -> list[Finding]:
        """Return the finding of backgrounds that differ by S: dL/dT of the steepest band at T + S/2
        over that at T, less one.
        """
        if self.kelvin is None or self.span_k <= INFRARED.background_k:
            return []
        growth = WORST.derivative(self.kelvin + self.span_k / 2.0) / WORST.derivative(self.kelvin)
        return [
            Finding(
                flag="unlike-conditions",
                effect=f"stated backgrounds differ by {self.span_k:.2g} K",
                remedy="levels of one background_c",
                bound=abs(measurement.value or 0.0) * float(growth - 1.0),
            )
        ]


def background_of(levels: list[StackStatistics]) -> BlackbodyBackground:
    """Return the background of the levels."""
    stated = [
        level.conditions.background_c
        for level in levels
        if level.conditions.background_c is not None
    ]
    if not stated:
        low, high = (kelvin_of(levels[end]) - ZERO_C for end in (0, -1))
        sentence = (
            "The background temperature is not stated: SiTF and NETD hold at one between the "
            f"levels, {low:.1f} to {high:.1f} °C, and the interval holds all of them; "
            "background_c in session.toml narrows it."
        )
        return BlackbodyBackground(kelvin=None, note=sentence)
    middle = float(np.mean(stated))
    return BlackbodyBackground(
        kelvin=middle + ZERO_C,
        note=f"Background {middle:.1f} °C ({middle + ZERO_C:.1f} K).",
        span_k=float(np.ptp(stated)),
    )


def fit_findings(levels: list[StackStatistics], transfer: SignalTransfer) -> list[Finding]:
    """Return the findings of the fit: a bend, scatter of the levels, drift within them, and
    extrapolation.
    """
    out: list[Finding] = []
    kelvin = np.array([kelvin_of(level) for level in levels])
    middle, slope = (
        abs(float(np.median(transfer.sitf))),
        abs(float(np.median(transfer.slope_dn_per_k))),
    )
    _, _, (low, high) = intervals_of(transfer.sitf)
    freedom, worst = len(levels) - 2, float(np.abs(transfer.residual_dn).max()) / slope
    if freedom and chdtrc(freedom, transfer.chi2) < INFRARED.false_alarm:
        departure = f"levels depart from the law ({transfer.likeliest.name}) by up to {worst:.2g} K"
        if transfer.chi2 - transfer.parabola_chi2 > INFRARED.bend_share * transfer.chi2:
            effect = (
                f"{departure}, along a bend that changes SiTF by "
                f"{100.0 * transfer.parabola_slope:.2g} %"
            )
            out.append(
                finding(
                    "nonlinear",
                    effect,
                    "levels closer to the background, or the band of the sensor",
                )
            )
        else:
            remedy = (
                "a shutter correction before every level, levels up and down, a settled black body"
            )
            out.append(finding("drift", f"{departure}: the offset changed between them", remedy))
    drifts = [
        black_body.cube.means.drift_dn
        for black_body in levels
        if black_body.cube is not None and black_body.cube.means.drift_seen
    ]
    drift_dn = float(np.sum(np.abs(drifts)))
    if drift_dn > 0.5 * (high - low) * float(np.ptp(kelvin)):
        effect = (
            f"the mean drifts by {drift_dn / slope:.2g} K within the stacks, more between them, "
            f"which may change SiTF by {100.0 * drift_dn / middle / float(np.ptp(kelvin)):.2g} %"
        )
        out.append(
            finding("drift", effect, "levels up and down, or each after a shutter correction")
        )
    distance = float(
        np.median(
            np.abs(transfer.background_k - np.clip(transfer.background_k, kelvin[0], kelvin[-1]))
        )
    )
    if distance > float(np.ptp(kelvin)):
        effect = (
            f"the background lies {distance:.1f} K beyond the levels, which span "
            f"{np.ptp(kelvin):.1f} K"
        )
        out.append(finding("extrapolated", effect, "levels around the background temperature"))
    return out


def gain_findings(levels: list[StackStatistics]) -> list[Finding]:
    """Return the finding of a gain that changed between levels, by condition or by their noise."""
    if any(level.conditions.automatic_gain for level in levels):
        return [
            finding(
                "agc",
                "automatic gain was on, so that levels may differ in gain",
                "automatic gain off",
            )
        ]
    known = [
        black_body
        for black_body in levels
        if black_body.cube is not None
        and black_body.cube.components["tvh"].variance_dn2 > QUANTISED_DN2
    ]
    if len(known) < 2:
        return []
    rng = np.random.default_rng(45)
    draws = [variance_draws(level, "tvh", rng) for level in known]
    faint, loud = (
        int(of([np.median(black_body) for black_body in draws])) for of in (np.argmin, np.argmax)
    )
    ratio = np.sqrt(np.maximum(draws[loud], 0.0) / np.maximum(draws[faint], 1e-12))
    ends = [float(WORST.radiance(kelvin_of(known[i]))) for i in (0, -1)]
    allowed = (1.0 + INFRARED.noise_change) * np.sqrt(ends[1] / ends[0])
    if np.quantile(ratio, 0.025) <= allowed:
        return []
    effect = (
        f"random noise of {known[loud].label} is {np.median(ratio):.3g} times that of "
        f"{known[faint].label}, of which photons explain at most {allowed:.3g}: the gain changed "
        "between the levels"
    )
    return [finding("agc", effect, "automatic gain off, and one gain for all levels")]


def gradient_findings(levels: list[StackStatistics]) -> list[Finding]:
    """Return the finding of a response that varies smoothly over the frame."""
    if levels[0].cube is None or levels[-1].cube is None:
        return []
    cold, hot = levels[0].cube, levels[-1].cube
    for axis in ("row", "column"):
        change = getattr(hot, f"{axis}_mean_dn") - getattr(cold, f"{axis}_mean_dn")
        basis = shading(len(change))
        smooth = basis @ (basis.T @ change)
        if (size := float(np.ptp(smooth) / abs(change.mean()))) > INFRARED.response_change:
            effect = (
                f"the response varies by {100.0 * size:.2g} % over the {axis}s; SiTF is its "
                f"mean over the frame"
            )
            return [
                finding(
                    "gradient",
                    effect,
                    "a black body that fills the field of view, or frames cut to it",
                )
            ]
    return []
