"""Observations of a camera with a tube: noise, halo, fixed patterns, levels.

    mu = b + k n / (1 + load),  (s^2 - s_d^2) / mu = B (K + s_l k F^2)

b: black level; n: photoelectrons of light, background and ions; k: signal of a photoelectron at the
voltage of the microchannel plate, whose load lowers it; K: signal of an electron; F^2: excess noise
factor; B: blur factor; s_l: fraction that image lag leaves.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from charact.fitting import predicted_quantities as predicted
from charact.fitting.measured_quantity import Measured, MeasuredQuantity, photon_transfer_of
from charact.fitting.mtf_observations import SPREAD
from charact.fitting.prior import rounds_its_darks
from charact.fitting.stack_levels import SessionStacks
from charact.fitting.thresholds import ERRORS, LIMITS
from charact.fitting.tube_dark_observations import EBI, NoiseBetweenPulses
from charact.fitting.tube_ions import IONS
from charact.fitting.tube_light import field_products
from charact.fitting.tube_time_observations import ImageLag
from charact.frames.image_lag import DECAY
from charact.observables import (
    Case,
    Estimates,
    Observable,
    Ridge,
    Values,
    admissible_measurements,
    columns,
    declare,
    observable,
)
from charact.observables.silicon import BLACK_LEVEL, CONVERSION_GAIN, READ_NOISE
from charact.observables.stack_level import StackLevel
from labdata import Array

SENSITIVITY = "photocathode.luminous_sensitivity_ua_per_lm"
GAIN = (
    SENSITIVITY,
    "tube.luminous_gain",
    "taper.transmission",
    "ccd.quantum_efficiency",
    CONVERSION_GAIN,
)
NOISE = (*GAIN, "microchannel_plate.detection_probability", "microchannel_plate.pulse_height_shape")
SHAPE = (*SPREAD, *NOISE, "tube.post_gain_share")
STRIP = "microchannel_plate.strip_current_ua_per_cm2"
LEVEL = (*GAIN, EBI, STRIP, BLACK_LEVEL, "taper.demagnification", *IONS)
HALO = "photocathode.halo_fraction"
NOISE_LABEL = "noise"


def usual_v(stacks: SessionStacks) -> float:
    """Return the MCP voltage of the session: of several, the one with most flats."""
    conditions = [entry.conditions for entry in stacks.session.of_kind("flat")]
    known = [float(setting.mcp_v) for setting in conditions if setting.mcp_v]
    described_v = float(stacks.camera.microchannel_plate.reference_v)
    return max(dict.fromkeys(known), key=known.count) if known else described_v


@dataclass(frozen=True, kw_only=True)
class FlatNoise:
    """Flats of the session's MCP voltage whose noise is observed."""

    mcp_v: float
    gate_s: float
    signal: Array  # shape (flat,), DN
    pooled_dn: float  # signal of the flats pooled by their information, S^2/V^2
    pooled: int  # numbers of the pooled flats: power at frequency 0, lag factor


@observable
class VarianceOfFlats(Observable[FlatNoise]):
    """Noise power at frequency 0 and lag factor of the pooled flats, and variance over signal of
    every flat.

    All are those of single exposures, per DN of signal: image lag leaves the fraction s of power
    and variance, and the lag factor is 1/s. Variance over signal is known far better than
    covariance gain and blur factor, whose errors cancel in it.
    """

    name = "noise and lag factor"
    order = 60
    tube = True
    unless: tuple[str, ...] = (ImageLag.name,)
    depends = (*SHAPE, *DECAY, STRIP)
    drawn: tuple[str, ...] = ("power", "lag_factor")

    def cases(self, stacks: SessionStacks) -> Iterator[Case[FlatNoise]]:
        """Yield the flats that were fitted, unless too few frames test image lag, which then biases
        their variance.
        """
        mcp_v = usual_v(stacks)
        gates_s = [flat.gate_s for flat in stacks.flats if flat.mcp_v == mcp_v]
        signal, variance, dark, sd = photon_transfer_of(
            stacks, "signal_dn", "variance_dn2", "dark_variance_dn2", "variance_sd_dn2"
        )
        lags = stacks.result.evidence.get("autocorrelation", {}).get("lag_exposures", ())
        if not len(lags) or not signal.size or not gates_s:
            return
        # A variance needs no model of the blur: it stays where that of power and lag failed.
        posteriors = (
            m.posterior
            for m in admissible_measurements(stacks.result, "covariance_gain", "DN")
            if m.stack is None and m.posterior is not None
        )
        draws = [p for p in posteriors if {"power", "lag_factor"} <= set(p.names)][:1]
        pooled = np.array([p[name] for p in draws for name in self.drawn])
        slope, quantised = (variance - dark) / signal, rounds_its_darks(stacks.camera)
        # Errors of every flat: mean and variance of the dark, whose noise rounding may hide; and of
        # few large events, which are removed from one stack and not from another.
        common = [
            ERRORS.leaning_dn * quantised * slope / signal,
            ERRORS.rounding_dn2 * quantised / signal,
            (0.0 if stacks.ions is None else stacks.ions.variance_dn2) / signal,
        ]
        errors = np.diag((sd / signal) ** 2) + sum(
            np.outer(sd_of_flats, sd_of_flats) for sd_of_flats in common
        )
        yield Case(
            estimates=Estimates(
                value=np.concatenate([np.median(pooled, axis=1), slope]) if draws else slope,
                covariance=np.asarray(block_diag(np.cov(pooled), errors) if draws else errors),
            ),
            of=FlatNoise(
                mcp_v=mcp_v,
                gate_s=float(np.median(gates_s)),
                signal=signal,
                pooled_dn=float(np.average(signal, weights=(signal / variance) ** 2)),
                pooled=len(pooled),
            ),
            label=NOISE_LABEL,
        )

    def model_covariance(self, estimates: Estimates, shown: FlatNoise) -> Array:
        model = np.full(estimates.value.size, ERRORS.noise)
        model[: min(shown.pooled, 1)] = ERRORS.power
        return np.diag((model * estimates.value) ** 2)

    def predict(self, values: Values, shown: FlatNoise) -> Array:
        """Return power, lag factor and variances of cameras, shape (n, k)."""
        gain = predicted.photoelectron_gain(values, shown.mcp_v)
        left_by_lag = field_products(values, shown.gate_s, 1)[:, 0]
        blur = predicted.noise_shape(values, gain)[0]

        def loaded(signal_dn: float) -> Array:
            return gain * (1.0 - predicted.gain_loss(values, signal_dn))

        def power_of(signal_dn: float) -> Array:
            return predicted.covariance_gain(values, left_by_lag * loaded(signal_dn))

        power = power_of(shown.pooled_dn)
        lag_factor = predicted.covariance_gain(values, loaded(shown.pooled_dn)) / power
        pooled = [power, lag_factor][: shown.pooled]
        return columns(*pooled, *(blur * power_of(signal) for signal in shown.signal))

    def ridge(self, shown: FlatNoise) -> Ridge:
        """Return the logarithm of the dimmest flat's variance over signal."""

        def number(values: Values) -> Array:
            # A plate that cannot give the signal has no variance: far outside all bounds.
            return np.log(np.maximum(self.predict(values, shown)[:, shown.pooled], 1e-300))

        return Ridge(carrier=SENSITIVITY, number=number, slope=-1.0)


@observable
class VarianceBesideLag(VarianceOfFlats):
    """The same without the lag factor, where frames show image lag by themselves."""

    name = "noise"
    order = 61
    unless = (VarianceOfFlats.name,)
    drawn = ("power",)


def voltage_of(shown: Measured) -> float:
    """Return the MCP voltage of a measurement, that of its stack or of the session."""
    volts_of = {entry.label: entry.conditions.mcp_v for entry in shown.stacks.session.stacks}
    return float(volts_of.get(shown.m.stack or "") or usual_v(shown.stacks))


def _with_flats(shown: Measured) -> bool:
    """Whether variances of flats do not contain a measured gain or blur factor."""
    is_elsewhere = voltage_of(shown) != usual_v(shown.stacks)
    return is_elsewhere or not list(VarianceOfFlats().cases(shown.stacks))


def _gain_of(values: Values, shown: Measured) -> Array:
    return predicted.photoelectron_gain(values, voltage_of(shown))


def _dark_of(shown: Measured) -> StackLevel:
    """Return the dark of a measurement, else the first."""
    darks = shown.stacks.all_darks
    return next((dark for dark in darks if dark.label == shown.m.stack), darks[0])


def _dark_variance(values: Values, shown: Measured) -> Array:
    """Return the temporal variance of a dark: read noise, EBI and ions, shape (n,), DN^2."""
    dark = _dark_of(shown)
    gain = predicted.photoelectron_gain(values, dark.mcp_v)
    blur = predicted.noise_shape(values, gain)[0]
    thermal = predicted.dark_variance(values, gain, blur, dark.gate_s)
    return thermal + predicted.ion_variance(values, gain, blur, dark.gate_s)


def _line_sd(stacks: SessionStacks) -> float:
    """Return the relative variance of the lines of multi-fibres, a systematic error."""
    plates = (
        stacks.camera.taper.pattern_contrast,
        stacks.camera.microchannel_plate.pattern_contrast,
    )
    return sum(ERRORS.line_area * (plate.high or float(plate)) ** 2 / 2.0 for plate in plates)


declare(
    MeasuredQuantity(
        name="covariance gain",
        shown_as=NOISE_LABEL,
        order=62,
        tube=True,
        quantity="covariance_gain",
        unit="DN",
        where=_with_flats,
        number=lambda values, shown: predicted.covariance_gain(values, _gain_of(values, shown)),
        relative_model_sd=ERRORS.noise,
        depends=NOISE,
    ),
    MeasuredQuantity(
        name="blur factor",
        shown_as=NOISE_LABEL,
        order=63,
        tube=True,
        quantity="blur_factor",
        where=_with_flats,
        number=lambda values, shown: predicted.blur_factor(values, _gain_of(values, shown)),
        relative_model_sd=ERRORS.noise,
        depends=SHAPE,
    ),
    MeasuredQuantity(
        name="variance of darks",
        shown_as=NOISE_LABEL,
        order=65,
        tube=True,
        unless=(NoiseBetweenPulses.name,),
        quantity="read_noise",
        unit="DN",
        power=2,
        where=lambda shown: shown.stacks.all_darks and not rounds_its_darks(shown.stacks.camera),
        number=_dark_variance,
        relative_model_sd=ERRORS.noise,
        depends=(READ_NOISE, EBI, *IONS, *NOISE),
    ),
    MeasuredQuantity(
        name="halo diameter",
        order=66,
        tube=True,
        quantity="halo_diameter",
        number=lambda values, shown: predicted.halo_diameter_px(values),
        model_sd=ERRORS.halo_px,
        depends=("photocathode.gap_mm", "taper.demagnification"),
    ),
    MeasuredQuantity(
        name="halo fraction",
        order=67,
        tube=True,
        quantity="halo_fraction",
        number=lambda values, shown: values[HALO],
        depends=(HALO,),
    ),
    MeasuredQuantity(
        name="fixed pattern",
        order=68,
        tube=True,
        quantity="prnu",
        unit="%",
        factor=0.01,
        power=2,
        number=lambda values, shown: predicted.spatial_variance(values),
        relative_model_sd=ERRORS.pattern,
        pattern_sd=_line_sd,
        depends=("ccd.prnu", "phosphor.gain_nonuniformity"),
    ),
)


@observable
class NeighbourCorrelation(Observable[float]):
    """Horizontal neighbour correlation of the brightest flat that is neither clipped nor
    saturated.
    """

    name = "neighbour correlation"
    order = 64
    tube = True
    depends = SHAPE

    def cases(self, stacks: SessionStacks) -> Iterator[Case[float]]:
        """Yield the measured correlation of that flat, at the MCP voltage of the session."""
        transfer, measured = (
            stacks.result.evidence.get(name, {}) for name in ("photon-transfer", "autocorrelation")
        )
        flats = [transfer.get(name, ()) for name in ("label", "signal_dn", "fitted")]
        signal = {label: mean for label, mean, fitted in zip(*flats, strict=True) if fitted}
        names = ("label", "neighbour_correlation", "neighbour_sd")
        usable = [
            (signal[label], value, sd)
            for label, value, sd in zip(*(measured.get(name, ()) for name in names), strict=True)
            if label in signal
        ]
        for _, value, sd in sorted(usable)[-1:]:
            estimates = Estimates.of_number(value, float(np.hypot(sd, ERRORS.neighbour)))
            yield Case(estimates=estimates, of=usual_v(stacks), label=NOISE_LABEL)

    def number(self, values: Values, shown: float) -> Array:
        gain = predicted.photoelectron_gain(values, shown)
        return predicted.noise_shape(values, gain)[1]


@observable
class TubeLevels(Observable[SessionStacks]):
    """Stack means: black level plus gain times photoelectrons; the clamp removes dark charge."""

    name = "levels"
    order = 69
    tube = True

    def usable(self, stacks: SessionStacks) -> SessionStacks | None:
        return stacks if stacks.levels else None

    def measure(self, shown: SessionStacks) -> Estimates:
        """Return the mean of every stack, DN."""
        mean, level_sd = (
            np.array([getattr(level, name) for level in shown.levels])
            for name in ("mean_dn", "mean_sd_dn")
        )
        # With little noise the mean is attracted to whole numbers.
        leaning = [
            ERRORS.leaning_dn * (level.noise_dn < LIMITS.least_noise_dn) for level in shown.levels
        ]
        lit = ERRORS.level * np.maximum(mean - mean.min(), 0.0)
        variance = level_sd**2 + ERRORS.black_dn**2 + lit**2 + np.square(leaning)
        return Estimates(value=mean, covariance=np.diag(variance))

    def predict(self, values: Values, shown: SessionStacks) -> Array:
        """Return the mean of every stack, shape (n, stack), DN."""
        lux, gate_s, mcp_v = (
            np.array([getattr(level, name) for level in shown.levels])
            for name in ("illuminance_lux", "gate_s", "mcp_v")
        )
        values = predicted.in_columns(values)
        background = predicted.background_rate(values) + predicted.ion_light(values)
        events = predicted.photoelectrons(values, lux, gate_s) + background * gate_s
        gain = predicted.photoelectron_gain(values, mcp_v)
        load = predicted.mcp_load(values, lux, gate_s, mcp_v)
        return values[BLACK_LEVEL] + gain * events / (1.0 + load)

    def parameters(self, shown: SessionStacks) -> tuple[str, ...]:
        several = len({level.mcp_v for level in shown.levels}) > 1
        return (*LEVEL, "microchannel_plate.gain_exponent") if several else LEVEL

    def ridge(self, shown: SessionStacks) -> Ridge:
        """Return the level of the darkest stack: black level and EBI together are known far better
        than either.
        """
        darkest = min(shown.levels, key=lambda level: level.mean_dn)
        index = shown.levels.index(darkest)
        return Ridge(
            carrier=BLACK_LEVEL,
            number=lambda values: self.predict(values, shown)[:, index],
            slope=1.0,
        )
