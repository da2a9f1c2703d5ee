"""SiTF, NETD and 3-D noise in kelvin from flats of a black body at two or more temperatures."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from charact.estimators.infrared.levels import (
    WORST,
    BlackbodyBackground,
    background_of,
    choose_levels,
    finding,
    fit_findings,
    gain_findings,
    gradient_findings,
    kelvin_of,
    mean_sd_of,
    require_order,
    variance_draws,
)
from charact.estimators.infrared.signal_transfer import (
    ZERO_C,
    SignalTransfer,
    band_note,
    fit_signal_transfer,
)
from charact.estimators.infrared.thresholds import INFRARED
from charact.estimators.noise.findings import (
    Unmeasurable,
    fields_of,
    findings_in,
    rounding_findings,
    scaled,
)
from charact.estimators.noise.gain.series import read_levels
from charact.estimators.noise.prepared_session import defect_pixels, prepare
from charact.estimators.noise.three_dimensional import three_dimensional
from charact.frames.stack_statistics import StackStatistics
from charact.frames.thresholds import CUBE
from charact.method import Context
from charact.method.registry import single_blas_thread
from charact.method.stopwatch import with_timing
from charact.verdict import Finding, judge
from labdata import Array, Session, StackEntry
from labdata.camera.description import is_thermal
from labdata.measurement import (
    Measurement,
    Posterior,
    Result,
    intervals_of,
    make_refusal,
    measurement_from_draws,
)

METHOD = "signal-transfer"
E1543 = "ASTM E1543 (scanning imagers, background 295 K, noise through a reference filter)"


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


@dataclass(frozen=True, kw_only=True)
class BlackbodySeries:
    """Levels of one setting in order of temperature, their signal transfer, and what was found."""

    levels: tuple[StackStatistics, ...]
    mean_sd_dn: Array  # standard error of each mean by temporal noise and rounding, shape (level,)
    transfer: SignalTransfer
    notes: tuple[str, ...]
    findings: tuple[Finding, ...]
    band_um: tuple[float, float] | None
    background: BlackbodyBackground
    seed: int

    def sitf(self, context: Context, fields: dict[str, Any]) -> Measurement:
        """Return the SiTF at the background temperature."""
        draws = self.transfer.sitf
        notes = [self.background.note, band_note(self.band_um, self.transfer), *self.notes]
        if np.median(draws) < 0:
            draws = -draws
            notes.append("White is cold: the signal falls with temperature.")
        notes.append(
            "Temperatures are taken as stated: emissivity of the black body and transmission "
            "of a collimator or window are not corrected."
        )
        posterior = Posterior(
            names=("sitf",),
            units=("DN/K",),
            draws=draws[:, None],
            sampler="laplace",
            seed=self.seed,
        )
        number = measurement_from_draws(
            "sitf", "DN/K", draws, notes=tuple(notes), posterior=posterior, **fields
        )
        return judge(number, [*self.background.findings_of(number), *self.findings])

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
        kelvin = np.array([kelvin_of(level) for level in known])
        variance = np.stack([variance_draws(level, "tvh", rng) for level in known], axis=1)
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
        nearest = np.argsort(np.abs(kelvin - np.median(at)), kind="stable")[:2]
        of_noise = [
            finding(flag, f"random noise of {m.stack} is suspect", f"what settles its {flag}")
            for i in nearest
            for m in noise.find("noise_tvh", stack=known[i].label)
            for flag in m.flags
        ]
        posterior = Posterior(
            names=("sitf", "netd"),
            units=("DN/K", "mK"),
            sampler="laplace",
            seed=self.seed,
            draws=np.column_stack([np.abs(transfer.sitf), draws]),
        )
        notes = (what, self.background.note, *self.notes)
        number = measurement_from_draws(
            "netd", "mK", draws, notes=notes, posterior=posterior, **fields
        )
        rounded = [
            entry
            for i in nearest
            for entry in rounding_findings(known[i].cube.components["tvh"].variance_dn2)
        ]
        of_noise += findings_in(scaled(rounded, 1e3 / float(np.median(np.abs(transfer.sitf)))))
        return judge(number, [*self.background.findings_of(number), *self.findings, *of_noise])

    def in_kelvin(self, m: Measurement) -> Measurement | None:
        """Return a component of 3-D noise, DN, in K at its black body's temperature; None of an
        excluded level.
        """
        level = next((candidate for candidate in self.levels if candidate.label == m.stack), None)
        if m.value is None or m.interval95 is None or level is None or level.cube is None:
            return None
        rng, name = np.random.default_rng([self.seed, 44]), m.quantity.removeprefix("noise_")
        slope = np.abs(self.transfer.slope_at(kelvin_of(level)))
        part = level.cube.components[name]
        # As in DN: a negative estimate is chance and must not lower the limit.
        draws = (
            np.sqrt(np.maximum(variance_draws(level, name, rng) - min(part.variance_dn2, 0.0), 0.0))
            / slope
        )
        value = m.value / float(np.median(slope))
        _, *intervals = intervals_of(draws)
        around = [(min(low, value), max(high, value)) for low, high in intervals]
        if m.interval95[0] == 0.0:
            around[1] = (0.0, around[1][1])
        rounded = rounding_findings(part.variance_dn2) if name == "tvh" else []
        in_dn = tuple(start for entry in rounded for start in entry.beginnings)
        notes = (
            *(note for note in m.notes if not note.endswith(" DN") and not note.startswith(in_dn)),
            *self.notes,
        )
        number = replace(
            m, unit="K", value=value, interval68=around[0], interval95=around[1], notes=notes
        )
        of_noise = findings_in(scaled(rounded, 1.0 / float(np.median(slope))))
        return judge(number, [*self.findings, *of_noise])

    def figure_data(self) -> dict[str, Any]:
        """Return the figure data: levels, law and residuals."""
        transfer = self.transfer
        slope = float(np.median(transfer.slope_dn_per_k))
        warm = np.linspace(kelvin_of(self.levels[0]), kelvin_of(self.levels[-1]), 41)
        return {
            "figure": "signal-transfer",
            "label": [level.label for level in self.levels],
            "blackbody_c": [kelvin_of(level) - ZERO_C for level in self.levels],
            "mean_dn": [level.mean_dn for level in self.levels],
            "mean_sd_dn": np.hypot(self.mean_sd_dn, slope * INFRARED.blackbody_sd_k).tolist(),
            "residual_k": (transfer.residual_dn / slope).tolist(),
            "background_c": float(np.median(transfer.background_k)) - ZERO_C,
            "law": transfer.likeliest.name,
            "law_c": (warm - ZERO_C).tolist(),
            "law_mean_dn": transfer.law_dn(warm).tolist(),
            "chi2": transfer.chi2,
        }


def _series(flats: list[StackStatistics], single: list[str], context: Context) -> BlackbodySeries:
    """Return the series of black-body levels; Unmeasurable if there is no signal transfer."""
    chosen, notes, saturated = choose_levels(flats, single)
    if len(chosen) < INFRARED.advised_levels:
        notes.append(
            f"{len(chosen)} levels; {INFRARED.advised_levels} tell scatter, drift and bend apart."
        )
    kelvin, mean = np.array([(kelvin_of(level), level.mean_dn) for level in chosen]).T
    sd = np.array([mean_sd_of(level) for level in chosen])
    require_order(kelvin, mean, sd)
    background = background_of(chosen)
    imager = context.camera
    band = (float(imager.band.short_um), float(imager.band.long_um)) if is_thermal(imager) else None
    transfer = fit_signal_transfer(
        kelvin,
        mean,
        sd,
        background_k=background.kelvin,
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
        *saturated,
        *fit_findings(chosen, transfer),
        *gain_findings(chosen),
        *gradient_findings(chosen),
    ]
    return BlackbodySeries(
        levels=tuple(chosen),
        mean_sd_dn=sd,
        transfer=transfer,
        notes=tuple(notes),
        findings=tuple(findings),
        band_um=band,
        background=background,
        seed=context.seed,
    )
