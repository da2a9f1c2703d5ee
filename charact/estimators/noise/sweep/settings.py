"""Settings of a gain sweep, each with the noise of its flats and darks."""

from dataclasses import dataclass, field, replace

import numpy as np

from charact.estimators.noise.findings import finding, findings_in
from charact.estimators.noise.gain import emva1288
from charact.estimators.noise.gain.checks import series_findings
from charact.estimators.noise.gain.series import (
    GAINS,
    gain_obstacle,
    has_intensifier,
    longest_series,
    series_of_one_gain,
)
from charact.estimators.noise.gain.single_setting import (
    SingleSetting,
    fit_single_setting,
    quantisation_fraction,
)
from charact.estimators.noise.gain.undetected_correlation import allowance_of
from charact.estimators.noise.illumination import relative_sd_of
from charact.estimators.noise.thresholds import GAIN, SWEEP
from charact.frames.stack_statistics import StackStatistics
from charact.method import Context
from charact.verdict import Finding
from labdata import Array
from labdata.conditions import Conditions


@dataclass(frozen=True, kw_only=True)
class GainControl:
    """A control of the gain."""

    name: str  # name of the condition
    unit: str  # unit
    words: str  # name in notes
    logarithmic: bool  # whether the gain is a power of it; else the gain is exponential in it
    tube: bool  # whether it acts in the tube, so that the gain per electron is constant

    def place(self, value: Array) -> Array:
        """Return positions on the axis along which ln gain is linear."""
        if self.logarithmic:
            return np.log(value)
        return value * (np.log(10.0) / 20.0 if self.unit == "dB" else 1.0)

    def value(self, position: Array) -> Array:
        """Return the values at positions, the inverse of `place`."""
        if self.logarithmic:
            return np.exp(position)
        return position / (np.log(10.0) / 20.0 if self.unit == "dB" else 1.0)

    def text(self, value: float) -> str:
        """Return a value with its unit."""
        return (
            f"{value:.4g}"
            if self.unit == "1"
            else f"{value:.4g} {self.unit}{'s' * (self.unit == 'count')}"
        )


KNOBS = (
    GainControl(name="mcp_v", unit="V", words="MCP voltage", logarithmic=True, tube=True),
    GainControl(
        name="gain_control", unit="count", words="control word", logarithmic=False, tube=True
    ),
    GainControl(
        name="em_gain", unit="1", words="stated multiplication", logarithmic=True, tube=False
    ),
    GainControl(
        name="camera_gain_db", unit="dB", words="camera gain", logarithmic=False, tube=False
    ),
)


def setting_of(
    flats: list[StackStatistics], knob: GainControl
) -> list[tuple[float, list[StackStatistics]]]:
    """Return the flats by value of a control with all other controls equal; of several groups the
    one of most values.
    """
    by_gains: dict[tuple, list[StackStatistics]] = {}
    for flat in flats:
        value = getattr(flat.conditions, knob.name)
        if value is not None and (value > 0 or not knob.logarithmic):
            other_gains = tuple(
                repeatable_value(flat.conditions, name) for name in GAINS if name != knob.name
            )
            by_gains.setdefault(other_gains, []).append(flat)
    grouped = [_by_value(group, knob) for group in by_gains.values()]
    return max(
        grouped,
        key=lambda groups: (len(groups), sum(len(group) for _, group in groups)),
        default=[],
    )


def repeatable_value(conditions: Conditions, name: str) -> float | None:
    """Return a setting rounded to its repeatability."""
    value = getattr(conditions, name)
    if not value:
        return value
    if name == "camera_gain_db":
        return round(value / SWEEP.same_setting_db)
    return round(float(np.log(abs(value))) / SWEEP.same_setting)


def _by_value(
    flats: list[StackStatistics], knob: GainControl
) -> list[tuple[float, list[StackStatistics]]]:
    """Return the flats grouped by value within its repeatability, with the mean value."""
    groups: list[tuple[list[float], list[StackStatistics]]] = []
    for flat in sorted(flats, key=lambda level: getattr(level.conditions, knob.name)):
        value = getattr(flat.conditions, knob.name)
        same = SWEEP.same_setting_db if knob.unit == "dB" else SWEEP.same_setting * abs(value)
        if not groups or value - groups[-1][0][-1] > same:
            groups.append(([], []))
        groups[-1][0].append(value)
        groups[-1][1].append(flat)
    return [(float(np.mean(values)), group) for values, group in groups]


# Flags of a single series that do not apply to the joint fit.
OF_ONE_SERIES = ("too-few-frames", "nonlinear")


@dataclass(frozen=True, kw_only=True)
class SweepSetting:
    """Noise of the flats and darks of one setting."""

    value: float  # value of the control, in its unit
    labels: tuple[str, ...]  # labels of its flats in the linear range, in order of rising level
    # draws of the covariance gain, or for white noise of the system gain, shape (draw,), DN
    gain_dn: Array
    # log_variance, log_variance_sd: ln of a pixel's variance over signal in DN, and its standard
    # error
    log_variance: float
    log_variance_sd: float
    blur_factor: Array  # draws of the blur factor, shape (draw,)
    white: bool  # whether noise of neighbouring pixels is uncorrelated
    light: Array | None  # light of each level, shape (level,), in `light_unit`; None if unknown
    light_unit: str  # "photon", "lx s" or "lx"
    light_relative_sd: float  # common relative standard deviation of the light
    # signal_dn, signal_sd_dn: mean above the dark and its standard error, shape (level,)
    signal_dn: Array
    signal_sd_dn: Array
    # levels_dn, levels_sd_dn: covariance over signal of each level and its standard error, shape
    # (level,)
    levels_dn: Array
    levels_sd_dn: Array
    variance_dn2: Array  # temporal variance of each level above the dark's, shape (level,)
    # dark_variance_dn2, dark_variance_sd_dn2: temporal variance of its dark and the standard error;
    # None without a dark
    dark_variance_dn2: float | None = None
    dark_variance_sd_dn2: float = 0.0
    dark: str | None = None  # label of the dark
    # possible quantisation noise in variance and covariance over signal, DN, which differs between
    # darks and flats of small noise
    unsure_dn: float = 0.0
    findings: tuple[Finding, ...] = ()  # findings of this setting

    @property
    def stack(self) -> str:
        """Label of the brightest flat, which represents the setting."""
        return self.labels[-1]

    @property
    def log_gain(self) -> tuple[float, float]:
        """ln gain and its standard error."""
        low, middle, high = np.quantile(np.log(np.maximum(self.gain_dn, 1e-12)), [0.16, 0.5, 0.84])
        sd = float(high - low) / (2.0 * 0.994458)
        return float(middle), float(np.hypot(sd, self.unsure_dn / np.exp(middle)))

    @property
    def mean_signal_dn(self) -> float:
        """Mean signal of the covariance gain, weighted by information."""
        weight = 1.0 / np.maximum(self.levels_sd_dn, 1e-12) ** 2
        return float(weight @ self.signal_dn / weight.sum())


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Flats at several settings of one gain control."""

    knob: GainControl  # the varied control
    settings: tuple[SweepSetting, ...]  # settings in order of rising value
    main: float  # value of the setting of the session's single-setting quantities
    left_out: tuple[str, ...] = field(default=())  # notes on excluded settings and stacks


def sweep_of(
    darks: list[StackStatistics], flats: list[StackStatistics], *, context: Context
) -> Sweep | None:
    """Return the gain sweep of flats; None if no control was varied, or the images are too
    small.
    """
    candidates = [(knob, setting_of(flats, knob)) for knob in KNOBS]
    knob, groups = max(candidates, key=lambda entry: len(entry[1]))
    if len(groups) < 2 or min(len(level.bins.modes) for level in (*darks, *flats)) < GAIN.min_bins:
        return None
    swept = {flat.label for _, group in groups for flat in group}
    excluded = [flat.label for flat in flats if flat.label not in swept]
    gains, sentences = (
        [],
        [f"excluded from the sweep of the {knob.words}: {', '.join(excluded)}"] if excluded else [],
    )
    for value, group in groups:
        series = series_of_one_gain(sorted(group, key=lambda level: level.mean_dn), darks)
        reason = gain_obstacle(series)
        if reason is not None:
            sentences.append(f"at {knob.text(value)}: {reason}")
            continue
        context.progress(f"noise at {knob.text(value)}", 0.9)
        gains.append((value, fit_single_setting(series, context=context, quick=True)))
    # At the lowest gains read noise may hide correlated noise.
    white = all(setting_fit.white for _, setting_fit in gains)
    settings = [_setting(value, setting_fit, white, knob, context) for value, setting_fit in gains]
    main = getattr(longest_series(flats)[0].conditions, knob.name)
    return Sweep(
        knob=knob, settings=tuple(settings), main=float(main or 0.0), left_out=tuple(sentences)
    )


def _setting(
    value: float, setting_fit: SingleSetting, white: bool, knob: GainControl, context: Context
) -> SweepSetting:
    """Return the statistics of one setting."""
    series = setting_fit.series
    chosen = np.flatnonzero(series.fitted)
    flats = [series.flats[i] for i in chosen]
    light, unit = _light(flats) if series.reference == "dark" else (None, "")
    carried = setting_fit.at_low_signal(context) if light is None and not white else setting_fit
    log_carried = np.log(
        carried.posterior["covariance_gain"] / setting_fit.posterior["covariance_gain"]
    )
    covariance = setting_fit.levels_dn[chosen]
    signal_sd = [
        np.sqrt(max(gain * signal, 0.0) + 2.0 * series.darks[i].variance_dn2)
        / np.sqrt(flat.pixels * flat.frames)
        for i, flat, gain, signal in zip(
            chosen, flats, covariance, series.signal_dn[chosen], strict=True
        )
    ]
    # Darks of the same setting, as far as stated.
    dark_values = (None, repeatable_value(flats[0].conditions, knob.name))
    darks = [
        dark
        for dark in series.darks
        if series.reference == "dark"
        and dark.variance_dn2 > 0
        and repeatable_value(dark.conditions, knob.name) in dark_values
    ]
    dark = min(darks, key=lambda level: level.conditions.exposure_s or 0.0) if darks else None
    causes = [
        entry for entry in findings_in(series_findings(series)) if entry.flag not in OF_ONE_SERIES
    ] + findings_in(setting_fit.remarks())
    findings = [replace(entry, effect=f"at {knob.text(value)}: {entry.effect}") for entry in causes]
    gain = carried.posterior["covariance_gain"]
    if white:
        # The slope of the photon transfer curve.
        tube = has_intensifier([flat.conditions for flat in series.flats], context)
        allowance = allowance_of(setting_fit.neighbours, setting_fit.exposures, tube=tube)
        gain = emva1288.gain_line(
            series, context=replace(context, quick=True), allowance=allowance
        ).slope
    setting = SweepSetting(
        value=value,
        labels=tuple(flat.label for flat in flats),
        gain_dn=gain,
        log_variance=float(
            np.log(max(setting_fit.summary.variance_dn, 1e-12)) + np.median(log_carried)
        ),
        log_variance_sd=float(
            np.hypot(
                setting_fit.summary.variance_sd_dn / max(setting_fit.summary.variance_dn, 1e-12),
                np.std(log_carried),
            )
        ),
        blur_factor=np.ones(1000) if white else setting_fit.posterior["blur_factor"],
        white=white,
        light=light,
        light_unit=unit,
        light_relative_sd=relative_sd_of(
            [flat.conditions for flat in flats], "photons/px" if unit == "photon" else "lux"
        )[0],
        signal_dn=series.signal_dn[chosen],
        signal_sd_dn=np.array(signal_sd),
        levels_dn=covariance,
        levels_sd_dn=setting_fit.levels_sd_dn[chosen],
        variance_dn2=series.variance_dn2[chosen],
        dark_variance_dn2=None if dark is None else dark.variance_dn2,
        dark_variance_sd_dn2=0.0 if dark is None else dark.variance_sd_dn2,
        dark=None if dark is None else dark.label,
        findings=tuple(findings),
    )
    smallest_variance_dn2 = min(level.variance_dn2 for level in (*series.darks, *flats))
    rounding_fraction = quantisation_fraction(series, setting_fit.summary)
    return (
        _with_quantisation(setting, rounding_fraction, smallest_variance_dn2, knob)
        if rounding_fraction
        else setting
    )


def _with_quantisation(
    s: SweepSetting, rounding_fraction: float, least_dn2: float, knob: GainControl
) -> SweepSetting:
    """Return a setting with the uncertainty and finding of quantisation noise."""
    effect = (
        f"at {knob.text(s.value)}: noise of {np.sqrt(least_dn2):.2g} DN is smaller than the "
        f"quantisation step, which adds {100 * rounding_fraction:.2g} %"
    )
    is_coarse = rounding_fraction > SWEEP.max_quantisation
    return replace(
        s,
        unsure_dn=rounding_fraction * float(np.exp(s.log_variance)),
        log_variance_sd=float(np.hypot(s.log_variance_sd, rounding_fraction)),
        findings=(*s.findings, *([finding("quantised", effect)] if is_coarse else [])),
    )


def _light(flats: list[StackStatistics]) -> tuple[Array | None, str]:
    """Return the light of every flat in one unit; None if one is unknown."""
    known = [flat.conditions for flat in flats]
    photons = [c.photons_per_px for c in known]
    if all(photons):
        return np.array(photons, float), "photon"
    lux = [c.illuminance_lux for c in known]
    if not all(lux):
        return None, ""
    for name, scale in (("gate_ns", 1e-9), ("exposure_s", 1.0)):
        time = [getattr(c, name) for c in known]
        if all(time):
            return np.array(lux, float) * np.array(time, float) * scale, "lx s"
    untimed = all(c.gate_ns is None and c.exposure_s is None for c in known)
    return (np.array(lux, float), "lx") if untimed else (None, "")
