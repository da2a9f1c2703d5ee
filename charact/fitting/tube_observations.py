"""Observations of a camera with a tube: MTF, noise, halo, fixed patterns, levels."""

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from charact.fitting import predicted_quantities
from charact.fitting.mtf_observations import SPREAD, mtf_observations
from charact.fitting.observation import (
    Observation,
    Ridge,
    admissible_measurements,
    scalar_observation,
    sd_of,
)
from charact.fitting.prior import rounds_its_darks
from charact.fitting.thresholds import ERRORS, LIMITS
from charact.fitting.tube_ions import IONS, IonEvents, ions_of
from charact.fitting.tube_pattern_observations import frame_observations
from charact.observables import Values
from charact.observables.stack_level import StackLevel
from labdata import Array, Camera, Measurement, Result, Session

SENSITIVITY = "photocathode.luminous_sensitivity_ua_per_lm"
GAIN = (
    SENSITIVITY,
    "tube.luminous_gain",
    "taper.transmission",
    "ccd.quantum_efficiency",
    "video.conversion_gain_dn_per_e",
)
NOISE = (*GAIN, "microchannel_plate.detection_probability", "microchannel_plate.pulse_height_shape")
SHAPE = (*SPREAD, *NOISE, "tube.post_gain_share")
BLACK = "video.black_level_dn"
STRIP = "microchannel_plate.strip_current_ua_per_cm2"
READ = "ccd.read_noise_e"
LAG = ("phosphor.fast_fraction", "phosphor.fast_decay_ms", "phosphor.slow_decay_ms")
LEVEL = (
    *GAIN,
    "photocathode.ebi_lm_per_cm2",
    STRIP,
    BLACK,
    "taper.demagnification",
    *IONS,
)


@dataclass(frozen=True, kw_only=True)
class _Noise:
    """Noise quantities of one MCP voltage with their joint errors.

    `predict`: from values, photoelectron gain, and blur factor and neighbour correlation; shape (n,
    k).
    """

    mcp_v: float
    value: Array  # shape (k,)
    covariance: Array  # shape (k, k)
    predict: Callable[[Values, Array, tuple[Array, Array]], Array]
    parameters: tuple[str, ...] = NOISE
    # index of a number known far better than the parameters that it depends on
    ridge: int | None = None


def noise_observations(
    session: Session,
    sensor: Camera,
    result: Result,
    levels: tuple[StackLevel, ...],
    shown: Set[str] = frozenset(),
    ions: IonEvents | None = None,
) -> list[Observation]:
    """Observe noise power, variance and image lag of the flats and the variance of darks, by MCP
    voltage.

    `shown`: parameters that the frames have shown by themselves: image lag and darks are not
    observed twice. `ions`: ion events of the dark.
    """
    reference_v = float(sensor.microchannel_plate.reference_v)
    flats = session.of_kind("flat")
    known = [float(entry.conditions.mcp_v) for entry in flats if entry.conditions.mcp_v]
    # Of several voltages, the one with most flats is the session's.
    volts = max(dict.fromkeys(known), key=known.count) if known else reference_v
    gates_s = [level.gate_s for level in levels if not level.dark and level.mcp_v == volts]
    quantised = rounds_its_darks(sensor)
    observations = _of_flats(
        result,
        volts,
        float(np.median(gates_s)) if gates_s else np.inf,
        quantised,
        LAG[0] not in shown,
        ions,
    )
    volts_of = {entry.label: entry.conditions.mcp_v for entry in session.stacks}
    observations += [
        observation
        for observation in _separate(result, volts_of, volts)
        if observation.mcp_v != volts or not observations
    ]
    observations += _neighbours(result, volts)
    darks = [level for level in levels if level.dark]
    if darks and not quantised and READ not in shown:
        dark_of_label = {level.label: level for level in darks}
        reads = admissible_measurements(result, "read_noise", "DN")
        observations += [
            _dark(m, dark_of_label.get(m.stack or "", darks[0]), reference_v) for m in reads
        ]
    return [
        _together(
            [observation for observation in observations if observation.mcp_v == mcp_v],
            mcp_v,
            reference_v,
        )
        for mcp_v in dict.fromkeys(observation.mcp_v for observation in observations)
    ]


def _of_flats(
    result: Result, mcp_v: float, gate_s: float, quantised: bool, lag: bool, ions: IonEvents | None
) -> list[_Noise]:
    """Observe noise power at frequency 0 and lag factor of the pooled flats, and the variance of
    every flat.

    All are those of single exposures, per DN of signal: image lag leaves the fraction s of power
    and variance, and the lag factor is 1/s. Variance over signal is known far better than
    covariance gain and blur factor, whose errors cancel in it. Power is that of the flats pooled by
    their information, S^2/V^2 at the signal S and variance V.
    """
    transfer = result.evidence.get("photon-transfer", {})
    columns = [
        np.asarray(transfer.get(name, ()), float)
        for name in ("signal_dn", "variance_dn2", "dark_variance_dn2", "variance_sd_dn2", "fitted")
    ]
    lags = result.evidence.get("autocorrelation", {}).get("lag_exposures", ())
    # Too few frames to test image lag, which then biases their variance.
    if not len(lags) or not columns[4].any() or not np.isfinite(gate_s):
        return []
    signal, variance, dark, sd = (column[columns[4] > 0] for column in columns[:4])
    pooled_dn = float(np.average(signal, weights=(signal / variance) ** 2))
    # A variance needs no model of the blur: it stays where that of power and lag failed.
    drawn = [
        m.posterior
        for m in admissible_measurements(result, "covariance_gain", "DN")
        if m.stack is None
    ]
    drawn = [
        posterior
        for posterior in drawn
        if posterior is not None and {"power", "lag_factor"} <= set(posterior.names)
    ]
    names = ("power", "lag_factor") if lag else ("power",)
    pooled = np.stack([drawn[0][name] for name in names]) if drawn else np.empty((0, 2))
    slope = (variance - dark) / signal
    value = np.concatenate([np.median(pooled, axis=1), slope])
    # Rounding may hide the noise of a dark; mean and variance of the dark are errors of every flat.
    common = [
        ERRORS.leaning_dn * quantised * slope / signal,
        ERRORS.rounding_dn2 * quantised / signal,
    ]
    if ions is not None:
        # Of few large events, which are removed from one stack and not from another, the variance
        # is unsure by itself.
        common.append(ions.variance_dn2 / signal)
    slope_covariance = np.diag((sd / signal) ** 2) + sum(
        np.outer(sd_of_flats, sd_of_flats) for sd_of_flats in common
    )
    errors = block_diag(np.cov(pooled), slope_covariance) if drawn else slope_covariance
    model = np.full(value.size, ERRORS.noise)
    model[: 1 if drawn else 0] = ERRORS.power
    covariance = np.asarray(errors, np.float64) + np.diag((model * value) ** 2)

    def predict(values: Values, gain: Array, shape: tuple[Array, Array]) -> Array:
        lag_fraction = predicted_quantities.lag_noise_fraction(values, gate_s)
        loss = predicted_quantities.gain_loss

        def power_of(signal_dn: float) -> Array:
            return predicted_quantities.covariance_gain(
                values, lag_fraction * gain * (1.0 - loss(values, signal_dn))
            )

        power = power_of(pooled_dn)
        loaded = gain * (1.0 - loss(values, pooled_dn))
        factor = predicted_quantities.covariance_gain(values, loaded) / power
        slopes = [shape[0] * power_of(flat_signal) for flat_signal in signal]
        first = [power, factor][: len(pooled)]
        return np.stack(np.broadcast_arrays(*first, *slopes), axis=1)

    return [
        _Noise(
            mcp_v=mcp_v,
            value=value,
            covariance=covariance,
            predict=predict,
            parameters=(*SHAPE, *LAG, STRIP),
            ridge=value.size - slope.size,
        )
    ]


def _separate(result: Result, volts_of: Mapping[str, float | None], usual_v: float) -> list[_Noise]:
    """Observe covariance gain and blur factor with independent errors."""
    observations = []
    for quantity, unit, predict, depends in (
        (
            "covariance_gain",
            "DN",
            lambda values, gain, _: predicted_quantities.covariance_gain(values, gain),
            NOISE,
        ),
        ("blur_factor", None, lambda _, __, shape: shape[0], SHAPE),
    ):
        for m in admissible_measurements(result, quantity, unit):
            sd = float(np.hypot(sd_of(m), ERRORS.noise * (m.value or 0.0)))
            at = float(volts_of.get(m.stack or "") or usual_v)
            observations.append(_number(at, m.value or 0.0, sd, predict, depends))
    return observations


def _number(
    mcp_v: float,
    value: float,
    sd: float,
    predict: Callable[[Values, Array, tuple[Array, Array]], Array],
    depends: tuple[str, ...],
) -> _Noise:
    """Return one noise quantity; its prediction has shape (n,)."""
    return _Noise(
        mcp_v=mcp_v,
        value=np.array([value]),
        covariance=np.array([[sd**2]]),
        parameters=depends,
        predict=lambda values, gain, shape: predict(values, gain, shape)[:, None],
    )


def _neighbours(result: Result, volts: float) -> list[_Noise]:
    """Observe the horizontal neighbour correlation of the brightest flat that is neither clipped
    nor saturated.
    """
    measured = result.evidence.get("autocorrelation", {})
    transfer = result.evidence.get("photon-transfer", {})
    columns = [transfer.get(name, ()) for name in ("label", "signal_dn", "fitted")]
    signal = {label: mean for label, mean, fitted in zip(*columns, strict=True) if fitted}
    columns = [
        measured.get(name, ()) for name in ("label", "neighbour_correlation", "neighbour_sd")
    ]
    usable = [
        (signal[label], value, sd)
        for label, value, sd in zip(*columns, strict=True)
        if label in signal
    ]
    return [
        _number(
            volts,
            value,
            float(np.hypot(sd, ERRORS.neighbour)),
            lambda _, __, shape: shape[1],
            SHAPE,
        )
        for _, value, sd in sorted(usable)[-1:]
    ]


def _together(parts: list[_Noise], mcp_v: float, reference_v: float) -> Observation:
    """Combine quantities of one MCP voltage, so that the blur is computed once."""

    def predict(values: Values) -> Array:
        gain = predicted_quantities.photoelectron_gain(values, mcp_v, reference_v)
        shape = predicted_quantities.noise_shape(values, gain)
        predictions = [part.predict(values, gain, shape) for part in parts]
        count = max(len(prediction) for prediction in predictions)
        return np.concatenate(
            [
                np.broadcast_to(prediction, (count, prediction.shape[1]))
                for prediction in predictions
            ],
            axis=1,
        )

    # The numbers of the flats stand first.
    ridge = None
    if parts[0].ridge is not None:
        at = parts[0].ridge

        def number(values: Values) -> Array:
            # A plate that cannot give the signal has no variance: far outside all bounds.
            return np.log(np.maximum(predict(values)[:, at], 1e-300))

        ridge = Ridge(carrier=SENSITIVITY, number=number, slope=-1.0)
    return Observation(
        name="noise",
        value=np.concatenate([part.value for part in parts]),
        covariance=np.asarray(block_diag(*(part.covariance for part in parts)), np.float64),
        predict=predict,
        parameters=tuple(dict.fromkeys(path for part in parts for path in part.parameters)),
        ridge=ridge,
    )


def _dark(m: Measurement, dark: StackLevel, reference_v: float) -> _Noise:
    """Observe the temporal noise of darks: read noise, EBI and ions."""
    variance = (m.value or 0.0) ** 2

    def predict(values: Values, gain: Array, shape: tuple[Array, Array]) -> Array:
        thermal_variance = predicted_quantities.dark_variance(values, gain, shape[0], dark.gate_s)
        return thermal_variance + predicted_quantities.ion_variance(
            values, gain, shape[0], dark.gate_s
        )

    sd = float(np.hypot.reduce([2.0 * (m.value or 0.0) * sd_of(m), ERRORS.noise * variance]))
    depends = (READ, "photocathode.ebi_lm_per_cm2", *IONS, *NOISE)
    return _number(dark.mcp_v, variance, sd, predict, depends)


def tube_observations(
    session: Session, sensor: Camera, result: Result, levels: tuple[StackLevel, ...]
) -> tuple[Observation, ...]:
    """Return the observations in the order MTF, noise, halo, stack means.

    A mildly suspect measurement is used only if there is none with status ok; refused and otherwise
    flagged ones are excluded.
    """
    ions = ions_of(sensor, result, levels)
    frames = frame_observations(sensor, levels, ions)
    shown = {path for observation in frames for path in observation.parameters}
    observations = mtf_observations(session, sensor, result) + noise_observations(
        session, sensor, result, levels, shown, ions
    )
    for m in admissible_measurements(result, "halo_diameter"):
        sd, depends = (
            float(np.hypot(sd_of(m), ERRORS.halo_px)),
            ("photocathode.gap_mm", "taper.demagnification"),
        )
        observations.append(
            scalar_observation(
                "halo diameter", m.value or 0.0, sd, predicted_quantities.halo_diameter_px, depends
            )
        )
    path = "photocathode.halo_fraction"
    for m in admissible_measurements(result, "halo_fraction"):
        observations.append(
            scalar_observation(
                "halo fraction", m.value or 0.0, sd_of(m), lambda values: values[path], (path,)
            )
        )
    observations += _fixed_patterns(sensor, result)
    observations += [_levels(levels, sensor)] if levels else []
    return (*observations, *frames)


def _fixed_patterns(sensor: Camera, result: Result) -> list[Observation]:
    """Observe the relative variance of the fixed pattern; the lines of the multi-fibres are a
    systematic error.
    """
    plates = (sensor.taper.pattern_contrast, sensor.microchannel_plate.pattern_contrast)
    lines = sum(ERRORS.line_area * (plate.high or float(plate)) ** 2 / 2.0 for plate in plates)
    observations = []
    for m in admissible_measurements(result, "prnu", "%"):
        value = 1e-4 * (m.value or 0.0) ** 2
        sd = float(
            np.hypot.reduce([2e-4 * (m.value or 0.0) * sd_of(m), ERRORS.pattern * value, lines])
        )
        depends = ("ccd.prnu", "phosphor.gain_nonuniformity")
        observations.append(
            scalar_observation(
                "fixed pattern", value, sd, predicted_quantities.spatial_variance, depends
            )
        )
    return observations


def _levels(levels: tuple[StackLevel, ...], sensor: Camera) -> Observation:
    """Observe stack means: black level plus gain times photoelectrons; the clamp removes dark
    charge.
    """
    reference_v = float(sensor.microchannel_plate.reference_v)
    lux, gate_s, mcp_v = (
        np.array([getattr(level, name) for level in levels])
        for name in ("illuminance_lux", "gate_s", "mcp_v")
    )
    mean = np.array([level.mean_dn for level in levels])
    level_sd = np.array([level.mean_sd_dn for level in levels])

    def predict(values: Values) -> Array:
        column_values = {path: value[:, None] for path, value in values.items()}
        background = predicted_quantities.background_rate(
            column_values
        ) + predicted_quantities.ion_light(column_values)
        events = (
            predicted_quantities.photoelectrons(column_values, lux, gate_s) + background * gate_s
        )
        gain = predicted_quantities.photoelectron_gain(column_values, mcp_v, reference_v)
        load = predicted_quantities.mcp_load(column_values, lux, gate_s, mcp_v, reference_v)
        return column_values[BLACK] + gain * events / (1.0 + load)

    # With little noise the mean is attracted to whole numbers.
    leaning = np.array(
        [ERRORS.leaning_dn if level.noise_dn < LIMITS.least_noise_dn else 0.0 for level in levels]
    )
    lit = ERRORS.level * np.maximum(mean - mean.min(), 0.0)
    variance = level_sd**2 + ERRORS.black_dn**2 + lit**2 + leaning**2
    extra = ("microchannel_plate.gain_exponent",) if len(set(mcp_v.tolist())) > 1 else ()
    # Black level and EBI together are known far better than either.
    darkest = int(np.argmin(mean))
    ridge = Ridge(carrier=BLACK, number=lambda values: predict(values)[:, darkest], slope=1.0)
    return Observation(
        name="levels",
        value=mean,
        covariance=np.diag(variance),
        predict=predict,
        parameters=(*LEVEL, *extra),
        ridge=ridge,
    )
