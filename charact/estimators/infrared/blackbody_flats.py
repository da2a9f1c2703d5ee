"""SiTF, NETD and 3-D noise in kelvin from flats of a black body at two or more temperatures."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from charact.estimators.infrared.signal_transfer import (
    ZERO_C,
    Response,
    SignalTransfer,
    band_note,
    fit_signal_transfer,
)
from charact.estimators.infrared.thresholds import INFRARED
from charact.estimators.noise.findings import (
    Finding,
    Unmeasurable,
    fields_of,
    flags_of,
    notes_of,
    with_remedy,
)
from charact.estimators.noise.gain.series import gain_of, read_levels
from charact.estimators.noise.prepared_session import defect_pixels, prepare
from charact.estimators.noise.three_dimensional import three_dimensional
from charact.frames.components import shading
from charact.frames.rounding import QUANTISED_DN2, rounding_sd
from charact.frames.stack_statistics import StackStatistics
from charact.frames.thresholds import CUBE
from charact.method import Context
from charact.method.registry import single_blas_thread
from charact.method.stopwatch import with_timing
from labdata.camera.description import is_thermal
from labdata.measurement import (
    Measurement,
    Posterior,
    Result,
    intervals_of,
    make_measurement,
    make_refusal,
    measurement_from_draws,
)
from labdata.session import Session, StackEntry

Array = NDArray[np.float64]
METHOD = "signal-transfer"
E1543 = "ASTM E1543 (scanning imagers, background 295 K, noise through a reference filter)"

ONE_WAY = (
    "Levels were taken in the order of their temperature: a steady drift of the offset between "
    "them (10 to 50 mK/min of an uncooled camera without shutter corrections) would change SiTF "
    "unseen; some levels taken again show it."
)


def blackbody_flats(session: Session) -> tuple[StackEntry, ...]:
    """Return the flats of a session that show a black body of known temperature."""
    return tuple(
        entry for entry in session.of_kind("flat") if entry.conditions.blackbody_c is not None
    )


def is_linear(result: Result) -> bool:
    """Return whether black-body levels at three temperatures or more follow the law of radiance."""
    transfers = [
        m
        for m in result.find("sitf")
        if m.value is not None and not {"nonlinear", "drift", "agc"} & {*m.flags}
    ]
    return bool(transfers) and len(set(result.evidence["signal-transfer"]["blackbody_c"])) > 2


@with_timing
def measure(session: Session, *, context: Context) -> Result:
    """Measure SiTF, NETD and 3-D noise in DN and K from black-body flats.

    Parameters
    ----------
    session
        Session with flats whose conditions state `blackbody_c`; `background_c` is the temperature
        at which SiTF and NETD are stated. Other stacks are not used.
    context
        Settings of the method; the band of its imager, where there is one, gives the radiometric
        form.

    Returns
    -------
    Result
        `sitf` (DN/K) and `netd` (mK) of the session, or the reason why not; of every stack of eight
        frames and more `noise_t` to `noise_tvh` in DN and, where `sitf` is known, in K at the
        temperature of its black body.

    Notes
    -----
    NETD = sigma_tvh / SiTF, both at the background temperature: variances are interpolated between
    the levels. The spatial NETD is `noise_vh` in K. See
    `charact.estimators.infrared.signal_transfer`.
    """
    ready = prepare(replace(session, stacks=blackbody_flats(session)), context=context)
    context = ready.context
    _, flats, single = read_levels(ready.session, context=context, spectra=False, cubes=True)
    fields = fields_of(METHOD, context)
    noise = three_dimensional(flats, context=context)
    try:
        with single_blas_thread():
            series = _series(flats, single, context)
    except Unmeasurable as reason:
        refused = {"reason": str(reason), "refusal": "missing", **fields}
        result = Result(
            measurements=(
                make_refusal("sitf", "DN/K", **refused),
                make_refusal("netd", "mK", **refused),
            )
        )
    else:
        kelvin = [m for m in map(series.in_kelvin, noise.measurements) if m is not None]
        measurements = (series.sitf(context, fields), series.netd(noise, context, fields), *kelvin)
        result = Result(
            measurements=measurements, evidence={"signal-transfer": series.figure_data()}
        )
    return ready.in_dn(result + noise) + defect_pixels(
        ready.session, ready.surveys, ready.defects, context=context
    )


def _kelvin(level: StackStatistics) -> float:
    """Return the temperature of a level's black body, K."""
    assert level.conditions.blackbody_c is not None
    return level.conditions.blackbody_c + ZERO_C


@dataclass(frozen=True, kw_only=True)
class BlackbodySeries:
    """Levels of one setting in order of temperature, their signal transfer, and what was found."""

    levels: tuple[StackStatistics, ...]
    mean_sd_dn: Array  # standard error of each mean by temporal noise and rounding, shape (level,)
    transfer: SignalTransfer
    findings: tuple[Finding, ...]
    band_um: tuple[float, float] | None
    background: Finding  # note on the background temperature
    seed: int

    def sitf(self, context: Context, fields: dict[str, Any]) -> Measurement:
        """Return the SiTF at the background temperature."""
        draws = self.transfer.sitf
        findings = [
            self.background,
            Finding(None, band_note(self.band_um, self.transfer)),
            *self.findings,
        ]
        if np.median(draws) < 0:
            draws, findings = (
                -draws,
                [*findings, Finding(None, "White is cold: the signal falls with temperature.")],
            )
        findings.append(
            Finding(
                None,
                "Temperatures are taken as stated: emissivity of the black body and transmission "
                "of a collimator or window are not corrected.",
            )
        )
        posterior = Posterior(
            names=("sitf",),
            units=("DN/K",),
            draws=draws[:, None],
            sampler="laplace",
            seed=self.seed,
        )
        return measurement_from_draws(
            "sitf",
            "DN/K",
            draws,
            flags=flags_of(findings),
            notes=notes_of(findings),
            posterior=posterior,
            **fields,
        )

    def netd(self, noise: Result, context: Context, fields: dict[str, Any]) -> Measurement:
        """Return the temporal NETD at the background temperature; `noise`: the 3-D noise of the
        levels, DN.
        """
        known = [level for level in self.levels if level.cube is not None]
        if not known:
            reason = (
                f"NETD needs a black-body stack of at least {CUBE.min_frames} frames, and "
                f"{CUBE.min_pixels} rows and columns in each field"
            )
            return make_refusal("netd", "mK", reason, refusal="missing", **fields)
        rng, transfer = np.random.default_rng([context.seed, 43]), self.transfer
        kelvin = np.array([_kelvin(level) for level in known])
        variance = np.stack([_draws(level, "tvh", rng) for level in known], axis=1)
        pairs = zip(transfer.background_k, variance, strict=True)
        variance_dn2 = np.array(
            [np.interp(at, kelvin, level_variance) for at, level_variance in pairs]
        )
        # Beyond the levels the photon noise, an unknown part of the variance, goes on with
        # radiance.
        at = np.clip(transfer.background_k, kelvin[0], kelvin[-1])
        radiance_excess = WORST.radiance(transfer.background_k) / WORST.radiance(at) - 1.0
        variance_dn2 = variance_dn2 * (1.0 + radiance_excess * rng.uniform(0.0, 1.0, len(at)))
        draws = 1e3 * np.sqrt(np.maximum(variance_dn2, 0.0)) / np.abs(transfer.sitf)
        scanner = is_thermal(context.camera) and context.camera.scanner is not None
        standard = (
            f"as by {E1543}, but of frames as recorded, without that filter"
            if scanner
            else f"not by {E1543}"
        )
        what = (
            f"Temporal NETD, sigma_tvh / SiTF with quantisation, {standard}; the spatial one "
            f"is noise_vh in K."
        )
        findings = [Finding(None, what), self.background, *self.findings]
        nearest = np.argsort(np.abs(kelvin - np.median(at)), kind="stable")[:2]
        for m in (
            m for i in nearest for m in noise.find("noise_tvh", stack=known[i].label) if m.flags
        ):
            findings += [
                Finding(flag, f"{flag}: random noise of {m.stack}: {'; '.join(m.notes)}")
                for flag in m.flags
            ]
        posterior = Posterior(
            names=("sitf", "netd"),
            units=("DN/K", "mK"),
            sampler="laplace",
            seed=self.seed,
            draws=np.column_stack([np.abs(transfer.sitf), draws]),
        )
        return measurement_from_draws(
            "netd",
            "mK",
            draws,
            flags=flags_of(findings),
            notes=notes_of(findings),
            posterior=posterior,
            **fields,
        )

    def in_kelvin(self, m: Measurement) -> Measurement | None:
        """Return a component of 3-D noise, DN, in K at its black body's temperature; None of an
        excluded level.
        """
        level = next((candidate for candidate in self.levels if candidate.label == m.stack), None)
        if m.value is None or m.interval95 is None or level is None or level.cube is None:
            return None
        rng, name = np.random.default_rng([self.seed, 44]), m.quantity.removeprefix("noise_")
        slope = np.abs(self.transfer.slope_at(_kelvin(level)))
        part = level.cube.components[name]
        # As in DN: a negative estimate is chance and must not lower the limit.
        draws = (
            np.sqrt(np.maximum(_draws(level, name, rng) - min(part.variance_dn2, 0.0), 0.0)) / slope
        )
        value = m.value / float(np.median(slope))
        _, *intervals = intervals_of(draws)
        around = [(min(low, value), max(high, value)) for low, high in intervals]
        if m.interval95[0] == 0.0:
            around[1] = (0.0, around[1][1])
        same = {key: getattr(m, key) for key in ("method", "seconds", "stack", "provenance")}
        notes = tuple(note for note in m.notes if not note.endswith(" DN")) + notes_of(
            self.findings
        )
        return make_measurement(
            m.quantity,
            "K",
            value,
            *around,
            flags=(*m.flags, *flags_of(self.findings)),
            notes=notes,
            **same,
        )

    def figure_data(self) -> dict[str, Any]:
        """Return the figure data: levels, law and residuals."""
        transfer = self.transfer
        slope = float(np.median(transfer.slope_dn_per_k))
        warm = np.linspace(_kelvin(self.levels[0]), _kelvin(self.levels[-1]), 41)
        return {
            "figure": "signal-transfer",
            "label": [level.label for level in self.levels],
            "blackbody_c": [_kelvin(level) - ZERO_C for level in self.levels],
            "mean_dn": [level.mean_dn for level in self.levels],
            "mean_sd_dn": np.hypot(self.mean_sd_dn, slope * INFRARED.blackbody_sd_k).tolist(),
            "residual_k": (transfer.residual_dn / slope).tolist(),
            "background_c": float(np.median(transfer.background_k)) - ZERO_C,
            "law": transfer.likeliest.name,
            "law_c": (warm - ZERO_C).tolist(),
            "law_mean_dn": transfer.law_dn(warm).tolist(),
            "chi2": transfer.chi2,
        }


def _draws(level: StackStatistics, name: str, rng: np.random.Generator) -> Array:
    """Return draws of the variance of a component, shape (draw,), DN^2."""
    assert level.cube is not None
    return level.cube.components[name].draws(rng, INFRARED.draws)


# Response whose radiance grows fastest with temperature.
WORST = Response(low_um=3.0, high_um=5.0)


def _series(flats: list[StackStatistics], single: list[str], context: Context) -> BlackbodySeries:
    """Return the series of black-body levels; Unmeasurable if there is no signal transfer."""
    chosen, notes = _one_setting(flats)
    if (
        len(chosen) > 2
        and np.all(steps := np.sign(np.diff([_kelvin(level) for level in chosen])))
        and np.ptp(steps) == 0
    ):
        notes.append(Finding(None, ONE_WAY))
    chosen.sort(key=_kelvin)
    if single:
        notes.append(Finding(None, f"excluded (single frame, no noise): {', '.join(single)}"))
    chosen, saturated = _drop_saturated(chosen)
    notes += saturated
    if len(temperatures := sorted({_kelvin(level) - ZERO_C for level in chosen})) < 2:
        known = f"one, at {temperatures[0]:.1f} °C" if temperatures else "none"
        other = f"{temperatures[0] + 5.0:.0f} °C" if temperatures else "20 and 30 °C"
        exclusions = "".join(f"; {finding.note}" for finding in notes)
        raise Unmeasurable(
            "SiTF needs two or more black-body levels (flats with blackbody_c, neither clipped "
            f"nor single frames), got {known}{exclusions}: add 8 or more frames at {other}; "
            f"{INFRARED.advised_levels} levels also show drift and bend"
        )
    kelvin, mean = np.array([(_kelvin(level), level.mean_dn) for level in chosen]).T
    sd = np.array([_mean_sd(level) for level in chosen])
    _require_order(kelvin, mean, sd)
    background_k, background = _background(chosen)
    imager = context.camera
    band = (float(imager.band.short_um), float(imager.band.long_um)) if is_thermal(imager) else None
    transfer = fit_signal_transfer(
        kelvin,
        mean,
        sd,
        background_k=background_k,
        band_um=band,
        rng=np.random.default_rng([context.seed, 42]),
    )
    middle, spread = float(np.median(transfer.sitf)), float(np.std(transfer.slope_dn_per_k))
    if abs(middle) < INFRARED.significant_sd * spread:
        raise Unmeasurable(
            f"the mean does not follow the black body: the slope is {middle:.3g} ± {spread:.2g} "
            "DN/K; switch automatic gain and level off, set levels further apart, and let the "
            "black body fill the frame"
        )
    findings = [
        *notes,
        *_fit_findings(chosen, transfer),
        *_gain_findings(chosen),
        *_gradient_findings(chosen),
    ]
    return BlackbodySeries(
        levels=tuple(chosen),
        mean_sd_dn=sd,
        transfer=transfer,
        findings=tuple(findings),
        band_um=band,
        background=background,
        seed=context.seed,
    )


def _one_setting(flats: list[StackStatistics]) -> tuple[list[StackStatistics], list[Finding]]:
    """Return the levels of the gain and exposure with most temperatures, and a note on the
    others.
    """
    settings: dict[tuple, list[StackStatistics]] = {}
    for level in flats:
        settings.setdefault((*gain_of(level.conditions), level.conditions.exposure_s), []).append(
            level
        )
    chosen = max(
        settings.values(), key=lambda levels: len({_kelvin(flat) for flat in levels}), default=[]
    )
    chosen_labels = {level.label for level in chosen}
    other = [level.label for level in flats if level.label not in chosen_labels]
    return chosen, [
        Finding(None, f"excluded (other gain or exposure): {', '.join(other)}")
    ] if other else []


def _drop_saturated(levels: list[StackStatistics]) -> tuple[list[StackStatistics], list[Finding]]:
    """Return the levels without clipped values and without a collapse of noise at either end, and
    what was left out.
    """
    unsaturated = [
        level
        for level in levels
        if max(level.low_fraction, level.high_fraction) <= INFRARED.max_clipped_fraction
    ]
    out = [
        level.label
        for level in levels
        if max(level.low_fraction, level.high_fraction) > INFRARED.max_clipped_fraction
    ]
    findings = (
        [Finding(None, f"excluded (values at 0 DN or full scale): {', '.join(out)}")] if out else []
    )
    for end, inner in ((-1, -2), (0, 1)):
        while (
            len(unsaturated) > 2
            and unsaturated[end].variance_dn2
            < INFRARED.saturated_noise**2 * unsaturated[inner].variance_dn2
        ):
            gone = unsaturated.pop(end)
            ratio = np.sqrt(gone.variance_dn2 / unsaturated[end].variance_dn2)
            effect = (
                f"noise of {gone.label} falls to {ratio:.2g} of the next level's, so it was "
                f"excluded"
            )
            findings.append(
                with_remedy("saturated", effect, "levels within the span of the camera")
            )
    return unsaturated, findings


def _mean_sd(level: StackStatistics) -> float:
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


def _require_order(kelvin: Array, mean: Array, sd: Array) -> None:
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


def _background(levels: list[StackStatistics]) -> tuple[float | None, Finding]:
    """Return the background temperature, K, None if unknown, and the finding on it."""
    stated = [
        level.conditions.background_c
        for level in levels
        if level.conditions.background_c is not None
    ]
    if not stated:
        low, high = (_kelvin(levels[end]) - ZERO_C for end in (0, -1))
        sentence = (
            "The background temperature is not stated: SiTF and NETD hold at one between the "
            f"levels, {low:.1f} to {high:.1f} °C, and the interval holds all of them; "
            "background_c in session.toml narrows it."
        )
        return None, Finding(None, sentence)
    middle, span_k = float(np.mean(stated)), float(np.ptp(stated))
    sentence = f"Background {middle:.1f} °C ({middle + ZERO_C:.1f} K)."
    if span_k <= INFRARED.background_k:
        return middle + ZERO_C, Finding(None, sentence)
    effect = (
        f"stated backgrounds differ by {span_k:.2g} K; the value holds at their mean, "
        f"{middle:.1f} °C"
    )
    return middle + ZERO_C, with_remedy("unlike-conditions", effect, "levels of one background_c")


def _fit_findings(levels: list[StackStatistics], transfer: SignalTransfer) -> list[Finding]:
    """Return the findings of the fit: a bend, scatter of the levels, drift within them, and
    extrapolation.
    """
    out: list[Finding] = []
    kelvin = np.array([_kelvin(level) for level in levels])
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
                with_remedy(
                    "nonlinear",
                    effect,
                    "levels closer to the background, or the band of the sensor",
                )
            )
        else:
            remedy = (
                "a shutter correction before every level, levels up and down, a settled black body"
            )
            out.append(
                with_remedy("drift", f"{departure}: the offset changed between them", remedy)
            )
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
            with_remedy("drift", effect, "levels up and down, or each after a shutter correction")
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
        out.append(with_remedy("extrapolated", effect, "levels around the background temperature"))
    if len(levels) < INFRARED.advised_levels:
        out.append(
            Finding(
                None,
                (
                    f"{len(levels)} levels; {INFRARED.advised_levels} tell scatter, drift and bend "
                    f"apart."
                ),
            )
        )
    return out


def _gain_findings(levels: list[StackStatistics]) -> list[Finding]:
    """Return the finding of a gain that changed between levels, by condition or by their noise."""
    if any(level.conditions.automatic_gain for level in levels):
        return [
            with_remedy(
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
    draws = [_draws(level, "tvh", rng) for level in known]
    faint, loud = (
        int(of([np.median(black_body) for black_body in draws])) for of in (np.argmin, np.argmax)
    )
    ratio = np.sqrt(np.maximum(draws[loud], 0.0) / np.maximum(draws[faint], 1e-12))
    ends = [float(WORST.radiance(_kelvin(known[i]))) for i in (0, -1)]
    allowed = (1.0 + INFRARED.noise_change) * np.sqrt(ends[1] / ends[0])
    if np.quantile(ratio, 0.025) <= allowed:
        return []
    effect = (
        f"random noise of {known[loud].label} is {np.median(ratio):.3g} times that of "
        f"{known[faint].label}, of which photons explain at most {allowed:.3g}: the gain changed "
        "between the levels"
    )
    return [with_remedy("agc", effect, "automatic gain off, and one gain for all levels")]


def _gradient_findings(levels: list[StackStatistics]) -> list[Finding]:
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
                with_remedy(
                    "gradient",
                    effect,
                    "a black body that fills the field of view, or frames cut to it",
                )
            ]
    return []
